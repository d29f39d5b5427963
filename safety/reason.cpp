// SPDX-License-Identifier: Apache-2.0
#include "safety/reason.hpp"

#include <bit>

namespace holdfast::safety {

Severity severity(Reason reason) noexcept {
  const auto code = static_cast<unsigned>(reason);
  if (code == 0) return Severity::none;
  if (code <= 20) return Severity::stop;
  if (code <= 44) return Severity::hold;
  if (code <= 55) return Severity::readiness;
  return Severity::advisory;
}

Reason ReasonSet::primary() const noexcept {
  return bits_ == 0 ? Reason::none : static_cast<Reason>(std::countr_zero(bits_));
}

}  // namespace holdfast::safety
