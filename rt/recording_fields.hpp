// SPDX-License-Identifier: Apache-2.0
// The fields of every recorded struct (bridge/recorder/ros2_message.hpp says how). Each description
// binds all members, so that a new one must be described here before anything compiles. To be
// included by those who write or read recordings only.
#pragma once

#include <algorithm>

#include "rt/recording.hpp"

namespace holdfast::bridge::ros2 {

namespace detail {
inline std::string upper(std::string_view prefix, std::string_view name) {
  std::string text = std::string(prefix) + std::string(name);
  std::transform(text.begin(), text.end(), text.begin(),
                 [](unsigned char c) { return static_cast<char>(std::toupper(c)); });
  return text;
}
/// The codes that have a name.
template <typename E>
std::vector<std::pair<std::string, unsigned>> names(std::string_view prefix) {
  constexpr unsigned kCodes = 64;  // as many as a ReasonSet holds; every enumeration is smaller
  std::vector<std::pair<std::string, unsigned>> list;
  for (unsigned code = 0; code < kCodes; ++code) {
    const std::string_view text = name(static_cast<E>(code));
    if (text != "unknown") list.emplace_back(upper(prefix, text), code);
  }
  return list;
}
}  // namespace detail

template <>
struct EnumNames<safety::Mode> {
  static auto list() { return detail::names<safety::Mode>("MODE_"); }
};
template <>
struct EnumNames<safety::Reason> {
  static auto list() { return detail::names<safety::Reason>("REASON_"); }
};
template <>
struct EnumNames<perception::TrackingStatus> {
  static auto list() { return detail::names<perception::TrackingStatus>("STATUS_"); }
};
template <>
struct EnumNames<perception::TrackingReason> {
  static auto list() { return detail::names<perception::TrackingReason>("TRACKING_"); }
};
template <>
struct EnumNames<safety::Command> {
  static std::vector<std::pair<std::string, unsigned>> list() {
    return {{"COMMAND_NONE", 0}, {"COMMAND_ARM", 1},         {"COMMAND_DISARM", 2},
            {"COMMAND_STOP", 3}, {"COMMAND_ACKNOWLEDGE", 4}, {"COMMAND_CONFIRM", 5}};
  }
};

template <>
struct Wire<safety::ReasonSet> {
  using Type = std::uint64_t;
  static Type to(safety::ReasonSet value) { return value.bits(); }
  static safety::ReasonSet from(Type value) { return safety::ReasonSet{value}; }
};

template <>
struct Description<safety::Limits> {
  static constexpr std::string_view kName = "holdfast_msgs/Limits";
  template <typename Archive, typename Value>
  static void fields(Archive& archive, Value& v) {
    auto& [frame_period, frame_lateness, estimate_age_max, pose_validity, pose_lead,
           robot_silence_max, loop_lateness_max, clock_step_max, frame_future_max, hold_max,
           hold_recovery, confirm_min, confirm_max, drift_max_mm, displacement_max_mm,
           rotation_max_rad, speed_max_mm_per_s, sigma_target_max_mm, zoom_tolerance,
           focus_tolerance_mm, scale_mismatch_max, optics_age_max, inliers_min, inlier_spread_min] =
        v;
    archive("frame_period_ns", frame_period);
    archive("frame_lateness_ns", frame_lateness);
    archive("estimate_age_max_ns", estimate_age_max);
    archive("pose_validity_ns", pose_validity);
    archive("pose_lead_ns", pose_lead);
    archive("robot_silence_max_ns", robot_silence_max);
    archive("loop_lateness_max_ns", loop_lateness_max);
    archive("clock_step_max_ns", clock_step_max);
    archive("frame_future_max_ns", frame_future_max);
    archive("hold_max_ns", hold_max);
    archive("hold_recovery_ns", hold_recovery);
    archive("confirm_min_ns", confirm_min);
    archive("confirm_max_ns", confirm_max);
    archive("drift_max_mm", drift_max_mm);
    archive("displacement_max_mm", displacement_max_mm);
    archive("rotation_max_rad", rotation_max_rad);
    archive("speed_max_mm_per_s", speed_max_mm_per_s);
    archive("sigma_target_max_mm", sigma_target_max_mm);
    archive("zoom_tolerance", zoom_tolerance);
    archive("focus_tolerance_mm", focus_tolerance_mm);
    archive("scale_mismatch_max", scale_mismatch_max);
    archive("optics_age_max_ns", optics_age_max);
    archive("inliers_min", inliers_min);
    archive("inlier_spread_min", inlier_spread_min);
  }
};

template <>
struct Description<rt::PoseFilterParameters> {
  static constexpr std::string_view kName = "holdfast_msgs/FilterParameters";
  template <typename Archive, typename Value>
  static void fields(Archive& archive, Value& v) {
    auto& [acceleration, angular_acceleration, velocity_sigma, angular_velocity_sigma, gate,
           gap_max] = v;
    archive("acceleration_density_mm2_per_s3", acceleration);
    archive("angular_acceleration_density_rad2_per_s3", angular_acceleration);
    archive("velocity_sigma_init_mm_per_s", velocity_sigma);
    archive("angular_velocity_sigma_init_rad_per_s", angular_velocity_sigma);
    archive("innovation_gate_sigma", gate);
    archive("gap_max_ns", gap_max);
  }
};

template <>
struct Description<safety::HandEyeSigma> {
  static constexpr std::string_view kName = "holdfast_msgs/HandEyeSigma";
  template <typename Archive, typename Value>
  static void fields(Archive& archive, Value& v) {
    auto& [t_mm, r_rad] = v;
    archive("t_mm", t_mm);
    archive("r_rad", r_rad);
  }
};

template <>
struct Description<rt::ControlParameters> {
  static constexpr std::string_view kName = "holdfast_msgs/ControlParameters";
  template <typename Archive, typename Value>
  static void fields(Archive& archive, Value& v) {
    auto& [limits, filter, T_robot_camera, hand_eye_sigma, optics_are_fixed, advisories] = v;
    archive("limits", limits);
    archive("filter", filter);
    archive("transform_robot_camera", T_robot_camera);
    archive("hand_eye_sigma", hand_eye_sigma);
    archive("optics_are_fixed", optics_are_fixed);
    archive("advisories", advisories);
  }
};

template <>
struct Description<rt::FrameArrival> {
  static constexpr std::string_view kName = "holdfast_msgs/FrameArrival";
  template <typename Archive, typename Value>
  static void fields(Archive& archive, Value& v) {
    auto& [frame, t_received, t_exposure, faults, is_connected, is_frame] = v;
    archive("frame", frame);
    archive("t_received_ns", t_received);
    archive("t_exposure_ns", t_exposure);
    archive("faults", faults);
    archive("is_connected", is_connected);
    archive("is_frame", is_frame);
  }
};

template <>
struct Description<perception::StageTimes> {
  static constexpr std::string_view kName = "holdfast_msgs/StageTimes";
  template <typename Archive, typename Value>
  static void fields(Archive& archive, Value& v) {
    auto& [mask, detect, match, model, pyramid, align, chain, check, total] = v;
    archive("mask_ns", mask);
    archive("detect_ns", detect);
    archive("match_ns", match);
    archive("model_ns", model);
    archive("pyramid_ns", pyramid);
    archive("align_ns", align);
    archive("chain_ns", chain);
    archive("check_ns", check);
    archive("total_ns", total);
  }
};

template <>
struct Description<perception::MotionEstimate> {
  static constexpr std::string_view kName = "holdfast_msgs/MotionEstimate";
  template <typename Archive, typename Value>
  static void fields(Archive& archive, Value& v) {
    auto& [status, reason, t_exposure, T_camera_site, covariance, p_pivot, dx, dy, rotation, scale,
           features, matches, inliers, inlier_spread, rms, has_frame_to_frame, frame_dx, frame_dy,
           has_drift, drift, zncc, brightness, contrast, noise, has_check, check, check_sigma,
           times] = v;
    archive("status", status);
    archive("reason", reason);
    archive("t_exposure_ns", t_exposure);
    archive("transform_camera_site", T_camera_site);
    archive("covariance", covariance);
    archive("p_pivot_site_mm", p_pivot);
    archive("dx_um", dx);
    archive("dy_um", dy);
    archive("rotation_rad", rotation);
    archive("scale", scale);
    archive("features", features);
    archive("matches", matches);
    archive("inliers", inliers);
    archive("inlier_spread", inlier_spread);
    archive("reprojection_rms_px", rms);
    archive("has_frame_to_frame", has_frame_to_frame);
    archive("frame_to_frame_dx_um", frame_dx);
    archive("frame_to_frame_dy_um", frame_dy);
    archive("has_drift", has_drift);
    archive("drift_um", drift);
    archive("zncc", zncc);
    archive("brightness", brightness);
    archive("contrast", contrast);
    archive("noise_grey", noise);
    archive("has_check", has_check);
    archive("check_um", check);
    archive("check_sigma", check_sigma);
    archive("times", times);
  }
};

template <>
struct Description<rt::StampedEstimate> {
  static constexpr std::string_view kName = "holdfast_msgs/StampedEstimate";
  template <typename Archive, typename Value>
  static void fields(Archive& archive, Value& v) {
    auto& [motion, registration_id, frame, t_frame_received, t_published] = v;
    archive("motion", motion);
    archive("registration_id", registration_id);
    archive("frame", frame);
    archive("t_frame_received_ns", t_frame_received);
    archive("t_published_ns", t_published);
  }
};

template <>
struct Description<safety::RegistrationInput> {
  static constexpr std::string_view kName = "holdfast_msgs/RegistrationInput";
  template <typename Archive, typename Value>
  static void fields(Archive& archive, Value& v) {
    auto& [is_loaded, id, T_site_ct, covariance, p_target, zoom, focus_mm] = v;
    archive("is_loaded", is_loaded);
    archive("id", id);
    archive("transform_site_ct", T_site_ct);
    archive("covariance", covariance);
    archive("p_target_site_mm", p_target);
    archive("zoom", zoom);
    archive("focus_mm", focus_mm);
  }
};

template <>
struct Description<safety::OpticsInput> {
  static constexpr std::string_view kName = "holdfast_msgs/OpticsInput";
  template <typename Archive, typename Value>
  static void fields(Archive& archive, Value& v) {
    auto& [is_declared_fixed, has_report, t_report, faults, is_known, zoom, focus_mm, is_moving] =
        v;
    archive("is_declared_fixed", is_declared_fixed);
    archive("has_report", has_report);
    archive("t_report_ns", t_report);
    archive("faults", faults);
    archive("is_known", is_known);
    archive("zoom", zoom);
    archive("focus_mm", focus_mm);
    archive("is_moving", is_moving);
  }
};

template <>
struct Description<safety::RobotInput> {
  static constexpr std::string_view kName = "holdfast_msgs/RobotInput";
  template <typename Archive, typename Value>
  static void fields(Archive& archive, Value& v) {
    auto& [has_status, t_last_status, has_fault] = v;
    archive("has_status", has_status);
    archive("t_last_status_ns", t_last_status);
    archive("has_fault", has_fault);
  }
};

template <>
struct Description<safety::OperatorInput> {
  static constexpr std::string_view kName = "holdfast_msgs/OperatorInput";
  template <typename Archive, typename Value>
  static void fields(Archive& archive, Value& v) {
    auto& [command, stop_id] = v;
    archive("command", command);
    archive("stop_id", stop_id);
  }
};

template <>
struct Description<safety::LoopInput> {
  static constexpr std::string_view kName = "holdfast_msgs/LoopInput";
  template <typename Archive, typename Value>
  static void fields(Archive& archive, Value& v) {
    auto& [wake_lateness, clock_divergence, message_corrupt, second_publisher, internal_fault] = v;
    archive("wake_lateness_ns", wake_lateness);
    archive("clock_divergence_ns", clock_divergence);
    archive("message_corrupt", message_corrupt);
    archive("second_publisher", second_publisher);
    archive("internal_fault", internal_fault);
  }
};

/// Without the registration, which is a message of its own.
template <>
struct Description<rt::Readings> {
  static constexpr std::string_view kName = "holdfast_msgs/Readings";
  template <typename Archive, typename Value>
  static void fields(Archive& archive, Value& v) {
    auto& [arrivals, arrival_count, estimate, registration, robot_status, optics, operator_command,
           loop] = v;
    (void)registration;
    archive("operator_command", operator_command);
    archive("loop", loop);
    archive("robot_status", robot_status);
    archive("optics", optics);
    archive.list("arrivals", arrivals, arrival_count);
    archive("estimate", estimate);
  }
};

template <>
struct Description<safety::GateState> {
  static constexpr std::string_view kName = "holdfast_msgs/GateState";
  template <typename Archive, typename Value>
  static void fields(Archive& archive, Value& v) {
    auto& [mode, cause, t_mode_entered, t_last_cycle, has_cycle, stop_cause, stop_id,
           t_acknowledged, is_acknowledged, t_hold_entered, hold_cause, t_well_since,
           is_awaiting_good_frame, t_frame_at_fault, registration_id, has_registration,
           t_registration_seen, is_keyframe_verified, t_optics_doubted] = v;
    archive("mode", mode);
    archive("cause", cause);
    archive("t_mode_entered_ns", t_mode_entered);
    archive("t_last_cycle_ns", t_last_cycle);
    archive("has_cycle", has_cycle);
    archive("stop_cause", stop_cause);
    archive("stop_id", stop_id);
    archive("t_acknowledged_ns", t_acknowledged);
    archive("is_acknowledged", is_acknowledged);
    archive("t_hold_entered_ns", t_hold_entered);
    archive("hold_cause", hold_cause);
    archive("t_well_since_ns", t_well_since);
    archive("is_awaiting_good_frame", is_awaiting_good_frame);
    archive("t_frame_at_fault_ns", t_frame_at_fault);
    archive("registration_id", registration_id);
    archive("has_registration", has_registration);
    archive("t_registration_seen_ns", t_registration_seen);
    archive("is_keyframe_verified", is_keyframe_verified);
    archive("t_optics_doubted_ns", t_optics_doubted);
  }
};

template <>
struct Description<rt::PoseFilter::Snapshot> {
  static constexpr std::string_view kName = "holdfast_msgs/FilterState";
  template <typename Archive, typename Value>
  static void fields(Archive& archive, Value& v) {
    auto& [has_state, t, T_camera_site, p_pivot, velocity, covariance, estimate_covariance] = v;
    archive("has_state", has_state);
    archive("t_ns", t);
    archive("transform_camera_site", T_camera_site);
    archive("p_pivot_site_mm", p_pivot);
    archive("velocity", velocity);
    archive("covariance", covariance);
    archive("estimate_covariance", estimate_covariance);
  }
};

template <>
struct Description<safety::CameraInput> {
  static constexpr std::string_view kName = "holdfast_msgs/CameraInput";
  template <typename Archive, typename Value>
  static void fields(Archive& archive, Value& v) {
    auto& [is_connected, has_frame, t_last_frame_received, faults] = v;
    archive("is_connected", is_connected);
    archive("has_frame", has_frame);
    archive("t_last_frame_received_ns", t_last_frame_received);
    archive("faults", faults);
  }
};

template <>
struct Description<safety::TrackingInput> {
  static constexpr std::string_view kName = "holdfast_msgs/TrackingInput";
  template <typename Archive, typename Value>
  static void fields(Archive& archive, Value& v) {
    auto& [has_estimate, is_new, is_lost, is_degraded, registration_id, t_exposure, inliers,
           inlier_spread, has_drift, drift_mm, contradicts_filter, scale] = v;
    archive("has_estimate", has_estimate);
    archive("is_new", is_new);
    archive("is_lost", is_lost);
    archive("is_degraded", is_degraded);
    archive("registration_id", registration_id);
    archive("t_exposure_ns", t_exposure);
    archive("inliers", inliers);
    archive("inlier_spread", inlier_spread);
    archive("has_drift", has_drift);
    archive("drift_mm", drift_mm);
    archive("contradicts_filter", contradicts_filter);
    archive("scale", scale);
  }
};

template <>
struct Description<rt::ControlState> {
  static constexpr std::string_view kName = "holdfast_msgs/ControlState";
  template <typename Archive, typename Value>
  static void fields(Archive& archive, Value& v) {
    auto& [gate, filter, camera, tracking, robot, optics, registration_id, has_registration,
           newest_frame, t_newest_frame_received, t_estimate_published, t_evidence] = v;
    rt::PoseFilter::Snapshot snapshot = filter.snapshot();
    archive("gate", gate);
    archive("filter", snapshot);
    archive("camera", camera);
    archive("tracking", tracking);
    archive("robot", robot);
    archive("optics", optics);
    archive("registration_id", registration_id);
    archive("has_registration", has_registration);
    archive("newest_frame", newest_frame);
    archive("t_newest_frame_received_ns", t_newest_frame_received);
    archive("t_estimate_published_ns", t_estimate_published);
    archive("t_evidence_ns", t_evidence);
    if constexpr (!std::is_const_v<Value>) filter.restore(snapshot);
  }
};

template <>
struct Description<safety::PredictedPose> {
  static constexpr std::string_view kName = "holdfast_msgs/PredictedPose";
  template <typename Archive, typename Value>
  static void fields(Archive& archive, Value& v) {
    auto& [T_camera_site, covariance, speed] = v;
    archive("transform_camera_site", T_camera_site);
    archive("covariance", covariance);
    archive("speed_mm_per_s", speed);
  }
};

template <>
struct Description<rt::RecordedPose> {
  static constexpr std::string_view kName = "holdfast_msgs/ApprovedPose";
  template <typename Archive, typename Value>
  static void fields(Archive& archive, Value& v) {
    auto& [T_robot_ct, covariance, t_pose, validity, registration_id] = v;
    archive("transform_robot_ct", T_robot_ct);
    archive("covariance", covariance);
    archive("t_pose_ns", t_pose);
    archive("validity_ns", validity);
    archive("registration_id", registration_id);
  }
};

template <>
struct Description<rt::RecordedSession> {
  static constexpr std::string_view kName = "holdfast_msgs/Session";
  template <typename Archive, typename Value>
  static void fields(Archive& archive, Value& v) {
    auto& [version, run, part, t_begun, offset, loop_period, checksum, ct, zoom, focus_mm, p_target,
           parameters] = v;
    archive("version", version);
    archive("run", run);
    archive("part", part);
    archive("t_begun_ns", t_begun);
    archive("utc_minus_monotonic_ns", offset);
    archive("loop_period_ns", loop_period);
    archive("registration_checksum", checksum);
    archive("ct", ct);
    archive("zoom", zoom);
    archive("focus_mm", focus_mm);
    archive("p_target_ct_mm", p_target);
    archive("parameters", parameters);
  }
};

template <>
struct Description<rt::RecordedRegistration> {
  static constexpr std::string_view kName = "holdfast_msgs/Registration";
  template <typename Archive, typename Value>
  static void fields(Archive& archive, Value& v) {
    auto& [from_cycle, registration] = v;
    archive("from_cycle", from_cycle);
    archive("registration", registration);
  }
};

template <>
struct Description<rt::TapedState> {
  static constexpr std::string_view kName = "holdfast_msgs/State";
  template <typename Archive, typename Value>
  static void fields(Archive& archive, Value& v) {
    auto& [after, state] = v;
    archive("after_cycle", after);
    archive("state", state);
  }
};

template <>
struct Description<rt::RecordedInput> {
  static constexpr std::string_view kName = "holdfast_msgs/Input";
  template <typename Archive, typename Value>
  static void fields(Archive& archive, Value& v) {
    auto& [cycle, t_scheduled, t_woken, t_decided, t_done, missed, readings] = v;
    archive("cycle", cycle);
    archive("t_scheduled_ns", t_scheduled);
    archive("t_woken_ns", t_woken);
    archive("t_decided_ns", t_decided);
    archive("t_done_ns", t_done);
    archive("missed", missed);
    archive("readings", readings);
  }
};

template <>
struct Description<rt::RecordedDecision> {
  static constexpr std::string_view kName = "holdfast_msgs/Decision";
  template <typename Archive, typename Value>
  static void fields(Archive& archive, Value& v) {
    auto& [cycle, mode, cause, reasons, changed, stop_id, approved, prediction, sigma, t_evidence,
           frame, t_exposure, t_frame_received] = v;
    archive("cycle", cycle);
    archive("mode", mode);
    archive("cause", cause);
    archive("reasons", reasons);
    archive("changed", changed);
    archive("stop_id", stop_id);
    archive("sigma_target_mm", sigma);
    archive("t_evidence_ns", t_evidence);
    archive("frame", frame);
    archive("t_exposure_ns", t_exposure);
    archive("t_frame_received_ns", t_frame_received);
    archive("approved", approved);
    archive("prediction", prediction);
  }
};

template <>
struct Description<rt::RecordedGap> {
  static constexpr std::string_view kName = "holdfast_msgs/Gap";
  template <typename Archive, typename Value>
  static void fields(Archive& archive, Value& v) {
    auto& [first_cycle, count] = v;
    archive("first_cycle", first_cycle);
    archive("count", count);
  }
};

template <>
struct Description<rt::RecordedTime> {
  static constexpr std::string_view kName = "builtin_interfaces/Time";
  template <typename Archive, typename Value>
  static void fields(Archive& archive, Value& v) {
    auto& [sec, nanosec] = v;
    archive("sec", sec);
    archive("nanosec", nanosec);
  }
};

template <>
struct Description<rt::RecordedLog> {
  static constexpr std::string_view kName = "rcl_interfaces/Log";
  template <typename Archive, typename Value>
  static void fields(Archive& archive, Value& v) {
    auto& [stamp, level, name, text, file, function, line] = v;
    archive("stamp", stamp);
    archive("level", level);
    archive("name", name);
    archive("msg", text);
    archive("file", file);
    archive("function", function);
    archive("line", line);
  }
};

}  // namespace holdfast::bridge::ros2
