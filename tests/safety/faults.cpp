// SPDX-License-Identifier: Apache-2.0
#include "tests/safety/faults.hpp"

#include <cmath>
#include <limits>

namespace holdfast::safety::test {
namespace {

using std::chrono::nanoseconds;

constexpr double kNan = std::numeric_limits<double>::quiet_NaN();
constexpr double kInfinity = std::numeric_limits<double>::infinity();
/// For values that reach their comparison through sines and square roots.
constexpr double kRounding = 1e-12;

using In = Inputs;
using Lim = Limits;

double beyond(double limit) {
  return std::nextafter(limit, kInfinity);
}

void set_displacement(Inputs& in, double mm) {
  in.prediction->T_camera_site.translation() = Eigen::Vector3d(0, mm, 0);
}

/// About the camera's axis through the target, so that the target stays where it is.
void set_rotation(Inputs& in, double rad) {
  in.registration.p_target_site_mm = Eigen::Vector3d(0, 0, 200);
  in.prediction->T_camera_site = Eigen::AngleAxisd(rad, Eigen::Vector3d::UnitZ());
}

/// Half the variance from each source; the registration's rotation has no lever.
void set_sigma(Inputs& in, double mm) {
  in.registration.T_site_ct.translation() = in.registration.p_target_site_mm;
  in.registration.covariance(0, 0) = in.prediction->covariance(0, 0) = 0.5 * mm * mm;
}

Fault camera_fault(const std::string& name, Reason reason) {
  return {name, reason, "SR-05", [reason](In& in, const Lim&) { in.camera.faults.insert(reason); }};
}

Fault optics_fault(const std::string& name, Reason reason) {
  return {name, reason, "SR-97", [reason](In& in, const Lim&) { in.optics.faults.insert(reason); }};
}

Fault bad_number(const std::string& name, const std::function<void(Inputs&)>& spoil) {
  return {name, Reason::invalid_number, "SR-03", [spoil](In& in, const Lim&) { spoil(in); }};
}

std::vector<Fault> bad_numbers() {
  return {
      bad_number("PredictedTranslationNan",
                 [](In& in) { in.prediction->T_camera_site(0, 3) = kNan; }),
      bad_number("PredictedTranslationInfinite",
                 [](In& in) { in.prediction->T_camera_site(2, 3) = kInfinity; }),
      bad_number("PredictedRotationNan", [](In& in) { in.prediction->T_camera_site(1, 0) = kNan; }),
      bad_number("PredictedRotationScaled",
                 [](In& in) { in.prediction->T_camera_site.linear() *= 1.001; }),
      bad_number("PredictedRotationMirrored",
                 [](In& in) { in.prediction->T_camera_site(2, 2) = -1; }),
      bad_number("PredictedLastRow", [](In& in) { in.prediction->T_camera_site(3, 0) = 1e-3; }),
      bad_number("PredictedCovarianceNan", [](In& in) { in.prediction->covariance(4, 4) = kNan; }),
      bad_number("PredictedCovarianceUnfilled",
                 [](In& in) { in.prediction->covariance.setZero(); }),
      bad_number("PredictedCovarianceNegative",
                 [](In& in) { in.prediction->covariance(0, 0) = -1e-4; }),
      bad_number("PredictedCovarianceAsymmetric",
                 [](In& in) { in.prediction->covariance(0, 1) = 5e-5; }),
      bad_number("PredictedCovarianceIndefinite",
                 [](In& in) {
                   in.prediction->covariance(0, 1) = in.prediction->covariance(1, 0) = 1.1e-4;
                 }),
      bad_number("SpeedNan", [](In& in) { in.prediction->speed_mm_per_s = kNan; }),
      bad_number("SpeedNegative", [](In& in) { in.prediction->speed_mm_per_s = -1; }),
      bad_number("RegistrationTranslationNan",
                 [](In& in) { in.registration.T_site_ct(1, 3) = kNan; }),
      bad_number("RegistrationRotationSkewed",
                 [](In& in) { in.registration.T_site_ct(0, 1) = 1e-4; }),
      bad_number("RegistrationCovarianceInfinite",
                 [](In& in) { in.registration.covariance(3, 3) = kInfinity; }),
      bad_number("RegistrationCovarianceUnfilled",
                 [](In& in) { in.registration.covariance.setZero(); }),
      bad_number("TargetNan", [](In& in) { in.registration.p_target_site_mm.y() = kNan; }),
      bad_number("SpreadNan", [](In& in) { in.tracking.inlier_spread = kNan; }),
      bad_number("SpreadAboveOne", [](In& in) { in.tracking.inlier_spread = 1.5; }),
      bad_number("DriftNan", [](In& in) { in.tracking.drift_mm = kNan; }),
      bad_number("DriftNegative", [](In& in) { in.tracking.drift_mm = -0.1; }),
      bad_number("RobotTransformNan", [](In& in) { in.T_robot_camera(0, 0) = kNan; }),
      bad_number("RobotTransformZero", [](In& in) { in.T_robot_camera.matrix().setZero(); }),
      bad_number("ScaleNan", [](In& in) { in.tracking.scale = kNan; }),
      bad_number("ScaleNegative", [](In& in) { in.tracking.scale = -1; }),
      bad_number("ZoomNan", [](In& in) { in.optics.zoom = kNan; }),
      bad_number("ZoomNegative", [](In& in) { in.optics.zoom = -1.25; }),
      bad_number("FocusInfinite", [](In& in) { in.optics.focus_mm = kInfinity; }),
      bad_number("RegistrationZoomNan", [](In& in) { in.registration.zoom = kNan; }),
      bad_number("RegistrationFocusNegative", [](In& in) { in.registration.focus_mm = -200; }),
      bad_number("HandEyeSigmaNan", [](In& in) { in.hand_eye_sigma.t_mm = kNan; }),
      bad_number("HandEyeCovarianceNan", [](In& in) { in.hand_eye_sigma.covariance(4, 4) = kNan; }),
      bad_number("HandEyeCovarianceHalfFilledIn",
                 [](In& in) { in.hand_eye_sigma.covariance(0, 0) = 1e-4; }),
      bad_number("HandEyeSigmaNegative", [](In& in) { in.hand_eye_sigma.r_rad = -1e-4; }),
  };
}

std::vector<Fault> events() {
  return {
      {"OperatorStop", Reason::operator_stop, "SR-21",
       [](In& in, const Lim&) { in.operator_command.command = Command::stop; }},
      {"UnknownCommand", Reason::message_corrupt, "SR-20",
       [](In& in, const Lim&) { in.operator_command.command = static_cast<Command>(6); }},
      {"MessageCorrupt", Reason::message_corrupt, "SR-20",
       [](In& in, const Lim&) { in.loop.message_corrupt = true; }},
      {"SecondPublisher", Reason::second_publisher, "SR-19",
       [](In& in, const Lim&) { in.loop.second_publisher = true; }},
      {"InternalFault", Reason::internal_fault, "SR-28",
       [](In& in, const Lim&) { in.loop.internal_fault = true; }},
      {"ZoomChanged", Reason::optics_changed, "SR-16",
       [](In& in, const Lim&) {
         in.optics.zoom = 1.5;
         in.tracking.scale = 1.2;
       }},
      {"FocusChanged", Reason::optics_changed, "SR-16",
       [](In& in, const Lim&) { in.optics.focus_mm = 250; }},
      {"OpticsMoving", Reason::optics_moving, "SR-97",
       [](In& in, const Lim&) { in.optics.is_moving = true; }},
      {"OpticsNeverTold", Reason::microscope_missing, "SR-97",
       [](In& in, const Lim&) { in.optics = OpticsInput{}; }},
      {"OpticsUnknown", Reason::microscope_silent, "SR-97",
       [](In& in, const Lim&) { in.optics.is_known = false; }},
      optics_fault("MicroscopeMissing", Reason::microscope_missing),
      optics_fault("MicroscopeNotOperational", Reason::microscope_not_operational),
      optics_fault("MicroscopeSilent", Reason::microscope_silent),
      optics_fault("MicroscopeCorrupt", Reason::microscope_corrupt),
      optics_fault("CanBusOff", Reason::can_bus_off),
      optics_fault("CanErrorPassive", Reason::can_error_passive),
      optics_fault("CanOverflow", Reason::can_overflow),
      optics_fault("CanDown", Reason::can_down),
      {"OpticsFaultThatIsNoFault", Reason::internal_fault, "SR-28",
       [](In& in, const Lim&) { in.optics.faults.insert(Reason::frame_dark); }},
      {"ScaleOfNoZoom", Reason::scale_mismatch, "SR-99",
       [](In& in, const Lim&) { in.tracking.scale = 1.25; }},
      {"ScaleOfFixedOptics", Reason::scale_mismatch, "SR-99",
       [](In& in, const Lim&) {
         in.optics = OpticsInput{};
         in.optics.is_declared_fixed = true;
         in.tracking.scale = 0.9;
       }},
      {"RobotFault", Reason::robot_fault, "SR-18",
       [](In& in, const Lim&) { in.robot.has_fault = true; }},
      {"RobotNeverHeard", Reason::robot_silent, "SR-17",
       [](In& in, const Lim&) { in.robot = RobotInput{}; }},
      {"Disconnected", Reason::camera_disconnected, "SR-05",
       [](In& in, const Lim&) { in.camera.is_connected = false; }},
      camera_fault("CameraDisconnectedEvent", Reason::camera_disconnected),
      camera_fault("FrameLateEvent", Reason::frame_late),
      camera_fault("FrameIncomplete", Reason::frame_incomplete),
      camera_fault("FrameGap", Reason::frame_gap),
      camera_fault("FrameFrozen", Reason::frame_frozen),
      camera_fault("FrameDark", Reason::frame_dark),
      camera_fault("FrameSaturated", Reason::frame_saturated),
      camera_fault("FrameTimeInvalid", Reason::frame_time_invalid),
      {"FaultThatIsNoFault", Reason::internal_fault, "SR-28",
       [](In& in, const Lim&) { in.camera.faults.insert(Reason::not_armed); }},
      {"NeverTracked", Reason::tracking_lost, "SR-06",
       [](In& in, const Lim&) { in.tracking = TrackingInput{}; }},
      {"TrackingLost", Reason::tracking_lost, "SR-06",
       [](In& in, const Lim&) { in.tracking.is_lost = true; }},
      {"TrackingLostWithGarbage", Reason::tracking_lost, "SR-06",
       [](In& in, const Lim&) {
         in.tracking.is_lost = true;
         in.tracking.drift_mm = in.tracking.inlier_spread = kNan;
       }},
      {"OtherKeyframe", Reason::tracking_lost, "SR-35",
       [](In& in, const Lim&) { in.tracking.registration_id ^= 1U; }},
      {"NoPrediction", Reason::tracking_lost, "SR-06",
       [](In& in, const Lim&) { in.prediction.reset(); }},
      {"TrackingDegraded", Reason::tracking_degraded, "SR-06",
       [](In& in, const Lim&) { in.tracking.is_degraded = true; }},
      {"DriftUnknown", Reason::tracking_weak, "SR-06",
       [](In& in, const Lim&) { in.tracking.has_drift = false; }},
      {"PoseJump", Reason::pose_jump, "SR-11",
       [](In& in, const Lim&) { in.tracking.contradicts_filter = true; }},
      {"EstimateFromTheBeginningOfTime", Reason::estimate_stale, "SR-07",
       [](In& in, const Lim&) { in.tracking.t_exposure = Timestamp::min(); }},
      {"FrameFromTheEndOfTime", Reason::frame_time_invalid, "SR-07",
       [](In& in, const Lim&) { in.camera.t_last_frame_received = Timestamp::max(); }},
  };
}

LimitCase time_limit(const std::string& name, Reason reason, const std::string& requirement,
                     const std::function<void(Inputs&, const Limits&, nanoseconds)>& set) {
  return {name, reason, requirement,
          [set](In& in, const Lim& limits) { set(in, limits, nanoseconds(0)); },
          [set](In& in, const Lim& limits) { set(in, limits, nanoseconds(1)); }};
}

LimitCase real_limit(const std::string& name, Reason reason, const std::string& requirement,
                     double Limits::*limit, double rounding,
                     const std::function<void(Inputs&, double)>& set) {
  return {name, reason, requirement,
          [=](In& in, const Lim& limits) { set(in, limits.*limit * (1 - rounding)); },
          [=](In& in, const Lim& limits) { set(in, beyond(limits.*limit * (1 + rounding))); }};
}

std::vector<LimitCase> time_limits() {
  using Ns = nanoseconds;
  return {
      time_limit("FrameDeadline", Reason::frame_late, "SR-04",
                 [](In& in, const Lim& limits, Ns more) {
                   in.camera.t_last_frame_received =
                       in.now - limits.frame_period - limits.frame_lateness - more;
                 }),
      time_limit("FrameReceivedAhead", Reason::frame_time_invalid, "SR-07",
                 [](In& in, const Lim& limits, Ns more) {
                   in.camera.t_last_frame_received = in.now + limits.frame_future_max + more;
                 }),
      time_limit("EstimateAge", Reason::estimate_stale, "SR-07",
                 [](In& in, const Lim& limits, Ns more) {
                   in.tracking.t_exposure = in.now - limits.estimate_age_max - more;
                 }),
      time_limit("ExposureAhead", Reason::frame_time_invalid, "SR-07",
                 [](In& in, const Lim& limits, Ns more) {
                   in.tracking.t_exposure = in.now + limits.frame_future_max + more;
                 }),
      time_limit("RobotSilence", Reason::robot_silent, "SR-17",
                 [](In& in, const Lim& limits, Ns more) {
                   in.robot.t_last_status = in.now - limits.robot_silence_max - more;
                 }),
      time_limit("RobotStatusAhead", Reason::robot_silent, "SR-17",
                 [](In& in, const Lim& limits, Ns more) {
                   in.robot.t_last_status = in.now + limits.frame_future_max + more;
                 }),
      time_limit("OpticsAge", Reason::microscope_silent, "SR-97",
                 [](In& in, const Lim& limits, Ns more) {
                   in.optics.t_report = in.now - limits.optics_age_max - more;
                 }),
      time_limit("OpticsReportAhead", Reason::microscope_silent, "SR-97",
                 [](In& in, const Lim& limits, Ns more) {
                   in.optics.t_report = in.now + limits.frame_future_max + more;
                 }),
      time_limit("LoopLateness", Reason::loop_overrun, "SR-14",
                 [](In& in, const Lim& limits, Ns more) {
                   in.loop.wake_lateness = limits.loop_lateness_max + more;
                 }),
      time_limit("ClockStepForward", Reason::clock_step, "SR-13",
                 [](In& in, const Lim& limits, Ns more) {
                   in.loop.clock_divergence = limits.clock_step_max + more;
                 }),
      time_limit("ClockStepBack", Reason::clock_step, "SR-13",
                 [](In& in, const Lim& limits, Ns more) {
                   in.loop.clock_divergence = -limits.clock_step_max - more;
                 }),
  };
}

std::vector<LimitCase> other_limits() {
  return {
      real_limit("Drift", Reason::drift_exceeded, "SR-08", &Limits::drift_max_mm, 0,
                 [](In& in, double mm) { in.tracking.drift_mm = mm; }),
      real_limit("Displacement", Reason::displacement_exceeded, "SR-09",
                 &Limits::displacement_max_mm, kRounding, set_displacement),
      real_limit("Rotation", Reason::displacement_exceeded, "SR-33", &Limits::rotation_max_rad,
                 kRounding, set_rotation),
      real_limit("Speed", Reason::speed_exceeded, "SR-10", &Limits::speed_max_mm_per_s, 0,
                 [](In& in, double speed) { in.prediction->speed_mm_per_s = speed; }),
      real_limit("Sigma", Reason::covariance_exceeded, "SR-12", &Limits::sigma_target_max_mm,
                 kRounding, set_sigma),
      real_limit("Zoom", Reason::optics_changed, "SR-16", &Limits::zoom_tolerance, kRounding,
                 [](In& in, double more) { in.optics.zoom = in.registration.zoom + more; }),
      real_limit("ZoomBelow", Reason::optics_changed, "SR-16", &Limits::zoom_tolerance, kRounding,
                 [](In& in, double less) { in.optics.zoom = in.registration.zoom - less; }),
      real_limit("Focus", Reason::optics_changed, "SR-16", &Limits::focus_tolerance_mm, kRounding,
                 [](In& in, double mm) { in.optics.focus_mm = in.registration.focus_mm + mm; }),
      real_limit("FocusBelow", Reason::optics_changed, "SR-16", &Limits::focus_tolerance_mm,
                 kRounding,
                 [](In& in, double mm) { in.optics.focus_mm = in.registration.focus_mm - mm; }),
      real_limit("Scale", Reason::scale_mismatch, "SR-99", &Limits::scale_mismatch_max, kRounding,
                 [](In& in, double more) { in.tracking.scale = 1 + more; }),
      real_limit("ScaleBelow", Reason::scale_mismatch, "SR-99", &Limits::scale_mismatch_max,
                 kRounding, [](In& in, double less) { in.tracking.scale = 1 - less; }),
      {"Inliers", Reason::tracking_weak, "SR-06",
       [](In& in, const Lim& limits) { in.tracking.inliers = limits.inliers_min; },
       [](In& in, const Lim& limits) { in.tracking.inliers = limits.inliers_min - 1; }},
      {"InlierSpread", Reason::tracking_weak, "SR-06",
       [](In& in, const Lim& limits) { in.tracking.inlier_spread = limits.inlier_spread_min; },
       [](In& in, const Lim& limits) {
         in.tracking.inlier_spread = std::nextafter(limits.inlier_spread_min, 0.0);
       }},
  };
}

}  // namespace

const std::vector<Fault>& faults() {
  static const std::vector<Fault> all = [] {
    std::vector<Fault> list = events();
    for (Fault& fault : bad_numbers()) list.push_back(std::move(fault));
    return list;
  }();
  return all;
}

const std::vector<LimitCase>& limit_cases() {
  static const std::vector<LimitCase> all = [] {
    std::vector<LimitCase> list = time_limits();
    for (LimitCase& limit : other_limits()) list.push_back(std::move(limit));
    return list;
  }();
  return all;
}

const std::vector<RealLimitCase>& real_limit_cases() {
  static const std::vector<RealLimitCase> all = {
      {"Drift", Reason::drift_exceeded, &Limits::drift_max_mm,
       [](In& in, double mm) { in.tracking.drift_mm = mm; }},
      {"Displacement", Reason::displacement_exceeded, &Limits::displacement_max_mm,
       set_displacement},
      {"Rotation", Reason::displacement_exceeded, &Limits::rotation_max_rad, set_rotation},
      {"Speed", Reason::speed_exceeded, &Limits::speed_max_mm_per_s,
       [](In& in, double speed) { in.prediction->speed_mm_per_s = speed; }},
      {"Sigma", Reason::covariance_exceeded, &Limits::sigma_target_max_mm, set_sigma},
      {"Zoom", Reason::optics_changed, &Limits::zoom_tolerance,
       [](In& in, double zoom) { in.optics.zoom = zoom; }},
      {"Focus", Reason::optics_changed, &Limits::focus_tolerance_mm,
       [](In& in, double mm) { in.optics.focus_mm = mm; }},
      {"Scale", Reason::scale_mismatch, &Limits::scale_mismatch_max,
       [](In& in, double scale) { in.tracking.scale = scale; }},
      {"InlierSpread", Reason::tracking_weak, &Limits::inlier_spread_min,
       [](In& in, double spread) { in.tracking.inlier_spread = spread; }},
  };
  return all;
}

const std::vector<Fault>& all_faults() {
  static const std::vector<Fault> all = [] {
    std::vector<Fault> list = faults();
    for (const LimitCase& limit : limit_cases()) {
      list.push_back({limit.name + "Exceeded", limit.reason, limit.requirement, limit.beyond});
    }
    return list;
  }();
  return all;
}

}  // namespace holdfast::safety::test
