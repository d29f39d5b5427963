// SPDX-License-Identifier: Apache-2.0
// The pattern projector: an 8-bit grey image on an output of its own, on or off, and when it was
// surely dark, so that frames which may show the pattern can be told from those which cannot.
// `holdfast project` is the one user so far. No program asks state() or may_be_lit() yet; above all
// not the daemon, so the pattern must be off while it tracks.
#pragma once

#include <chrono>

#include <opencv2/core.hpp>

namespace holdfast::bridge {

/// Times on CLOCK_MONOTONIC.
struct ProjectorState {
  bool is_on = false;
  /// The newest stretch in which there was surely no light; empty, as here, while none is known.
  std::chrono::nanoseconds t_dark_from = std::chrono::nanoseconds::max();
  std::chrono::nanoseconds t_dark_until = std::chrono::nanoseconds::max();  ///< max: it lasts
};

/// False only when an exposure from `t_begin` to `t_end` (CLOCK_MONOTONIC) lies within the newest
/// dark stretch: of earlier ones nothing is known any more. Pure.
[[nodiscard]] constexpr bool may_be_lit(const ProjectorState& state,
                                        std::chrono::nanoseconds t_begin,
                                        std::chrono::nanoseconds t_end) noexcept {
  return t_begin < state.t_dark_from || t_end >= state.t_dark_until;
}

/// One thread; all of it from the thread that constructed it.
class Projector {
 public:
  Projector() = default;
  virtual ~Projector() = default;
  Projector(const Projector&) = delete;
  Projector& operator=(const Projector&) = delete;

  /// Shows `pattern` (CV_8UC1, of the output's size). Throws InputError on another image, and shows
  /// on what it showed; UnavailableError when the output is gone, and may be lit from then on.
  virtual void show(const cv::Mat& pattern) = 0;
  /// Black. Throws UnavailableError as show() does.
  virtual void off() = 0;
  [[nodiscard]] virtual ProjectorState state() const noexcept = 0;
  [[nodiscard]] virtual cv::Size size_px() const noexcept = 0;
};

}  // namespace holdfast::bridge
