// SPDX-License-Identifier: Apache-2.0
// The live view's side of the daemon: now and then a frame that the tracker is done with, made
// small, with what the tracker said of it, and written for others to see. For eyes alone: nothing
// of it comes back, and no decision waits for it.
#pragma once

#include <array>
#include <atomic>
#include <chrono>
#include <cstdint>
#include <filesystem>

#include <Eigen/Core>
#include <opencv2/core.hpp>

#include "bridge/live_view/live_file.hpp"
#include "perception/direct_tracker.hpp"
#include "perception/job_thread.hpp"
#include "perception/projection.hpp"
#include "perception/reflection_mask.hpp"

namespace holdfast::rt {

struct LiveViewConfig {
  std::filesystem::path file;
  int width_max_px = 640;  ///< the camera's frame is divided by a whole number to come below it
  double rate_max_hz = 15;
};

class LiveView {
 public:
  /// Throws as bridge::LiveWriter; InputError when the camera's frame is too small, or too long for
  /// its width, to be made a picture.
  LiveView(const LiveViewConfig& config, const perception::CameraModel& camera,
           const perception::ReflectionMaskParameters& mask);

  /// After `tracker` has told `estimate` of `image` (CV_8UC1 or BGR): when one is due and the one
  /// before is done, takes `image` for one of an earlier frame, without a copy; else does nothing.
  /// The tracker's thread; never waits for the picture. Takes no memory.
  void offer(cv::Mat& image, std::uint64_t frame, const perception::MotionEstimate& estimate,
             const perception::DirectTracker& tracker);

  /// Until the picture in work is written. The tracker's thread; for tests and measurements.
  void wait() { thread_.wait(); }
  /// 0, or the errno of the newest write that failed. Any thread.
  [[nodiscard]] int error() const noexcept { return error_.load(std::memory_order_relaxed); }

 private:
  void make_picture();
  void make_pixels();
  void make_mask();
  void place_tracked();

  // The tracker's thread's.
  std::chrono::nanoseconds period_;
  std::chrono::nanoseconds t_due_{};
  // From order to take the job's, else the tracker's thread's.
  cv::Mat image_;
  std::uint64_t frame_ = 0;
  perception::MotionEstimate estimate_;
  std::array<Eigen::Vector3d, bridge::kLivePointsMax> p_inliers_mm_;
  std::size_t inliers_ = 0;
  // The job's.
  perception::CameraModel camera_;
  perception::Projector projector_;
  perception::ReflectionMaskParameters mask_parameters_;
  perception::GreyAndMask grey_and_mask_;
  cv::Mat glints_, small_, mask_;
  bridge::LivePicture picture_;
  bridge::LiveWriter writer_;
  std::atomic<int> error_{0};
  perception::JobThread thread_;  // last: it uses all the others
};

}  // namespace holdfast::rt
