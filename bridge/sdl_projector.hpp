// SPDX-License-Identifier: Apache-2.0
// A projector that is a display: a borderless window that covers one output, pixel for pixel,
// without scaling.
#pragma once

#include <memory>
#include <string>
#include <vector>

#include "bridge/projector.hpp"

namespace holdfast::bridge {

struct Display {
  int index = 0;
  std::string name;
  cv::Rect area_px;  ///< on the desktop
};

/// Throws UnavailableError when there is no graphical session.
[[nodiscard]] std::vector<Display> list_displays();

struct SdlProjectorParameters {
  int display = 1;  ///< index in list_displays(); 0 is usually the operator's own screen
  /// From handing the image over to its surely being in the light: output and projector together.
  std::chrono::milliseconds settling{100};
};

class SdlProjector : public Projector {
 public:
  /// Covers the display with black. Throws UnavailableError when there is no graphical session or
  /// no such display (naming those that are there). One at a time in a process.
  explicit SdlProjector(const SdlProjectorParameters& parameters = {});
  ~SdlProjector() override;

  void show(const cv::Mat& pattern) override;
  void off() override;
  [[nodiscard]] ProjectorState state() const noexcept override;
  [[nodiscard]] cv::Size size_px() const noexcept override;

  /// Answers the window system, and draws again what it has lost. Call several times a second.
  /// Throws UnavailableError when the output is gone; it may be lit from then on.
  void service();

 private:
  struct Impl;
  std::unique_ptr<Impl> impl_;
};

}  // namespace holdfast::bridge
