// SPDX-License-Identifier: Apache-2.0
#include "bridge/frame_pairing.hpp"

#include <vector>

#include <gtest/gtest.h>

namespace holdfast::bridge {
namespace {

using std::chrono::milliseconds;
using std::chrono::nanoseconds;

constexpr milliseconds kPeriod{100}, kTimeout{300}, kTransfer{20};

class Pairing : public ::testing::Test {
 protected:
  /// Frame of trigger `k`, exposed `late` after it; `advanced` as its camera counts.
  void add(Side side, int k, nanoseconds late = {}, std::uint64_t advanced = 1) {
    const nanoseconds t = k * kPeriod + late;
    now = std::max(now, t + kTransfer);
    pairing.add(side, {t, now, advanced, pairing.free_slot(side)});
    look();
  }
  void look() {
    while (const auto matched = pairing.next(now)) seen.push_back(*matched);
  }
  std::vector<Match> matches() const {
    std::vector<Match> all;
    for (const Matched& matched : seen) all.push_back(matched.match);
    return all;
  }

  FramePairing pairing{{.skew_max = milliseconds(2),
                        .same_trigger_max = kPeriod / 2,
                        .partner_timeout = kTimeout,
                        .capacity = 3}};
  nanoseconds now{};
  std::vector<Matched> seen;
};

TEST_F(Pairing, PairsWhatWasExposedTogetherWhicheverArrivesFirst) {
  add(Side::left, 1);
  add(Side::right, 1, milliseconds(2));
  add(Side::right, 2);
  add(Side::left, 2, milliseconds(2));
  add(Side::left, 3);
  add(Side::left, 4);
  add(Side::right, 3);
  add(Side::right, 4);
  EXPECT_EQ(matches(), std::vector<Match>(4, Match::pair));
  for (const Matched& matched : seen)
    EXPECT_LE(std::chrono::abs(matched.left->t_exposure - matched.right->t_exposure),
              milliseconds(2));
}

TEST_F(Pairing, NeverPairsFramesOfTwoTriggers) {
  add(Side::left, 1);
  add(Side::right, 2);
  add(Side::left, 2);
  EXPECT_EQ(matches(), (std::vector{Match::right_missing, Match::pair}));
  EXPECT_EQ(seen[0].left->t_exposure, 1 * kPeriod);
  EXPECT_EQ(seen[1].left->t_exposure, 2 * kPeriod);
}

TEST_F(Pairing, ReportsEachFrameWhosePartnerIsMissing) {
  add(Side::left, 1);
  add(Side::right, 1);
  add(Side::right, 2);
  add(Side::right, 3);
  add(Side::left, 4);
  add(Side::right, 4);
  EXPECT_EQ(matches(),
            (std::vector{Match::pair, Match::left_missing, Match::left_missing, Match::pair}));
  EXPECT_FALSE(seen[1].left);
  EXPECT_EQ(seen[1].right->t_exposure, 2 * kPeriod);
}

TEST_F(Pairing, OneTriggersFramesTooFarApartAreSkewed) {
  add(Side::left, 1);
  add(Side::right, 1, milliseconds(2) + nanoseconds(1));
  add(Side::left, 2, milliseconds(50));
  add(Side::right, 2);
  add(Side::left, 3);
  add(Side::right, 3);
  EXPECT_EQ(matches(), (std::vector{Match::skewed, Match::skewed, Match::pair}));
}

TEST_F(Pairing, GivesAFrameUpAfterTheTimeoutWithoutAnotherOne) {
  add(Side::left, 1);
  ASSERT_TRUE(pairing.deadline());
  EXPECT_EQ(*pairing.deadline(), now + kTimeout);
  now = *pairing.deadline() - nanoseconds(1);
  look();
  EXPECT_TRUE(seen.empty());
  now = *pairing.deadline();
  look();
  EXPECT_EQ(matches(), std::vector{Match::right_missing});
  EXPECT_FALSE(pairing.deadline());
}

TEST_F(Pairing, ASideThatIsFullGivesItsOldestUp) {
  for (int k = 1; k <= 3; ++k) add(Side::left, k);
  EXPECT_TRUE(seen.empty());
  add(Side::left, 4);
  EXPECT_EQ(matches(), std::vector{Match::right_missing});
  EXPECT_EQ(seen[0].left->t_exposure, 1 * kPeriod);
}

TEST_F(Pairing, SlotsOfWaitingFramesAreNotGivenOut) {
  for (int k = 1; k <= 3; ++k) add(Side::left, k);
  std::vector<int> slots;
  add(Side::right, 1);
  add(Side::right, 2);
  add(Side::right, 3);
  for (const Matched& matched : seen) slots.push_back(matched.left->slot);
  EXPECT_EQ(slots, (std::vector{0, 1, 2}));
}

TEST_F(Pairing, IdsThatAdvanceUnalikeAreASlip) {
  add(Side::left, 1, {}, 0);  // the first: unknown
  add(Side::right, 1, {}, 0);
  add(Side::left, 2);
  add(Side::right, 2, {}, 2);  // one id further, and no frame was missing
  add(Side::left, 3);
  add(Side::right, 3);
  EXPECT_EQ(matches(), (std::vector{Match::pair, Match::slipped, Match::pair}));
}

TEST_F(Pairing, AMissingFrameExplainsIdsThatAdvanceUnalike) {
  add(Side::left, 1, {}, 0);
  add(Side::right, 1, {}, 0);
  add(Side::left, 2);  // the right camera ignored this trigger: its ids know nothing of it
  add(Side::left, 3);
  add(Side::right, 3, {}, 1);
  EXPECT_EQ(matches(), (std::vector{Match::pair, Match::right_missing, Match::pair}));
}

TEST_F(Pairing, AReconnectedCameraBeginsItsIdsAnew) {
  add(Side::left, 1, {}, 0);
  add(Side::right, 1, {}, 0);
  add(Side::left, 2);
  add(Side::right, 2, {}, 0);
  add(Side::left, 3);
  add(Side::right, 3);
  EXPECT_EQ(matches(), std::vector<Match>(3, Match::pair));
}

}  // namespace
}  // namespace holdfast::bridge
