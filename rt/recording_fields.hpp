// SPDX-License-Identifier: Apache-2.0
// The fields of every recorded struct (bridge/recorder/ros2_message.hpp says how): here those of a
// recording itself, with what they hold in the headers below. Each description binds all members,
// so that a new one must be described before anything compiles. To be included by those who write
// or read recordings only.
#pragma once

#include "rt/recording_state.hpp"

namespace holdfast::bridge::ros2 {

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
