// SPDX-License-Identifier: Apache-2.0
#include <fstream>
#include <random>
#include <regex>
#include <sstream>

#include <gtest/gtest.h>

#include "bridge/can/microscope_protocol.hpp"

namespace holdfast::bridge::can {
namespace {

bool is_understood(const Frame& frame) {
  return decode_command(frame) || decode_confirm(frame) || decode_state(frame) ||
         decode_heartbeat(frame, 1);
}

std::vector<Frame> one_of_each(bool is_fd) {
  return {encode(CommandMessage{7, Quantity::focus, 212.345}, is_fd),
          encode(ConfirmMessage{7, Quantity::zoom, ConfirmResult::reached, 1.25}, is_fd),
          encode(StateMessage{{1.25, 212.345, 40}, true, 9}, is_fd),
          encode(HeartbeatMessage{NodeState::operational, 15}, 1, is_fd)};
}

TEST(MicroscopeProtocol, BringsEveryValueBackToWithinItsResolution) {
  const auto state = decode_state(encode(StateMessage{{1.23456, 212.3456, 42.5}, true, 9}, false));
  ASSERT_TRUE(state);
  EXPECT_NEAR(state->optics.zoom, 1.23456, 0.5e-4);
  EXPECT_NEAR(state->optics.focus_mm, 212.3456, 0.5e-3);
  EXPECT_DOUBLE_EQ(state->optics.illumination_percent, 42.5);
  EXPECT_TRUE(state->is_moving);
  EXPECT_EQ(state->counter, 9);
  const auto command = decode_command(encode(CommandMessage{7, Quantity::focus, 212.345}, true));
  ASSERT_TRUE(command);
  EXPECT_EQ(command->sequence, 7);
  EXPECT_NEAR(command->value, 212.345, 1e-9);
}

TEST(MicroscopeProtocol, RefusesEverySingleBitFlipOfFrameAndIdentifier) {
  RecordProperty("requirement", "SR-94");
  for (const bool is_fd : {false, true}) {
    for (const Frame& good : one_of_each(is_fd)) {
      ASSERT_TRUE(is_understood(good));
      for (unsigned bit = 0; bit < 64 + 11; ++bit) {
        Frame bad = good;
        if (bit < 64)
          bad.data[bit / 8] = static_cast<std::uint8_t>(bad.data[bit / 8] ^ 1U << bit % 8);
        if (bit >= 64) bad.id ^= 1U << (bit - 64);
        EXPECT_FALSE(is_understood(bad)) << "id " << good.id << " bit " << bit;
      }
    }
  }
}

TEST(MicroscopeProtocol, RefusesOtherLengthsAndErrorFrames) {
  RecordProperty("requirement", "SR-94");
  for (const Frame& good : one_of_each(false)) {
    for (int size = 0; size <= 64; ++size) {
      Frame bad = good;
      bad.size = static_cast<std::uint8_t>(size);
      EXPECT_EQ(is_understood(bad), size == 8);
    }
    Frame bad = good;
    bad.is_error = true;
    EXPECT_FALSE(is_understood(bad));
  }
}

TEST(MicroscopeProtocol, WhatItAcceptsOfRandomFramesIsInRange) {
  std::mt19937 random(1);
  int accepted = 0;
  for (int i = 0; i < 300'000; ++i) {
    Frame frame;
    frame.id = i % 2 == 0 ? kStateId : kConfirmId;
    frame.size = 8;
    for (std::size_t byte = 0; byte < 8; ++byte)
      frame.data[byte] = static_cast<std::uint8_t>(random());
    frame.data[6] = static_cast<std::uint8_t>(frame.data[6] & (i % 2 == 0 ? 0x1f : 0));
    const auto state = decode_state(frame);
    const auto confirm = decode_confirm(frame);
    accepted += state || confirm ? 1 : 0;
    if (state) {
      ASSERT_LE(state->optics.illumination_percent, 100);
    }
    if (confirm) {
      ASSERT_LE(confirm->value, confirm->quantity == Quantity::zoom ? 6.5535 : 16777.215);
    }
  }
  EXPECT_GT(accepted, 100);  // one of 256 has the right CRC: the ranges were really tried
}

// The DBC file is what other tools read: signals extracted by its rules must be ours.
TEST(MicroscopeProtocol, AgreesWithTheDbcFile) {
  std::ifstream file(HOLDFAST_MICROSCOPE_DBC);
  std::stringstream text;
  text << file.rdbuf();
  const std::string dbc = text.str();
  const auto signal = [&dbc](const std::string& name, const Frame& frame) {
    const std::regex pattern(" SG_ " + name + R"([ m0-9M]*: (\d+)\|(\d+)@1\+ \(([0-9.]+),0\))");
    std::smatch match;
    if (!std::regex_search(dbc, match, pattern)) return -1.0;
    std::uint64_t bits = 0;
    for (std::size_t i = 8; i-- > 0;) bits = bits << 8U | frame.data[i];
    const int start = std::stoi(match[1]);
    const int length = std::stoi(match[2]);
    return static_cast<double>(bits >> start & ((std::uint64_t{1} << length) - 1)) *
           std::stod(match[3]);
  };
  const Frame state = encode(StateMessage{{1.2345, 212.345, 42.5}, true, 9}, false);
  EXPECT_NEAR(signal("Zoom", state), 1.2345, 1e-9);
  EXPECT_NEAR(signal("Focus", state), 212.345, 1e-9);
  EXPECT_NEAR(signal("Illumination", state), 42.5, 1e-9);
  EXPECT_EQ(signal("StateCounter", state), 9);
  EXPECT_EQ(signal("IsMoving", state), 1);
  EXPECT_EQ(signal("StateCrc", state), state.data[7]);
  const Frame command = encode(CommandMessage{7, Quantity::focus, 212.345}, false);
  EXPECT_EQ(signal("CommandSequence", command), 7);
  EXPECT_EQ(signal("CommandQuantity", command), 2);
  EXPECT_NEAR(signal("CommandFocus", command), 212.345, 1e-9);
  const Frame confirm =
      encode(ConfirmMessage{7, Quantity::zoom, ConfirmResult::device_fault, 1.25}, false);
  EXPECT_EQ(signal("ConfirmResult", confirm), 2);
  EXPECT_NEAR(signal("ConfirmZoom", confirm), 1.25, 1e-9);
  const Frame heartbeat = encode(HeartbeatMessage{NodeState::operational, 15}, 1, false);
  EXPECT_EQ(signal("NodeState", heartbeat), 5);
  EXPECT_EQ(signal("HeartbeatCounter", heartbeat), 15);
  for (const Frame& frame : one_of_each(false))
    EXPECT_NE(dbc.find("BO_ " + std::to_string(frame.id) + " "), std::string::npos) << frame.id;
}

}  // namespace
}  // namespace holdfast::bridge::can
