// SPDX-License-Identifier: Apache-2.0
#include "perception/keyframe_maker.hpp"

#include <limits>
#include <optional>
#include <utility>

#include "perception/job_thread.hpp"

namespace holdfast::perception {

SiteGeometry seen_from(const CameraModel& camera, const Site& site,
                       const Eigen::Isometry3d& T_camera_site) {
  if (site.is_plane()) return SitePlane{(T_camera_site * site.p_pivot_mm()).z()};
  constexpr int kStride = 4;  // the relief is smooth against it
  constexpr double kHalf = 0.5 * (kStride - 1);
  SiteDepth depth;
  depth.grid = PixelGrid{camera.fx_px / kStride, camera.fy_px / kStride,
                         (camera.cx_px - kHalf) / kStride, (camera.cy_px - kHalf) / kStride};
  depth.depth_mm = cv::Mat(camera.height_px / kStride, camera.width_px / kStride, CV_32FC1,
                           cv::Scalar(std::numeric_limits<double>::quiet_NaN()));
  for (int y = 0; y < depth.depth_mm.rows; ++y) {
    auto* row = depth.depth_mm.ptr<float>(y);
    for (int x = 0; x < depth.depth_mm.cols; ++x) {
      const Eigen::Vector2d ray((x - depth.grid->cx_px) / depth.grid->fx_px,
                                (y - depth.grid->cy_px) / depth.grid->fy_px);
      if (const auto p_site = site.meet(ray, T_camera_site))
        row[x] = static_cast<float>((T_camera_site * *p_site).z());
    }
  }
  return depth;
}

namespace {

std::unique_ptr<TiedKeyframe> make_tied(const KeyframeOrder& order, const CameraModel& camera,
                                        const TrackerParameters& parameters) {
  const SiteGeometry geometry = seen_from(camera, order.site, order.tie.T_tied_first);
  if (invalid_geometry(camera, geometry)) return nullptr;
  DirectKeyframeResult made = make_direct_keyframe(
      {order.image, Site(camera, geometry), order.mask}, order.moving_half, camera, parameters);
  if (!made.keyframe) return nullptr;
  return std::make_unique<TiedKeyframe>(
      TiedKeyframe{std::move(*made.keyframe), order.tie, order.number, 0});
}

}  // namespace

struct KeyframeMaker::Impl {
  CameraModel camera;
  TrackerParameters parameters;
  KeyframeOrder ordered;
  Made made;
  bool is_made = false;             // without a thread: and not taken
  std::optional<JobThread> thread;  // none: made by the owner. Last: it uses all the others

  Impl(const CameraModel& c, const TrackerParameters& p, bool is_threaded)
      : camera(c), parameters(p) {
    camera.distortion = c.distortion.clone();
    if (is_threaded) thread.emplace([this] { work(); });
  }

  void work() {
    ordered.given_up.clear();
    made.keyframe = make_tied(ordered, camera, parameters);
    ordered.site = Site();
  }
};

KeyframeMaker::KeyframeMaker(const CameraModel& camera, const TrackerParameters& parameters,
                             bool is_threaded)
    : impl_(std::make_unique<Impl>(camera, parameters, is_threaded)) {}
KeyframeMaker::~KeyframeMaker() = default;

bool KeyframeMaker::is_idle() const {
  return impl_->thread ? impl_->thread->is_idle() : !impl_->is_made;
}

void KeyframeMaker::order(KeyframeOrder order) {
  order.image = order.image.clone();
  impl_->ordered = std::move(order);
  if (impl_->thread) return impl_->thread->order();
  impl_->work();
  impl_->is_made = true;
}

void KeyframeMaker::wait() {
  if (impl_->thread) impl_->thread->wait();
}

std::optional<KeyframeMaker::Made> KeyframeMaker::take() {
  const bool is_done = impl_->thread ? impl_->thread->take() : std::exchange(impl_->is_made, false);
  if (!is_done) return std::nullopt;
  return std::exchange(impl_->made, Made{});
}

}  // namespace holdfast::perception
