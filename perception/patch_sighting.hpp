// SPDX-License-Identifier: Apache-2.0
// One patch of a template in an image, at a pose: where it is seen, how far its gradients say it is
// displaced, and how pose and depth would move it.
#pragma once

#include <array>

#include <Eigen/Geometry>
#include <opencv2/core.hpp>

#include "perception/direct_template.hpp"
#include "perception/patch_kernel.hpp"
#include "perception/pose_fit.hpp"
#include "perception/projection.hpp"

namespace holdfast::perception {

inline constexpr int kSightingCells = 8;  ///< per side of the image

/// Displacements in pixels of the template.
struct PatchSighting {
  const PatchGeometry* geometry;
  Eigen::Matrix<double, 2, 6> jacobian;  ///< of the displacement by the pose step
  Eigen::Matrix2d to_patch;              ///< from pixels of the image to pixels of the template
  Eigen::Vector2d displacement;
  Eigen::Vector2d by_depth;  ///< displacement for one sigma of depth
  double zncc;
  float brightness, contrast;  ///< of the image's patch, in terms of the template's
  int cell;                    ///< of kSightingCells x kSightingCells
};

/// No state but its parameters; allocation-free.
class PatchObserver {
 public:
  PatchObserver(const CameraModel& camera, Freedom freedom, const Eigen::Vector3d& p_pivot_site_mm,
                double depth_sigma_mm);

  /// `image` is the pyramid's `level`. False, and `out` is void, when the patch is not wholly in
  /// the image, or is seen too obliquely or at another scale (1/5 to 5 in area).
  [[nodiscard]] bool look(const PatchPixels& pixels, const PatchGeometry& geometry,
                          const cv::Mat& image, int level, const Eigen::Isometry3d& T_camera_site,
                          Interpolation interpolation, PatchSighting& out) const;

 private:
  Projector projector_;
  Freedom freedom_;
  Eigen::Vector3d p_pivot_site_mm_;
  double depth_sigma_mm_;
  int width_px_, height_px_;
  Simd simd_ = best_simd();
};

}  // namespace holdfast::perception
