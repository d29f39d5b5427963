// SPDX-License-Identifier: Apache-2.0
// A recorded image stream: a folder of images in name order, or a video. Frames come out as the
// tracker takes them (CV_8UC1 or BGR CV_8UC3), each with its time. One thread at a time.
#pragma once

#include <chrono>
#include <memory>
#include <optional>
#include <string>

#include <opencv2/core.hpp>

namespace holdfast::bridge {

struct SequenceFrame {
  int index = 0;     ///< from 0
  std::string name;  ///< file, or video and frame, for messages
  std::chrono::nanoseconds t{};
  cv::Mat image;
};

/// Where the times come from.
enum class TimeSource : std::uint8_t {
  timestamps_file,  ///< timestamps.csv beside the frames: a line `frame,t_ns` each, as they are
  given_rate,       ///< the caller's frame rate, from 0
  video_rate,       ///< the video's own frame rate, from 0
  assumed_rate      ///< nothing known: 30 frames/s, from 0; the caller should say so to its user
};

class ImageSequence {
 public:
  /// Opens a folder (PNG, TIFF, JPEG, PGM, PPM, BMP; others are ignored) or a video that OpenCV
  /// reads. `fps` overrides any timestamps.csv. Throws InputError when there is nothing to read.
  ImageSequence(const std::string& path, std::optional<double> fps);
  ~ImageSequence();
  ImageSequence(const ImageSequence&) = delete;
  ImageSequence& operator=(const ImageSequence&) = delete;

  /// Number of frames: exact for a folder, as the file declares it for a video (0: not declared).
  [[nodiscard]] int size() const noexcept;
  [[nodiscard]] TimeSource time_source() const noexcept;

  /// The next frame; nothing after the last. 16-bit grey is scaled to 8 bit by the smallest of 10,
  /// 12, 14 and 16 bits that holds the first frame. Throws InputError, naming the file: unreadable
  /// or truncated image, a video that ends before its declared last frame, a size or type unlike
  /// the first frame's, a frame without a time.
  [[nodiscard]] std::optional<SequenceFrame> next();

 private:
  struct Impl;
  std::unique_ptr<Impl> impl_;
};

}  // namespace holdfast::bridge
