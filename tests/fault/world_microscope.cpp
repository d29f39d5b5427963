// SPDX-License-Identifier: Apache-2.0
// The microscope: its true optics, what its node says of them on the bus, and our reader.
#include <linux/can/error.h>

#include "rt/optics_thread.hpp"
#include "tests/fault/world.hpp"

namespace holdfast::fault {
namespace {

namespace can = bridge::can;

can::Frame error_frame(std::uint32_t what, std::uint8_t controller) {
  can::Frame frame;
  frame.is_error = true;
  frame.id = what;
  frame.size = 8;
  frame.data[1] = controller;
  return frame;
}

}  // namespace

/// Relative to the registration's.
double World::zoom_true() const {
  return 1 + disturbance.zoom_step + zoom_turned_;
}

void World::run_microscope() {
  const Disturbance& d = disturbance;
  zoom_turned_ += d.zoom_rate_per_s * 1e-3;
  if (d.is_reader_restarted && !has_restarted_reader_) {
    watch_ = can::MicroscopeWatch({}, now_);
    has_restarted_reader_ = true;
  }
  const bool is_due = steps_ % 20 == 0 && !d.is_node_silent && !d.is_bus_down;
  if (is_due) {
    const can::HeartbeatMessage heartbeat{
        d.is_node_booting ? can::NodeState::booting : can::NodeState::operational,
        heartbeat_counter_};
    heartbeat_counter_ = (heartbeat_counter_ + 1) & 0x0f;
    hear(encode(heartbeat, 1, false));
  }
  if (is_due) {
    const double zoom = d.is_encoder_stuck ? 1 : zoom_true();
    const double flicker = options_.is_lively ? uniform(-1, 1) : 0;
    const double focus_mm =
        registration_.focus_mm + (d.is_encoder_stuck ? 0 : d.focus_step_mm) + 0.1 * flicker;
    const can::StateMessage state{
        {registration_.zoom * zoom + d.encoder_error + 1e-3 * flicker, focus_mm, 50},
        d.is_drive_moving,
        state_counter_};
    state_counter_ = (state_counter_ + (d.is_node_skipping ? 2 : 1)) & 0x0f;
    can::Frame frame = encode(state, false);
    if (d.is_node_corrupt) frame.data[static_cast<std::size_t>(uniform(0, 7.99))] ^= 0x10;
    hear(frame);
  }
  if (d.is_bus_off) hear(error_frame(CAN_ERR_BUSOFF, 0));
  if (d.is_bus_passive) hear(error_frame(CAN_ERR_CRTL, CAN_ERR_CRTL_TX_PASSIVE));
  if (d.is_bus_overflowing) ++bus_drops_;
  if (is_daemon_suspended_) return;
  watch_.supervise(now_, !d.is_bus_down, bus_drops_);
  if (is_recovery_wanted_ && needs_recovery(watch_.faults())) watch_.forget();
  is_recovery_wanted_ = false;
  if (!d.is_reader_dead) {
    newest_optics_ = rt::optics_input(watch_.report(), now_);
    readings_.optics = newest_optics_;
  } else if (options_.bug == Bug::optics_restamped && newest_optics_) {
    newest_optics_->t_report = now_;
    readings_.optics = newest_optics_;
  }
}

}  // namespace holdfast::fault
