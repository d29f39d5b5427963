// SPDX-License-Identifier: Apache-2.0
// The same set-up with everything rendered: `demo --setup` on the virtual rig, as a user runs it,
// and beside its files the truth that it was never told.
#pragma once

#include <cstdint>
#include <filesystem>

#include "registration/ct_registration.hpp"

namespace holdfast::registration::test {

struct RenderedRig {
  std::uint32_t seed = 1;  ///< microscope, board, visits
  std::uint32_t phantom_seed = 1000;
  double zoom = 1.3;
  int pairs = 8;
};

struct RenderedMeasurement {
  RegistrationInput input;                   ///< as the set-up read it: fiducials and surfaces
  Eigen::Isometry3d T_ct_head, T_camera_ct;  ///< the truth, as of DrawnMeasurement
  double focus_mm = 0;
};

/// Runs the set-up into `folder`, unless one stands there. Throws RefusedError with its reason.
[[nodiscard]] RenderedMeasurement render_measurement(const RenderedRig& rig,
                                                     const std::filesystem::path& folder);

}  // namespace holdfast::registration::test
