// SPDX-License-Identifier: Apache-2.0
// Sparse direct alignment: the pose under which the patches of a template, moved by it, look like
// the image. Inverse compositional Gauss-Newton on SE(3) about the pivot; every patch contributes
// the displacement its gradients see, weighted by what its texture, the noise and its depth allow,
// and by Tukey's function of how well it agrees with the others.
//
// Lens distortion is in the projection: images are never resampled. Blind to brightness and
// contrast, patch by patch.
#pragma once

#include <array>
#include <memory>
#include <span>
#include <vector>

#include <Eigen/Geometry>

#include "perception/direct_template.hpp"
#include "perception/motion_estimate.hpp"
#include "perception/pose_fit.hpp"
#include "perception/pyramid.hpp"
#include "perception/tracker_parameters.hpp"

namespace holdfast::perception {

/// How well the template fits at a pose.
struct AlignmentQuality {
  int visible = 0;         ///< patches inside the image
  int inliers = 0;         ///< of them, those with a say
  double zncc = 0;         ///< mean of the inliers, -1..1
  double spread = 0;       ///< fraction of the 8x8 image cells with an inlier, 0..1
  double residual_px = 0;  ///< rms of the inliers' own displacements, px of the full image
  double noise = 0;       ///< grey levels, of one pixel: what is left after brightness and contrast
  double brightness = 1;  ///< median ratio of a patch's mean to its template's
  double contrast = 1;    ///< median ratio of a patch's deviation to its template's
  /// How much of the template is still there at full size, over how much at quarter size (medians
  /// of the regression of image on template): blur takes from fine detail, smoke and light from
  /// all. 1 where the quarter size shows too little.
  double sharpness = 1;
};

struct Alignment {
  bool is_solved = false;  ///< otherwise nothing below counts
  Eigen::Isometry3d T_camera_site = Eigen::Isometry3d::Identity();
  Matrix6d covariance = Matrix6d::Zero();  ///< as MotionEstimate::covariance
  AlignmentQuality quality;
};

/// What patches that took no part in an alignment say of its pose.
struct Testimony {
  int visible = 0;
  int agreeing = 0;  ///< alike, and displaced by no more than noise explains, or half a pixel
};

class DirectAligner {
 public:
  DirectAligner(const CameraModel& camera, const TrackerParameters& parameters, Freedom freedom,
                const Eigen::Vector3d& p_pivot_site_mm);
  ~DirectAligner();
  DirectAligner(DirectAligner&&) noexcept;
  DirectAligner& operator=(DirectAligner&&) noexcept;

  /// Makes room for this many patches a level: no call allocates after it.
  void reserve(std::size_t patches);

  /// From the level `coarsest` (0: full size) down to full size. One thread at a time.
  [[nodiscard]] Alignment align(const DirectTemplate& patches, const Pyramid& image,
                                const Eigen::Isometry3d& T_start, int coarsest);
  /// Where the patches that had a say in the last alignment lie on the site, as many as there is
  /// room for; how many that are.
  [[nodiscard]] std::size_t inliers(std::span<Eigen::Vector3d> p_site_mm) const noexcept;
  /// The noise is that of the last alignment.
  [[nodiscard]] Testimony ask(const TemplateLevel& witnesses, const Pyramid& image,
                              const Eigen::Isometry3d& T_camera_site) const;
  /// Mean ZNCC of the level's visible patches where the pose puts them, none left out; -1 when
  /// fewer than 8 are visible.
  [[nodiscard]] double similarity(const DirectTemplate& patches, const Pyramid& image, int level,
                                  const Eigen::Isometry3d& T_camera_site) const;

 private:
  struct Impl;
  std::unique_ptr<Impl> impl_;
};

}  // namespace holdfast::perception
