// SPDX-License-Identifier: Apache-2.0
// The features' check on a thread of its own: one frame at a time, taken when it is idle, with the
// estimate that it is to check. It never holds up the one that orders.
#pragma once

#include <memory>
#include <optional>

#include "perception/feature_check.hpp"

namespace holdfast::perception {

/// The estimate of the frame that was handed over.
struct CheckedPose {
  Eigen::Isometry3d T_camera_site = Eigen::Isometry3d::Identity();
  Matrix6d covariance = Matrix6d::Zero();
};

struct CheckResult {
  FeatureMotion motion;
  CheckedPose of;
};

class CheckThread {
 public:
  /// Starts the thread, with ordinary scheduling and its creator's CPUs. `features` has a keyframe.
  explicit CheckThread(FeatureCheck features);
  ~CheckThread();  ///< waits for the frame in work
  CheckThread(const CheckThread&) = delete;
  CheckThread& operator=(const CheckThread&) = delete;

  // One thread at a time.
  /// Copies the image, if idle; false, and nothing is done, while a frame is in work or its result
  /// has not been taken.
  bool order(const cv::Mat& image, const CheckedPose& of);
  /// The result, once.
  [[nodiscard]] std::optional<CheckResult> take();
  /// Until nothing is in work.
  void wait();

 private:
  struct Impl;
  std::unique_ptr<Impl> impl_;
};

}  // namespace holdfast::perception
