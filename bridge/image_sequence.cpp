// SPDX-License-Identifier: Apache-2.0
#include "bridge/image_sequence.hpp"

#include <algorithm>
#include <array>
#include <cctype>
#include <charconv>
#include <cmath>
#include <filesystem>
#include <fstream>
#include <vector>

#include <opencv2/videoio.hpp>

#include "bridge/image_file.hpp"
#include "rt/core/error.hpp"

namespace holdfast::bridge {
namespace {

namespace fs = std::filesystem;
using std::chrono::nanoseconds;

constexpr double kAssumedRateHz = 30;
constexpr std::size_t kFramesMax = 10'000'000;

bool is_image_name(const fs::path& path) {
  static constexpr std::array kExtensions = {".png",  ".tif", ".tiff", ".jpg",
                                             ".jpeg", ".pgm", ".ppm",  ".bmp"};
  std::string extension = path.extension().string();
  std::transform(extension.begin(), extension.end(), extension.begin(),
                 [](unsigned char c) { return static_cast<char>(std::tolower(c)); });
  return std::find(kExtensions.begin(), kExtensions.end(), extension) != kExtensions.end();
}

std::vector<std::string> images_of(const std::string& folder) {
  std::vector<std::string> files;
  std::error_code error;
  for (const auto& entry : fs::directory_iterator(folder, error))
    if (is_image_name(entry.path()) && !entry.is_directory())
      files.push_back(entry.path().string());
  if (error) throw InputError(folder + ": cannot be read: " + error.message());
  if (files.empty()) throw InputError(folder + ": holds no PNG, TIFF, JPEG, PGM, PPM or BMP image");
  if (files.size() > kFramesMax)
    throw InputError(folder + ": holds more than " + std::to_string(kFramesMax) + " images");
  std::sort(files.begin(), files.end());
  return files;
}

template <typename T>
bool parse_number(std::string_view text, T& value) {
  const auto [end, error] = std::from_chars(text.data(), text.data() + text.size(), value);
  return error == std::errc() && end == text.data() + text.size();
}

/// `frame,t_ns` lines under a header; frames count from 0, times grow.
std::vector<nanoseconds> read_timestamps(const std::string& path) {
  std::ifstream file(path);
  if (!file) throw InputError(path + ": cannot be read");
  std::vector<nanoseconds> times;
  std::string line;
  for (std::size_t number = 1; std::getline(file, line) && number <= kFramesMax; ++number) {
    if (!line.empty() && line.back() == '\r') line.pop_back();
    if (line.empty() || (number == 1 && line == "frame,t_ns")) continue;
    const auto comma = line.find(',');
    std::size_t frame = 0;
    std::int64_t t_ns = 0;
    const std::string where = path + ": line " + std::to_string(number);
    if (comma == std::string::npos ||
        !parse_number(std::string_view(line).substr(0, comma), frame) ||
        !parse_number(std::string_view(line).substr(comma + 1), t_ns))
      throw InputError(where + ": must be frame,t_ns in whole numbers");
    if (frame != times.size())
      throw InputError(where + ": frame is " + std::to_string(frame) + ", must be " +
                       std::to_string(times.size()));
    times.emplace_back(t_ns);
  }
  return times;
}

int bits_holding(const cv::Mat& image) {
  double top = 0;
  cv::minMaxLoc(image, nullptr, &top);
  for (const int bits : {10, 12, 14})
    if (top < std::pow(2, bits)) return bits;
  return 16;
}

}  // namespace

struct ImageSequence::Impl {
  std::string path;
  std::vector<std::string> files;  // of a folder
  cv::VideoCapture video;
  int declared = 0;
  int position = 0;
  double rate_hz = kAssumedRateHz;
  TimeSource time_source = TimeSource::assumed_rate;
  std::vector<nanoseconds> times;
  cv::Size size;
  int type = -1;
  int bits = 0;  // of 16-bit frames, from the first

  void open_video();
  void choose_times(std::optional<double> fps);
  [[nodiscard]] nanoseconds time_of(const std::string& name) const;
  [[nodiscard]] bool read_video(cv::Mat& image);
  [[nodiscard]] cv::Mat to_8_bit(const cv::Mat& image, const std::string& name);
};

void ImageSequence::Impl::open_video() {
  bool is_open = false;
  try {
    // One backend: the others would take the path for a URI or a pattern, and some leak.
    is_open = video.open(path, cv::CAP_FFMPEG);
  } catch (const cv::Exception&) {
    is_open = false;
  }
  if (!is_open) throw InputError(path + ": is neither a folder of images nor a readable video");
  const double count = video.get(cv::CAP_PROP_FRAME_COUNT);
  if (count > 0 && count < static_cast<double>(kFramesMax)) declared = static_cast<int>(count);
}

void ImageSequence::Impl::choose_times(std::optional<double> fps) {
  if (fps) {
    if (!(*fps > 0 && *fps <= 1e5))
      throw InputError("fps is " + std::to_string(*fps) + ", must be above 0 to 100000 frames/s");
    rate_hz = *fps;
    time_source = TimeSource::given_rate;
    return;
  }
  const fs::path folder = files.empty() ? fs::path(path).parent_path() : fs::path(path);
  const std::string beside = (folder / "timestamps.csv").string();
  if (fs::exists(beside)) {
    times = read_timestamps(beside);
    time_source = TimeSource::timestamps_file;
    if (!files.empty() && times.size() != files.size())
      throw InputError(beside + ": has times of " + std::to_string(times.size()) +
                       " frames, must have " + std::to_string(files.size()));
  } else if (files.empty()) {
    const double own = video.get(cv::CAP_PROP_FPS);
    if (own > 0 && own <= 1e5) {
      rate_hz = own;
      time_source = TimeSource::video_rate;
    }
  }
}

nanoseconds ImageSequence::Impl::time_of(const std::string& name) const {
  if (time_source != TimeSource::timestamps_file)
    return nanoseconds(std::llround(position * 1e9 / rate_hz));
  if (static_cast<std::size_t>(position) >= times.size())
    throw InputError(name + ": has no time in timestamps.csv");
  return times[static_cast<std::size_t>(position)];
}

bool ImageSequence::Impl::read_video(cv::Mat& image) {
  cv::Mat frame;
  if (video.read(frame) && !frame.empty()) {
    image = frame.clone();
    return true;
  }
  if (position == 0) throw InputError(path + ": no frame of the video can be decoded");
  if (position < declared)
    throw InputError(path + ": the video ends after " + std::to_string(position) + " of " +
                     std::to_string(declared) + " frames");
  return false;
}

cv::Mat ImageSequence::Impl::to_8_bit(const cv::Mat& image, const std::string& name) {
  if (type < 0) {
    type = image.type();
    size = image.size();
    if (type == CV_16UC1) bits = bits_holding(image);
  }
  if (image.size() != size)
    throw InputError(name + ": is " + std::to_string(image.cols) + "x" +
                     std::to_string(image.rows) + " px, must be " + std::to_string(size.width) +
                     "x" + std::to_string(size.height) + " px as the first frame");
  if (image.type() != type) throw InputError(name + ": is of another type than the first frame");
  if (type == CV_8UC1 || type == CV_8UC3) return image;
  if (type != CV_16UC1)
    throw InputError(name + ": must be 8-bit grey, 8-bit colour or 16-bit grey");
  cv::Mat scaled;
  image.convertTo(scaled, CV_8U, 255.0 / (std::pow(2, bits) - 1));
  return scaled;
}

ImageSequence::ImageSequence(const std::string& path, std::optional<double> fps)
    : impl_(std::make_unique<Impl>()) {
  impl_->path = path;
  std::error_code error;
  if (!fs::exists(path, error)) throw InputError(path + ": is not there");
  if (fs::is_directory(path, error)) {
    impl_->files = images_of(path);
    impl_->declared = static_cast<int>(impl_->files.size());
  } else {
    impl_->open_video();
  }
  impl_->choose_times(fps);
}
ImageSequence::~ImageSequence() = default;

int ImageSequence::size() const noexcept {
  return impl_->declared;
}
TimeSource ImageSequence::time_source() const noexcept {
  return impl_->time_source;
}

std::optional<SequenceFrame> ImageSequence::next() {
  Impl& s = *impl_;
  SequenceFrame frame;
  frame.index = s.position;
  if (s.files.empty()) {
    frame.name = s.path + ": frame " + std::to_string(s.position);
    if (!s.read_video(frame.image)) return std::nullopt;
  } else {
    if (static_cast<std::size_t>(s.position) >= s.files.size()) return std::nullopt;
    frame.name = s.files[static_cast<std::size_t>(s.position)];
    frame.image = read_image_file(frame.name);
  }
  frame.image = s.to_8_bit(frame.image, frame.name);
  frame.t = s.time_of(frame.name);
  ++s.position;
  return frame;
}

}  // namespace holdfast::bridge
