// SPDX-License-Identifier: Apache-2.0
// The virtual microscope on CAN: three drives that need time, their encoders, a heartbeat. Knows
// the truth that the daemon has to read from the bus. One thread; time is passed in.
#pragma once

#include <chrono>
#include <cstdint>
#include <memory>
#include <optional>

#include "bridge/can/frame.hpp"
#include "bridge/can/microscope_protocol.hpp"

namespace holdfast::sim {

struct MicroscopeNodeParameters {
  std::uint8_t node = 1;
  bool is_fd = false;
  bridge::can::Optics optics{1.0, 200.0, 50.0};
  double zoom_per_s = 1.0;
  double focus_mm_per_s = 50;
  double zoom_min = 0.4, zoom_max = 2.4;
  double focus_min_mm = 150, focus_max_mm = 450;
  std::chrono::nanoseconds heartbeat_period = std::chrono::milliseconds(20);
  std::chrono::nanoseconds state_period = std::chrono::milliseconds(20);
};

class MicroscopeNode {
 public:
  MicroscopeNode(std::unique_ptr<bridge::can::Transport> transport,
                 const MicroscopeNodeParameters& parameters)
      : transport_(std::move(transport)), parameters_(parameters), optics_(parameters.optics) {}

  /// Takes commands, moves the drives, sends what is due.
  void poll(std::chrono::nanoseconds now);

  /// An instrument nurse turns the knob: no command, the encoder tells.
  void turn(bridge::can::Quantity quantity, double value);

  bool is_silent = false;  ///< the node is off: it neither hears nor speaks
  bool is_faulty = false;  ///< the drives do not move
  bridge::can::NodeState state = bridge::can::NodeState::operational;

  [[nodiscard]] const bridge::can::Optics& optics() const { return optics_; }
  [[nodiscard]] bridge::can::Transport& transport() const { return *transport_; }

 private:
  void take(const bridge::can::CommandMessage& command, std::chrono::nanoseconds now);
  void drive(std::chrono::nanoseconds now);
  void confirm(bridge::can::ConfirmResult result);
  [[nodiscard]] double& value_of(bridge::can::Quantity quantity);
  void send(const bridge::can::Frame& frame) { (void)transport_->send(frame); }

  std::unique_ptr<bridge::can::Transport> transport_;
  MicroscopeNodeParameters parameters_;
  bridge::can::Optics optics_;
  std::optional<bridge::can::CommandMessage> goal_;
  std::optional<std::chrono::nanoseconds> t_previous_;
  std::chrono::nanoseconds t_heartbeat_{}, t_state_{};
  std::uint8_t heartbeat_counter_ = 0, state_counter_ = 0;
};

}  // namespace holdfast::sim
