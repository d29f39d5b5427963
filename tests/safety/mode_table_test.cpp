// SPDX-License-Identifier: Apache-2.0
#include "safety/mode_table.hpp"

#include <algorithm>
#include <fstream>
#include <regex>
#include <string>
#include <vector>

#include <gtest/gtest.h>

namespace holdfast::safety {
namespace {

constexpr unsigned kConditionCount = 9;
constexpr std::array kModes = {Mode::init,      Mode::unregistered, Mode::ready,
                               Mode::permitted, Mode::hold,         Mode::stop_latched};

/// The specification again, written as a decision and not as a table.
Mode specified(Mode mode, ConditionSet set) {
  const auto is = [&](Condition condition) { return set.contains(condition); };
  if (mode == Mode::stop_latched) return is(Condition::released) ? Mode::ready : mode;
  if (is(Condition::latching_fault)) return Mode::stop_latched;
  if (mode == Mode::init) return is(Condition::inputs_arrived) ? Mode::unregistered : mode;
  if (mode == Mode::unregistered) return is(Condition::verified) ? Mode::ready : mode;
  if (mode == Mode::ready) {
    if (is(Condition::verification_withdrawn)) return Mode::unregistered;
    return is(Condition::armed) ? Mode::permitted : mode;
  }
  if (is(Condition::disarmed)) return Mode::ready;
  if (mode == Mode::permitted) return is(Condition::hold_reason) ? Mode::hold : mode;
  return is(Condition::recovered) ? Mode::permitted : mode;
}

TEST(ModeTable, FollowsTheSpecificationForEveryModeAndSetOfConditions) {
  RecordProperty("requirement", "SR-26");
  for (const Mode mode : kModes) {
    for (unsigned bits = 0; bits < 1U << kConditionCount; ++bits) {
      ConditionSet set;
      for (unsigned i = 0; i < kConditionCount; ++i) {
        set.set(static_cast<Condition>(i), ((bits >> i) & 1U) != 0);
      }
      EXPECT_EQ(next_mode(mode, set), specified(mode, set)) << name(mode) << ' ' << bits;
    }
  }
}

std::vector<std::string> matches(const std::string& pattern) {
  std::ifstream file(HOLDFAST_MODES_MD);
  const std::regex regex(pattern);
  std::vector<std::string> found;
  for (std::string line; std::getline(file, line);) {
    std::smatch match;
    if (std::regex_match(line, match, regex)) {
      found.push_back(match[1].str() + ' ' + match[2].str() + ' ' + match[3].str());
    }
  }
  return found;
}

TEST(ModeTable, IsTheOneInTheDocument) {
  std::vector<std::string> rows;
  std::vector<std::string> arrows;
  for (const Transition& row : kTransitions) {
    const std::string from(name(row.from));
    const std::string to(name(row.to));
    const std::string when(name(row.when));
    rows.push_back(from + ' ' + when + ' ' + to);
    arrows.push_back(from + ' ' + to + ' ' + when);
  }
  EXPECT_EQ(matches(R"(\| ([a-z_]+) \| ([a-z_]+) \| ([a-z_]+) \|)"), rows);
  std::vector<std::string> drawn = matches(R"(  ([a-z_]+) --> ([a-z_]+): ([a-z_]+))");
  std::sort(drawn.begin(), drawn.end());
  std::sort(arrows.begin(), arrows.end());
  EXPECT_EQ(drawn, arrows);
}

TEST(LatchingReasons, AreAllStopsWhilePermittedOrHeld) {
  const ReasonSet all(~std::uint64_t{0});
  EXPECT_EQ(latching_reasons(Mode::permitted, all), all.with(Severity::stop));
  EXPECT_EQ(latching_reasons(Mode::hold, all), all.with(Severity::stop));
}

TEST(LatchingReasons, AreThoseThatPutTheSystemInDoubtBefore) {
  ReasonSet expected;
  for (const Reason reason :
       {Reason::operator_stop, Reason::invalid_number, Reason::clock_step, Reason::loop_overrun,
        Reason::second_publisher, Reason::message_corrupt, Reason::internal_fault}) {
    expected.insert(reason);
  }
  for (const Mode mode : {Mode::init, Mode::unregistered, Mode::ready}) {
    EXPECT_EQ(latching_reasons(mode, ReasonSet(~std::uint64_t{0})), expected) << name(mode);
  }
}

TEST(LatchingReasons, AreNoneOnceLatched) {
  EXPECT_TRUE(latching_reasons(Mode::stop_latched, ReasonSet(~std::uint64_t{0})).empty());
}

TEST(Names, OfWhatDoesNotExistAreUnknown) {
  EXPECT_EQ(name(static_cast<Mode>(6)), "unknown");
  EXPECT_EQ(name(static_cast<Condition>(kConditionCount)), "unknown");
}

}  // namespace
}  // namespace holdfast::safety
