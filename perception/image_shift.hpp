// SPDX-License-Identifier: Apache-2.0
// By how much the picture as a whole has moved since the frame before: phase correlation of small
// images. Only to find the way back into the reach of alignment after a jolt; never a measurement.
#pragma once

#include <optional>

#include <opencv2/core.hpp>

namespace holdfast::perception {

class ImageShift {
 public:
  /// Keeps `quarter` (CV_8UC1, a pyramid's smallest level) at half its size as the frame before.
  void remember(const cv::Mat& quarter);
  void forget() { has_previous_ = false; }

  /// Shift of `quarter` against the frame remembered, in pixels of the full image, good to about
  /// 8 px; nothing without one of the same size, or when no shift stands out.
  [[nodiscard]] std::optional<cv::Point2d> find(const cv::Mat& quarter);

 private:
  void reduce(const cv::Mat& quarter, cv::Mat& out);
  bool has_previous_ = false;
  cv::Mat small_, window_, previous_, now_, spectrum_before_, spectrum_now_, correlation_;
};

}  // namespace holdfast::perception
