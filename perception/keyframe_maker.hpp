// SPDX-License-Identifier: Apache-2.0
// Makes a tied keyframe: the first one's shape seen from another place, and all that direct
// tracking wants of the image taken there. At once, or on a thread of its own that never holds up
// the one that orders.
#pragma once

#include <memory>
#include <optional>
#include <vector>

#include "perception/tied_keyframes.hpp"

namespace holdfast::perception {

/// The site's shape as a camera at T_camera_site sees it, on its undistorted pixel grid at a
/// quarter of the resolution; unknown where the site's is. Of a plane: the plane it sees (planar
/// motion: T turns about z only).
[[nodiscard]] SiteGeometry seen_from(const CameraModel& camera, const Site& site,
                                     const Eigen::Isometry3d& T_camera_site);

struct KeyframeOrder {
  cv::Mat image;
  Site site;                  ///< the first keyframe's
  cv::Mat mask, moving_half;  ///< of the first, as in make_direct_keyframe()
  Tie tie;
  int number = 0;
  std::vector<std::unique_ptr<TiedKeyframe>> given_up;  ///< their memory is given back, first
};

class KeyframeMaker {
 public:
  /// `is_threaded`: starts a thread, with ordinary scheduling and its creator's CPUs.
  KeyframeMaker(const CameraModel& camera, const TrackerParameters& parameters, bool is_threaded);
  ~KeyframeMaker();  ///< waits for the one in work
  KeyframeMaker(const KeyframeMaker&) = delete;
  KeyframeMaker& operator=(const KeyframeMaker&) = delete;

  // One thread at a time.
  [[nodiscard]] bool is_idle() const;
  /// When idle. `order.image` is copied.
  void order(KeyframeOrder order);
  struct Made {
    std::unique_ptr<TiedKeyframe> keyframe;  ///< none: the place cannot serve
  };
  /// The one ordered, once.
  [[nodiscard]] std::optional<Made> take();
  /// Until nothing is in work.
  void wait();

 private:
  struct Impl;
  std::unique_ptr<Impl> impl_;
};

}  // namespace holdfast::perception
