// SPDX-License-Identifier: Apache-2.0
// A small analytic stereo microscope for the tests of reconstruction: toed-in, with lens
// distortion, over a smooth relief with dots on it. Nothing in it is shared with the code under
// test but OpenCV's camera model. (The virtual operating room is the honest rig; this one is
// quick.)
#pragma once

#include <cstdint>

#include <opencv2/core.hpp>

#include "registration/rectification.hpp"
#include "registration/stereo_calibration.hpp"

namespace holdfast::test {

struct StereoRig {
  cv::Size image_px{400, 320};
  double focal_px = 2000, baseline_mm = 24, distance_mm = 200;
  double distortion_k1 = -0.1;
  double pitch_rad = 0.002;  ///< of the right camera against the left
  double relief_mm = 3;      ///< amplitude

  bool is_lattice = false;  ///< every dot in its place: repeats along the rows
  double dot_pitch_mm = 1.2, dot_radius_mm = 0.4;
  double dots_turn_rad = 0, dots_shift_mm = 0;  ///< of the dots on the site
  double contrast_grey = 140, ambient_grey = 30, texture_grey = 4;
  double noise_grey = 1;
  std::uint32_t seed = 1;  ///< of the dots and the noise

  /// The true calibration; zoom 1.
  [[nodiscard]] registration::ZoomCalibration calibration() const;
  /// CV_8UC1.
  [[nodiscard]] cv::Mat1b left() const { return view(true); }
  [[nodiscard]] cv::Mat1b right() const { return view(false); }
  /// Depth of the relief in the rectified left frame at a rectified pixel, mm.
  [[nodiscard]] double true_depth_mm(const registration::Rectification& geometry, double x_px,
                                     double y_px) const;

 private:
  [[nodiscard]] cv::Mat1b view(bool is_left) const;
  [[nodiscard]] double height_mm(double x_mm, double y_mm) const;  // z of the relief, frame camera
  [[nodiscard]] cv::Vec3d meet(const cv::Vec3d& origin_mm, const cv::Vec3d& direction) const;
  [[nodiscard]] double grey(double x_mm, double y_mm) const;
};

}  // namespace holdfast::test
