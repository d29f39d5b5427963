// SPDX-License-Identifier: Apache-2.0
#include "bridge/frame_check.hpp"

#include <cstddef>
#include <cstring>

#include <fmt/core.h>

#include "rt/core/error.hpp"

namespace holdfast::bridge {
namespace {

constexpr int kRowStep = 8;

struct Samples {
  std::uint64_t hash = 0x9E3779B97F4A7C15U;
  std::uint64_t dark = 0, saturated = 0, total = 0;
};

std::uint64_t mixed(std::uint64_t hash, std::uint64_t word) {
  hash = (hash ^ word) * 0xFF51AFD7ED558CCDU;
  return hash ^ (hash >> 32U);
}

// Four independent lanes: one multiplication's latency would otherwise bound the speed.
std::uint64_t hash_row(std::uint64_t hash, const unsigned char* bytes, std::size_t size) {
  std::uint64_t lane[4] = {hash, hash + 1, hash + 2, hash + 3};
  std::size_t i = 0;
  for (; i + 32 <= size; i += 32)
    for (std::size_t k = 0; k < 4; ++k) {
      std::uint64_t word = 0;
      std::memcpy(&word, bytes + i + 8 * k, 8);
      lane[k] = mixed(lane[k], word);
    }
  for (; i < size; ++i) lane[0] = mixed(lane[0], bytes[i]);
  return mixed(mixed(mixed(lane[0], lane[1]), lane[2]), lane[3]);
}

template <typename Sample>
void count_row(const Sample* samples, std::size_t n, unsigned dark, unsigned saturated,
               Samples& out) {
  std::uint32_t n_dark = 0, n_saturated = 0;
  for (std::size_t i = 0; i < n; ++i) {
    n_dark += samples[i] <= dark ? 1U : 0U;
    n_saturated += samples[i] >= saturated ? 1U : 0U;
  }
  out.dark += n_dark;
  out.saturated += n_saturated;
  out.total += n;
}

template <typename Sample>
Samples look_at(const cv::Mat& image, unsigned dark, unsigned saturated) {
  Samples samples;
  const auto n = static_cast<std::size_t>(image.cols) * static_cast<std::size_t>(image.channels());
  for (int y = 0; y < image.rows; y += kRowStep) {
    samples.hash = hash_row(samples.hash, image.ptr(y), n * sizeof(Sample));
    count_row(image.ptr<Sample>(y), n, dark, saturated, samples);
  }
  samples.hash = mixed(samples.hash, n);
  return samples;
}

}  // namespace

FrameCheck::FrameCheck(const FrameCheckLimits& limits) : limits_(limits) {
  for (const int level : {limits.dark_level, limits.saturated_level})
    if (level < 0 || level > 255)
      throw InputError(fmt::format("frame check: level {} is outside 0..255", level));
  for (const double fraction : {limits.dark_fraction_max, limits.saturated_fraction_max})
    if (!(fraction >= 0 && fraction <= 1))
      throw InputError(fmt::format("frame check: fraction {} is outside 0..1", fraction));
}

safety::ReasonSet FrameCheck::check(const cv::Mat& image) noexcept {
  safety::ReasonSet reasons;
  const auto dark = static_cast<unsigned>(limits_.dark_level);
  const auto saturated = static_cast<unsigned>(limits_.saturated_level);
  Samples samples;
  if (!image.empty() && image.depth() == CV_8U) {
    samples = look_at<std::uint8_t>(image, dark, saturated);
  } else if (!image.empty() && image.type() == CV_16UC1) {
    samples = look_at<std::uint16_t>(image, dark * 16, saturated * 16);
  } else {
    reasons.insert(safety::Reason::internal_fault);
    previous_.reset();
    return reasons;
  }
  const auto total = static_cast<double>(samples.total);
  if (previous_ == samples.hash) reasons.insert(safety::Reason::frame_frozen);
  if (static_cast<double>(samples.dark) > limits_.dark_fraction_max * total)
    reasons.insert(safety::Reason::frame_dark);
  if (static_cast<double>(samples.saturated) > limits_.saturated_fraction_max * total)
    reasons.insert(safety::Reason::frame_saturated);
  previous_ = samples.hash;
  return reasons;
}

}  // namespace holdfast::bridge
