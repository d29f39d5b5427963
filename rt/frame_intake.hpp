// SPDX-License-Identifier: Apache-2.0
// Between the camera and the rest: reports each frame's arrival and faults to the control loop at
// once, and hands the newest sound frame to the tracker. A frame with a fault is never tracked.
#pragma once

#include <array>
#include <atomic>
#include <condition_variable>
#include <mutex>

#include <opencv2/core.hpp>

#include "bridge/camera_source.hpp"
#include "bridge/frame_check.hpp"
#include "rt/frame_arrivals.hpp"

namespace holdfast::rt {

struct IntakeFrame {
  cv::Mat image;  ///< CV_8UC1 or CV_8UC3
  std::uint64_t frame = 0;
  safety::Timestamp t_received{};
  safety::Timestamp t_exposure{};
};

class FrameIntake {
 public:
  using Arrivals = FrameArrivals;

  explicit FrameIntake(const bridge::FrameCheckLimits& limits) : check_(limits) {}

  /// Camera thread only. Copies the image; never waits for the tracker beyond the swap of an index.
  void on_report(const bridge::CameraReport& report);

  /// Tracker thread only. Waits for a frame newer than the last one; false when closed. A frame
  /// that was replaced before it was fetched counts as skipped.
  [[nodiscard]] bool wait_frame(IntakeFrame& frame);

  /// Any thread: wait_frame returns false from now on.
  void close();

  /// Control thread only reads it.
  [[nodiscard]] Arrivals& arrivals() noexcept { return arrivals_; }
  [[nodiscard]] std::uint64_t frames_skipped() const noexcept { return skipped_.load(); }
  /// Uncertainty of the camera's clock against ours, ns, newest.
  [[nodiscard]] std::chrono::nanoseconds clock_sigma() const noexcept {
    return std::chrono::nanoseconds{clock_sigma_ns_.load()};
  }

 private:
  void hand_over(const bridge::CameraReport& report);

  bridge::FrameCheck check_;
  Arrivals arrivals_;
  std::atomic<std::uint64_t> skipped_{0};
  std::atomic<std::int64_t> clock_sigma_ns_{0};
  std::mutex mutex_;  // camera and tracker thread; held for an index swap only
  std::condition_variable fresh_;
  bool is_fresh_ = false;
  bool is_closed_ = false;
  IntakeFrame writing_;  // camera thread's
  IntakeFrame waiting_;  // guarded by mutex_
};

}  // namespace holdfast::rt
