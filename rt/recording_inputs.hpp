// SPDX-License-Identifier: Apache-2.0
// The fields of what goes into a control step: parameters and readings. As recording_fields.hpp.
#pragma once

#include "rt/recording_names.hpp"

namespace holdfast::bridge::ros2 {

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
    auto& [t_mm, r_rad, covariance] = v;
    archive("t_mm", t_mm);
    archive("r_rad", r_rad);
    archive("covariance", covariance);
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
    auto& [mask, detect, match, model, pyramid, align, chain, check, ties, total] = v;
    archive("mask_ns", mask);
    archive("detect_ns", detect);
    archive("match_ns", match);
    archive("model_ns", model);
    archive("pyramid_ns", pyramid);
    archive("align_ns", align);
    archive("chain_ns", chain);
    archive("check_ns", check);
    archive("ties_ns", ties);
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
           keyframe, has_tie_jump, tie_jump, tie_jump_sigma, times] = v;
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
    archive("keyframe", keyframe);
    archive("has_tie_jump", has_tie_jump);
    archive("tie_jump_um", tie_jump);
    archive("tie_jump_sigma", tie_jump_sigma);
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

}  // namespace holdfast::bridge::ros2
