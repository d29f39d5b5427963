// SPDX-License-Identifier: Apache-2.0
// The mode state machine as one table. Rows are tried from the top; the first whose mode and
// condition hold is taken, at most one a cycle; without one the mode stays. The same table is in
// docs/safety/modes.md, kept equal by a test.
#pragma once

#include <array>
#include <cstdint>
#include <string_view>

#include "safety/gate.hpp"

namespace holdfast::safety {

enum class Condition : std::uint8_t {
  latching_fault,          ///< a stop reason that latches in this mode, or the hold timed out
  inputs_arrived,          ///< a frame has arrived since start
  verified,                ///< a new estimate passes the drift check against the keyframe
  verification_withdrawn,  ///< the verified registration was replaced or withdrawn, or the optics
                           ///< came into doubt before it was used
  armed,                   ///< the operator arms, and no stop or hold reason is present
  disarmed,                ///< the operator disarms
  hold_reason,             ///< a hold reason is present
  recovered,               ///< all has been well for hold_recovery
  released                 ///< acknowledged, confirmed in time, and the drift check passes
};
[[nodiscard]] std::string_view name(Condition condition) noexcept;

struct Transition {
  Mode from;
  Condition when;
  Mode to;
};

inline constexpr std::array kTransitions = {
    Transition{Mode::init, Condition::latching_fault, Mode::stop_latched},
    Transition{Mode::init, Condition::inputs_arrived, Mode::unregistered},
    Transition{Mode::unregistered, Condition::latching_fault, Mode::stop_latched},
    Transition{Mode::unregistered, Condition::verified, Mode::ready},
    Transition{Mode::ready, Condition::latching_fault, Mode::stop_latched},
    Transition{Mode::ready, Condition::verification_withdrawn, Mode::unregistered},
    Transition{Mode::ready, Condition::armed, Mode::permitted},
    Transition{Mode::permitted, Condition::latching_fault, Mode::stop_latched},
    Transition{Mode::permitted, Condition::disarmed, Mode::ready},
    Transition{Mode::permitted, Condition::hold_reason, Mode::hold},
    Transition{Mode::hold, Condition::latching_fault, Mode::stop_latched},
    Transition{Mode::hold, Condition::disarmed, Mode::ready},
    Transition{Mode::hold, Condition::recovered, Mode::permitted},
    Transition{Mode::stop_latched, Condition::released, Mode::ready},
};

/// The conditions that hold in one cycle.
class ConditionSet {
 public:
  constexpr void set(Condition condition, bool holds) noexcept {
    bits_ |= (holds ? 1U : 0U) << static_cast<unsigned>(condition);
  }
  [[nodiscard]] constexpr bool contains(Condition condition) const noexcept {
    return ((bits_ >> static_cast<unsigned>(condition)) & 1U) != 0;
  }

 private:
  std::uint32_t bits_ = 0;
};

/// The mode after this cycle.
[[nodiscard]] Mode next_mode(Mode mode, ConditionSet conditions) noexcept;

/// The stop reasons that latch in `mode`: in permitted and hold all; before, those that put the
/// system itself or its inputs in doubt (the others merely keep it from being armed); in
/// stop_latched none, for it is latched already.
[[nodiscard]] ReasonSet latching_reasons(Mode mode, ReasonSet reasons) noexcept;

}  // namespace holdfast::safety
