// SPDX-License-Identifier: Apache-2.0
#include "rt/live_view.hpp"

#include <algorithm>
#include <cmath>
#include <utility>

#include <fmt/format.h>
#include <opencv2/imgproc.hpp>

#include "rt/core/error.hpp"

namespace holdfast::rt {
namespace {

using bridge::kLiveMaskCellPx;
using std::chrono::nanoseconds;

/// How much is shown of a side, in pixels of the picture.
int shown_px(int camera_px, int factor) {
  return camera_px / factor / kLiveMaskCellPx * kLiveMaskCellPx;
}

/// Everything about the pictures that stays.
bridge::LivePicture blank(const LiveViewConfig& config, const perception::CameraModel& camera) {
  bridge::LivePicture picture;
  picture.factor = (camera.width_px + config.width_max_px - 1) / config.width_max_px;
  picture.width_px = shown_px(camera.width_px, picture.factor);
  picture.height_px = shown_px(camera.height_px, picture.factor);
  const auto is_side = [](int px) {
    return px >= bridge::kLiveSideMinPx && px <= bridge::kLiveSideMaxPx;
  };
  if (!is_side(picture.width_px) || !is_side(picture.height_px) ||
      picture.factor > bridge::kLiveFactorMax)
    throw InputError(fmt::format(
        "live view: {}x{} px at width_max_px {} make a picture of {}x{}, not {} to {} px a side",
        camera.width_px, camera.height_px, config.width_max_px, picture.width_px, picture.height_px,
        bridge::kLiveSideMinPx, bridge::kLiveSideMaxPx));
  picture.camera_width_px = camera.width_px;
  picture.camera_height_px = camera.height_px;
  picture.fx_px = camera.fx_px;
  picture.fy_px = camera.fy_px;
  picture.cx_px = camera.cx_px;
  picture.cy_px = camera.cy_px;
  picture.points.reserve(bridge::kLivePointsMax);
  return picture;
}

bridge::LivePoint place(const bridge::LivePicture& picture, const Eigen::Vector2d& camera_px) {
  return {picture.of_camera_px(camera_px.x()), picture.of_camera_px(camera_px.y())};
}

}  // namespace

LiveView::LiveView(const LiveViewConfig& config, const perception::CameraModel& camera,
                   const perception::ReflectionMaskParameters& mask)
    : period_(std::llround(1e9 / config.rate_max_hz)),
      camera_(camera),
      projector_(camera),
      mask_parameters_(mask),
      picture_(blank(config, camera)),
      writer_(config.file),
      thread_([this] { make_picture(); }) {}

void LiveView::offer(cv::Mat& image, std::uint64_t frame,
                     const perception::MotionEstimate& estimate,
                     const perception::DirectTracker& tracker) {
  // A frame a little early is the one: at half the camera's rate each second frame would else miss.
  if (estimate.t_exposure + period_ / 8 < t_due_) return;
  (void)thread_.take();
  if (!thread_.is_idle()) return;
  if (image.cols != picture_.camera_width_px || image.rows != picture_.camera_height_px) return;
  t_due_ = std::max(t_due_ + period_, estimate.t_exposure);
  std::swap(image, image_);
  frame_ = frame;
  estimate_ = estimate;
  inliers_ = tracker.inliers(p_inliers_mm_);
  thread_.order();
}

/// Means of factor x factor.
void LiveView::make_pixels() {
  const cv::Rect shown(0, 0, picture_.width_px * picture_.factor,
                       picture_.height_px * picture_.factor);
  const cv::Size size(picture_.width_px, picture_.height_px);
  cv::resize(image_(shown), small_, size, 0, 0, cv::INTER_AREA);
  if (small_.channels() == 3) cv::cvtColor(small_, small_, cv::COLOR_BGR2RGB);
  picture_.channels = small_.channels();
  picture_.pixels.assign(small_.datastart, small_.dataend);
}

/// What the reflection mask takes from this frame: the features that check the tracker are found
/// without it. Half the camera's pixels are its own.
void LiveView::make_mask() {
  const cv::Size size(picture_.width_px / kLiveMaskCellPx, picture_.height_px / kLiveMaskCellPx);
  make_grey_and_mask(image_, mask_parameters_, grey_and_mask_);
  cv::bitwise_not(grey_and_mask_.keep_half, glints_);
  const cv::Rect shown(0, 0, size.width * kLiveMaskCellPx / 2 * picture_.factor,
                       size.height * kLiveMaskCellPx / 2 * picture_.factor);
  cv::resize(glints_(shown), mask_, size, 0, 0, cv::INTER_AREA);
  picture_.mask.assign(mask_.datastart, mask_.dataend);
}

void LiveView::place_tracked() {
  const perception::MotionEstimate& e = estimate_;
  picture_.frame = frame_;
  picture_.status = e.status;
  picture_.reason = e.reason;
  picture_.inliers = e.inliers;
  picture_.visible = e.matches;
  picture_.points.clear();
  const auto add = [this](const Eigen::Vector3d& p_camera_mm) {
    const bridge::LivePoint at = place(picture_, projector_.pixel(p_camera_mm));
    const bool is_inside = at.x_px >= 0 && at.x_px <= static_cast<float>(picture_.width_px - 1) &&
                           at.y_px >= 0 && at.y_px <= static_cast<float>(picture_.height_px - 1);
    if (is_inside) picture_.points.push_back(at);
  };
  for (std::size_t i = 0; i < inliers_; ++i)
    if (p_inliers_mm_[i].z() > 0) add(p_inliers_mm_[i]);
  const Eigen::Vector3d p_now_mm = e.T_camera_site * e.p_pivot_site_mm;
  picture_.has_motion =
      e.status != perception::TrackingStatus::lost && e.p_pivot_site_mm.z() > 0 && p_now_mm.z() > 0;
  picture_.from = picture_.to = {};
  if (!picture_.has_motion) return;
  picture_.from = place(picture_, projector_.pixel(e.p_pivot_site_mm));
  picture_.to = place(picture_, projector_.pixel(p_now_mm));
  picture_.plane_depth_mm = e.p_pivot_site_mm.z();
}

void LiveView::make_picture() {
  make_pixels();
  make_mask();
  place_tracked();
  const bridge::dds::Clocks now = bridge::dds::read_clocks();
  picture_.t_exposure = estimate_.t_exposure;
  picture_.t_utc = now.utc - (now.monotonic - estimate_.t_exposure);
  error_.store(writer_.write(picture_), std::memory_order_relaxed);
}

}  // namespace holdfast::rt
