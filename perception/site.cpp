// SPDX-License-Identifier: Apache-2.0
#include "perception/site.hpp"

#include <algorithm>
#include <cmath>
#include <limits>
#include <sstream>

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
  if (depth.cols != camera.width_px || depth.rows != camera.height_px) {
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

Site::Site(const CameraModel& camera, const SiteGeometry& geometry) : camera_(camera) {
  if (const auto* plane = std::get_if<SitePlane>(&geometry))
    plane_mm_ = plane->depth_mm;
  else
    depth_mm_ = std::get<SiteDepth>(geometry).depth_mm.clone();
  p_pivot_mm_ = Eigen::Vector3d(0, 0, depth_near(Eigen::Vector2d::Zero()));
  const cv::Point2d middle(0.5 * (camera.width_px - 1), 0.5 * (camera.height_px - 1));
  const cv::Point2d n = to_normalised(camera, {middle}).front();
  const Eigen::Vector2d ray(n.x, n.y);
  p_centre_mm_ = depth_near(ray) * ray.homogeneous();
}

std::optional<double> Site::depth_at(const Eigen::Vector2d& ray) const {
  if (is_plane()) return plane_mm_;
  const double u = ray.x() * camera_.fx_px + camera_.cx_px;
  const double v = ray.y() * camera_.fy_px + camera_.cy_px;
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
  if (!(step <= kStepMaxPixels * mean / camera_.f_px()) || std::isnan(mean)) return std::nullopt;
  const double a = u - x, b = v - y;
  return (1 - b) * ((1 - a) * z00 + a * z01) + b * ((1 - a) * z10 + a * z11);
}

double Site::depth_near(const Eigen::Vector2d& ray) const {
  if (const auto depth = depth_at(ray)) return *depth;
  const double u = ray.x() * camera_.fx_px + camera_.cx_px;
  const double v = ray.y() * camera_.fy_px + camera_.cy_px;
  double nearest = std::numeric_limits<double>::infinity(), depth_mm = 0;
  for (int y = 0; y < depth_mm_.rows; ++y)
    for (int x = 0; x < depth_mm_.cols; ++x) {
      const float z = depth_mm_.at<float>(y, x);
      const double distance = std::hypot(x - u, y - v);
      if (std::isnan(z) || distance >= nearest) continue;
      nearest = distance;
      depth_mm = static_cast<double>(z);
    }
  return depth_mm;
}

std::optional<Eigen::Vector3d> Site::lift(const Eigen::Vector2d& ray) const {
  const auto depth = depth_at(ray);
  if (!depth) return std::nullopt;
  return *depth * ray.homogeneous();
}

std::optional<Eigen::Vector3d> Site::meet(const Eigen::Vector2d& ray,
                                          const Eigen::Isometry3d& T_camera_site) const {
  const Eigen::Isometry3d T_site_camera = T_camera_site.inverse(Eigen::Isometry);
  const Eigen::Vector3d origin = T_site_camera.translation();
  const Eigen::Vector3d direction = T_site_camera.linear() * ray.homogeneous();
  if (is_plane()) {
    const double along = (plane_mm_ - origin.z()) / direction.z();
    if (!(along > 0)) return std::nullopt;
    return origin + along * direction;
  }
  // The relief is shallow against its distance: taking the depth below the last guess settles.
  constexpr int kIterations = 12;
  constexpr double kSettledMm = 1e-4;
  Eigen::Vector3d p = origin + (p_pivot_mm_.z() - origin.z()) / direction.z() * direction;
  for (int i = 0; i < kIterations; ++i) {
    if (!(p.z() > 0)) return std::nullopt;
    const auto depth = depth_at(p.head<2>() / p.z());
    if (!depth) return std::nullopt;
    const double error = *depth - p.z();
    p += error / direction.z() * direction;
    if (std::abs(error) < kSettledMm) return p;
  }
  return std::nullopt;
}

}  // namespace holdfast::perception
