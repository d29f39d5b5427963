// SPDX-License-Identifier: Apache-2.0
// No violation in any state that the real gate can reach, and one in each gate with a seeded bug.
#include "tests/safety/gate_enumeration.hpp"

#include <algorithm>
#include <cstdio>

#include <gtest/gtest.h>

#include "safety/mode_table.hpp"

namespace holdfast::safety::test {
namespace {

TEST(GateEnumeration, NoReachableStateViolatesTheRules) {
  RecordProperty("requirement", "SR-01,SR-15,SR-22,SR-24,SR-25,SR-26,SR-34,SR-107");
  const Enumeration result = enumerate(&Gate::decide);
  EXPECT_EQ(result.violation, "");
  RecordProperty("states", static_cast<int>(result.states));
  RecordProperty("transitions", static_cast<int>(result.transitions));
  // What was explored is the whole table, or the zero means nothing.
  for (const Transition& row : kTransitions)
    EXPECT_TRUE(result.mode_changes.contains({row.from, row.to}))
        << name(row.from) << " to " << name(row.to) << " was never taken";
  EXPECT_GT(result.merged_and_compared, 1000U);
  for (const auto& [change, count] : result.mode_changes) {
    const auto& [from, to] = change;
    const bool is_in_table =
        from == to || std::ranges::any_of(kTransitions, [&](const Transition& row) {
          return row.from == from && row.to == to;
        });
    EXPECT_TRUE(is_in_table) << name(from) << " to " << name(to) << ", " << count << " times";
  }
  std::printf("%zu states, %zu inputs, %zu transitions\n", result.states, result.inputs,
              result.transitions);
}

// Seeded bugs: the real gate with one thing broken around it. Each must be found.

Decision hold_never_times_out(const Limits& limits, const Inputs& in, GateState& s) noexcept {
  if (s.mode == Mode::hold) s.t_hold_entered = s.t_last_cycle;
  return Gate::decide(limits, in, s);
}

Decision hold_recovers_at_once(const Limits& limits, const Inputs& in, GateState& s) noexcept {
  s.t_well_since = in.now - limits.hold_recovery;
  return Gate::decide(limits, in, s);
}

Decision pose_goes_on_in_hold(const Limits& limits, const Inputs& in, GateState& s) noexcept {
  static std::optional<ApprovedPose> newest;
  Decision decision = Gate::decide(limits, in, s);
  if (decision.approved) newest = decision.approved;
  if (decision.mode == Mode::hold) decision.approved = newest;
  return decision;
}

Decision any_stop_id_will_do(const Limits& limits, const Inputs& in, GateState& s) noexcept {
  Inputs changed = in;
  changed.operator_command.stop_id = s.stop_id;
  return Gate::decide(limits, changed, s);
}

Decision confirmation_never_expires(const Limits& limits, const Inputs& in, GateState& s) noexcept {
  if (s.is_acknowledged && in.now - s.t_acknowledged > limits.confirm_max)
    s.t_acknowledged = in.now - limits.confirm_max;
  return Gate::decide(limits, in, s);
}

Decision one_step_is_enough(const Limits& limits, const Inputs& in, GateState& s) noexcept {
  if (s.mode == Mode::stop_latched && !s.is_acknowledged) {
    s.is_acknowledged = true;
    s.t_acknowledged = in.now - limits.confirm_min;
  }
  return Gate::decide(limits, in, s);
}

Decision stop_between_the_steps_is_forgotten(const Limits& limits, const Inputs& in,
                                             GateState& s) noexcept {
  const bool was_acknowledged = s.mode == Mode::stop_latched && s.is_acknowledged;
  const Decision decision = Gate::decide(limits, in, s);
  if (was_acknowledged && in.operator_command.command == Command::none) s.is_acknowledged = true;
  return decision;
}

Decision release_arms(const Limits& limits, const Inputs& in, GateState& s) noexcept {
  const bool was_stopped = s.mode == Mode::stop_latched;
  const Decision decision = Gate::decide(limits, in, s);
  if (was_stopped && s.mode == Mode::ready) s.mode = Mode::permitted;
  return decision;
}

Decision verification_survives_a_change(const Limits& limits, const Inputs& in,
                                        GateState& s) noexcept {
  s.registration_id = in.registration.id;
  return Gate::decide(limits, in, s);
}

Decision time_may_go_back(const Limits& limits, const Inputs& in, GateState& s) noexcept {
  s.has_cycle = false;
  return Gate::decide(limits, in, s);
}

Decision doubt_about_optics_is_forgotten(const Limits& limits, const Inputs& in,
                                         GateState& s) noexcept {
  const Decision decision = Gate::decide(limits, in, s);
  s.t_optics_doubted = Timestamp{};
  return decision;
}

Decision optics_are_not_asked(const Limits& limits, const Inputs& in, GateState& s) noexcept {
  Inputs changed = in;
  changed.optics.is_declared_fixed = true;
  return Gate::decide(limits, changed, s);
}

struct SeededBug {
  const char* name;
  Decide decide;
};
std::ostream& operator<<(std::ostream& out, const SeededBug& bug) {
  return out << bug.name;
}

class SeededGateBug : public ::testing::TestWithParam<SeededBug> {};

#define HOLDFAST_BUG(function) \
  SeededBug {                  \
#function, &function       \
  }
INSTANTIATE_TEST_SUITE_P(
    Each, SeededGateBug,
    ::testing::Values(HOLDFAST_BUG(hold_never_times_out), HOLDFAST_BUG(hold_recovers_at_once),
                      HOLDFAST_BUG(pose_goes_on_in_hold), HOLDFAST_BUG(any_stop_id_will_do),
                      HOLDFAST_BUG(confirmation_never_expires), HOLDFAST_BUG(one_step_is_enough),
                      HOLDFAST_BUG(stop_between_the_steps_is_forgotten), HOLDFAST_BUG(release_arms),
                      HOLDFAST_BUG(verification_survives_a_change), HOLDFAST_BUG(time_may_go_back),
                      HOLDFAST_BUG(doubt_about_optics_is_forgotten),
                      HOLDFAST_BUG(optics_are_not_asked)),
    [](const auto& bug) { return std::string(bug.param.name); });

TEST_P(SeededGateBug, IsFound) {
  const Enumeration result = enumerate(GetParam().decide);
  EXPECT_NE(result.violation, "");
  RecordProperty("found_as", result.violation);
}

}  // namespace
}  // namespace holdfast::safety::test
