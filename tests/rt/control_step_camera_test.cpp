// SPDX-License-Identifier: Apache-2.0
// What the control step makes of arrivals: deadlines, faults, too many of them.
#include <gtest/gtest.h>

#include "tests/rt/control_step_fixture.hpp"

namespace holdfast::rt {
namespace {

using safety::Mode;
using safety::Reason;
using safety::Timestamp;
using testing::ControlStep;
using testing::kPeriod;

TEST_F(ControlStep, WithdrawsInTheFirstCycleAfterTheFrameDeadline) {
  RecordProperty("requirement", "SR-74");
  reach_permitted();
  inputs.has_frames = false;
  const Timestamp deadline = state.camera.t_last_frame_received + parameters.limits.frame_period +
                             parameters.limits.frame_lateness;
  while (now + kPeriod <= deadline) ASSERT_EQ(cycle().decision.mode, Mode::permitted);
  cycle();
  EXPECT_EQ(output.decision.mode, Mode::hold);
  EXPECT_EQ(output.decision.cause, Reason::frame_late);
  EXPECT_EQ(output.t_evidence, deadline);
  EXPECT_LE(now - output.t_evidence, kPeriod);
}

TEST_F(ControlStep, KeepsTheEvidenceUntilModeOrCauseChange) {
  reach_permitted();
  inputs.has_frames = false;
  run(std::chrono::milliseconds(45));
  ASSERT_EQ(output.decision.cause, Reason::frame_late);
  const Timestamp evidence = output.t_evidence;
  run(std::chrono::milliseconds(10));
  EXPECT_EQ(output.t_evidence, evidence);
}

TEST_F(ControlStep, NoFaultIsLostAmongSeveralArrivalsOfOneCycle) {
  RecordProperty("requirement", "SR-74");
  for (const Reason fault : {Reason::frame_gap, Reason::frame_incomplete, Reason::frame_frozen,
                             Reason::frame_dark, Reason::frame_saturated}) {
    SCOPED_TRACE(safety::name(fault));
    restart();
    reach_permitted();
    cycle([&](Readings& readings) {
      readings.arrival_count = 3;
      for (std::size_t i = 0; i < 3; ++i) {
        readings.arrivals[i] = FrameArrival{};
        readings.arrivals[i].t_received =
            now - std::chrono::microseconds(300 - 100 * static_cast<int>(i));
      }
      readings.arrivals[0].faults.insert(fault);
    });
    EXPECT_EQ(output.decision.mode, Mode::hold);
    EXPECT_EQ(output.decision.cause, fault);
    EXPECT_EQ(output.t_evidence, now - std::chrono::microseconds(300));
  }
}

TEST_F(ControlStep, AnIncompleteFrameDoesNotFeedTheFrameDeadline) {
  reach_permitted();
  const Timestamp newest = state.camera.t_last_frame_received;
  cycle([&](Readings& readings) {
    readings.arrival_count = 1;
    readings.arrivals[0].t_received = now;
    readings.arrivals[0].faults.insert(Reason::frame_incomplete);
  });
  EXPECT_EQ(state.camera.t_last_frame_received, newest);
}

TEST_F(ControlStep, ADisconnectionHoldsUntilTheCameraIsBack) {
  reach_permitted();
  inputs.has_frames = false;
  cycle([&](Readings& readings) {
    readings.arrival_count = 1;
    readings.arrivals[0].t_received = now;
    readings.arrivals[0].is_connected = false;
  });
  EXPECT_EQ(output.decision.cause, Reason::camera_disconnected);
  cycle();
  EXPECT_TRUE(output.decision.reasons.contains(Reason::camera_disconnected));
}

TEST_F(ControlStep, MoreArrivalsThanFitAreAnInternalFault) {
  RecordProperty("requirement", "SR-72");
  reach_permitted();
  cycle([&](Readings& readings) {
    readings.arrival_count = Readings::kMaxArrivals + 1;
    for (FrameArrival& arrival : readings.arrivals) arrival.t_received = now;
  });
  EXPECT_EQ(output.decision.mode, Mode::stop_latched);
  EXPECT_EQ(output.decision.cause, Reason::internal_fault);
}

TEST_F(ControlStep, AnOverflowReportedByTheLoopStops) {
  RecordProperty("requirement", "SR-72");
  reach_permitted();
  cycle([](Readings& readings) { readings.loop.internal_fault = true; });
  EXPECT_EQ(output.decision.cause, Reason::internal_fault);
}

}  // namespace
}  // namespace holdfast::rt
