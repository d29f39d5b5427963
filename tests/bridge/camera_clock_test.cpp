// SPDX-License-Identifier: Apache-2.0
#include "bridge/camera_clock.hpp"

#include <cmath>
#include <random>

#include <gtest/gtest.h>

namespace holdfast::bridge {
namespace {

using std::chrono::milliseconds;
using std::chrono::nanoseconds;
using std::chrono::seconds;

// A camera whose clock is slower than the host's by `drift_ppm` and was switched on at `t_on`;
// frames arrive `delay` after their stamp plus an exponential jitter.
class Link {
 public:
  Link(double drift_ppm, nanoseconds delay, nanoseconds jitter)
      : drift_ppm_(drift_ppm), delay_(delay), jitter_ns_(static_cast<double>(jitter.count())) {}
  [[nodiscard]] nanoseconds stamp(nanoseconds t_host) const {
    const double since = static_cast<double>((t_host - t_on).count());
    return nanoseconds(std::llround(since * (1 - drift_ppm_ * 1e-6)));
  }
  nanoseconds arrival(nanoseconds t_host) {
    return t_host + delay_ + nanoseconds(std::llround(jitter_ns_ * exponential_(random_)));
  }
  nanoseconds t_on = seconds(1000);

 private:
  double drift_ppm_;
  nanoseconds delay_;
  double jitter_ns_;
  std::mt19937 random_{7};
  std::exponential_distribution<double> exponential_{1.0};
};

constexpr nanoseconds kPeriod{33'333'333};

CameraClockParameters with_delay(nanoseconds known) {
  CameraClockParameters parameters;
  parameters.known_delay = known;
  return parameters;
}

nanoseconds feed(CameraClock& clock, Link& link, nanoseconds t, int frames) {
  for (int i = 0; i < frames; ++i, t += kPeriod)
    EXPECT_TRUE(clock.add(link.stamp(t), link.arrival(t))) << i;
  return t;
}

TEST(CameraClock, FindsOffsetAndDriftUnderJitter) {
  Link link(37, milliseconds(5), milliseconds(1));
  CameraClock clock(with_delay(milliseconds(5)));
  const nanoseconds t = feed(clock, link, link.t_on + seconds(3), 30 * 40);
  EXPECT_NEAR(clock.drift_ppm(), 37, 3);
  const auto error = clock.to_host(link.stamp(t)) - t;
  EXPECT_LT(std::chrono::abs(error), nanoseconds(150'000));
  EXPECT_LE(std::chrono::abs(error), 3 * clock.sigma());
}

TEST(CameraClock, KeepsFollowingADriftBeyondItsWindow) {
  Link link(-50, nanoseconds(0), nanoseconds(200'000));
  CameraClock clock;
  const nanoseconds t = feed(clock, link, link.t_on + seconds(1), 30 * 300);
  EXPECT_LT(std::chrono::abs(clock.to_host(link.stamp(t)) - t), nanoseconds(100'000));
}

TEST(CameraClock, OneDelayedPacketChangesNothing) {
  Link link(10, nanoseconds(0), nanoseconds(50'000));
  CameraClock clock;
  const nanoseconds t = feed(clock, link, link.t_on + seconds(1), 600);
  const auto before = clock.to_host(link.stamp(t + kPeriod));
  EXPECT_TRUE(clock.add(link.stamp(t), t + milliseconds(30)));
  const auto after = clock.to_host(link.stamp(t + kPeriod));
  EXPECT_LT(std::chrono::abs(after - before), nanoseconds(20'000));
}

TEST(CameraClock, UncertaintyStartsLargeAndShrinks) {
  Link link(0, nanoseconds(0), nanoseconds(50'000));
  CameraClock clock;
  nanoseconds t = feed(clock, link, link.t_on + seconds(1), 1);
  EXPECT_GE(clock.sigma(), milliseconds(5));
  feed(clock, link, t, 299);
  EXPECT_LT(clock.sigma(), nanoseconds(600'000));
  EXPECT_GE(clock.sigma(), nanoseconds(20'000));
}

TEST(CameraClock, UncertaintyGrowsWhenTheDelayBecomesLonger) {
  Link link(0, nanoseconds(0), nanoseconds(50'000));
  CameraClock clock;
  nanoseconds t = feed(clock, link, link.t_on + seconds(1), 30 * 20);
  const auto before = clock.sigma();
  for (int i = 0; i < 90; ++i, t += kPeriod)
    EXPECT_TRUE(clock.add(link.stamp(t), t + milliseconds(8)));
  EXPECT_GT(clock.sigma(), before + milliseconds(4));
}

TEST(CameraClock, TellsARestartedClockAndLearnsItAnew) {
  Link link(20, nanoseconds(0), nanoseconds(50'000));
  CameraClock clock;
  nanoseconds t = feed(clock, link, link.t_on + seconds(1), 300);
  link.t_on = t - seconds(1);  // power cycle: stamps begin again
  EXPECT_FALSE(clock.add(link.stamp(t), link.arrival(t)));
  EXPECT_EQ(clock.arrivals(), 1U);
  t = feed(clock, link, t + kPeriod, 300);
  EXPECT_LT(std::chrono::abs(clock.to_host(link.stamp(t)) - t), nanoseconds(150'000));
}

TEST(CameraClock, TellsAClockThatJumpsAhead) {
  Link link(0, nanoseconds(0), nanoseconds(50'000));
  CameraClock clock;
  const nanoseconds t = feed(clock, link, link.t_on + seconds(1), 300);
  EXPECT_FALSE(clock.add(link.stamp(t) + milliseconds(100), link.arrival(t)));
}

TEST(CameraClock, TellsARepeatedStamp) {
  Link link(0, nanoseconds(0), nanoseconds(0));
  CameraClock clock;
  const nanoseconds t = feed(clock, link, link.t_on + seconds(1), 10);
  EXPECT_FALSE(clock.add(link.stamp(t - kPeriod), t));
}

}  // namespace
}  // namespace holdfast::bridge
