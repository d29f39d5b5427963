// SPDX-License-Identifier: Apache-2.0
#include "registration/hand_eye_fit.hpp"

#include <cmath>
#include <limits>

#include <Eigen/Cholesky>
#include <boost/math/distributions/chi_squared.hpp>

namespace holdfast::registration {
namespace {

constexpr double kAlongSigmaMm = 100;  // along a beam: as good as unknown, yet a number
constexpr int kRounds = 30, kApproaches = 200;
constexpr double kAtRestMm = 1e-7;

using Points = std::vector<Eigen::Vector3d>;

Eigen::Matrix3Xd columns(const Points& points) {
  Eigen::Matrix3Xd matrix(3, static_cast<Eigen::Index>(points.size()));
  for (std::size_t i = 0; i < points.size(); ++i)
    matrix.col(static_cast<Eigen::Index>(i)) = points[i];
  return matrix;
}

bool has_beam(const std::vector<RobotSpot>& robot) {
  for (const RobotSpot& spot : robot)
    if (spot.direction) return true;
  return false;
}

/// The robot's point, or of its beam that next to `p_robot_mm`.
Eigen::Vector3d nearest(const RobotSpot& spot, const Eigen::Vector3d& p_robot_mm) {
  if (!spot.direction) return spot.point_mm;
  return spot.point_mm + spot.direction->dot(p_robot_mm - spot.point_mm) * *spot.direction;
}

/// Moves each beam's point to its spot; how far the farthest went.
double follow(const Eigen::Isometry3d& T_camera_robot, const Points& p_camera_mm,
              const std::vector<RobotSpot>& robot, Points& p_robot_mm) {
  const Eigen::Isometry3d T_robot_camera = T_camera_robot.inverse();
  double farthest_mm = 0;
  for (std::size_t i = 0; i < robot.size(); ++i) {
    const Eigen::Vector3d next = nearest(robot[i], T_robot_camera * p_camera_mm[i]);
    farthest_mm = std::max(farthest_mm, (next - p_robot_mm[i]).norm());
    p_robot_mm[i] = next;
  }
  return farthest_mm;
}

/// Points on the beams to begin with: at one distance along all, drawn to the camera's shape by
/// fits in turn with steps along the beams; of several distances the one that ends best.
Points start_points(const Points& p_camera_mm, const std::vector<RobotSpot>& robot) {
  Points best;
  for (const RobotSpot& spot : robot) best.push_back(spot.point_mm);
  if (!has_beam(robot)) return best;
  const Eigen::Matrix3Xd camera = columns(p_camera_mm);
  double least = std::numeric_limits<double>::infinity();
  for (const double along_mm : {0.0, 50.0, 100.0, 200.0, 400.0, 800.0}) {
    Points points;
    for (const RobotSpot& spot : robot)
      points.push_back(spot.direction ? spot.point_mm + along_mm * *spot.direction : spot.point_mm);
    Eigen::Isometry3d T = Eigen::Isometry3d::Identity();
    for (int i = 0; i < kApproaches; ++i) {
      T = horn(camera, columns(points));
      if (follow(T, p_camera_mm, robot, points) < kAtRestMm) break;
    }
    const double cost = (camera - (T * columns(points))).squaredNorm();
    if (!(cost < least)) continue;
    least = cost;
    best = points;
  }
  return best;
}

Eigen::Matrix3d robot_covariance(const RobotSpot& spot, const Eigen::Vector3d& p_robot_mm) {
  const double own = spot.sigma_mm * spot.sigma_mm;
  if (!spot.direction) return own * Eigen::Matrix3d::Identity();
  const Eigen::Vector3d& d = *spot.direction;
  const Eigen::Matrix3d along = d * d.transpose();
  const double turned_mm = spot.sigma_rad * (p_robot_mm - spot.point_mm).norm();
  return (own + turned_mm * turned_mm) * (Eigen::Matrix3d::Identity() - along) +
         kAlongSigmaMm * kAlongSigmaMm * along;
}

FiducialSet fiducials_of(const Points& p_camera_mm, const Eigen::MatrixXd& joint,
                         const std::vector<RobotSpot>& robot, const Points& p_robot_mm) {
  FiducialSet set;
  set.has_covariances = true;
  set.joint_covariance_camera_mm2 = joint;
  for (std::size_t i = 0; i < robot.size(); ++i) {
    FiducialPair pair;
    pair.p_ct_mm = p_robot_mm[i];
    pair.p_camera_mm = p_camera_mm[i];
    pair.covariance_ct_mm2 = robot_covariance(robot[i], p_robot_mm[i]);
    set.pairs.push_back(pair);
  }
  return set;
}

double tail(double squared, int dof) {
  return boost::math::cdf(
      boost::math::complement(boost::math::chi_squared{static_cast<double>(dof)}, squared));
}

/// Residuals y = p_camera - T·p_robot, their weights, and their derivatives by a step.
struct Linear {
  Eigen::VectorXd y;
  Eigen::MatrixXd W, J;
};

Linear linear_at(const SpotFit& fit) {
  const auto n = static_cast<Eigen::Index>(fit.fiducials.pairs.size());
  Linear linear;
  linear.y.resize(3 * n);
  linear.J.resize(3 * n, 6);
  for (Eigen::Index i = 0; i < n; ++i) {
    const FiducialPair& pair = fit.fiducials.pairs[static_cast<std::size_t>(i)];
    linear.J.middleRows<3>(3 * i) = point_jacobian(fit.rigid.T_camera_ct, pair.p_ct_mm);
    linear.y.segment<3>(3 * i) = pair.p_camera_mm - fit.rigid.T_camera_ct * pair.p_ct_mm;
  }
  linear.W = fiducial_noise(fit.fiducials, fit.rigid.T_camera_ct)
                 .llt()
                 .solve(Eigen::MatrixXd::Identity(3 * n, 3 * n));
  return linear;
}

}  // namespace

SpotFit fit_spots(const std::vector<Eigen::Vector3d>& p_camera_mm,
                  const Eigen::MatrixXd& joint_covariance_mm2,
                  const std::vector<RobotSpot>& robot) {
  SpotFit fit;
  Points p_robot_mm = start_points(p_camera_mm, robot);
  for (int round = 0; round < kRounds; ++round) {
    fit.fiducials = fiducials_of(p_camera_mm, joint_covariance_mm2, robot, p_robot_mm);
    fit.rigid = fit_rigid(fit.fiducials);
    if (fit.rigid.status != FitStatus::fitted) return fit;
    if (follow(fit.rigid.T_camera_ct, p_camera_mm, robot, p_robot_mm) < kAtRestMm) break;
  }
  fit.degrees_of_freedom = -6;
  double squares = 0;
  const Eigen::Isometry3d T_robot_camera = fit.rigid.T_camera_ct.inverse();
  for (std::size_t i = 0; i < robot.size(); ++i) {
    const Eigen::Vector3d p_robot = T_robot_camera * p_camera_mm[i];
    const double off_mm = (nearest(robot[i], p_robot) - p_robot).norm();
    fit.degrees_of_freedom += robot[i].direction ? 2 : 3;
    fit.residuals_mm.push_back(off_mm);
    squares += off_mm * off_mm;
  }
  fit.rms_mm = std::sqrt(squares / static_cast<double>(robot.size()));
  fit.chi_squared = fit.rigid.chi_squared;
  fit.p_value = fit.degrees_of_freedom > 0 ? tail(fit.chi_squared, fit.degrees_of_freedom) : 1;
  return fit;
}

std::vector<SpotLeftOut> left_out(const SpotFit& fit, const std::vector<RobotSpot>& robot) {
  const Linear at = linear_at(fit);
  // As in leave_one_out(): the prediction error of one from all others is Q_ii^-1 (Qy)_i.
  const Eigen::MatrixXd WJ = at.W * at.J;
  const Eigen::MatrixXd Q = at.W - WJ * (at.J.transpose() * WJ).ldlt().solve(WJ.transpose());
  const Eigen::VectorXd Qy = Q * at.y;
  std::vector<SpotLeftOut> result;
  for (std::size_t i = 0; i < robot.size(); ++i) {
    const auto row = static_cast<Eigen::Index>(3 * i);
    const Eigen::Matrix3d Q_ii = Q.block<3, 3>(row, row);
    Eigen::Vector3d displacement = Q_ii.ldlt().solve(Qy.segment<3>(row));
    SpotLeftOut one;
    one.squared_sigma = displacement.dot(Q_ii * displacement);
    if (robot[i].direction) {
      const Eigen::Vector3d d = fit.rigid.T_camera_ct.linear() * *robot[i].direction;
      displacement -= d.dot(displacement) * d;
    }
    one.displacement_mm = displacement.norm();
    one.p_value = tail(one.squared_sigma, robot[i].direction ? 2 : 3);
    result.push_back(one);
  }
  return result;
}

SpotScale scale_of(const SpotFit& fit) {
  const Linear at = linear_at(fit);
  const auto n = static_cast<Eigen::Index>(fit.fiducials.pairs.size());
  Eigen::Vector3d middle = Eigen::Vector3d::Zero();
  for (const FiducialPair& pair : fit.fiducials.pairs)
    middle += pair.p_camera_mm / static_cast<double>(n);
  Eigen::MatrixXd J(3 * n, 7);
  J.leftCols<6>() = at.J;
  for (Eigen::Index i = 0; i < n; ++i)
    J.block<3, 1>(3 * i, 6) = fit.fiducials.pairs[static_cast<std::size_t>(i)].p_camera_mm - middle;
  const Eigen::MatrixXd WJ = at.W * J;
  const Eigen::MatrixXd normal = J.transpose() * WJ;
  // Steps of a millimetre, a radian and one are unlike: alike in size before they are solved for.
  const Eigen::VectorXd unit = normal.diagonal().cwiseMax(1e-300).cwiseSqrt().cwiseInverse();
  const Eigen::MatrixXd inverse = (unit.asDiagonal() * normal * unit.asDiagonal())
                                      .ldlt()
                                      .solve(Eigen::MatrixXd::Identity(7, 7));
  const Eigen::VectorXd step =
      unit.asDiagonal() * (inverse * (unit.asDiagonal() * (WJ.transpose() * at.y)));
  return {1 + step[6], unit[6] * std::sqrt(std::max(inverse(6, 6), 0.0))};
}

}  // namespace holdfast::registration
