// SPDX-License-Identifier: Apache-2.0
#include "rt/dashboard/live_answer.hpp"

#include <bit>
#include <cmath>
#include <cstring>
#include <string_view>

#include <nlohmann/json.hpp>
#include <opencv2/imgcodecs.hpp>
#include <opencv2/imgproc.hpp>

#include "perception/motion_estimate.hpp"

namespace holdfast::dashboard {
namespace {

using bridge::LivePicture;
using bridge::LivePoint;
using nlohmann::json;
using std::chrono::nanoseconds;

static_assert(std::endian::native == std::endian::little, "the answer is little-endian");
constexpr int kJpegQuality = 80;

double milliseconds_of(nanoseconds duration) {
  return std::chrono::duration<double, std::milli>(duration).count();
}

json tenths(LivePoint p) {
  return {std::lround(10 * p.x_px), std::lround(10 * p.y_px)};
}

json to_json(const LivePicture& p, nanoseconds now) {
  json points = json::array();
  for (const LivePoint& point : p.points) {
    points.push_back(std::lround(10 * point.x_px));
    points.push_back(std::lround(10 * point.y_px));
  }
  return {{"why", nullptr},
          {"frame", p.frame},
          {"age_ms", milliseconds_of(now - p.t_exposure)},
          {"width_px", p.width_px},
          {"height_px", p.height_px},
          {"status", perception::name(p.status)},
          {"reason", perception::name(p.reason)},
          {"inliers", p.inliers},
          {"visible", p.visible},
          {"points_tenth_px", std::move(points)},
          {"from_tenth_px", p.has_motion ? tenths(p.from) : json()},
          {"to_tenth_px", p.has_motion ? tenths(p.to) : json()}};
}

std::string framed(const std::string& text, std::string_view mask, std::string_view jpeg) {
  const auto number = [](std::size_t n) {
    const auto value = static_cast<std::uint32_t>(n);
    std::string bytes(sizeof value, '\0');
    std::memcpy(bytes.data(), &value, sizeof value);
    return bytes;
  };
  std::string all = "HFL1" + number(text.size()) + number(mask.size());
  all.reserve(all.size() + text.size() + mask.size() + jpeg.size());
  return all.append(text).append(mask).append(jpeg);
}

std::string_view view_of(const std::vector<unsigned char>& bytes) {
  // NOLINTNEXTLINE(cppcoreguidelines-pro-type-reinterpret-cast): bytes as a body's characters
  return {reinterpret_cast<const char*>(bytes.data()), bytes.size()};
}

}  // namespace

LiveAnswer::LiveAnswer(const std::filesystem::path& file) {
  if (!file.empty()) reader_.emplace(file);
}

void LiveAnswer::encode(const LivePicture& picture) {
  if (picture.frame == frame_ && picture.t_exposure == t_exposure_) return;
  const int type = picture.channels == 3 ? CV_8UC3 : CV_8UC1;
  cv::Mat pixels(picture.height_px, picture.width_px, type);
  std::memcpy(pixels.data, picture.pixels.data(), picture.pixels.size());
  if (picture.channels == 3) cv::cvtColor(pixels, pixels, cv::COLOR_RGB2BGR);
  cv::imencode(".jpg", pixels, jpeg_, {cv::IMWRITE_JPEG_QUALITY, kJpegQuality});
  frame_ = picture.frame;
  t_exposure_ = picture.t_exposure;
  ++encoded_;
}

std::string LiveAnswer::compose(bridge::dds::Clocks now) {
  const LivePicture* picture = reader_ ? reader_->look(now) : nullptr;
  if (picture == nullptr) {
    const bool was_seen = reader_ && reader_->t_seen();
    const json none{
        {"why", reader_ ? std::string(sentence(reader_->why())) : "none is set up"},
        {"since_ms",
         was_seen ? json(milliseconds_of(now.monotonic - *reader_->t_seen())) : json()}};
    return framed(none.dump(), {}, {});
  }
  encode(*picture);
  return framed(to_json(*picture, now.monotonic).dump(), view_of(picture->mask), view_of(jpeg_));
}

}  // namespace holdfast::dashboard
