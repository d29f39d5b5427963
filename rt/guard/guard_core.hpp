// SPDX-License-Identifier: Apache-2.0
// What the guard decides: messages and time in, one answer out. Independent of safety/, perception/
// and the control loop: it shares with the daemon the message definitions and their end-to-end
// protection, nothing else, and has limits of its own. Refuses by default. Pure: no clock, no I/O,
// no heap; noexcept. One thread.
//
// Lengths in mm, angles in rad. p_t is the target in ct (RegistrationInfo.target_ct_mm).
#pragma once

#include <chrono>
#include <cstdint>
#include <string_view>

#include <Eigen/Geometry>

#include "bridge/dds/message_protection.hpp"
#include "bridge/dds/message_types.hpp"
#include "safety/end_to_end.hpp"

namespace holdfast::guard {

using std::chrono::milliseconds;
using std::chrono::nanoseconds;

/// Why the guard does not permit. On the wire: the codes are stable. Of several the lowest is
/// named.
enum class GuardCause : std::uint8_t {
  none = 0,
  robot_disobeys = 1,    ///< the robot is enabled although the guard does not permit; latched
  pose_implausible = 2,  ///< a pose contradicts registration, keyframe or tracking; latched
  pose_jump = 3,         ///< the target moved faster than can be; latched
  message_bad = 4,       ///< a message failed its end-to-end check
  daemon_silent = 5,     ///< no fresh motion-stop message
  health_silent = 6,     ///< no fresh tracking health
  pose_silent = 7,       ///< the daemon permits, but no fresh pose
  pose_old = 8,          ///< the newest pose is extrapolated too far
  robot_silent = 9,      ///< no fresh status of the robot
  robot_fault = 10,      ///< the robot reports a fault
  tracking_lost = 11,    ///< the health says so, whatever the daemon permits
  not_registered = 12,   ///< no registration announced, or not that of the poses
  daemon_not_permitting = 13,
  recovering = 14  ///< all is well, but not for long enough
};
[[nodiscard]] std::string_view name(GuardCause cause) noexcept;  ///< as spelled above

struct GuardLimits {
  nanoseconds daemon_silence_max = milliseconds(8);  ///< motion-stop messages come every 5 ms
  nanoseconds pose_silence_max = milliseconds(5);    ///< poses come every 1 ms
  nanoseconds pose_age_max = milliseconds(120);      ///< exposure to the predicted instant
  nanoseconds health_silence_max = milliseconds(250);
  nanoseconds robot_silence_max = milliseconds(120);
  nanoseconds robot_obeys_within = milliseconds(50);  ///< after permission was withdrawn
  nanoseconds recovery = milliseconds(20);            ///< all must be well this long
  double displacement_max_mm = 18;                    ///< of the target since the keyframe
  double rotation_max_rad = 0.45;                     ///< since the keyframe
  double speed_max_mm_per_s = 60;                     ///< of the target, between two poses
  double pose_step_max_mm = 0.5;                      ///< on top: what one new frame may correct
  double tracking_gap_max_mm = 4;  ///< pose against the newest frame's own estimate, at the target
  double target_error_max_mm = 1e-3;  ///< published target against pose times planned target
};

/// One line naming the first limit out of its sensible range; empty when all are usable. Allocates.
[[nodiscard]] std::string invalid_limit(const GuardLimits& limits);

struct GuardAnswer {
  bool is_permitted = false;
  GuardCause cause = GuardCause::daemon_silent;
  std::uint32_t daemon_source = 0;
  nanoseconds t_changed{};          ///< since when this answer is given
  bool may_stroke_watchdog = true;  ///< false once the robot disobeys: only a reset is left
};

class GuardCore {
 public:
  /// T_robot_camera from the guard's own configuration.
  GuardCore(const GuardLimits& limits, const Eigen::Isometry3d& T_robot_camera) noexcept;

  void take(const msg::MotionStop& message, bridge::dds::Clocks now) noexcept;
  void take(const msg::CompensatedPose& message, bridge::dds::Clocks now) noexcept;
  void take(const msg::TrackingHealth& message, bridge::dds::Clocks now) noexcept;
  void take(const msg::RegistrationInfo& message, bridge::dds::Clocks now) noexcept;
  void take(const msg::RobotStatus& message, bridge::dds::Clocks now) noexcept;

  /// The answer at `now`; time must not go back. Call it at least every millisecond.
  const GuardAnswer& decide(nanoseconds now) noexcept;

 private:
  template <class M>
  [[nodiscard]] bool is_good(const M& message, safety::Receiver& receiver,
                             bridge::dds::Clocks now) noexcept;
  [[nodiscard]] GuardCause content_fault(const msg::CompensatedPose& message) const noexcept;
  [[nodiscard]] GuardCause fault(nanoseconds now) const noexcept;
  void watch_robot(nanoseconds now) noexcept;

  GuardLimits limits_;
  Eigen::Isometry3d T_robot_camera_;
  safety::Receiver stops_, poses_, health_, registrations_, robot_;

  // Newest good messages, and when they were sent or came.
  bool is_daemon_permitting_ = false;
  nanoseconds t_stop_{}, t_pose_{}, t_health_{}, t_robot_{};
  nanoseconds t_permitting_{};  // since when the daemon permits
  nanoseconds t_predicted_{}, pose_age_{};
  std::uint64_t pose_registration_id_ = 0;
  bool has_pose_ = false;
  Eigen::Vector3d p_target_robot_mm_ = Eigen::Vector3d::Zero();
  bool is_tracking_ = false;
  std::uint64_t health_registration_id_ = 0;
  Eigen::Isometry3d T_camera_site_ = Eigen::Isometry3d::Identity();  // the newest frame's own
  bool has_registration_ = false;
  std::uint64_t registration_id_ = 0;
  Eigen::Isometry3d T_site_ct_ = Eigen::Isometry3d::Identity();
  Eigen::Vector3d p_target_ct_mm_ = Eigen::Vector3d::Zero();
  bool is_robot_enabled_ = false, has_robot_fault_ = false;

  bool has_bad_message_ = false;
  GuardCause latched_ = GuardCause::none;  // until the daemon itself has withdrawn permission
  bool has_disobeyed_ = false;             // for good
  nanoseconds t_well_since_{};
  bool was_well_ = false;
  nanoseconds t_enabled_against_us_{};
  bool is_enabled_against_us_ = false;
  GuardAnswer answer_;
};

}  // namespace holdfast::guard
