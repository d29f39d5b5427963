// SPDX-License-Identifier: Apache-2.0
#include "tests/registration/support/real_stereo.hpp"

#include <algorithm>
#include <cmath>
#include <cstring>
#include <fstream>
#include <iterator>
#include <limits>
#include <string>
#include <vector>

#include <opencv2/imgcodecs.hpp>
#include <zlib.h>

namespace holdfast::test {
namespace {

constexpr float kNan = std::numeric_limits<float>::quiet_NaN();

/// The only array of a compressed .npz: a zip of one deflated .npy of floats.
cv::Mat1f read_npz(const std::string& path, cv::Size size) {
  std::ifstream file(path, std::ios::binary);
  std::vector<char> bytes((std::istreambuf_iterator<char>(file)), {});
  if (bytes.size() < 30) return {};
  std::uint16_t name_length = 0, extra_length = 0;
  std::memcpy(&name_length, bytes.data() + 26, 2);
  std::memcpy(&extra_length, bytes.data() + 28, 2);
  const std::size_t start = 30U + name_length + extra_length;
  const std::size_t wanted = static_cast<std::size_t>(size.area()) * sizeof(float);
  std::vector<char> npy(wanted + 4096);
  z_stream stream{};
  if (inflateInit2(&stream, -MAX_WBITS) != Z_OK) return {};
  stream.next_in = reinterpret_cast<Bytef*>(bytes.data() + start);
  stream.avail_in = static_cast<uInt>(bytes.size() - start);
  stream.next_out = reinterpret_cast<Bytef*>(npy.data());
  stream.avail_out = static_cast<uInt>(npy.size());
  const int outcome = inflate(&stream, Z_FINISH);
  const std::size_t found = stream.total_out;
  inflateEnd(&stream);
  if (outcome != Z_STREAM_END || found < wanted) return {};
  cv::Mat1f array(size);
  std::memcpy(array.data, npy.data() + (found - wanted), wanted);  // after npy's header
  return array;
}

}  // namespace

RealStereo motorcycle() {
  const std::string folder = "/usr/lib/python3/dist-packages/skimage/data/motorcycle_";
  RealStereo pair{cv::imread(folder + "left.png", cv::IMREAD_GRAYSCALE),
                  cv::imread(folder + "right.png", cv::IMREAD_GRAYSCALE),
                  {},
                  {0, 80}};
  if (pair.left.empty()) return {};
  pair.truth_px = read_npz(folder + "disp.npz", pair.left.size());
  for (float& d : pair.truth_px)
    if (!std::isfinite(d)) d = kNan;
  return pair;
}

RealStereo aloe() {
  const std::string folder = "/usr/share/doc/opencv-doc/examples/data/aloe";
  RealStereo pair{cv::imread(folder + "L.jpg", cv::IMREAD_GRAYSCALE),
                  cv::imread(folder + "R.jpg", cv::IMREAD_GRAYSCALE),
                  {},
                  {1, 224}};
  const cv::Mat truth = cv::imread(folder + "GT.png", cv::IMREAD_GRAYSCALE);
  if (pair.left.empty() || truth.empty()) return {};
  truth.convertTo(pair.truth_px, CV_32F);
  for (float& d : pair.truth_px)
    if (d == 0) d = kNan;
  return pair;
}

registration::RectifiedPair matchable(const RealStereo& pair,
                                      const registration::MatchParameters& parameters,
                                      registration::DisparityRange range) {
  const cv::Size size = padded_size(parameters, pair.left.size());
  const int largest = range.minimum_px + range.count - 1;
  registration::RectifiedPair result;
  result.left.pixels = cv::Mat1b(size, uchar{0});
  pair.left.copyTo(result.left.pixels(cv::Rect({}, pair.left.size())));
  result.right.pixels = cv::Mat1b(size.height, size.width + range.count, uchar{0});
  const int columns = std::min(pair.right.cols, result.right.pixels.cols - largest);
  pair.right.colRange(0, columns)
      .copyTo(result.right.pixels(cv::Rect(largest, 0, columns, pair.right.rows)));
  result.left.covered.assign(static_cast<std::size_t>(size.height), {0, pair.left.cols});
  result.right.covered.assign(static_cast<std::size_t>(size.height), {largest, largest + columns});
  return result;
}

DisparityErrors errors_of(const cv::Mat1f& disparity_px, const cv::Mat1f& truth_px) {
  std::vector<double> errors;
  double known = 0, bad = 0;
  for (int y = 0; y < truth_px.rows; ++y)
    for (int x = 0; x < truth_px.cols; ++x) {
      if (std::isnan(truth_px(y, x))) continue;
      ++known;
      const double error = static_cast<double>(std::abs(disparity_px(y, x) - truth_px(y, x)));
      if (std::isnan(error)) continue;
      errors.push_back(error);
      if (error > 2) ++bad;
    }
  if (errors.empty()) return {};
  const double matched = static_cast<double>(errors.size());
  const auto middle = errors.begin() + static_cast<std::ptrdiff_t>(errors.size() / 2);
  std::nth_element(errors.begin(), middle, errors.end());
  return {matched / known, bad / matched, (matched - bad) / known, *middle};
}

}  // namespace holdfast::test
