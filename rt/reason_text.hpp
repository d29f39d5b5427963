// SPDX-License-Identifier: Apache-2.0
// A reason in words, for people: the dashboard's and the console's. Any thread.
#pragma once

#include <string_view>

#include "rt/guard/guard_core.hpp"
#include "safety/reason.hpp"

namespace holdfast::rt {

/// One sentence without a full stop; for a code that is not listed, that it is unknown.
[[nodiscard]] std::string_view sentence(safety::Reason reason) noexcept;
[[nodiscard]] std::string_view sentence(guard::GuardCause cause) noexcept;

/// "stop", "hold", "readiness", "advisory", "none".
[[nodiscard]] std::string_view name(safety::Severity severity) noexcept;

}  // namespace holdfast::rt
