// SPDX-License-Identifier: Apache-2.0
#include "tests/fault/classes.hpp"

#include <array>

namespace holdfast::fault {
namespace {

using safety::Reason;

// Declared bounds, ms, from the requirements.
// A motion that no frame has shown yet: estimate_age_max (docs/safety/hazards.md, "What remains").
constexpr int kUnseen = 90;
// A fault that is there to be seen: the next cycle, the wire, the robot's poll.
constexpr int kSeen = 5;
// Silence on the wire: the validity.
constexpr int kSilence = 20;
// The next frame's deadline (frame_period + frame_lateness) and the longest way of one that is on
// time.
constexpr int kFrame = 41 + 22;
// What one frame shows: exposure to estimate, at worst a frame period after it began.
constexpr int kTracked = 34 + 22;
// The node tells every 20 ms.
constexpr int kTold = 20 + kSeen;
// No heartbeat for 1.5 of its periods, and a look of our reader.
constexpr int kNodeSilence = 30 + kSeen;
// Our own reader says nothing: optics_age_max.
constexpr int kReaderSilence = 50 + kSeen;
constexpr int kRobotSilence = 100 + 10;

constexpr double kFastMmPerS = 25;  // below speed_max: the site runs away while nobody looks

template <Reason R>
void frame_fault(World& w) {
  w.disturbance.frame_faults.insert(R);
  w.disturbance.site_speed_mm_per_s = kFastMmPerS;
}
#define HOLDFAST_SET(...)                            \
  [](World& w) {                                     \
    [[maybe_unused]] Disturbance& d = w.disturbance; \
    __VA_ARGS__;                                     \
  }
/// ... while the site moves on.
#define HOLDFAST_RUN(...) HOLDFAST_SET(__VA_ARGS__; d.site_speed_mm_per_s = kFastMmPerS)

constexpr std::array kClasses = {
    // camera
    FaultClass{"camera_silent", "camera", kUnseen, kFrame, HOLDFAST_RUN(d.is_camera_silent = true)},
    FaultClass{"camera_disconnected", "camera", kUnseen, kSeen,
               HOLDFAST_RUN(d.is_camera_disconnected = true)},
    FaultClass{"frames_skipped", "camera", kUnseen, kFrame + 34,
               HOLDFAST_RUN(d.is_skipping_frames = true)},
    FaultClass{"frames_late", "camera", kUnseen, kFrame,
               HOLDFAST_RUN(d.frame_delay = milliseconds(40))},
    FaultClass{"frame_incomplete", "camera", kUnseen, kFrame,
               frame_fault<Reason::frame_incomplete>},
    FaultClass{"frame_time_invalid", "camera", kUnseen, kFrame,
               frame_fault<Reason::frame_time_invalid>},
    // image content
    FaultClass{"image_frozen", "image", kUnseen, kFrame, HOLDFAST_RUN(d.is_frozen = true)},
    FaultClass{"image_dark", "image", kUnseen, kFrame, frame_fault<Reason::frame_dark>},
    FaultClass{"image_saturated", "image", kUnseen, kFrame, frame_fault<Reason::frame_saturated>},
    FaultClass{"tracking_lost", "image", kUnseen, kTracked, HOLDFAST_RUN(d.is_lost = true)},
    FaultClass{"tracking_degraded", "image", kUnseen, kTracked, HOLDFAST_RUN(d.is_degraded = true)},
    FaultClass{"few_inliers", "image", kUnseen, kTracked, HOLDFAST_RUN(d.has_few_inliers = true)},
    FaultClass{"bunched_inliers", "image", kUnseen, kTracked,
               HOLDFAST_RUN(d.has_bunched_inliers = true)},
    FaultClass{"no_drift_evidence", "image", kUnseen, kTracked,
               HOLDFAST_RUN(d.has_no_drift = true)},
    FaultClass{"tracker_silent", "image", kUnseen, 34 + 90,
               HOLDFAST_RUN(d.is_tracker_silent = true)},
    FaultClass{"tracker_slow", "image", kUnseen, 34 + 90,
               HOLDFAST_RUN(d.tracker_delay = milliseconds(80))},
    FaultClass{"tracker_jumps", "image", kSeen, kTracked,
               HOLDFAST_SET(d.estimate_offset_mm = w.uniform(1, 5))},
    FaultClass{"tracker_jumps_unseen_by_the_check", "image", kSeen, kTracked,
               HOLDFAST_SET(d.estimate_offset_mm = w.uniform(3, 5); d.is_drift_seen = false)},
    FaultClass{"tracker_slides", "image", kSeen, 0,
               HOLDFAST_SET(d.estimate_rate_mm_per_s = w.uniform(1, 8))},
    FaultClass{"tracker_uncertain", "image", kSeen, 200,
               HOLDFAST_SET(d.covariance_scale = w.uniform(60, 200))},
    FaultClass{"estimate_nan", "image", kUnseen, kTracked, HOLDFAST_RUN(d.has_nan = true)},
    FaultClass{"estimate_no_rotation", "image", kUnseen, kTracked,
               HOLDFAST_RUN(d.has_bad_rotation = true)},
    // time
    FaultClass{"exposure_in_the_future", "time", kUnseen, kTracked,
               HOLDFAST_RUN(d.exposure_error = milliseconds(40))},
    FaultClass{"clock_step", "time", kSeen, kSeen, HOLDFAST_RUN(d.has_clock_step = true)},
    FaultClass{"loop_late", "time", kSeen, kSeen, HOLDFAST_RUN(d.wake_lateness = milliseconds(6))},
    FaultClass{"loop_stalled", "time", kSilence, kSilence, HOLDFAST_RUN(d.is_loop_stalled = true)},
    // DDS
    FaultClass{"message_loss", "dds", kSilence, 0, HOLDFAST_SET(d.loss = w.uniform(0.05, 0.5))},
    FaultClass{"message_duplicates", "dds", kSilence, 0,
               HOLDFAST_SET(d.duplicates = w.uniform(0.05, 1))},
    FaultClass{"message_corruption", "dds", kSilence, 0,
               HOLDFAST_SET(d.corruption = w.uniform(0.05, 1))},
    FaultClass{"message_reordering", "dds", kSilence, 0,
               HOLDFAST_SET(d.reordering = w.uniform(0.05, 0.5))},
    FaultClass{"messages_delayed", "dds", kUnseen, kSilence,
               HOLDFAST_RUN(d.wire_delay = milliseconds(30))},
    FaultClass{"cable_cut", "dds", kSilence, kSilence, HOLDFAST_RUN(d.is_cut_to_robot = true)},
    FaultClass{"stops_cut", "dds", kSilence, kSilence + 5, HOLDFAST_RUN(d.is_cut_stops = true)},
    FaultClass{"poses_cut", "dds", kSilence, kSilence, HOLDFAST_RUN(d.is_cut_poses = true)},
    FaultClass{"poses_truncated", "dds", kSeen, kSeen, HOLDFAST_RUN(d.is_truncated = true)},
    FaultClass{"permission_replayed", "dds", kSilence, kSilence,
               HOLDFAST_RUN(d.is_replayed = true; d.is_daemon_dead = true)},
    FaultClass{"second_sender", "dds", kSilence, kSeen, HOLDFAST_RUN(d.is_masqueraded = true)},
    FaultClass{"second_daemon_reported", "dds", kSeen, kSeen,
               HOLDFAST_SET(d.has_second_publisher = true)},
    // processes and memory
    FaultClass{"daemon_dead", "process", kSilence, kSilence, HOLDFAST_RUN(d.is_daemon_dead = true)},
    FaultClass{"publisher_dead", "process", kSilence, kSilence,
               HOLDFAST_RUN(d.is_publisher_dead = true)},
    // Stopped and going on, again and again: what is short may pass unnoticed, if it does no harm.
    FaultClass{"daemon_suspended_briefly", "process", kUnseen, 0,
               HOLDFAST_RUN(d.daemon_pause = milliseconds(w.between(1, 20)))},
    FaultClass{"daemon_suspended", "process", kSilence, kSilence,
               HOLDFAST_RUN(d.daemon_pause = milliseconds(w.between(20, 300)))},
    FaultClass{"guard_dead", "process", kUnseen, kSilence, HOLDFAST_RUN(d.is_guard_dead = true),
               true},
    FaultClass{"guard_suspended_briefly", "process", kUnseen, 0,
               HOLDFAST_RUN(d.guard_pause = milliseconds(w.between(1, 20))), true},
    FaultClass{"guard_suspended", "process", kUnseen, kSilence,
               HOLDFAST_RUN(d.guard_pause = milliseconds(w.between(20, 300))), true},
    FaultClass{"queue_overflow", "memory", kSeen, kSeen, HOLDFAST_SET(d.has_overflow = true)},
    // registration, optics
    FaultClass{"registration_replaced", "registration", kSeen, kSeen,
               HOLDFAST_SET(d.is_registration_replaced = true)},
    FaultClass{"registration_withdrawn", "registration", kSeen, kSeen,
               HOLDFAST_SET(d.is_registration_withdrawn = true)},
    FaultClass{"other_keyframe", "registration", kUnseen, kTracked,
               HOLDFAST_RUN(d.has_other_keyframe = true)},
    FaultClass{"zoom_driven", "optics", kUnseen, kTold,
               HOLDFAST_SET(d.zoom_rate_per_s = w.uniform(0.01, 1); d.is_drive_moving = true)},
    // Until 0.16 % (zoom_tolerance of zoom 1.25) are passed, and told.
    FaultClass{"zoom_turned_by_hand", "optics", kUnseen, kTold + 16,
               HOLDFAST_SET(d.zoom_rate_per_s = w.uniform(0.1, 2))},
    FaultClass{
        "focus_turned", "optics", kUnseen, kTold,
        HOLDFAST_SET(d.focus_step_mm = w.uniform(0.3, 20); d.zoom_step = -d.focus_step_mm / 200)},
    // The encoder says nothing of it: the image's scale does.
    FaultClass{"zoom_moved_silently", "optics", kUnseen, kTracked,
               HOLDFAST_SET(d.zoom_step = w.uniform(0.021, 0.4); d.is_encoder_stuck = true)},
    FaultClass{"zoom_told_wrongly", "optics", kSeen, kTold,
               HOLDFAST_SET(d.encoder_error = w.uniform(0.0025, 0.5))},
    FaultClass{"microscope_silent", "optics", kUnseen, kNodeSilence,
               HOLDFAST_SET(d.is_node_silent = true; d.zoom_rate_per_s = 1)},
    FaultClass{
        "microscope_never_seen", "optics", kUnseen, kSeen,
        HOLDFAST_SET(d.is_reader_restarted = d.is_node_silent = true; d.zoom_rate_per_s = 1)},
    FaultClass{"microscope_restarts", "optics", kUnseen, kTold,
               HOLDFAST_SET(d.is_node_booting = true; d.zoom_rate_per_s = 1)},
    FaultClass{"microscope_corrupt", "optics", kUnseen, kTold,
               HOLDFAST_SET(d.is_node_corrupt = true; d.zoom_rate_per_s = 1)},
    FaultClass{"microscope_skips", "optics", kUnseen, kTold + 20,
               HOLDFAST_SET(d.is_node_skipping = true; d.zoom_rate_per_s = 1)},
    FaultClass{"can_bus_off", "optics", kUnseen, kSeen,
               HOLDFAST_SET(d.is_bus_off = d.is_node_silent = true; d.zoom_rate_per_s = 1)},
    FaultClass{"can_error_passive", "optics", kUnseen, kSeen,
               HOLDFAST_SET(d.is_bus_passive = true)},
    FaultClass{"can_overflow", "optics", kUnseen, kSeen, HOLDFAST_SET(d.is_bus_overflowing = true)},
    FaultClass{"can_down", "optics", kUnseen, kSeen,
               HOLDFAST_SET(d.is_bus_down = true; d.zoom_rate_per_s = 1)},
    FaultClass{"optics_reader_dead", "optics", kUnseen, kReaderSilence,
               HOLDFAST_SET(d.is_reader_dead = true; d.zoom_rate_per_s = w.uniform(0.02, 0.1))},
    // operator, robot
    FaultClass{"operator_stop", "operator", kSeen, kSeen, HOLDFAST_SET(d.is_operator_stop = true)},
    FaultClass{"operator_message_corrupt", "operator", kSeen, kSeen,
               HOLDFAST_SET(d.is_operator_corrupt = true)},
    FaultClass{"robot_fault", "robot", kSeen, kSeen, HOLDFAST_SET(d.has_robot_fault = true)},
    FaultClass{"robot_status_silent", "robot", kSeen, kRobotSilence + kSilence,
               HOLDFAST_SET(d.is_robot_silent = true)},
    FaultClass{"robot_status_cut", "robot", kSeen, kRobotSilence + kSilence,
               HOLDFAST_SET(d.is_cut_from_robot = true)},
    // the patient
    FaultClass{"patient_knocked", "patient", kUnseen, 0,
               HOLDFAST_SET(d.site_jump_mm = w.uniform(1, 6))},
    FaultClass{"patient_moves_fast", "patient", kUnseen, kUnseen + 100,
               HOLDFAST_SET(d.site_speed_mm_per_s = w.uniform(35, 200))},
    FaultClass{"patient_moves", "patient", kUnseen, 0,
               HOLDFAST_SET(d.site_speed_mm_per_s = w.uniform(5, 29))},
    FaultClass{"patient_turns", "patient", kUnseen, 0,
               HOLDFAST_SET(d.site_turn_rad_per_s = w.uniform(0.05, 1))},
};

#undef HOLDFAST_SET
#undef HOLDFAST_RUN

}  // namespace

std::span<const FaultClass> fault_classes() {
  return kClasses;
}

}  // namespace holdfast::fault
