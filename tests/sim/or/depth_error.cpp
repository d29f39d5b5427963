// SPDX-License-Identifier: Apache-2.0
#include "tests/sim/or/depth_error.hpp"

#include <array>
#include <cmath>
#include <limits>
#include <optional>
#include <vector>

#include <Eigen/Geometry>
#include <fmt/format.h>
#include <opencv2/calib3d.hpp>

#include "registration/evaluation.hpp"
#include "registration/rectification.hpp"
#include "rt/core/error.hpp"
#include "tests/sim/or/calibration_error.hpp"

namespace holdfast::sim {
namespace {

using Eigen::Isometry3d;
using Eigen::Vector3d;

Eigen::Matrix3d as_eigen(const cv::Matx33d& m) {
  Eigen::Matrix3d result;
  for (int r = 0; r < 3; ++r)
    for (int c = 0; c < 3; ++c) result(r, c) = m(r, c);
  return result;
}

/// The true microscope above the phantom at one pose, and what the pipeline takes it for.
class Sight {
 public:
  Sight(const registration::ZoomCalibration& calibration, const cv::Size& size_px,
        const RoomConfig& config, const RoomScene& scene, int pose)
      : calibration_(calibration),
        geometry_(registration::rectification_of(calibration, size_px)),
        R_rectified_camera_(as_eigen(geometry_.R1)),
        scene_(scene) {
    const Microscope microscope(config.optics);
    optics_ = microscope.at(config.zoom, config.visit);
    const Isometry3d T_ct_head =
        head_poses(config, scene.phantom, microscope.focus_mm())[static_cast<std::size_t>(pose)];
    T_ct_left_ = T_ct_head * optics_.T_head_left;
    T_ct_right_ = T_ct_head * optics_.T_head_right;
    T_camera_ct_ = frame_of(calibration, optics_) * T_ct_head.inverse();
  }

  /// What the pixel of the rectified left grid truly shows: the raw pixel is the pipeline's idea,
  /// the line of sight through it the true one.
  [[nodiscard]] std::optional<Vector3d> surface_ct(double x, double y) const {
    const Vector3d ray = R_rectified_camera_.transpose() * direction(x, y);
    std::vector<cv::Point2d> raw;
    cv::projectPoints(std::vector<cv::Point3d>{{ray.x() / ray.z(), ray.y() / ray.z(), 1}},
                      cv::Vec3d(), cv::Vec3d(), calibration_.camera_matrix_left,
                      calibration_.distortion_left, raw);
    const SightLine line = optics_.left.sight_line({raw[0].x, raw[0].y});
    if (!line.direction.allFinite()) return {};
    return scene_.renderer.first_hit(line, T_ct_left_);
  }

  /// Whether the right camera's image shows this surface point.
  [[nodiscard]] bool is_seen_right(const Vector3d& p_ct) const {
    constexpr double kSameMm = 0.1;
    const Vector3d p_right = T_ct_right_.inverse() * p_ct;
    const Eigen::Vector2d pixel = optics_.right.project(p_right);
    if (!(pixel.x() >= 0 && pixel.y() >= 0 && pixel.x() <= geometry_.size_px.width - 1 &&
          pixel.y() <= geometry_.size_px.height - 1))
      return false;
    const auto hit =
        scene_.renderer.first_hit({Vector3d::Zero(), p_right / p_right.z()}, T_ct_right_);
    return hit && (*hit - p_ct).norm() < kSameMm;
  }

  [[nodiscard]] double error_mm(double x, double y, double depth_mm, const Vector3d& p_ct) const {
    const Vector3d measured = R_rectified_camera_.transpose() * (depth_mm * direction(x, y));
    return (measured - T_camera_ct_ * p_ct).norm();
  }

  [[nodiscard]] bool is_at_edge(double x, double y, const Vector3d& p_ct,
                                const DepthErrorOptions& options) const {
    const double r = options.edge_reach_px, here = depth(p_ct);
    // A plane's depth changes evenly: only what departs from it by more is an edge.
    for (const auto& [dx, dy] : std::array<std::array<double, 2>, 2>{{{r, 0}, {0, r}}}) {
      const auto before = surface_ct(x - dx, y - dy), after = surface_ct(x + dx, y + dy);
      if (!before || !after) return true;
      if (std::abs(depth(*before) - here) > options.edge_jump_mm &&
          std::abs(depth(*before) + depth(*after) - 2 * here) > options.edge_jump_mm)
        return true;
      if (std::abs(depth(*after) - here) > options.edge_jump_mm &&
          std::abs(depth(*before) + depth(*after) - 2 * here) > options.edge_jump_mm)
        return true;
    }
    return false;
  }

 private:
  [[nodiscard]] Vector3d direction(double x, double y) const {  // rectified, z = 1
    return {(x - geometry_.P1(0, 2)) / geometry_.P1(0, 0),
            (y - geometry_.P1(1, 2)) / geometry_.P1(1, 1), 1};
  }
  [[nodiscard]] double depth(const Vector3d& p_ct) const { return (T_camera_ct_ * p_ct).z(); }

  const registration::ZoomCalibration& calibration_;
  registration::Rectification geometry_;
  Eigen::Matrix3d R_rectified_camera_;
  const RoomScene& scene_;
  StereoOptics optics_;
  Isometry3d T_ct_left_, T_ct_right_, T_camera_ct_;
};

}  // namespace

DepthError depth_error(const cv::Mat_<float>& depth_mm,
                       const registration::ZoomCalibration& calibration, const RoomConfig& config,
                       const RoomScene& scene, int pose, const DepthErrorOptions& options) {
  if (depth_mm.cols != kSensorWidthPx || depth_mm.rows != kSensorHeightPx)
    throw InputError(fmt::format("the depth map is {}x{} px, must be {}x{} px", depth_mm.cols,
                                 depth_mm.rows, kSensorWidthPx, kSensorHeightPx));
  if (pose < 0 || pose >= config.poses)
    throw InputError(fmt::format("pose {}, must be 0 to {}", pose, config.poses - 1));
  const Sight sight(calibration, depth_mm.size(), config, scene, pose);
  DepthError result;
  std::vector<double> all;
  std::size_t off_edges = 0, wrong_off_edges = 0;
  for (int y = options.edge_reach_px; y < depth_mm.rows; y += options.step_px)
    for (int x = options.edge_reach_px; x < depth_mm.cols; x += options.step_px) {
      const auto p_ct = sight.surface_ct(x, y);
      if (!p_ct || !scene.phantom.region_of_interest_mm.contains(*p_ct) ||
          !sight.is_seen_right(*p_ct))
        continue;
      ++result.seen;
      const auto depth = static_cast<double>(depth_mm(y, x));
      if (!std::isfinite(depth)) continue;
      const double error = sight.error_mm(x, y, depth, *p_ct);
      all.push_back(error);
      if (sight.is_at_edge(x, y, *p_ct, options)) continue;
      ++off_edges;
      if (error > 1) ++wrong_off_edges;
    }
  constexpr double kNan = std::numeric_limits<double>::quiet_NaN();
  const auto share = [](std::size_t part, std::size_t whole) {
    return whole > 0 ? static_cast<double>(part) / static_cast<double>(whole) : kNan;
  };
  result.known = all.size();
  result.coverage = share(result.known, result.seen);
  result.share_over_1_mm_off_edges = share(wrong_off_edges, off_edges);
  const registration::DistanceFigures figures = registration::distance_figures(std::move(all));
  result.median_mm = figures.median_mm;
  result.mean_mm = figures.mean_mm;
  result.rms_mm = figures.rmse_mm;
  result.p95_mm = figures.p95_mm;
  result.p99_mm = figures.p99_mm;
  result.share_over_1_mm = figures.share_over_1_mm;
  return result;
}

}  // namespace holdfast::sim
