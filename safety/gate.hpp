// SPDX-License-Identifier: Apache-2.0
// The gate: the only place that can construct an approved pose. It refuses by default; an approved
// pose exists only in the cycle in which every condition holds. decide() is a pure function of
// (limits, inputs, state): no clock, no I/O, no heap, noexcept; safe to call on the real-time path.
#pragma once

#include <array>
#include <cstdint>
#include <optional>

#include <Eigen/Geometry>

#include "safety/limits.hpp"
#include "safety/reason.hpp"

namespace holdfast::safety {

using Matrix6d = Eigen::Matrix<double, 6, 6>;

/// init: starting, no input seen yet. unregistered: inputs arrive, no usable registration.
/// ready: registered and verified against the keyframe, not armed. permitted: poses are approved.
/// hold: withdrawn, may recover by itself. stop_latched: withdrawn until acknowledged.
enum class Mode : std::uint8_t { init, unregistered, ready, permitted, hold, stop_latched };
[[nodiscard]] std::string_view name(Mode mode) noexcept;

/// What the camera side reported since the previous cycle.
struct CameraInput {
  bool is_connected = false;
  bool has_frame = false;             ///< at least one frame has arrived since start
  Timestamp t_last_frame_received{};  ///< of the newest complete frame
  ReasonSet faults;                   ///< frame_* and camera_* seen since the previous cycle
};

/// What the tracker reported about the newest frame. Valid only when has_estimate; when is_lost, no
/// number in it is read.
struct TrackingInput {
  bool has_estimate = false;
  bool is_new = false;  ///< the estimate arrived since the previous cycle
  bool is_lost = true;
  bool is_degraded = true;
  std::uint64_t registration_id = 0;  ///< whose keyframe it is measured against
  Timestamp t_exposure{};             ///< mid-exposure of its frame
  int inliers = 0;
  double inlier_spread = 0;  ///< fraction of image cells holding an inlier, 0..1
  bool has_drift = false;    ///< drift_mm was measured; without it the evidence is weak
  double drift_mm = 0;       ///< frame-to-frame chain against the keyframe, at the target; >= 0
  bool contradicts_filter = false;  ///< innovation beyond the filter's gate
  double scale = 1;  ///< of the image relative to the keyframe, as the optics alone explain it; > 0
};

/// The motion filter's pose at Inputs::now. A covariance that was not filled in (a zero on the
/// diagonal) is an invalid number, here and in the registration: nothing is known exactly.
struct PredictedPose {
  Eigen::Isometry3d T_camera_site = Eigen::Isometry3d::Identity();
  Matrix6d covariance =
      Matrix6d::Zero();       ///< tx,ty,tz,rx,ry,rz (mm, rad; camera axes, about the target)
  double speed_mm_per_s = 0;  ///< of the target
};

struct RegistrationInput {
  bool is_loaded = false;
  std::uint64_t id = 0;  ///< from the registration's checksum
  Eigen::Isometry3d T_site_ct = Eigen::Isometry3d::Identity();
  /// tx,ty,tz,rx,ry,rz (mm, rad; site axes): p_site = Exp(r)·R·p_ct + t + dt, as in
  /// registration.json; that is, about the image of the ct origin.
  Matrix6d covariance = Matrix6d::Zero();
  Eigen::Vector3d p_target_site_mm = Eigen::Vector3d::Zero();  ///< where accuracy is judged
  double zoom = 0;      ///< those the registration was made with
  double focus_mm = 0;  ///< working distance
};

/// What the reader of the microscope's encoders reported last. Fixed optics are believed only when
/// they are declared; then nothing else here is read.
struct OpticsInput {
  bool is_declared_fixed = false;
  bool has_report = false;  ///< at least one since start
  Timestamp t_report{};     ///< when the reader last looked
  ReasonSet faults;         ///< microscope_* and can_*, present at that time
  bool is_known = false;    ///< zoom and focus are what the encoders say
  double zoom = 0;
  double focus_mm = 0;
  bool is_moving = false;  ///< a drive runs
};

/// What is not known of the hand-eye calibration: p_robot = Exp(r)·R·p_camera + t + dt, that is,
/// turning about the camera. The sum of both counts; all zero takes T_robot_camera as exact.
struct HandEyeSigma {
  double t_mm = 0;  ///< 1 sigma, alike along all axes
  double r_rad = 0;
  /// tx,ty,tz,rx,ry,rz (mm, rad), fixed robot axes, as measured.
  Matrix6d covariance = Matrix6d::Zero();
};

struct RobotInput {
  bool has_status = false;
  Timestamp t_last_status{};
  bool has_fault = false;
};

/// Operator commands; they arrive as messages with end-to-end protection.
enum class Command : std::uint8_t { none, arm, disarm, stop, acknowledge, confirm };
struct OperatorInput {
  Command command = Command::none;
  std::uint32_t stop_id = 0;  ///< acknowledge and confirm must name the stop they end
};

struct LoopInput {
  Duration wake_lateness{};      ///< of this cycle against its absolute deadline
  Duration clock_divergence{};   ///< change of (UTC - monotonic) since the previous cycle
  bool message_corrupt = false;  ///< an input message failed its end-to-end check since last cycle
  bool second_publisher = false;
  bool internal_fault = false;
};

struct Inputs {
  Timestamp now{};
  CameraInput camera;
  TrackingInput tracking;
  std::optional<PredictedPose> prediction;
  RegistrationInput registration;
  OpticsInput optics;
  RobotInput robot;
  OperatorInput operator_command;
  LoopInput loop;
  Eigen::Isometry3d T_robot_camera = Eigen::Isometry3d::Identity();
  HandEyeSigma hand_eye_sigma;
};

/// What the gate remembers between cycles. Read it freely; only decide() changes it.
struct GateState {
  Mode mode = Mode::init;
  Reason cause = Reason::initialising;  ///< of the previous cycle's decision
  Timestamp t_mode_entered{};
  Timestamp t_last_cycle{};
  bool has_cycle = false;
  Reason stop_cause = Reason::none;  ///< why the latched stop was entered
  std::uint32_t stop_id = 0;         ///< counts stops; names the one to acknowledge
  Timestamp t_acknowledged{};        ///< first step of acknowledgement
  bool is_acknowledged = false;
  Timestamp t_hold_entered{};
  Reason hold_cause = Reason::none;     ///< the newest hold reason of this hold
  Timestamp t_well_since{};             ///< no hold reason since
  bool is_awaiting_good_frame = false;  ///< a camera fault came, no good frame after it yet
  Timestamp t_frame_at_fault{};         ///< newest frame's reception when that fault came
  std::uint64_t registration_id = 0;    ///< the one that is loaded
  bool has_registration = false;        ///< one is loaded
  Timestamp t_registration_seen{};      ///< since when it is loaded
  bool is_keyframe_verified = false;    ///< ... and matched to the live image
  Timestamp t_optics_doubted{};         ///< newest cycle with an optics reason
};

/// A pose a robot may act on until its cycle + validity. Only Gate can make one.
class ApprovedPose {
 public:
  [[nodiscard]] const Eigen::Isometry3d& T_robot_ct() const noexcept { return T_robot_ct_; }
  /// tx,ty,tz,rx,ry,rz (mm, rad; robot axes, about the target).
  [[nodiscard]] const Matrix6d& covariance() const noexcept { return covariance_; }
  /// The instant it is for: its cycle + Limits::pose_lead.
  [[nodiscard]] Timestamp t_pose() const noexcept { return t_pose_; }
  [[nodiscard]] Duration validity() const noexcept { return validity_; }
  [[nodiscard]] std::uint64_t registration_id() const noexcept { return registration_id_; }

 private:
  friend class Gate;
  ApprovedPose() noexcept = default;
  Eigen::Isometry3d T_robot_ct_ = Eigen::Isometry3d::Identity();
  Matrix6d covariance_ = Matrix6d::Zero();
  Timestamp t_pose_{};
  Duration validity_{};
  std::uint64_t registration_id_ = 0;
};

struct Decision {
  Mode mode = Mode::init;
  Reason cause = Reason::initialising;  ///< primary reason why not permitted; none when permitted
  ReasonSet reasons;                    ///< everything that holds in this cycle
  bool changed = false;                 ///< mode or cause differ from the previous cycle
  std::uint32_t stop_id = 0;
  std::optional<ApprovedPose> approved;  ///< only in Mode::permitted
};

class Gate {
 public:
  /// One cycle. Updates `state` in place and returns the decision. noexcept, allocation-free.
  /// Any internal contradiction ends in stop_latched with Reason::internal_fault.
  [[nodiscard]] static Decision decide(const Limits& limits, const Inputs& inputs,
                                       GateState& state) noexcept;
};

}  // namespace holdfast::safety
