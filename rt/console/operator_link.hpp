// SPDX-License-Identifier: Apache-2.0
// The console on the wire: what the daemon says, and the operator's protected commands. One thread.
#pragma once

#include <chrono>

#include "bridge/dds/endpoint.hpp"
#include "rt/console/dialogue.hpp"

namespace holdfast::console {

class OperatorLink {
 public:
  /// With DDS Security `security` is an operator's folder. Throws InputError, UnavailableError.
  OperatorLink(std::uint32_t domain, const std::string& security);

  /// Takes what has come. Call it at least every 10 ms: messages older than 20 ms are not believed.
  void look();
  /// The newest state; null when none was heard for 100 ms. Valid until the next look().
  [[nodiscard]] const msg::MotionStop* shown() const noexcept;

  /// A daemon listens, and takes this console for the only one: another one's last command is long
  /// enough ago (a source that changes at once is refused as an intruder, and stops the robot).
  [[nodiscard]] bool is_ready() const noexcept;

  /// Sends, and waits up to 1 s until the daemon has it. Throws UnavailableError.
  void send(const Order& order);

 private:
  bridge::dds::Participant participant_;
  bridge::dds::ProtectedWriter<msg::OperatorCommand> commands_;
  bridge::dds::ProtectedReader<msg::MotionStop> stops_;
  msg::MotionStop newest_{};
  std::chrono::nanoseconds t_start_, t_heard_{};
  bool has_heard_ = false;
};

}  // namespace holdfast::console
