// SPDX-License-Identifier: Apache-2.0
#include "bridge/frame_ids.hpp"

#include <gtest/gtest.h>

namespace holdfast::bridge {
namespace {

constexpr auto k16 = FrameIdWidth::bits16;
constexpr auto k64 = FrameIdWidth::bits64;

TEST(FrameIds, SuccessorsMissNothing) {
  EXPECT_EQ(frames_between(1, 2, k16), 0U);
  EXPECT_EQ(frames_between(70000, 70001, k64), 0U);
}

TEST(FrameIds, SixteenBitsWrapFromTheHighestToOne) {
  EXPECT_EQ(frames_between(65535, 1, k16), 0U);
  EXPECT_EQ(frames_between(65534, 2, k16), 2U);
}

TEST(FrameIds, CountsWhatWasSkipped) {
  EXPECT_EQ(frames_between(10, 14, k16), 3U);
  EXPECT_EQ(frames_between(10, 14, k64), 3U);
}

TEST(FrameIds, RepeatedAndEarlierIdsHaveNoDistance) {
  EXPECT_EQ(frames_between(10, 10, k16), std::nullopt);
  EXPECT_EQ(frames_between(10, 9, k16), std::nullopt);
  EXPECT_EQ(frames_between(10, 9, k64), std::nullopt);
  EXPECT_EQ(frames_between(65535, 1, k64), std::nullopt);
}

TEST(FrameIds, ZeroAndBeyondSixteenBitsAreNoIdsOfSixteenBits) {
  EXPECT_EQ(frames_between(65535, 0, k16), std::nullopt);
  EXPECT_EQ(frames_between(65535, 65536, k16), std::nullopt);
}

}  // namespace
}  // namespace holdfast::bridge
