// SPDX-License-Identifier: Apache-2.0
// What the console makes of a line that a person typed, given what the daemon says at that moment.
// Nothing that leads towards motion is sent by one line alone: arming asks back, and a stop ends by
// `acknowledge N` and then `confirm N`, both naming it. What leads away from motion goes at once.
// Pure: text, messages and time in, an order out; no I/O. One thread.
#pragma once

#include <chrono>
#include <cstdint>
#include <optional>
#include <string>
#include <string_view>

#include "bridge/dds/message_types.hpp"
#include "safety/gate.hpp"

namespace holdfast::console {

struct Order {
  safety::Command command = safety::Command::none;
  std::uint32_t stop_id = 0;  ///< of the stop that acknowledge and confirm name
};

struct Reply {
  std::string text;            ///< to the person, one line
  std::optional<Order> order;  ///< to the daemon
  bool is_end = false;         ///< the person wants to leave
};

/// How long a first step waits for its second; the gate has its own bound (Limits::confirm_max).
inline constexpr std::chrono::seconds kSecondStepWithin{10};

class Dialogue {
 public:
  /// `shown`: the newest state, null when nothing fresh is heard from the daemon.
  [[nodiscard]] Reply take(std::string_view line, const msg::MotionStop* shown,
                           std::chrono::nanoseconds now);

 private:
  [[nodiscard]] Reply arm(const msg::MotionStop& shown, std::chrono::nanoseconds now);
  [[nodiscard]] Reply yes(const msg::MotionStop& shown, std::chrono::nanoseconds now);
  [[nodiscard]] Reply acknowledge(std::string_view number, const msg::MotionStop& shown,
                                  std::chrono::nanoseconds now);
  [[nodiscard]] Reply confirm(std::string_view number, const msg::MotionStop& shown,
                              std::chrono::nanoseconds now);

  std::optional<std::chrono::nanoseconds> t_arm_asked_;
  std::optional<std::chrono::nanoseconds> t_acknowledged_;
  std::uint32_t acknowledged_id_ = 0;
};

/// "STOP  drift_exceeded: The two ways …  (stop 4: type `acknowledge 4`)"; for null that nothing is
/// heard.
[[nodiscard]] std::string state_line(const msg::MotionStop* shown);

/// The same as JSON, one object; `shown` must not be null.
[[nodiscard]] std::string state_json(const msg::MotionStop& shown);

/// Why `order` cannot lead to anything now; empty when it may. For those who give both steps at
/// once. `shown` null: nothing is heard.
[[nodiscard]] std::string objection(const Order& order, const msg::MotionStop* shown);

}  // namespace holdfast::console
