// SPDX-License-Identifier: Apache-2.0
#include "perception/site.hpp"

#include <algorithm>
#include <array>
#include <cmath>
#include <limits>
#include <sstream>

#include <Eigen/Cholesky>

namespace holdfast::perception {
namespace {

constexpr double kDepthMinMm = 1, kDepthMaxMm = 1e5;
constexpr double kKnownShareMin = 0.02;
/// Between neighbouring pixels a surface seen at 80 degrees changes by 6 pixels' width. Steeper
/// than that is an edge, where the depth between the pixels is nobody's.
constexpr double kStepMaxPixels = 6;

bool is_usable(double depth_mm) {
  return depth_mm >= kDepthMinMm && depth_mm <= kDepthMaxMm;
}

}  // namespace

std::optional<std::string> invalid_geometry(const CameraModel& camera,
                                            const SiteGeometry& geometry) {
  std::ostringstream line;
  if (const auto* plane = std::get_if<SitePlane>(&geometry)) {
    if (plane->depth_mm >= kDepthMinMm && plane->depth_mm <= kDepthMaxMm) return std::nullopt;
    line << "the plane's depth is " << plane->depth_mm << " mm, must be " << kDepthMinMm << " to "
         << kDepthMaxMm << " mm";
    return line.str();
  }
  const cv::Mat& depth = std::get<SiteDepth>(geometry).depth_mm;
  if (depth.type() != CV_32FC1) return std::string("the depth map must be 32-bit float");
  const auto& grid = std::get<SiteDepth>(geometry).grid;
  if (grid && !(grid->fx_px > 0 && grid->fy_px > 0 && std::isfinite(grid->cx_px) &&
                std::isfinite(grid->cy_px)))
    return std::string("the depth map's grid must have focal lengths above 0 px");
  if (!std::get<SiteDepth>(geometry).R_depth_camera.isUnitary(1e-6))
    return std::string("the depth map's frame must be a rotation of the camera's");
  if (depth.cols < 2 || depth.rows < 2) return std::string("the depth map must be 2x2 px at least");
  if (!grid && (depth.cols != camera.width_px || depth.rows != camera.height_px)) {
    line << "the depth map is " << depth.cols << "x" << depth.rows << ", must be "
         << camera.width_px << "x" << camera.height_px << " px as the camera";
    return line.str();
  }
  std::size_t known = 0;
  for (int y = 0; y < depth.rows; ++y)
    for (int x = 0; x < depth.cols; ++x) {
      const float z = depth.at<float>(y, x);
      if (std::isnan(z)) continue;
      if (!is_usable(static_cast<double>(z))) {
        line << "the depth at (" << x << ", " << y << ") is " << z << " mm, must be " << kDepthMinMm
             << " to " << kDepthMaxMm << " mm, or NaN where unknown";
        return line.str();
      }
      ++known;
    }
  const double share = static_cast<double>(known) / static_cast<double>(depth.total());
  if (share >= kKnownShareMin) return std::nullopt;
  line << "the depth is known at " << 100 * share << " % of the pixels, must be "
       << 100 * kKnownShareMin << " % at least";
  return line.str();
}

Site::Site(const CameraModel& camera, const SiteGeometry& geometry)
    : grid_{camera.fx_px, camera.fy_px, camera.cx_px, camera.cy_px} {
  if (const auto* plane = std::get_if<SitePlane>(&geometry)) {
    plane_mm_ = plane->depth_mm;
  } else {
    const auto& depth = std::get<SiteDepth>(geometry);
    depth_mm_ = depth.depth_mm.clone();
    grid_ = depth.grid.value_or(grid_);
    R_depth_camera_ = depth.R_depth_camera;
  }
  p_pivot_mm_ = Eigen::Vector3d(0, 0, depth_near(Eigen::Vector2d::Zero()));
  const cv::Point2d middle(0.5 * (camera.width_px - 1), 0.5 * (camera.height_px - 1));
  const cv::Point2d n = to_normalised(camera, {middle}).front();
  const Eigen::Vector2d ray(n.x, n.y);
  p_centre_mm_ = depth_near(ray) * ray.homogeneous();
}

std::optional<double> Site::depth_at(const Eigen::Vector2d& depth_ray) const {
  if (is_plane()) return plane_mm_;
  const double u = depth_ray.x() * grid_.fx_px + grid_.cx_px;
  const double v = depth_ray.y() * grid_.fy_px + grid_.cy_px;
  if (!(u >= 0 && v >= 0 && u <= depth_mm_.cols - 1 && v <= depth_mm_.rows - 1))
    return std::nullopt;
  const int x = std::min(static_cast<int>(u), depth_mm_.cols - 2);
  const int y = std::min(static_cast<int>(v), depth_mm_.rows - 2);
  const float* top = depth_mm_.ptr<float>(y) + x;
  const float* bottom = depth_mm_.ptr<float>(y + 1) + x;
  const auto z00 = static_cast<double>(top[0]), z01 = static_cast<double>(top[1]);
  const auto z10 = static_cast<double>(bottom[0]), z11 = static_cast<double>(bottom[1]);
  const double step = std::max({z00, z01, z10, z11}) - std::min({z00, z01, z10, z11});
  const double mean = 0.25 * (z00 + z01 + z10 + z11);  // NaN if any is: fails the next test
  if (!(step <= kStepMaxPixels * mean / grid_.fx_px) || std::isnan(mean)) return std::nullopt;
  const double a = u - x, b = v - y;
  return (1 - b) * ((1 - a) * z00 + a * z01) + b * ((1 - a) * z10 + a * z11);
}

double Site::depth_near(const Eigen::Vector2d& ray) const {
  if (const auto p = lift(ray)) return p->z();
  const Eigen::Vector3d d = R_depth_camera_ * ray.homogeneous();
  const double u = d.x() / d.z() * grid_.fx_px + grid_.cx_px;
  const double v = d.y() / d.z() * grid_.fy_px + grid_.cy_px;
  double nearest = std::numeric_limits<double>::infinity(), depth_mm = 0;
  for (int y = 0; y < depth_mm_.rows; ++y)
    for (int x = 0; x < depth_mm_.cols; ++x) {
      const float z = depth_mm_.at<float>(y, x);
      const double distance = std::hypot(x - u, y - v);
      if (std::isnan(z) || distance >= nearest) continue;
      nearest = distance;
      depth_mm = static_cast<double>(z);
    }
  return depth_mm / d.z();
}

std::optional<Eigen::Vector3d> Site::lift(const Eigen::Vector2d& ray) const {
  const Eigen::Vector3d d = R_depth_camera_ * ray.homogeneous();
  const auto depth = depth_at(d.head<2>() / d.z());
  if (!depth) return std::nullopt;
  return *depth / d.z() * ray.homogeneous();
}

std::optional<Eigen::Vector3d> Site::plane_near(const Eigen::Vector2d& ray, double reach) const {
  if (is_plane()) return Eigen::Vector3d(0, 0, 1 / plane_mm_);
  // With p = z (x, y, 1), n . p = 1 is linear in the inverse depth: n . (x, y, 1) = 1 / z.
  constexpr int kSteps = 2, kSide = 2 * kSteps + 1, kKnownMin = 19;
  std::array<Eigen::Vector4d, static_cast<std::size_t>(kSide * kSide)> samples;  // ray, 1/z
  std::size_t known = 0;
  Eigen::Matrix3d H = Eigen::Matrix3d::Zero();
  Eigen::Vector3d b = Eigen::Vector3d::Zero();
  for (int j = -kSteps; j <= kSteps; ++j)
    for (int i = -kSteps; i <= kSteps; ++i) {
      const Eigen::Vector2d offset = reach / kSteps * Eigen::Vector2d(i, j);
      const auto p = lift(ray + offset);
      if (!p) continue;
      const Eigen::Vector3d x = (offset / reach).homogeneous();
      samples[known++] << x, 1 / p->z();
      H += x * x.transpose();
      b += x / p->z();
    }
  if (known < static_cast<std::size_t>(kKnownMin)) return std::nullopt;
  const Eigen::Vector3d fit = H.ldlt().solve(b);
  const double depth_mm = 1 / fit.z();
  double squares = 0;
  for (std::size_t k = 0; k < known; ++k)
    squares += std::pow(fit.dot(samples[k].head<3>()) - samples[k].w(), 2);
  const double rms_mm = std::sqrt(squares / static_cast<double>(known)) * depth_mm * depth_mm;
  if (!(rms_mm < reach * depth_mm)) return std::nullopt;
  Eigen::Vector3d n;
  n.head<2>() = fit.head<2>() / reach;
  n.z() = fit.z() - n.head<2>().dot(ray);
  return n;
}

std::optional<Eigen::Vector3d> Site::meet(const Eigen::Vector2d& ray,
                                          const Eigen::Isometry3d& T_camera_site) const {
  const Eigen::Isometry3d T_depth_camera = R_depth_camera_ * T_camera_site.inverse(Eigen::Isometry);
  const Eigen::Vector3d origin = T_depth_camera.translation();
  const Eigen::Vector3d direction = T_depth_camera.linear() * ray.homogeneous();
  if (is_plane()) {
    const double along = (plane_mm_ - origin.z()) / direction.z();
    if (!(along > 0)) return std::nullopt;
    return origin + along * direction;
  }
  // The relief is shallow against its distance: taking the depth below the last guess settles.
  constexpr int kIterations = 12;
  constexpr double kSettledMm = 1e-4;
  const double z_start_mm = (R_depth_camera_ * p_pivot_mm_).z();
  Eigen::Vector3d p = origin + (z_start_mm - origin.z()) / direction.z() * direction;
  for (int i = 0; i < kIterations; ++i) {
    if (!(p.z() > 0)) return std::nullopt;
    const auto depth = depth_at(p.head<2>() / p.z());
    if (!depth) return std::nullopt;
    const double error = *depth - p.z();
    p += error / direction.z() * direction;
    if (std::abs(error) < kSettledMm) return R_depth_camera_.transpose() * p;
  }
  return std::nullopt;
}

}  // namespace holdfast::perception
