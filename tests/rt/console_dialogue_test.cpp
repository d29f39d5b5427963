// SPDX-License-Identifier: Apache-2.0
#include <gtest/gtest.h>
#include <nlohmann/json.hpp>

#include "rt/console/dialogue.hpp"

namespace holdfast::console {
namespace {

using safety::Command;
using safety::Mode;
using safety::Reason;
using namespace std::chrono_literals;

class ConsoleDialogue : public ::testing::Test {
 protected:
  static msg::MotionStop state(Mode mode, Reason cause, std::uint32_t stop_id = 0) {
    msg::MotionStop m{};
    m.mode = static_cast<std::uint8_t>(mode);
    m.cause = static_cast<std::uint8_t>(cause);
    m.reasons = m.cause == 0 ? 0 : std::uint64_t{1} << m.cause;
    m.is_permitted = mode == Mode::permitted;
    m.is_latched = mode == Mode::stop_latched;
    m.stop_id = stop_id;
    return m;
  }
  void becomes(Mode mode, Reason cause, std::uint32_t stop_id = 0) {
    shown_ = state(mode, cause, stop_id);
  }
  /// What is sent for a line; Command::none for nothing.
  Command sent(const std::string& line, std::chrono::nanoseconds after = 1s) {
    now_ += after;
    const Reply reply = dialogue_.take(line, shown_ ? &*shown_ : nullptr, now_);
    text_ = reply.text;
    order_ = reply.order.value_or(Order{});
    return order_.command;
  }

  Dialogue dialogue_;
  std::optional<msg::MotionStop> shown_;
  std::chrono::nanoseconds now_ = 100s;
  std::string text_;
  Order order_;
};

TEST_F(ConsoleDialogue, StopsAndDisarmsAtOnceAndStopsAlsoInTheDark) {
  RecordProperty("requirement", "SR-133");
  EXPECT_EQ(sent("stop"), Command::stop);
  EXPECT_EQ(sent("  stop \r"), Command::stop);
  EXPECT_EQ(sent("disarm"), Command::none);
  becomes(Mode::permitted, Reason::none);
  EXPECT_EQ(sent("disarm"), Command::disarm);
}

TEST_F(ConsoleDialogue, ArmsOnlyWhenAskedTwiceInTimeAndReady) {
  RecordProperty("requirement", "SR-133");
  becomes(Mode::ready, Reason::not_armed);
  EXPECT_EQ(sent("yes"), Command::none);
  EXPECT_EQ(sent("arm"), Command::none);
  EXPECT_EQ(sent("yes"), Command::arm);
  EXPECT_EQ(sent("yes"), Command::none) << "once";
  EXPECT_EQ(sent("arm"), Command::none);
  EXPECT_EQ(sent("yes", 10s), Command::arm);
  EXPECT_EQ(sent("arm"), Command::none);
  EXPECT_EQ(sent("yes", 10s + 1ns), Command::none);
  EXPECT_EQ(sent("arm yes"), Command::none) << "not in one line";
  EXPECT_EQ(sent("arm"), Command::none);
  becomes(Mode::stop_latched, Reason::drift_exceeded, 3);
  EXPECT_EQ(sent("yes"), Command::none) << text_;
  becomes(Mode::ready, Reason::not_armed);
  EXPECT_EQ(sent("yes"), Command::none) << "what was asked before the stop is void";
  EXPECT_EQ(sent("arm"), Command::none);
  shown_.reset();
  EXPECT_EQ(sent("yes"), Command::none) << "silence";
}

TEST_F(ConsoleDialogue, EndsAStopOnlyInTwoStepsThatNameIt) {
  RecordProperty("requirement", "SR-133");
  becomes(Mode::stop_latched, Reason::drift_exceeded, 4);
  EXPECT_EQ(sent("confirm 4"), Command::none);
  EXPECT_EQ(sent("acknowledge"), Command::none);
  EXPECT_EQ(sent("acknowledge 3"), Command::none);
  EXPECT_EQ(sent("acknowledge 4x"), Command::none);
  EXPECT_EQ(sent("acknowledge -4"), Command::none);
  EXPECT_EQ(sent("acknowledge 4"), Command::acknowledge);
  EXPECT_EQ(order_.stop_id, 4U);
  EXPECT_EQ(sent("confirm"), Command::none);
  EXPECT_EQ(sent("confirm 4"), Command::none) << "a wrong second step voids the first";
  EXPECT_EQ(sent("acknowledge 4"), Command::acknowledge);
  EXPECT_EQ(sent("confirm 4"), Command::confirm);
  EXPECT_EQ(order_.stop_id, 4U);
  EXPECT_EQ(sent("confirm 4"), Command::none) << "once";
}

TEST_F(ConsoleDialogue, ConfirmsNeitherANewerStopNorTooLate) {
  RecordProperty("requirement", "SR-133");
  becomes(Mode::stop_latched, Reason::drift_exceeded, 4);
  EXPECT_EQ(sent("acknowledge 4"), Command::acknowledge);
  becomes(Mode::stop_latched, Reason::pose_jump, 5);
  EXPECT_EQ(sent("confirm 4"), Command::none) << text_;
  EXPECT_EQ(sent("acknowledge 4"), Command::none) << text_;
  EXPECT_EQ(sent("acknowledge 5"), Command::acknowledge);
  EXPECT_EQ(sent("confirm 5", 10s + 1ns), Command::none) << text_;
  becomes(Mode::ready, Reason::not_armed);
  EXPECT_EQ(sent("acknowledge 5"), Command::none) << text_;
  shown_.reset();
  EXPECT_EQ(sent("acknowledge 5"), Command::none) << text_;
}

TEST_F(ConsoleDialogue, SaysWordReasonAndWhatToDo) {
  EXPECT_TRUE(state_line(nullptr).starts_with("STOP: NO DATA"));
  msg::MotionStop m = state(Mode::stop_latched, Reason::drift_exceeded, 4);
  m.reasons |= std::uint64_t{1} << static_cast<unsigned>(Reason::frame_late);
  EXPECT_EQ(state_line(&m),
            "STOP  The two ways of measuring the motion disagree: drift (drift_exceeded); stop 4: "
            "`acknowledge 4`; also frame_late");
  EXPECT_EQ(nlohmann::json::parse(state_json(m))["reasons"],
            (nlohmann::json{"drift_exceeded", "frame_late"}));
  m = state(Mode::permitted, Reason::none);
  EXPECT_TRUE(state_line(&m).starts_with("PERMITTED"));
  m.cause = 9;
  EXPECT_FALSE(state_line(&m).starts_with("PERMITTED")) << "a message that contradicts itself";
}

TEST_F(ConsoleDialogue, TakesWhateverIsTyped) {
  becomes(Mode::ready, Reason::not_armed);
  for (const std::string& line :
       {std::string(), std::string(" "), std::string("help"),
        std::string("acknowledge 99999999999999999999"), std::string(1000, 'x'),
        std::string("arm\0yes", 7), std::string("\x1b[A")})
    EXPECT_EQ(sent(line), Command::none);
  EXPECT_TRUE(dialogue_.take("quit", nullptr, now_).is_end);
}

}  // namespace
}  // namespace holdfast::console
