// SPDX-License-Identifier: Apache-2.0
// What comes to the daemon over DDS: the robot's status and the operator's commands, checked end to
// end. A message that fails its check is reported as such and its content never seen.
#pragma once

#include <array>
#include <cstddef>
#include <cstdint>
#include <optional>
#include <span>

#include "bridge/dds/endpoint.hpp"
#include "safety/gate.hpp"

namespace holdfast::bridge::dds {

/// What has arrived since the previous poll.
struct ReceivedInputs {
  std::optional<safety::RobotInput> robot;  ///< the newest accepted status; a fault in any accepted
                                            ///< one is kept
  bool is_corrupt = false;  ///< a message failed its check, or more commands came than have room:
                            ///< LoopInput::message_corrupt

  [[nodiscard]] std::span<const safety::OperatorInput> commands() const noexcept {
    return std::span(commands_).first(command_count_);
  }

 private:
  friend class InputReader;
  std::array<safety::OperatorInput, 8> commands_{};  // oldest first
  std::size_t command_count_ = 0;
};

/// One thread, not the control loop's.
class InputReader {
 public:
  /// `clock`: how the robot's and the console's host relate to this one. Throws UnavailableError.
  explicit InputReader(const Participant& participant,
                       safety::ClockRelation clock = safety::ClockRelation::same_host);
  /// Does not wait, does not allocate.
  [[nodiscard]] ReceivedInputs poll() noexcept;

  [[nodiscard]] EndpointStatus robot_endpoint() const noexcept { return robot_.reader().status(); }
  [[nodiscard]] EndpointStatus operator_endpoint() const noexcept {
    return operator_.reader().status();
  }

 private:
  ProtectedReader<msg::RobotStatus> robot_;
  ProtectedReader<msg::OperatorCommand> operator_;
};

}  // namespace holdfast::bridge::dds
