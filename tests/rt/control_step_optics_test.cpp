// SPDX-License-Identifier: Apache-2.0
// The control step and the microscope: what its reader hands over reaches the gate, and ages.
#include "tests/rt/control_step_fixture.hpp"

namespace holdfast::rt::testing {
namespace {

using safety::Mode;
using safety::Reason;

class ControlStepOptics : public ControlStep {
 protected:
  ControlStepOptics() {
    parameters.optics_are_fixed = false;
    look.has_report = look.is_known = true;
    look.zoom = inputs.registration.zoom;
    look.focus_mm = inputs.registration.focus_mm;
  }
  ControlOutput look_cycle(safety::Command command = safety::Command::none) {
    return cycle([&](Readings& readings) {
      look.t_report = now;
      readings.optics = look;
      readings.operator_command.command = command;
    });
  }
  void look_for(safety::Duration time) {
    for (const safety::Timestamp end = now + time; now < end;) look_cycle();
  }
  void reach_permitted_looking() {
    look_for(milliseconds(500));
    ASSERT_EQ(look_cycle(safety::Command::arm).decision.mode, Mode::permitted);
  }
  safety::OpticsInput look;
};

TEST_F(ControlStepOptics, NeverPermitsWithoutALook) {
  RecordProperty("requirement", "SR-97");
  run(milliseconds(500));
  EXPECT_EQ(output.decision.mode, Mode::unregistered);
  EXPECT_TRUE(output.decision.reasons.contains(Reason::microscope_missing));
}

TEST_F(ControlStepOptics, PermitsWithTheRegistrationsOptics) {
  ASSERT_NO_FATAL_FAILURE(reach_permitted_looking());
}

TEST_F(ControlStepOptics, StopsInTheCycleThatReadsAnotherZoom) {
  RecordProperty("requirement", "SR-16,SR-74");
  ASSERT_NO_FATAL_FAILURE(reach_permitted_looking());
  look.zoom += 0.1;
  EXPECT_EQ(look_cycle().decision.cause, Reason::optics_changed);
  EXPECT_EQ(output.decision.mode, Mode::stop_latched);
  EXPECT_EQ(output.t_evidence, now);
}

TEST_F(ControlStepOptics, HoldsWhenTheReaderFallsSilent) {
  RecordProperty("requirement", "SR-97");
  ASSERT_NO_FATAL_FAILURE(reach_permitted_looking());
  const safety::Timestamp t_last = now;
  run(parameters.limits.optics_age_max);
  EXPECT_EQ(output.decision.mode, Mode::permitted);
  cycle();
  EXPECT_EQ(output.decision.mode, Mode::hold);
  EXPECT_EQ(output.decision.cause, Reason::microscope_silent);
  EXPECT_EQ(output.t_evidence, t_last + parameters.limits.optics_age_max);
}

TEST_F(ControlStepOptics, HoldsOnAFaultOfTheBusUnderItsName) {
  RecordProperty("requirement", "SR-108");
  ASSERT_NO_FATAL_FAILURE(reach_permitted_looking());
  look.faults.insert(Reason::can_bus_off);
  look.is_known = false;
  EXPECT_EQ(look_cycle().decision.cause, Reason::can_bus_off);
  EXPECT_EQ(output.decision.mode, Mode::hold);
}

TEST_F(ControlStepOptics, StopsWhenTheImagesScaleIsNotTheZooms) {
  RecordProperty("requirement", "SR-99");
  restart();
  ASSERT_NO_FATAL_FAILURE(reach_permitted());
  spoil_next_estimate([&](StampedEstimate& estimate) {
    estimate.motion.scale = 1 + 1.01 * parameters.limits.scale_mismatch_max;
  });
  EXPECT_EQ(output.decision.cause, Reason::scale_mismatch);
  EXPECT_EQ(output.decision.mode, Mode::stop_latched);
}

}  // namespace
}  // namespace holdfast::rt::testing
