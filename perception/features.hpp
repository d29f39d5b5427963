// SPDX-License-Identifier: Apache-2.0
// ORB features (paper B, section 2.2.4) spread evenly over the image: FAST corners on a small
// pyramid, the best of each grid cell, oriented by the intensity centroid, described by ORB's
// rotated BRIEF. OpenCV's own selection keeps the strongest only, and they bunch.
#pragma once

#include <array>
#include <cstdint>
#include <memory>
#include <vector>

#include <opencv2/core.hpp>

#include "perception/tracker_parameters.hpp"

namespace holdfast::perception {

using Descriptor = std::array<std::uint64_t, 4>;  ///< 256 bits

struct Features {
  /// Pixel of the full-size image. Whole numbers: a corner is found on a pixel grid. Two views of
  /// a still scene therefore agree to exactly zero: only sub-pixel alignment measures motion.
  std::vector<cv::Point2f> pixels;
  std::vector<Descriptor> descriptors;
  std::vector<float> strengths;  ///< FAST score
  [[nodiscard]] int size() const noexcept { return static_cast<int>(pixels.size()); }
};

class FeatureDetector {
 public:
  explicit FeatureDetector(const FeatureParameters& parameters);
  ~FeatureDetector();
  FeatureDetector(FeatureDetector&&) noexcept;
  FeatureDetector& operator=(FeatureDetector&&) noexcept;

  /// Forgets the thresholds that follow the scene: what comes next depends on its images only.
  void reset();

  /// `grey`, `half` and `keep_half` as make_grey_and_mask() leaves them. Features of the regions
  /// to keep, in a deterministic order; possibly none. Each call adapts the thresholds for the
  /// next: after about ten on one image they are settled. One thread at a time.
  void detect(const cv::Mat& grey, const cv::Mat& half, const cv::Mat& keep_half, Features& out);

 private:
  struct Impl;
  std::unique_ptr<Impl> impl_;
};

}  // namespace holdfast::perception
