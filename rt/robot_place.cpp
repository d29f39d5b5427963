// SPDX-License-Identifier: Apache-2.0
#include "rt/robot_place.hpp"

#include <cmath>

#include <fmt/format.h>

#include "bridge/robot_config.hpp"
#include "registration/hand_eye_file.hpp"
#include "rt/core/error.hpp"

namespace holdfast::rt {
namespace {

/// What another calibration of the same microscope, whose frame stands elsewhere, gives away; a
/// zoom that has been seated anew stays an order of magnitude below.
constexpr double kCameraDisagreementMaxMm = 0.1;

}  // namespace

RobotPlace read_robot_place(const bridge::ConfigSection& robot) {
  RobotPlace place;
  place.where = robot.where("hand_eye");
  if (robot.has("hand_eye")) {
    for (const char* typed : {"translation_mm", "rotation_xyzw", "sigma_t_mm", "sigma_r_rad"})
      if (robot.has(typed))
        throw InputError(
            fmt::format("{} contradicts hand_eye: give one of them", robot.where(typed)));
    place.hand_eye = robot.path("hand_eye");
    return place;
  }
  place.T_robot_camera = bridge::read_robot_camera(robot);
  for (const char* key : {"sigma_t_mm", "sigma_r_rad"})
    if (!robot.has(key))
      throw InputError(
          fmt::format("{} is required: how exactly a T_robot_camera that is typed is "
                      "known; 0 takes it as exact. Or give hand_eye = \"FILE\" of "
                      "`holdfast hand-eye`",
                      robot.where(key)));
  place.sigma.t_mm = robot.number("sigma_t_mm", 0, {0, 10});
  place.sigma.r_rad = robot.number("sigma_r_rad", 0, {0, 0.1});
  return place;
}

void load_robot_place(RobotPlace& place, const perception::CameraModel& camera,
                      const registration::Registration& registration,
                      const safety::Limits& limits) {
  if (place.hand_eye.empty()) return;
  const registration::HandEyeCalibration found = registration::load_hand_eye(place.hand_eye);
  const auto refuse = [&](const std::string& what) {
    throw InputError(fmt::format("{}: {}: {}", place.where, place.hand_eye.string(), what));
  };
  // Not (... <= ...): a registration that states none is refused as well.
  if (!(std::abs(found.zoom - registration.zoom) <= limits.zoom_tolerance * registration.zoom))
    refuse(fmt::format("made at zoom {:g}, the registration at {:g}, tolerance {:g}", found.zoom,
                       registration.zoom, limits.zoom_tolerance));
  if (!(std::abs(found.focus_mm - registration.focus_mm) <= limits.focus_tolerance_mm))
    refuse(
        fmt::format("made at a working distance of {:g} mm, the registration at {:g} mm, "
                    "tolerance {:g} mm",
                    found.focus_mm, registration.focus_mm, limits.focus_tolerance_mm));
  if (found.image_width_px != camera.width_px || found.image_height_px != camera.height_px)
    refuse(fmt::format("made with images of {}x{} px, the camera's are {}x{} px",
                       found.image_width_px, found.image_height_px, camera.width_px,
                       camera.height_px));
  Eigen::Matrix3d matrix;
  matrix << camera.fx_px, 0, camera.cx_px, 0, camera.fy_px, camera.cy_px, 0, 0, 1;
  if (const double off_mm = registration::disagreement_mm(found, matrix);
      !(off_mm <= kCameraDisagreementMaxMm))
    refuse(
        fmt::format("made with another camera calibration: they place a pixel up to {:.2f} mm "
                    "apart at the working distance, at most {:g} mm",
                    off_mm, kCameraDisagreementMaxMm));
  place.T_robot_camera = found.T_robot_camera;
  place.sigma.covariance = found.covariance;
}

}  // namespace holdfast::rt
