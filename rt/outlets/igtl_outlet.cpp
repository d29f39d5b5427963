// SPDX-License-Identifier: Apache-2.0
#include "rt/outlets/igtl_outlet.hpp"

#include <algorithm>

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

igtl::Image to_igtl_image(const bridge::LivePicture& p) {
  igtl::Image image;
  image.width_px = p.width_px;
  image.height_px = p.height_px;
  image.components = p.channels;
  // NOLINTNEXTLINE(cppcoreguidelines-pro-type-reinterpret-cast): bytes as a message's characters
  image.pixels = {reinterpret_cast<const char*>(p.pixels.data()), p.pixels.size()};
  const double z_mm = p.plane_depth_mm;
  image.spacing_x_mm = p.factor * z_mm / p.fx_px;
  image.spacing_y_mm = p.factor * z_mm / p.fy_px;
  // The camera's pixel in the middle of what is shown.
  const double u = 0.5 * p.width_px * p.factor - 0.5, v = 0.5 * p.height_px * p.factor - 0.5;
  image.p_middle_mm = {(u - p.cx_px) * z_mm / p.fx_px, (v - p.cy_px) * z_mm / p.fy_px, z_mm};
  return image;
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

void IgtlOutlet::tell_picture(const bridge::LivePicture* picture, bridge::dds::Clocks now) {
  if (picture == nullptr && shown_) {
    std::fill(shown_->pixels.begin(), shown_->pixels.end(), std::uint8_t{0});
    server_.send(igtl::image_message(kCameraImage, now.utc, to_igtl_image(*shown_)));
    shown_.reset();
  }
  if (picture == nullptr || !(picture->plane_depth_mm > 0)) return;
  if (shown_ && shown_->frame == picture->frame && shown_->t_exposure == picture->t_exposure)
    return;
  server_.send(igtl::image_message(kCameraImage, picture->t_utc, to_igtl_image(*picture)));
  shown_ = *picture;
}

void IgtlOutlet::tell(const observer::ObservedState& state, bridge::dds::Clocks now) {
  tell_status(state, now);  // first: who reads on has the reason before what it is the reason for
  if (const auto pose = feed_.next_pose(state, now.monotonic))
    server_.send(igtl::transform_message(kRobotToPatient, pose->t_utc, T_patient_robot(*pose)));
  if (const auto site = feed_.next_site(state, now.monotonic))
    server_.send(igtl::transform_message(kCameraToPatient, site->t_utc, T_patient_camera(*site)));
}

}  // namespace holdfast::outlets
