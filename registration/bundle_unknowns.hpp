// SPDX-License-Identifier: Apache-2.0
// Part of stereo_bundle: the unknowns as the solver moves them, and their way from and to OpenCV's
// parameters.
#pragma once

#include <array>
#include <vector>

#include <Eigen/Core>

#include "registration/stereo_calibration.hpp"

namespace holdfast::registration::bundle {

inline constexpr int kIntrinsics = 13;
inline constexpr int kExtrinsics = 6;  // rotation vector and T: left to right camera
inline constexpr int kPose = 6;        // rotation vector and translation: board to left camera
inline constexpr int kBend = 3;
inline constexpr int kOfZoom = 2 * kIntrinsics + kExtrinsics;

/// log fx, log fy, cx, cy, k1 k2 p1 p2 k3 s1 s2 s3 s4 (no k4..k6).
using Camera = std::array<double, kIntrinsics>;
using Bend = std::array<double, kBend>;

struct ZoomUnknowns {
  Camera left{}, right{};
  std::array<double, kExtrinsics> extrinsics{};

  [[nodiscard]] std::array<double*, 3> blocks() {
    return {left.data(), right.data(), extrinsics.data()};
  }
};

struct Unknowns {
  std::vector<ZoomUnknowns> zooms;
  std::vector<std::array<double, kPose>> poses;  ///< of every pair, zoom by zoom
  Bend bend{};
};

[[nodiscard]] ZoomUnknowns from_opencv(const ZoomCalibration& zoom);

/// `like` gives what the unknowns do not hold. The distortion has `coefficients` numbers.
[[nodiscard]] ZoomCalibration to_opencv(const ZoomUnknowns& zoom, int coefficients,
                                        const ZoomCalibration& like);

/// `covariance` (of the unknowns in blocks()' order) in parameter_vector()'s order and units.
[[nodiscard]] Eigen::MatrixXd to_opencv_covariance(const ZoomUnknowns& zoom, int coefficients,
                                                   const Eigen::MatrixXd& covariance);

}  // namespace holdfast::registration::bundle
