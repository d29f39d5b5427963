// SPDX-License-Identifier: Apache-2.0
// The dashboard's answers as JSON (docs/dashboard.md lists the members). A number that is not there
// is null, never 0. Any thread.
#pragma once

#include <string>

#include "bridge/dds/message_protection.hpp"
#include "rt/observer/observed_state.hpp"

namespace holdfast::dashboard {

using observer::Histogram;
using observer::ObservedState;
using observer::Shown;
using observer::StopEvent;
using std::chrono::nanoseconds;

/// `/state`: what is, now.
[[nodiscard]] std::string state_json(const ObservedState& state, bridge::dds::Clocks now);
/// `/history`: stops and latencies since this program began.
[[nodiscard]] std::string history_json(const ObservedState& state);

}  // namespace holdfast::dashboard
