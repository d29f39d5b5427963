// SPDX-License-Identifier: Apache-2.0
#include "rt/core/latency_histogram.hpp"

#include <thread>

#include <gtest/gtest.h>

namespace holdfast::rt {
namespace {

using std::chrono::nanoseconds;

TEST(LatencyHistogram, IsZeroWhenEmpty) {
  LatencyHistogram histogram;
  const LatencySnapshot snapshot = histogram.snapshot();
  EXPECT_EQ(snapshot.count(), 0U);
  EXPECT_EQ(snapshot.max(), nanoseconds(0));
  EXPECT_EQ(snapshot.percentile(0.5), nanoseconds(0));
}

TEST(LatencyHistogram, EachValueLiesInItsBinAndBinsAreNarrow) {
  std::uint64_t previous_edge = 0;
  for (std::size_t bin = 1; bin < detail::kBinCount; ++bin) {
    const std::uint64_t edge = detail::upper_edge_ns(bin);
    ASSERT_EQ(detail::bin_of(edge), bin);
    ASSERT_EQ(detail::bin_of(previous_edge + 1), bin);
    ASSERT_LE(static_cast<double>(edge - previous_edge - 1),
              0.032 * static_cast<double>(previous_edge + 1));
    previous_edge = edge;
  }
}

TEST(LatencyHistogram, PercentilesNeverUnderstateAndStayWithinTheBinWidth) {
  LatencyHistogram histogram;
  for (int us = 1; us <= 1000; ++us) histogram.record(std::chrono::microseconds(us));
  const LatencySnapshot snapshot = histogram.snapshot();
  EXPECT_EQ(snapshot.count(), 1000U);
  EXPECT_EQ(snapshot.max(), std::chrono::microseconds(1000));
  for (const double fraction : {0.01, 0.5, 0.9, 0.99, 0.999, 1.0}) {
    const auto truth = fraction * 1e6;
    const auto read = static_cast<double>(snapshot.percentile(fraction).count());
    EXPECT_GE(read, truth) << fraction;
    EXPECT_LE(read, 1.032 * truth) << fraction;
  }
}

TEST(LatencyHistogram, KeepsTheTailBeyondItsRange) {
  LatencyHistogram histogram;
  histogram.record(nanoseconds(-5));
  histogram.record(std::chrono::seconds(100));
  const LatencySnapshot snapshot = histogram.snapshot();
  EXPECT_EQ(snapshot.percentile(0.5), nanoseconds(0));
  EXPECT_EQ(snapshot.percentile(1.0), std::chrono::seconds(100));
  EXPECT_EQ(snapshot.max(), std::chrono::seconds(100));
}

TEST(LatencyHistogram, MergeAddsCountsAndKeepsTheLargerMax) {
  LatencyHistogram a;
  LatencyHistogram b;
  for (int i = 0; i < 3; ++i) a.record(nanoseconds(10));
  b.record(nanoseconds(2000));
  LatencySnapshot both = a.snapshot();
  both.merge(b.snapshot());
  EXPECT_EQ(both.count(), 4U);
  EXPECT_EQ(both.max(), nanoseconds(2000));
  EXPECT_EQ(both.percentile(0.75), nanoseconds(10));
}

TEST(LatencyHistogram, SnapshotDuringRecordingIsConsistent) {
  constexpr int kRecords = 200'000;
  LatencyHistogram histogram;
  std::thread recorder([&] {
    for (int i = 0; i < kRecords; ++i) histogram.record(nanoseconds(i));
  });
  std::uint64_t count = 0;
  while (count < kRecords) {
    const LatencySnapshot snapshot = histogram.snapshot();
    ASSERT_GE(snapshot.count(), count);
    count = snapshot.count();
    // Records rise by 1 ns each: the max is never below the largest of those counted.
    ASSERT_GE(snapshot.max().count() + 1, static_cast<std::int64_t>(count));
  }
  recorder.join();
  EXPECT_EQ(histogram.snapshot().count(), static_cast<std::uint64_t>(kRecords));
}

}  // namespace
}  // namespace holdfast::rt
