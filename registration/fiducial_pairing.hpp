// SPDX-License-Identifier: Apache-2.0
// Part of ct_registration: which fiducials belong together, by their labels or, where none is
// common, by geometry; and the fit's problem made of them.
#pragma once

#include <optional>
#include <string>
#include <utility>
#include <vector>

#include "registration/ct_registration.hpp"

namespace holdfast::registration {

/// Ends the registration with a reason.
struct Refusal {
  RegistrationStatus status;
  std::string reason;
};
using MaybeRefusal = std::optional<Refusal>;

using IndexPairs = std::vector<std::pair<std::size_t, std::size_t>>;  ///< moving, fixed

/// Fills `pairs` or says why not: a label twice, too few points, no assignment or several. Pure.
[[nodiscard]] MaybeRefusal pair_fiducials(const RegistrationInput& input, IndexPairs& pairs);

/// Covariances count only where every point of `pairs` states one.
[[nodiscard]] FiducialSet fiducial_set(const RegistrationInput& input, const IndexPairs& pairs);

}  // namespace holdfast::registration
