// SPDX-License-Identifier: Apache-2.0
// Resamples a region of the rectified grid from a raw image: lens distortion and rotation undone in
// one bilinear step. Positions are exact on a grid of 8 px and interpolated in between (error below
// 0.001 px for a microscope's distortion; OpenCV's remap rounds them to 1/32 px).
#pragma once

#include <vector>

#include <opencv2/core.hpp>

#include "registration/rectification.hpp"
#include "registration/simd.hpp"
#include "registration/worker_pool.hpp"

namespace holdfast::registration {

/// 8 or 16 bits, grey or BGR, as 8-bit grey; 16 bits are taken as full scale. Shares the pixels of
/// one that is so already.
[[nodiscard]] cv::Mat1b grey_of(const cv::Mat& image);

struct RectifiedImage {
  cv::Mat1b pixels;  ///< of the region; 0 where the raw image does not reach
  /// Per row the columns [start, end) that the raw image covers.
  std::vector<cv::Range> covered;
};

/// Both views, same rows. Column x of `left` and disparity d belong to column
/// x + (largest disparity - d) of `right`.
struct RectifiedPair {
  RectifiedImage left, right;
};

class Rectifier {
 public:
  /// For images of one camera (OpenCV's matrix, distortion, rotation and projection); `region` may
  /// lie partly outside the image. Immutable afterwards: any thread.
  Rectifier(const cv::Matx33d& camera_matrix, const cv::Mat& distortion, const cv::Matx33d& R_,
            const cv::Matx34d& projection, cv::Size raw_size_px, const cv::Rect& region);

  /// `raw` is CV_8UC1 of raw_size_px. Reuses the memory of `out`.
  void apply(const cv::Mat1b& raw, WorkerPool& pool, RectifiedImage& out,
             Simd simd = best_simd()) const;
  [[nodiscard]] cv::Rect region() const { return region_; }

 private:
  cv::Size raw_size_px_;
  cv::Rect region_;
  cv::Mat1f u_, v_;  // raw positions at every 8th rectified pixel
};

/// The raw left image (as grey_of() takes it) on the whole rectified left grid.
[[nodiscard]] cv::Mat1b rectified_left(const cv::Mat& raw_left, const ZoomCalibration& zoom,
                                       const Rectification& geometry);

}  // namespace holdfast::registration
