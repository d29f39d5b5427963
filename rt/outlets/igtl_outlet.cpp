// SPDX-License-Identifier: Apache-2.0
#include "rt/outlets/igtl_outlet.hpp"

#include <fmt/format.h>

namespace holdfast::outlets {
namespace {

namespace igtl = bridge::openigtlink;
using observer::Level;

constexpr nanoseconds kStatusPeriod = std::chrono::milliseconds(100);

/// DICOM's LPS to Slicer's RAS: a half turn about the superior axis.
Eigen::Isometry3d T_ras_lps() {
  Eigen::Isometry3d T = Eigen::Isometry3d::Identity();
  T.linear() = Eigen::Vector3d(-1, -1, 1).asDiagonal();
  return T;
}

igtl::StatusCode code_of(Level level) {
  switch (level) {
    case Level::permitted:
      return igtl::StatusCode::ok;
    case Level::stop:
      return igtl::StatusCode::emergency;
    case Level::hold:
    case Level::not_ready:
      return igtl::StatusCode::not_ready;
    case Level::no_data:
      break;
  }
  return igtl::StatusCode::time_out;
}

}  // namespace

igtl::Status to_status(const observer::ObservedState& state, nanoseconds now) {
  const observer::Shown shown = state.shown(now);
  const msg::MotionStop* d = state.daemon(now);
  const bool is_of_daemon = d != nullptr && !shown.is_of_guard;
  return {code_of(shown.level), is_of_daemon ? d->cause : 0, shown.reason,
          fmt::format("{}: {} ({}{})", shown.word, shown.text, shown.is_of_guard ? "guard: " : "",
                      shown.reason)};
}

Eigen::Isometry3d T_patient_robot(const LivePose& pose) {
  return T_ras_lps() * pose.T_robot_ct.inverse();
}

Eigen::Isometry3d T_patient_camera(const LiveSite& site) {
  return T_ras_lps() * (site.T_camera_site * site.T_site_ct).inverse();
}

IgtlOutlet::IgtlOutlet(const IgtlSettings& settings)
    : server_(settings.server), feed_(settings.rate_hz) {}

void IgtlOutlet::tell_status(const observer::ObservedState& state, bridge::dds::Clocks now) {
  const igtl::Status status = to_status(state, now.monotonic);
  if (status.text == told_ && now.monotonic - t_status_ < kStatusPeriod) return;
  told_ = status.text;
  t_status_ = now.monotonic;
  std::string message = igtl::status_message(kStatusDevice, now.utc, status);
  server_.send(message);
  server_.set_greeting(std::move(message));
}

void IgtlOutlet::tell(const observer::ObservedState& state, bridge::dds::Clocks now) {
  tell_status(state, now);  // first: who reads on has the reason before what it is the reason for
  if (const auto pose = feed_.next_pose(state, now.monotonic))
    server_.send(igtl::transform_message(kRobotToPatient, pose->t_utc, T_patient_robot(*pose)));
  if (const auto site = feed_.next_site(state, now.monotonic))
    server_.send(igtl::transform_message(kCameraToPatient, site->t_utc, T_patient_camera(*site)));
}

}  // namespace holdfast::outlets
