// SPDX-License-Identifier: Apache-2.0
// The gate and the microscope's optics: what a turned zoom costs, and what brings permission back.
#include <gtest/gtest.h>

#include "safety/gate.hpp"
#include "tests/safety/gate_fixture.hpp"

namespace holdfast::safety {
namespace {

using std::chrono::milliseconds;
using std::chrono::nanoseconds;
using test::GateTest;

void zoomed(Inputs& in) {
  in.optics.zoom = 1.3;
}
void silent(Inputs& in) {
  in.optics.is_known = false;
  in.optics.faults.insert(Reason::microscope_missing);
}

class GateOptics : public GateTest {
 protected:
  /// A good cycle whose estimate is of an image exposed then.
  Decision step_exposed(Timestamp t, Command command = Command::none) {
    return step([=, this](Inputs& in) {
      in.tracking.t_exposure = t;
      in.operator_command = {command, state.stop_id};
    });
  }
};

TEST_F(GateOptics, ATurnedZoomStops) {
  RecordProperty("requirement", "SR-16");
  for (const Mode mode : {Mode::permitted, Mode::hold}) {
    state = GateState{};
    to(mode);
    const Decision decision = step(zoomed);
    EXPECT_EQ(decision.mode, Mode::stop_latched) << name(mode);
    EXPECT_EQ(decision.cause, Reason::optics_changed) << name(mode);
    EXPECT_FALSE(decision.approved);
  }
}

TEST_F(GateOptics, TheStopStaysWhileTheZoomIsAway) {
  RecordProperty("requirement", "SR-16");
  to(Mode::permitted);
  const std::uint32_t id = step(zoomed).stop_id;
  const auto commanded = [&](Command command) {
    return step([&](Inputs& in) {
      zoomed(in);
      in.operator_command = {command, id};
    });
  };
  commanded(Command::acknowledge);
  run(milliseconds(300), zoomed);
  EXPECT_EQ(commanded(Command::confirm).mode, Mode::stop_latched);
  run(milliseconds(300));
  EXPECT_EQ(state.mode, Mode::stop_latched) << "the zoom's return alone is not enough";
  command(Command::acknowledge, id);
  run(milliseconds(300));
  EXPECT_EQ(command(Command::confirm, id).mode, Mode::ready);
}

TEST_F(GateOptics, NoImageFromBeforeTheDoubtEndedReleasesAStop) {
  RecordProperty("requirement", "SR-107");
  to(Mode::stop_latched);
  command(Command::acknowledge, state.stop_id);
  run(milliseconds(300), silent);
  const Timestamp t_doubted = now;
  EXPECT_EQ(step_exposed(t_doubted, Command::confirm).mode, Mode::stop_latched);
  command(Command::acknowledge, state.stop_id);
  run(milliseconds(300));
  EXPECT_EQ(step_exposed(now, Command::confirm).mode, Mode::ready);
}

TEST_F(GateOptics, ADoubtTakesTheVerificationOfAReadyGate) {
  RecordProperty("requirement", "SR-107");
  for (const auto& doubt : {zoomed, silent}) {
    state = GateState{};
    to(Mode::ready);
    EXPECT_EQ(step(doubt).mode, Mode::unregistered);
    const Timestamp t_doubted = now;
    EXPECT_EQ(step_exposed(t_doubted).mode, Mode::unregistered);
    EXPECT_EQ(step_exposed(t_doubted + nanoseconds(1)).mode, Mode::ready);
  }
}

TEST_F(GateOptics, IsNotArmedOnAnImageFromBeforeTheDoubtEnded) {
  RecordProperty("requirement", "SR-107");
  to(Mode::permitted);
  step([](Inputs& in) {
    silent(in);
    in.operator_command.command = Command::disarm;
  });
  const Timestamp t_doubted = now;
  ASSERT_EQ(state.mode, Mode::ready);
  EXPECT_EQ(step_exposed(t_doubted, Command::arm).mode, Mode::ready);
  EXPECT_EQ(step_exposed(t_doubted + nanoseconds(1), Command::arm).mode, Mode::permitted);
}

TEST_F(GateOptics, AShortSilenceIsAHoldThatRecovers) {
  RecordProperty("requirement", "SR-97");
  to(Mode::permitted);
  const Decision decision = step(silent);
  EXPECT_EQ(decision.mode, Mode::hold);
  EXPECT_EQ(decision.cause, Reason::microscope_missing);
  EXPECT_EQ(run(limits.hold_recovery - milliseconds(1)).mode, Mode::hold);
  EXPECT_EQ(run(milliseconds(2)).mode, Mode::permitted);
}

TEST_F(GateOptics, AZoomThatReturnsElsewhereDuringASilenceStops) {
  RecordProperty("requirement", "SR-16,SR-97");
  to(Mode::permitted);
  run(milliseconds(50), silent);
  EXPECT_EQ(step(zoomed).mode, Mode::stop_latched);
}

TEST_F(GateOptics, FixedOpticsMustBeDeclared) {
  RecordProperty("requirement", "SR-97");
  const Decision decision = run(milliseconds(50), [](Inputs& in) { in.optics = OpticsInput{}; });
  EXPECT_EQ(decision.mode, Mode::unregistered);
  EXPECT_TRUE(decision.reasons.contains(Reason::microscope_missing));
  const auto fixed = [](Inputs& in) {
    in.optics = OpticsInput{};
    in.optics.is_declared_fixed = true;
  };
  EXPECT_EQ(run(milliseconds(50), fixed).mode, Mode::ready);
}

}  // namespace
}  // namespace holdfast::safety
