// SPDX-License-Identifier: Apache-2.0
// Renders the next frame on a second thread while the last one is being sent.
#pragma once

#include <chrono>
#include <condition_variable>
#include <cstdint>
#include <mutex>
#include <thread>
#include <vector>

#include "tests/sim/frame_source.hpp"

namespace holdfast::sim {

/// Everything an image depends on.
struct Shot {
  std::chrono::nanoseconds t_mid_exposure{};
  View view;
  bridge::PixelFormat format = bridge::PixelFormat::mono8;
  cv::Rect region;
  std::uint64_t source_version = 0;
  /// The same image, but for an instant that differs by less than 0.1 ms.
  [[nodiscard]] bool is_nearly(const Shot& other) const noexcept;
  [[nodiscard]] std::size_t bytes() const noexcept;
};

class RenderAhead {
 public:
  explicit RenderAhead(FrameSource& source);
  ~RenderAhead();
  RenderAhead(const RenderAhead&) = delete;
  RenderAhead& operator=(const RenderAhead&) = delete;

  /// Starts rendering `shot`, for a later take().
  void prepare(const Shot& shot);
  /// The pixels of `shot`: those prepared if they are nearly it (then `shot` gets their instant),
  /// else rendered now. Valid until the second next take(). One thread, the same as prepare()'s.
  const std::vector<std::uint8_t>& take(Shot& shot);

 private:
  void run();
  void render(const Shot& shot, std::vector<std::uint8_t>& pixels);

  FrameSource& source_;
  std::mutex mutex_;
  std::condition_variable changed_;
  enum class State : std::uint8_t { idle, wanted, rendering, ready } state_ = State::idle;
  bool stop_ = false;
  Shot shot_;
  std::vector<std::uint8_t> prepared_, taken_;
  std::thread thread_;
};

}  // namespace holdfast::sim
