// SPDX-License-Identifier: Apache-2.0
// What an outlet may tell of where things are, now: nothing unless daemon and guard are heard and
// the estimate holds. Pure: no I/O, no clock. Any thread.
//
// It is for eyes. That a pose is told is no permission: a robot acts on holdfast_client alone.
#pragma once

#include <chrono>
#include <cstdint>
#include <optional>

#include <Eigen/Geometry>

#include "rt/observer/observed_state.hpp"

namespace holdfast::outlets {

using std::chrono::nanoseconds;

/// The compensated pose. Lengths in mm.
struct LivePose {
  nanoseconds t_utc{};  ///< the instant it is for
  Eigen::Isometry3d T_robot_ct = Eigen::Isometry3d::Identity();
  Eigen::Vector3d p_target_robot_mm = Eigen::Vector3d::Zero();
  /// tx, ty, tz, rx, ry, rz (mm, rad) in robot axes, about the target.
  Eigen::Matrix<double, 6, 6> covariance = Eigen::Matrix<double, 6, 6>::Zero();
  std::uint32_t counter = 0;  ///< tells one pose from the next
};

/// The site as the camera sees it. Lengths in mm.
struct LiveSite {
  nanoseconds t_utc{};  ///< mid-exposure of its frame
  Eigen::Isometry3d T_camera_site = Eigen::Isometry3d::Identity();
  Eigen::Isometry3d T_site_ct = Eigen::Isometry3d::Identity();
  std::uint64_t frame = 0;
};

/// Nothing unless motion is permitted by daemon and guard, and the pose came with that permission.
[[nodiscard]] std::optional<LivePose> live_pose(const observer::ObservedState& state,
                                                nanoseconds now) noexcept;

/// Nothing unless the tracker follows, the registration is in force, and motion is permitted or
/// lacks nothing but to be armed. Its frame is at most kSiteAgeMax older than the message.
[[nodiscard]] std::optional<LiveSite> live_site(const observer::ObservedState& state,
                                                nanoseconds now) noexcept;

inline constexpr nanoseconds kSiteAgeMax = std::chrono::milliseconds(300);

/// What is new of both, at most so often. One thread.
class LiveFeed {
 public:
  /// Of each kind, 1/s; above 0.
  explicit LiveFeed(double rate_hz);
  [[nodiscard]] std::optional<LivePose> next_pose(const observer::ObservedState& state,
                                                  nanoseconds now) noexcept;
  [[nodiscard]] std::optional<LiveSite> next_site(const observer::ObservedState& state,
                                                  nanoseconds now) noexcept;

 private:
  nanoseconds period_;
  nanoseconds t_pose_{}, t_site_{};
  std::uint32_t counter_ = 0;
  std::uint64_t frame_ = 0;
};

}  // namespace holdfast::outlets
