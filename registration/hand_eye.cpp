// SPDX-License-Identifier: Apache-2.0
#include "registration/hand_eye.hpp"

#include <algorithm>
#include <cmath>
#include <functional>

#include <Eigen/Eigenvalues>
#include <fmt/format.h>

#include "registration/working_volume.hpp"

namespace holdfast::registration {
namespace {

using Points = std::vector<Eigen::Vector3d>;

Eigen::Matrix3d cross_matrix(const Eigen::Vector3d& v) {
  Eigen::Matrix3d m;
  m << 0, -v.z(), v.y(), v.z(), 0, -v.x(), -v.y(), v.x(), 0;
  return m;
}

/// Root mean squares along the three axes of the points, the longest first.
Eigen::Vector3d spreads_of(const Points& points) {
  Eigen::Matrix3Xd matrix(3, static_cast<Eigen::Index>(points.size()));
  for (std::size_t i = 0; i < points.size(); ++i)
    matrix.col(static_cast<Eigen::Index>(i)) = points[i];
  matrix.colwise() -= matrix.rowwise().mean().eval();
  const Eigen::Matrix3d scatter = matrix * matrix.transpose() / static_cast<double>(points.size());
  return Eigen::SelfAdjointEigenSolver<Eigen::Matrix3d>{scatter, Eigen::EigenvaluesOnly}
      .eigenvalues()
      .cwiseMax(0.0)
      .cwiseSqrt()
      .reverse();
}

bool is_valid(const HandEyeSpot& spot) {
  constexpr double kUnit = 1e-6;
  const auto is_variance = [](const Eigen::Matrix2d& c) {
    return c.allFinite() && c.trace() > 0 && c.determinant() > 0;
  };
  const RobotSpot& robot = spot.robot;
  return spot.left.centre_px.allFinite() && spot.right.centre_px.allFinite() &&
         is_variance(spot.left.covariance_px2) && is_variance(spot.right.covariance_px2) &&
         robot.point_mm.allFinite() && robot.sigma_mm > 0 && std::isfinite(robot.sigma_mm) &&
         robot.sigma_rad >= 0 && std::isfinite(robot.sigma_rad) &&
         (!robot.direction || std::abs(robot.direction->norm() - 1) < kUnit);
}

/// From T_camera_robot's covariance (camera axes) to that of its inverse (robot axes): with
/// p_c = Exp(r)·R·p_r + t + dt, the inverse turns by -R'r and moves by -R'dt + R'(r x t).
Matrix6d of_inverse(const Eigen::Isometry3d& T_camera_robot, const Matrix6d& covariance) {
  const Eigen::Matrix3d Rt = T_camera_robot.linear().transpose();
  Matrix6d A = Matrix6d::Zero();
  A.topLeftCorner<3, 3>() = -Rt;
  A.topRightCorner<3, 3>() = -Rt * cross_matrix(T_camera_robot.translation());
  A.bottomRightCorner<3, 3>() = -Rt;
  const Matrix6d result = A * covariance * A.transpose();
  return 0.5 * (result + result.transpose());
}

class Finder {
 public:
  explicit Finder(const HandEyeInput& input) : input_(input), limits_(input.limits) {}

  HandEye run() {
    const bool is_refused = !check_input() || !check_places() || !check_shape() || !check_fit() ||
                            !check_scale() || !check_target();
    if (!is_refused) {
      result_.status = HandEyeStatus::found;
      result_.T_robot_camera = fit_.rigid.T_camera_ct.inverse();
    }
    return std::move(result_);
  }

 private:
  bool refuse(HandEyeStatus status, std::string reason) {
    result_.status = status;
    result_.reason = std::move(reason);
    return false;
  }

  bool check_input() {
    const auto count = static_cast<int>(input_.spots.size());
    if (count < limits_.least_spots)
      return refuse(HandEyeStatus::too_few,
                    fmt::format("{} spots, at least {} are needed", count, limits_.least_spots));
    for (const HandEyeSpot& spot : input_.spots)
      if (!is_valid(spot))
        return refuse(HandEyeStatus::invalid_numbers,
                      fmt::format("{}: a number is not finite, no uncertainty is stated, or the "
                                  "beam's direction has no length",
                                  spot.name));
    if (input_.calibration.parameter_covariance.size() == 0)
      return refuse(HandEyeStatus::invalid_numbers,
                    "the calibration states no parameter_covariance: what is not known of it would "
                    "be missing in the result");
    return true;
  }

  bool check_places() {
    p_camera_mm_ = locate_spots(input_, joint_);
    const double focus_mm = input_.calibration.focus_mm;
    const auto points = triangulated_spots(input_);
    for (std::size_t i = 0; i < points.size(); ++i) {
      LocatedSpot spot;
      spot.name = input_.spots[i].name;
      spot.p_camera_mm = p_camera_mm_[i];
      const auto at = static_cast<Eigen::Index>(3 * i);
      spot.sigma_mm = std::sqrt(joint_.block<3, 3>(at, at).trace());
      spot.epipolar_px = points[i].epipolar_px;
      result_.spots.push_back(spot);
    }
    for (const LocatedSpot& spot : result_.spots) {
      if (!(spot.epipolar_px < limits_.largest_epipolar_px))
        return refuse(
            HandEyeStatus::other_calibration,
            fmt::format("{}: the two images disagree by {:.2f} px, must be below {:g} "
                        "px: left and right swapped, another zoom, or another calibration",
                        spot.name, spot.epipolar_px, limits_.largest_epipolar_px));
      if (!(spot.p_camera_mm.z() > 0.5 * focus_mm && spot.p_camera_mm.z() < 1.5 * focus_mm))
        return refuse(
            HandEyeStatus::other_calibration,
            fmt::format("{}: lies at {:.1f} mm, must be within half of the working "
                        "distance {:g} mm: left and right swapped, or another calibration",
                        spot.name, spot.p_camera_mm.z(), focus_mm));
    }
    return true;
  }

  bool check_shape() {
    for (std::size_t i = 0; i < p_camera_mm_.size(); ++i)
      for (std::size_t j = 0; j < i; ++j)
        if (const double d = (p_camera_mm_[i] - p_camera_mm_[j]).norm();
            !(d >= limits_.least_distance_mm))
          return refuse(HandEyeStatus::too_close,
                        fmt::format("{} and {} lie {:.2f} mm apart, at least {:g} mm are needed",
                                    input_.spots[j].name, input_.spots[i].name, d,
                                    limits_.least_distance_mm));
    const Eigen::Vector3d spreads = spreads_of(p_camera_mm_);
    if (!(spreads[1] >= limits_.least_width_mm))
      return refuse(HandEyeStatus::collinear,
                    fmt::format("the spots lie in a line: {:.2f} mm (1 sigma) about it, at least "
                                "{:g} mm are needed",
                                spreads[1], limits_.least_width_mm));
    if (!(spreads[2] >= limits_.least_relief_mm))
      return refuse(HandEyeStatus::flat,
                    fmt::format("the spots lie in a plane: {:.2f} mm (1 sigma) about it, at least "
                                "{:g} mm are needed, else a mirrored robot frame would pass: raise "
                                "or tilt the surface between the spots",
                                spreads[2], limits_.least_relief_mm));
    return true;
  }

  bool check_fit() {
    fit_ = fitted(p_camera_mm_);
    if (fit_.rigid.status == FitStatus::collinear)
      return refuse(HandEyeStatus::collinear, "the robot's points lie in a line");
    if (fit_.rigid.status != FitStatus::fitted)
      return refuse(HandEyeStatus::poor_fit, "no rigid motion fits: the fit does not converge");
    const std::vector<SpotLeftOut> left = left_out(fit_, robot());
    for (std::size_t i = 0; i < left.size(); ++i) {
      result_.spots[i].residual_mm = fit_.residuals_mm[i];
      result_.spots[i].left_out = left[i];
    }
    result_.rms_mm = fit_.rms_mm;
    result_.chi_squared = fit_.chi_squared;
    result_.p_value = fit_.p_value;
    result_.degrees_of_freedom = fit_.degrees_of_freedom;
    const auto worst = std::max_element(
        result_.spots.begin(), result_.spots.end(), [](const LocatedSpot& a, const LocatedSpot& b) {
          return a.left_out.squared_sigma < b.left_out.squared_sigma;
        });
    const double least_p_of_one = limits_.least_p / static_cast<double>(left.size());
    if (fit_.p_value >= limits_.least_p && worst->left_out.p_value >= least_p_of_one) return true;
    return explain(static_cast<std::size_t>(worst - result_.spots.begin()));
  }

  /// The residuals are not what the stated errors allow: which single mistake would explain it?
  bool explain(std::size_t worst) {
    HandEyeInput others = input_;
    others.spots.erase(others.spots.begin() + static_cast<std::ptrdiff_t>(worst));
    Eigen::MatrixXd joint;
    const Points points = locate_spots(others, joint);
    const SpotFit without = fit_spots(points, joint, robot_of(others));
    const LocatedSpot& spot = result_.spots[worst];
    if (without.rigid.status == FitStatus::fitted && without.p_value >= limits_.least_p)
      return refuse(
          HandEyeStatus::spot_displaced,
          fmt::format("{} lies {:.3f} mm from where all others say ({:.1f} sigma)", spot.name,
                      spot.left_out.displacement_mm, std::sqrt(spot.left_out.squared_sigma)));
    Points mirrored = p_camera_mm_;
    for (Eigen::Vector3d& p : mirrored) p.x() = -p.x();
    if (const SpotFit fit = fitted(mirrored, true); is_far_better(fit))
      return refuse(
          HandEyeStatus::mirrored,
          fmt::format("a reflection fits ({:.3f} mm rms), no motion does ({:.3f} mm): the "
                      "robot's frame is left-handed, or one axis has the wrong sign",
                      fit.rms_mm, fit_.rms_mm));
    const double scale = best_scale();
    if (const SpotFit fit = fitted(scaled(scale)); is_far_better(fit))
      return refuse(HandEyeStatus::other_scale,
                    fmt::format("the camera's distances are {:.4f} times the robot's: another zoom "
                                "or calibration, or the robot's points in another unit",
                                1 / scale));
    return refuse(HandEyeStatus::poor_fit,
                  fmt::format("the spots contradict each other: {:.3f} mm rms, chi squared {:.0f} "
                              "where {} are expected, p {:.1e}, at least {:g}",
                              fit_.rms_mm, fit_.chi_squared, fit_.degrees_of_freedom, fit_.p_value,
                              limits_.least_p));
  }

  bool check_scale() {
    result_.scale = scale_of(fit_);
    if (!(result_.scale.sigma <= limits_.largest_scale_sigma))
      return refuse(
          HandEyeStatus::scale_unknown,
          fmt::format(
              "the spots leave the scale open by {:.1f} % (1 sigma, at most {:g} %), so a wrong "
              "zoom would not show: spots farther apart, or beams of which also the origin moves",
              100 * result_.scale.sigma, 100 * limits_.largest_scale_sigma));
    if (!(std::abs(result_.scale.value - 1) <= limits_.scale_sigmas * result_.scale.sigma))
      return refuse(HandEyeStatus::other_scale,
                    fmt::format("the camera's distances are {:.4f} times the robot's, {:.1f} sigma "
                                "off: another zoom or calibration",
                                result_.scale.value,
                                std::abs(result_.scale.value - 1) / result_.scale.sigma));
    return true;
  }

  bool check_target() {
    const ZoomCalibration& zoom = input_.calibration;
    const WorkingVolume volume =
        working_volume(zoom, input_.image_width_px, input_.image_height_px, zoom.focus_mm);
    if (volume.p_camera_mm.empty())
      return refuse(HandEyeStatus::other_calibration,
                    "the two cameras have no field of view in common at the working distance");
    Eigen::Vector3d& middle = result_.p_middle_camera_mm;
    for (const Eigen::Vector3d& p : volume.p_camera_mm)
      middle += p / static_cast<double>(volume.p_camera_mm.size());
    result_.covariance = of_inverse(fit_.rigid.T_camera_ct, fit_.rigid.covariance);
    result_.covariance_middle_mm2 =
        target_covariance(fit_.rigid.T_camera_ct.inverse(), result_.covariance, middle);
    const double worst_mm =
        std::sqrt(Eigen::SelfAdjointEigenSolver<Eigen::Matrix3d>(result_.covariance_middle_mm2)
                      .eigenvalues()[2]);
    if (!(worst_mm <= limits_.largest_sigma_mm))
      return refuse(HandEyeStatus::target_uncertain,
                    fmt::format("the predicted error in the middle of the working volume is {:.3f} "
                                "mm (1 sigma, worst axis), at most {:g} mm: more spots, farther "
                                "apart, or beams that are less parallel",
                                worst_mm, limits_.largest_sigma_mm));
    return true;
  }

  static std::vector<RobotSpot> robot_of(const HandEyeInput& input) {
    std::vector<RobotSpot> robot;
    for (const HandEyeSpot& spot : input.spots) robot.push_back(spot.robot);
    return robot;
  }
  [[nodiscard]] std::vector<RobotSpot> robot() const { return robot_of(input_); }

  /// The fit to camera points that are not quite those measured.
  [[nodiscard]] SpotFit fitted(const Points& p_camera_mm, bool is_mirrored = false) const {
    Eigen::MatrixXd joint = joint_;
    if (is_mirrored)
      for (Eigen::Index i = 0; i < joint.rows(); i += 3) {
        joint.row(i) *= -1;
        joint.col(i) *= -1;
      }
    return fit_spots(p_camera_mm, joint, robot());
  }
  [[nodiscard]] bool is_far_better(const SpotFit& fit) const {
    constexpr double kShare = 0.1;
    return fit.rigid.status == FitStatus::fitted && fit.chi_squared < kShare * fit_.chi_squared;
  }
  [[nodiscard]] Points scaled(double scale) const {
    Points points = p_camera_mm_;
    for (Eigen::Vector3d& p : points) p *= scale;
    return points;
  }
  /// The scale of the camera's points that fits best: of the spreads for points, searched for
  /// beams.
  [[nodiscard]] double best_scale() const {
    const bool has_beam = std::any_of(input_.spots.begin(), input_.spots.end(),
                                      [](const HandEyeSpot& s) { return s.robot.direction; });
    if (!has_beam) {
      Points points;
      for (const HandEyeSpot& spot : input_.spots) points.push_back(spot.robot.point_mm);
      return spreads_of(points).norm() / spreads_of(p_camera_mm_).norm();
    }
    double best = 1, least = fit_.chi_squared;
    constexpr int kSteps = 24;
    for (int i = -kSteps; i <= kSteps; ++i) {
      const double scale = std::exp(0.6 * i / kSteps);
      if (const SpotFit fit = fitted(scaled(scale));
          fit.rigid.status == FitStatus::fitted && fit.chi_squared < least) {
        least = fit.chi_squared;
        best = scale;
      }
    }
    return best;
  }

  const HandEyeInput& input_;
  const HandEyeLimits& limits_;
  Points p_camera_mm_;
  Eigen::MatrixXd joint_;
  SpotFit fit_;
  HandEye result_;
};

}  // namespace

HandEye find_hand_eye(const HandEyeInput& input) {
  return Finder(input).run();
}

}  // namespace holdfast::registration
