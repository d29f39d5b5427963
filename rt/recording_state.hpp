// SPDX-License-Identifier: Apache-2.0
// The fields of what a control step remembers from one cycle to the next. As recording_fields.hpp.
#pragma once

#include "rt/recording_inputs.hpp"

namespace holdfast::bridge::ros2 {

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

}  // namespace holdfast::bridge::ros2
