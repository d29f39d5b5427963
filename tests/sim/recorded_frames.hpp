// SPDX-License-Identifier: Apache-2.0
// Recorded images as a camera would see them, one after the other, looped.
#pragma once

#include <functional>
#include <string>
#include <vector>

#include "tests/sim/frame_source.hpp"

namespace holdfast::sim {

class RecordedFrames : public FrameSource {
 public:
  /// Which image an exposure shows, counted from 0 and taken modulo their number.
  using Choice = std::function<std::size_t(std::chrono::nanoseconds t_mid_exposure)>;

  /// Decodes all of a folder or video (bridge/image_sequence.hpp) into memory. Without `choice`
  /// each new instant shows the next image. Throws InputError, naming the file; also when the
  /// images need more than 4 GiB.
  explicit RecordedFrames(const std::string& path, Choice choice = {});

  [[nodiscard]] cv::Size sensor_px() const noexcept override { return frames_.front().size(); }
  /// An occluded view is an evenly grey one.
  void render(std::chrono::nanoseconds t_mid_exposure, const View& view, bridge::PixelFormat format,
              const cv::Rect& region, std::uint8_t* pixels) override;
  [[nodiscard]] std::size_t size() const noexcept { return frames_.size(); }

 private:
  std::vector<cv::Mat> frames_;  // CV_8UC1 or CV_8UC3
  Choice choice_;
  std::size_t next_ = 0;
  std::chrono::nanoseconds t_last_{-1};
};

}  // namespace holdfast::sim
