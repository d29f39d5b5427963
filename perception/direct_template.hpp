// SPDX-License-Identifier: Apache-2.0
// The keyframe as direct alignment sees it: small patches with texture in both directions, spread
// over the image, each with its pixels and its place on the site, on every level of the pyramid.
#pragma once

#include <array>
#include <vector>

#include <Eigen/Core>
#include <opencv2/core.hpp>

#include "perception/camera_model.hpp"
#include "perception/patch_kernel.hpp"
#include "perception/pyramid.hpp"
#include "perception/site.hpp"
#include "perception/tracker_parameters.hpp"

namespace holdfast::perception {

struct PatchGeometry {
  Eigen::Vector3d p_site_mm;                ///< of the centre
  Eigen::Matrix<double, 3, 2> tangents_mm;  ///< along the site, per pixel of the level
  Eigen::Matrix2d information;              ///< sum of gradient products, (grey levels/px)^2
  Eigen::Matrix2d unit_covariance_px2;      ///< its inverse: for noise of one grey level
  float squares = 0;                        ///< sum of the squared values
  float mean = 0;                           ///< what was taken from the values
};

struct TemplateLevel {
  std::vector<PatchPixels> pixels;
  std::vector<PatchGeometry> geometry;
  [[nodiscard]] std::size_t size() const noexcept { return pixels.size(); }
};

using DirectTemplate = std::array<TemplateLevel, kPyramidLevels>;

/// Full-size patches that take no part in the alignment but are asked about it: the weakest texture
/// of each cell. What is bright and fixed to the microscope (projected dots, an aiming beam, dust)
/// wins every contest for texture; between it only the site is seen.
[[nodiscard]] TemplateLevel make_witnesses(const Pyramid& keyframe, const cv::Mat& keep_half,
                                           const CameraModel& camera, const Site& site,
                                           const DirectParameters& parameters);

/// Pixels and information of the 8x8 patch whose first pixel is `corner`, one pixel inside `image`
/// at least. False, when it has too little texture in one direction.
[[nodiscard]] bool cut_patch(const cv::Mat& image, cv::Point corner, double texture_min,
                             PatchPixels& pixels, PatchGeometry& geometry);

/// `keep_half`: as GreyAndMask has it; no patch touches a pixel that is 0 there. A patch whose
/// depth is unknown or steps is left out. Possibly empty.
[[nodiscard]] DirectTemplate make_template(const Pyramid& keyframe, const cv::Mat& keep_half,
                                           const CameraModel& camera, const Site& site,
                                           const DirectParameters& parameters);

}  // namespace holdfast::perception
