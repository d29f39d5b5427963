// SPDX-License-Identifier: Apache-2.0
// What an X display shows: the virtual projector's light is the content of a virtual screen.
#pragma once

#include <memory>
#include <string>

#include <opencv2/core.hpp>

namespace holdfast::sim {

class ScreenReader {
 public:
  /// `display`: as in DISPLAY, e.g. ":7". Throws UnavailableError. One thread.
  explicit ScreenReader(const std::string& display);
  ~ScreenReader();
  ScreenReader(const ScreenReader&) = delete;
  ScreenReader& operator=(const ScreenReader&) = delete;

  /// The whole screen now, CV_8UC3 BGR. Throws UnavailableError when it cannot be read.
  [[nodiscard]] cv::Mat read();

 private:
  struct Impl;
  std::unique_ptr<Impl> impl_;
};

}  // namespace holdfast::sim
