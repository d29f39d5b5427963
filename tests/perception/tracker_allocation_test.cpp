// SPDX-License-Identifier: Apache-2.0
// What the direct tracker asks of the heap: nothing while it follows, and where the features' check
// asks for memory, all of it is given back: no growth over a day in the theatre.
#include <atomic>
#include <cerrno>
#include <cmath>
#include <cstdint>
#include <cstdlib>
#include <vector>

#include <gtest/gtest.h>
#include <malloc.h>
#include <opencv2/core/utility.hpp>

#include "perception/direct_tracker.hpp"
#include "perception/tracker_parameters.hpp"
#include "tests/perception/support/moving_scene.hpp"

// Counts what this program asks of the heap, also from within libraries that use malloc.
namespace {
thread_local std::int64_t requests = 0;     // of this thread
std::atomic<std::int64_t> bytes_in_use{0};  // of all

void* taken(void* memory) {
  ++requests;
  bytes_in_use += static_cast<std::int64_t>(malloc_usable_size(memory));
  return memory;
}
void given_back(void* memory) {
  bytes_in_use -= static_cast<std::int64_t>(malloc_usable_size(memory));
}
}  // namespace
extern "C" {
void* __libc_malloc(std::size_t size);                     // NOLINT: glibc's own, as all below
void* __libc_calloc(std::size_t count, std::size_t size);  // NOLINT
void* __libc_realloc(void* memory, std::size_t size);      // NOLINT
void* __libc_memalign(std::size_t alignment, std::size_t size);  // NOLINT
void __libc_free(void* memory);                                  // NOLINT
void* malloc(std::size_t size) {                                 // NOLINT
  return taken(__libc_malloc(size));
}
void* calloc(std::size_t count, std::size_t size) {  // NOLINT
  return taken(__libc_calloc(count, size));
}
void* realloc(void* memory, std::size_t size) {  // NOLINT
  given_back(memory);
  return taken(__libc_realloc(memory, size));
}
void* aligned_alloc(std::size_t alignment, std::size_t size) {  // NOLINT
  return taken(__libc_memalign(alignment, size));
}
int posix_memalign(void** out, std::size_t alignment, std::size_t size) {  // NOLINT
  *out = taken(__libc_memalign(alignment, size));
  return *out == nullptr ? ENOMEM : 0;
}
void free(void* memory) {  // NOLINT
  given_back(memory);
  __libc_free(memory);
}
}

namespace holdfast::perception {
namespace {

constexpr int kWidthPx = 640, kHeightPx = 480;
constexpr double kDepthMm = 200;
constexpr int kCycle = 10;  // frames, after which the site is where it was

/// A site that goes round in a circle. Its frames are rendered once.
struct Circle {
  CameraModel camera = test::microscope_camera(kWidthPx, kHeightPx);
  test::MovingScene scene{camera, test::photograph(), kDepthMm, 4};
  std::vector<cv::Mat> frames;

  explicit Circle(double radius_mm) {
    for (int i = 0; i < kCycle; ++i) {
      const double angle = 2 * CV_PI * i / kCycle;
      const Eigen::Vector3d t_mm(radius_mm * std::sin(angle), radius_mm * (1 - std::cos(angle)), 0);
      frames.push_back(scene.image(test::moved_about(scene.p_pivot_mm(), t_mm, {0, 0, 0}), 2,
                                   static_cast<std::uint64_t>(i)));
    }
  }
};
const Circle& slow_circle() {
  static const Circle circle(0.2);
  return circle;
}
/// So fast that the search after a jolt is at work in every frame.
const Circle& fast_circle() {
  static const Circle circle(1.0);
  return circle;
}

class TrackerHeap : public ::testing::Test {
 protected:
  void SetUp() override { cv::setNumThreads(1); }
  [[nodiscard]] static DirectTracker tracker(const Circle& circle, const CheckParameters& check) {
    TrackerParameters parameters;
    parameters.check = check;
    DirectTracker made(circle.camera, parameters);
    EXPECT_EQ(made.set_keyframe(circle.frames[0], SiteDepth{circle.scene.depth_mm()}),
              TrackingReason::none);
    return made;
  }
  /// Once round; requests of this thread. Every frame must be tracked.
  std::int64_t round(const Circle& circle, DirectTracker& tracker) {
    const std::int64_t before = requests;
    int tracked = 0;
    for (const cv::Mat& frame : circle.frames) {
      const auto e = tracker.track(frame, std::chrono::milliseconds(++t_ms_));
      tracked += e.status == TrackingStatus::tracking ? 1 : 0;
    }
    const std::int64_t asked = requests - before;
    EXPECT_EQ(tracked, kCycle);
    return asked;
  }
  int t_ms_ = 0;
};

TEST_F(TrackerHeap, NothingIsAskedOfItWhileTheSiteIsFollowed) {
  CheckParameters none;
  none.every_frames = 0;
  DirectTracker following = tracker(slow_circle(), none);
  (void)round(slow_circle(), following);  // memory taken at first use
  EXPECT_EQ(round(slow_circle(), following), 0);
}

TEST_F(TrackerHeap, TheCheckBesideAsksNothingOnTheTrackersThread) {
  CheckParameters threaded;
  threaded.is_threaded = true;
  DirectTracker following = tracker(slow_circle(), threaded);
  (void)round(slow_circle(), following);
  (void)round(slow_circle(), following);
  EXPECT_EQ(round(slow_circle(), following), 0);
}

TEST_F(TrackerHeap, DoesNotGrowUnderChecksAndJolts) {
  CheckParameters at_once;
  at_once.every_frames = 2;
  DirectTracker following = tracker(fast_circle(), at_once);
  (void)round(fast_circle(), following);
  (void)round(fast_circle(), following);
  const std::int64_t before = bytes_in_use;
  for (int i = 0; i < 8; ++i) (void)round(fast_circle(), following);
  EXPECT_EQ(bytes_in_use - before, 0);
}

TEST_F(TrackerHeap, DoesNotGrowByLossAndRecovery) {
  CheckParameters at_once;
  DirectTracker following = tracker(fast_circle(), at_once);
  const cv::Mat black(kHeightPx, kWidthPx, CV_8UC1, cv::Scalar(0));
  const auto lose_and_find = [&] {
    EXPECT_EQ(following.track(black, std::chrono::milliseconds(++t_ms_)).status,
              TrackingStatus::lost);
    EXPECT_EQ(following.track(fast_circle().frames[3], std::chrono::milliseconds(++t_ms_)).status,
              TrackingStatus::relocalised);
  };
  for (int i = 0; i < 3; ++i) lose_and_find();
  const std::int64_t before = bytes_in_use;
  for (int i = 0; i < 10; ++i) lose_and_find();
  EXPECT_EQ(bytes_in_use - before, 0);
}

TEST(HeapCount, Counts) {
  const std::int64_t before = requests, in_use = bytes_in_use;
  {
    const std::vector<int> some(1000, 1);
    EXPECT_GT(requests, before + some[0] - 1);
    EXPECT_GE(bytes_in_use - in_use, 4000);
  }
  EXPECT_EQ(bytes_in_use, in_use);
}

}  // namespace
}  // namespace holdfast::perception
