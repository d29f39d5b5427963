// SPDX-License-Identifier: Apache-2.0
#include "perception/patch_sighting.hpp"

#include <algorithm>
#include <cmath>

namespace holdfast::perception {
namespace {

Eigen::Matrix3d cross_matrix(const Eigen::Vector3d& v) {
  Eigen::Matrix3d m;
  m << 0, -v.z(), v.y(), v.z(), 0, -v.x(), -v.y(), v.x(), 0;
  return m;
}

}  // namespace

PatchObserver::PatchObserver(const CameraModel& camera, Freedom freedom,
                             const Eigen::Vector3d& p_pivot_site_mm, double depth_sigma_mm)
    : projector_(camera),
      freedom_(freedom),
      p_pivot_site_mm_(p_pivot_site_mm),
      depth_sigma_mm_(depth_sigma_mm),
      width_px_(camera.width_px),
      height_px_(camera.height_px) {}

bool PatchObserver::look(const PatchPixels& pixels, const PatchGeometry& geometry,
                         const cv::Mat& image, int level, const Eigen::Isometry3d& T_camera_site,
                         Interpolation interpolation, PatchSighting& out) const {
  const Eigen::Vector3d p = T_camera_site * geometry.p_site_mm;
  if (!(p.z() > 1e-3)) return false;
  const double to_level = std::ldexp(1.0, -level);
  const Projection seen = projector_.project(p);
  const Eigen::Matrix<double, 2, 3> J = to_level * seen.d_pixel_d_point;
  const Eigen::Matrix2d A = J * (T_camera_site.linear() * geometry.tangents_mm);
  const double determinant = A.determinant();
  if (!(determinant > 0.2 && determinant < 5)) return false;
  PatchPlace place;
  place.u_px = (seen.pixel.x() + 0.5) * to_level - 0.5;
  place.v_px = (seen.pixel.y() + 0.5) * to_level - 0.5;
  place.a00 = static_cast<float>(A(0, 0));
  place.a01 = static_cast<float>(A(0, 1));
  place.a10 = static_cast<float>(A(1, 0));
  place.a11 = static_cast<float>(A(1, 1));
  if (!is_inside(place, image.cols, image.rows)) return false;

  const PatchSums sums = patch_sums(image, place, pixels, interpolation, simd_);
  const float squares = std::max(sums.ii - sums.i * sums.i / kPatchCount, 1e-3F);
  out.zncc = static_cast<double>(sums.vi / std::sqrt(squares * geometry.squares));
  const float gain = std::sqrt(geometry.squares / squares);
  out.brightness = sums.i / kPatchCount / std::max(geometry.mean, 1.0F);
  out.contrast = 1 / gain;
  out.displacement =
      geometry.unit_covariance_px2 *
      Eigen::Vector2d(static_cast<double>(gain * sums.gxi), static_cast<double>(gain * sums.gyi));
  const Eigen::Vector3d lever = p - T_camera_site * p_pivot_site_mm_;
  out.geometry = &geometry;
  out.to_patch << A(1, 1), -A(0, 1), -A(1, 0), A(0, 0);
  out.to_patch /= determinant;
  const Eigen::Matrix<double, 2, 3> by_point = out.to_patch * J;
  out.jacobian.leftCols<3>() = by_point;
  out.jacobian.rightCols<3>().noalias() = -by_point * cross_matrix(lever);
  if (freedom_ == Freedom::planar) out.jacobian.middleCols<2>(3).setZero();
  out.by_depth = depth_sigma_mm_ / geometry.p_site_mm.z() *
                 (by_point * (T_camera_site.linear() * geometry.p_site_mm));
  const int column = std::clamp(static_cast<int>(seen.pixel.x() * kSightingCells / width_px_), 0,
                                kSightingCells - 1);
  const int line = std::clamp(static_cast<int>(seen.pixel.y() * kSightingCells / height_px_), 0,
                              kSightingCells - 1);
  out.cell = line * kSightingCells + column;
  return true;
}

}  // namespace holdfast::perception
