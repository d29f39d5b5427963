// SPDX-License-Identifier: Apache-2.0
#include "registration/hand_eye_file.hpp"

#include <algorithm>

#include <Eigen/LU>
#include <opencv2/core/eigen.hpp>

#include "registration/sealed_json.hpp"

namespace holdfast::registration {
namespace {

using nlohmann::json;

int require_size(const JsonReader& reader, const char* key) {
  constexpr double kLargestPx = 65'536;
  const double value = reader.number(key);
  if (!(value >= 1 && value <= kLargestPx && std::floor(value) == value))
    reader.fail(fmt::format("{} = {} px is no image size", key, value));
  return static_cast<int>(value);
}

double require_positive(const JsonReader& reader, const char* key) {
  const double value = reader.number(key);
  if (!(value > 0)) reader.fail(fmt::format("{} = {} is not above 0", key, value));
  return value;
}

HandEyeCalibration parse(const json& content, const JsonReader& reader) {
  HandEyeCalibration calibration;
  calibration.T_robot_camera =
      require_pose(reader.matrix<4, 4>("T_robot_camera"), "T_robot_camera", reader);
  calibration.covariance = reader.matrix<6, 6>("covariance");
  require_covariance<6>(calibration.covariance, "covariance", reader);
  if (!(calibration.covariance.diagonal().minCoeff() > 0))
    reader.fail("covariance has a zero on its diagonal: nothing is known exactly");
  calibration.zoom = require_positive(reader, "zoom");
  calibration.focus_mm = require_positive(reader, "focus_mm");
  calibration.image_width_px = require_size(reader, "image_width");
  calibration.image_height_px = require_size(reader, "image_height");
  calibration.camera_matrix = reader.matrix<3, 3>("camera_matrix_left");
  const Eigen::Matrix3d& K = calibration.camera_matrix;
  if (!(K(0, 0) > 0 && K(1, 1) > 0) || K.row(2) != Eigen::RowVector3d(0, 0, 1))
    reader.fail("camera_matrix_left is no camera matrix");
  calibration.checksum = seal_of(content);
  return calibration;
}

std::string sealed(json content) {
  content["checksum"] = seal_of(content);
  // What is written must be what can be read: NaN becomes null in JSON and is refused here.
  const json written = json::parse(content.dump());
  (void)parse(written, JsonReader{written, "hand-eye calibration"});
  return content.dump(1) + "\n";
}

json content_of(const HandEyeCalibration& calibration) {
  json content;
  content["T_robot_camera"] = matrix_json(calibration.T_robot_camera.matrix());
  content["covariance"] = matrix_json(calibration.covariance);
  content["zoom"] = calibration.zoom;
  content["focus_mm"] = calibration.focus_mm;
  content["image_width"] = calibration.image_width_px;
  content["image_height"] = calibration.image_height_px;
  content["camera_matrix_left"] = matrix_json(calibration.camera_matrix);
  return content;
}

json vector_json(const Eigen::VectorXd& v) {
  return std::vector<double>(v.begin(), v.end());
}

}  // namespace

HandEyeCalibration load_hand_eye(const std::filesystem::path& file) {
  const json content = read_sealed(file);
  return parse(content, JsonReader{content, file.string()});
}

std::string sealed_hand_eye(const HandEyeCalibration& calibration) {
  return sealed(content_of(calibration));
}

std::string sealed_hand_eye(const HandEye& hand_eye, const HandEyeInput& input,
                            const std::string& stereo_sha256) {
  HandEyeCalibration calibration;
  calibration.T_robot_camera = hand_eye.T_robot_camera;
  calibration.covariance = hand_eye.covariance;
  calibration.zoom = input.calibration.zoom;
  calibration.focus_mm = input.calibration.focus_mm;
  calibration.image_width_px = input.image_width_px;
  calibration.image_height_px = input.image_height_px;
  cv::cv2eigen(input.calibration.camera_matrix_left, calibration.camera_matrix);
  json content = content_of(calibration);
  content["calibration_sha256"] = stereo_sha256;
  content["residual_rms_mm"] = hand_eye.rms_mm;
  content["chi_squared"] = hand_eye.chi_squared;
  content["degrees_of_freedom"] = hand_eye.degrees_of_freedom;
  content["p_value"] = hand_eye.p_value;
  content["scale"] = {{"value", hand_eye.scale.value}, {"sigma", hand_eye.scale.sigma}};
  content["predicted"] = {{"p_camera_mm", vector_json(hand_eye.p_middle_camera_mm)},
                          {"rms_mm", std::sqrt(hand_eye.covariance_middle_mm2.trace())},
                          {"covariance_mm2", matrix_json(hand_eye.covariance_middle_mm2)}};
  content["spots"] = json::array();
  for (std::size_t i = 0; i < hand_eye.spots.size(); ++i) {
    const LocatedSpot& spot = hand_eye.spots[i];
    content["spots"].push_back({{"name", spot.name},
                                {"left_px", vector_json(input.spots[i].left.centre_px)},
                                {"right_px", vector_json(input.spots[i].right.centre_px)},
                                {"p_camera_mm", vector_json(spot.p_camera_mm)},
                                {"sigma_mm", spot.sigma_mm},
                                {"epipolar_px", spot.epipolar_px},
                                {"residual_mm", spot.residual_mm},
                                {"left_out_mm", spot.left_out.displacement_mm},
                                {"left_out_p", spot.left_out.p_value}});
  }
  return sealed(content);
}

double disagreement_mm(const HandEyeCalibration& calibration,
                       const Eigen::Matrix3d& camera_matrix) {
  const Eigen::Matrix3d ours = calibration.camera_matrix.inverse(),
                        theirs = camera_matrix.inverse();
  double worst_mm = 0;
  for (const double x : {0.0, 0.5, 1.0})
    for (const double y : {0.0, 0.5, 1.0}) {
      const Eigen::Vector3d pixel(x * (calibration.image_width_px - 1),
                                  y * (calibration.image_height_px - 1), 1);
      worst_mm = std::max(worst_mm, calibration.focus_mm * (ours * pixel - theirs * pixel).norm());
    }
  return worst_mm;
}

}  // namespace holdfast::registration
