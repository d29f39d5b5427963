// SPDX-License-Identifier: Apache-2.0
// The motion from each frame to the next, cascaded: patches cut from the frame before, not from the
// keyframe. It drifts, as paper B's does; that is what it is for: what does not drift is compared
// with it.
#pragma once

#include <optional>

#include <Eigen/Geometry>

#include "perception/direct_alignment.hpp"
#include "perception/projection.hpp"

namespace holdfast::perception {

class FrameChain {
 public:
  FrameChain(const CameraModel& camera, const TrackerParameters& parameters, Freedom freedom,
             const Eigen::Vector3d& p_pivot_site_mm);

  /// A chain is there: the last frame was cut, and its pose is known.
  [[nodiscard]] bool is_linked() const noexcept { return T_last_.has_value(); }
  [[nodiscard]] const Eigen::Isometry3d& T_last() const noexcept { return *T_last_; }
  [[nodiscard]] int length() const noexcept { return length_; }
  void break_off() noexcept { T_last_.reset(); }

  /// T_camera_site of `image` from the frame before alone; nothing when that one's patches are not
  /// found near `T_start`. Needs is_linked().
  [[nodiscard]] std::optional<Eigen::Isometry3d> follow(const Pyramid& image,
                                                        const Eigen::Isometry3d& T_start);
  /// Cuts patches from `image`, seen from `T_camera_site`, where those of `keyframe` are now.
  /// `is_new`: a new chain starts here.
  void link(const Pyramid& image, const DirectTemplate& keyframe,
            const Eigen::Isometry3d& T_camera_site, bool is_new);
  /// The same chain told in another keyframe's frame of the site.
  void rebase(const Eigen::Isometry3d& T_other_site);

 private:
  Projector projector_;
  DirectParameters parameters_;
  DirectAligner aligner_;
  DirectTemplate patches_;
  std::optional<Eigen::Isometry3d> T_last_;
  int length_ = 0;
};

}  // namespace holdfast::perception
