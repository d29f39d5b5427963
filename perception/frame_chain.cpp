// SPDX-License-Identifier: Apache-2.0
#include "perception/frame_chain.hpp"

#include <algorithm>
#include <cmath>

#include <Eigen/LU>

namespace holdfast::perception {

FrameChain::FrameChain(const CameraModel& camera, const TrackerParameters& parameters,
                       Freedom freedom, const Eigen::Vector3d& p_pivot_site_mm)
    : projector_(camera),
      parameters_(parameters.direct),
      aligner_(camera, parameters, freedom, p_pivot_site_mm) {
  const auto n = 2 * static_cast<std::size_t>(parameters_.chain_patches);
  aligner_.reserve(n);
  patches_[0].pixels.reserve(n);
  patches_[0].geometry.reserve(n);
}

std::optional<Eigen::Isometry3d> FrameChain::follow(const Pyramid& image,
                                                    const Eigen::Isometry3d& T_start) {
  const Alignment found = aligner_.align(patches_, image, T_start, 0);
  const double share = static_cast<double>(found.quality.inliers) /
                       std::max<double>(1, static_cast<double>(patches_[0].size()));
  if (!found.is_solved || share < parameters_.share_min) return std::nullopt;
  return found.T_camera_site;
}

void FrameChain::link(const Pyramid& image, const DirectTemplate& keyframe,
                      const Eigen::Isometry3d& T_camera_site, bool is_new) {
  TemplateLevel& to = patches_[0];
  to.pixels.clear();
  to.geometry.clear();
  const cv::Mat& grey = image.levels[0];
  const auto& from = keyframe[0].geometry;
  const auto wanted = static_cast<std::size_t>(parameters_.chain_patches);
  const std::size_t stride = std::max<std::size_t>(1, from.size() / wanted);
  constexpr double kHalf = 0.5 * (kPatchSide - 1);
  for (std::size_t k = stride / 2; k < from.size() && to.size() < 2 * wanted; k += stride) {
    const Eigen::Vector3d p = T_camera_site * from[k].p_site_mm;
    if (!(p.z() > 1e-3)) continue;
    const Projection seen = projector_.project(p);
    const Eigen::Matrix2d A = seen.d_pixel_d_point * (T_camera_site.linear() * from[k].tangents_mm);
    if (!(A.determinant() > 0.2)) continue;
    const Eigen::Vector2d first = (seen.pixel.array() - kHalf).round();
    if (!(first.x() >= 2 && first.y() >= 2 && first.x() + kPatchSide + 2 < grey.cols &&
          first.y() + kPatchSide + 2 < grey.rows))
      continue;
    PatchPixels pixels;
    PatchGeometry geometry;
    const cv::Point corner(static_cast<int>(first.x()), static_cast<int>(first.y()));
    if (!cut_patch(grey, corner, parameters_.texture_min, pixels, geometry)) continue;
    const Eigen::Matrix2d to_keyframe = A.inverse();
    const Eigen::Vector2d beside = first.array() + kHalf - seen.pixel.array();
    geometry.p_site_mm = from[k].p_site_mm + from[k].tangents_mm * (to_keyframe * beside);
    geometry.tangents_mm = from[k].tangents_mm * to_keyframe;
    to.pixels.push_back(pixels);
    to.geometry.push_back(geometry);
  }
  T_last_ = T_camera_site;
  length_ = is_new ? 0 : length_ + 1;
}

void FrameChain::rebase(const Eigen::Isometry3d& T_other_site) {
  for (PatchGeometry& patch : patches_[0].geometry) {
    patch.p_site_mm = T_other_site * patch.p_site_mm;
    patch.tangents_mm = T_other_site.linear() * patch.tangents_mm;
  }
  if (T_last_) *T_last_ = *T_last_ * T_other_site.inverse(Eigen::Isometry);
}

}  // namespace holdfast::perception
