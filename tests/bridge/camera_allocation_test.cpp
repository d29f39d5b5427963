// SPDX-License-Identifier: Apache-2.0
// What the camera thread does with every frame asks nothing of the heap.
#include <atomic>
#include <cerrno>
#include <cstdlib>
#include <vector>

#include <gtest/gtest.h>
#include <opencv2/core/utility.hpp>

#include "bridge/camera_clock.hpp"
#include "bridge/frame_check.hpp"
#include "bridge/pixel_conversion.hpp"

// Counts what this program asks of the heap, also from within libraries that use malloc.
namespace {
std::atomic<std::uint64_t> allocations{0};
}
extern "C" {
void* __libc_malloc(std::size_t size);                           // NOLINT: glibc's own
void* __libc_memalign(std::size_t alignment, std::size_t size);  // NOLINT
void* malloc(std::size_t size) {                                 // NOLINT
  allocations.fetch_add(1, std::memory_order_relaxed);
  return __libc_malloc(size);
}
int posix_memalign(void** out, std::size_t alignment, std::size_t size) {  // NOLINT
  allocations.fetch_add(1, std::memory_order_relaxed);
  *out = __libc_memalign(alignment, size);
  return *out == nullptr ? ENOMEM : 0;
}
}

namespace holdfast::bridge {
namespace {

constexpr int kWidth = 64, kHeight = 32;

class FramePath : public ::testing::TestWithParam<PixelFormat> {};

TEST_P(FramePath, AllocatesNothingPerFrame) {
  cv::setNumThreads(1);
  PixelConversion convert(GetParam(), kWidth, kHeight);
  FrameCheck check;
  std::vector<std::uint8_t> pixels(row_bytes(GetParam(), kWidth) * kHeight, 7);
  CameraClock clock;
  (void)convert(pixels.data());  // the first call may set up the library
  const std::uint64_t before = allocations.load();
  const cv::Mat image = convert(pixels.data());
  (void)check.check(image);
  clock.add(std::chrono::milliseconds(33), std::chrono::milliseconds(34));
  EXPECT_EQ(allocations.load(), before);
}

INSTANTIATE_TEST_SUITE_P(Formats, FramePath,
                         ::testing::Values(PixelFormat::mono8, PixelFormat::mono12,
                                           PixelFormat::bayer_rg8, PixelFormat::bayer_gb8,
                                           PixelFormat::bayer_gr8, PixelFormat::bayer_bg8,
                                           PixelFormat::rgb8, PixelFormat::bgr8));

TEST(FramePathGuard, Counts) {
  const std::uint64_t before = allocations.load();
  const std::vector<int> some(1000, 1);
  EXPECT_GT(allocations.load(), before + static_cast<std::uint64_t>(some[0]) - 1);
}

}  // namespace
}  // namespace holdfast::bridge
