// SPDX-License-Identifier: Apache-2.0
// Images from a folder or a video as a camera would see them, one after the other, looped.
#pragma once

#include <filesystem>
#include <vector>

#include "tests/sim/frame_source.hpp"

namespace holdfast::sim {

class ImageSequence : public FrameSource {
 public:
  /// Decodes everything into memory. `path`: a folder of PNG, TIFF, JPEG or BMP in name order, or a
  /// video OpenCV reads; all of one size. Throws InputError naming the file.
  explicit ImageSequence(const std::filesystem::path& path);

  [[nodiscard]] cv::Size sensor_px() const noexcept override { return frames_.front().size(); }
  /// Each new `t_mid_exposure` shows the next image. An occluded view is a grey one.
  void render(std::chrono::nanoseconds t_mid_exposure, const View& view, bridge::PixelFormat format,
              const cv::Rect& region, std::uint8_t* pixels) override;
  [[nodiscard]] std::size_t size() const noexcept { return frames_.size(); }

 private:
  std::vector<cv::Mat> frames_;  // CV_8UC1 or CV_8UC3
  std::size_t next_ = 0;
  std::chrono::nanoseconds t_last_{-1};
};

}  // namespace holdfast::sim
