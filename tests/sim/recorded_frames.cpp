// SPDX-License-Identifier: Apache-2.0
#include "tests/sim/recorded_frames.hpp"

#include <fmt/core.h>

#include "bridge/image_sequence.hpp"
#include "rt/core/error.hpp"
#include "tests/sim/wire_pixels.hpp"

namespace holdfast::sim {
namespace {

constexpr std::size_t kMemoryMax = std::size_t{4} << 30U;
constexpr double kDarkLevel = 2, kOccludedLevel = 120;

}  // namespace

RecordedFrames::RecordedFrames(const std::string& path, Choice choice)
    : choice_(std::move(choice)) {
  // The camera's own rate plays them: whatever times the recording has do not matter.
  bridge::ImageSequence sequence(path, 1.0);
  std::size_t bytes = 0;
  while (const auto frame = sequence.next()) {
    bytes += frame->image.total() * frame->image.elemSize();
    if (bytes > kMemoryMax)
      throw InputError(
          fmt::format("{}: the sequence needs more than {} MiB", frame->name, kMemoryMax >> 20U));
    frames_.push_back(frame->image);
  }
}

void RecordedFrames::render(std::chrono::nanoseconds t_mid_exposure, const View& view,
                            bridge::PixelFormat format, const cv::Rect& region,
                            std::uint8_t* pixels) {
  if (choice_)
    next_ = choice_(t_mid_exposure) % frames_.size();
  else if (t_mid_exposure != t_last_ && t_last_.count() >= 0)
    next_ = (next_ + 1) % frames_.size();
  t_last_ = t_mid_exposure;
  cv::Mat image = frames_[next_](region);
  if (view.is_dark || view.is_occluded) {
    image = image.clone();
    image.setTo(cv::Scalar::all(view.is_occluded ? kOccludedLevel : kDarkLevel));
  }
  write_wire_pixels(image, format, region.tl(), pixels);
}

}  // namespace holdfast::sim
