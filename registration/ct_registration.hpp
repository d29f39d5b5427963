// SPDX-License-Identifier: Apache-2.0
// From fiducials (and surfaces) to a registration that may be used, or a refusal that says why.
// Every doubt refuses: there is no fallback.
#pragma once

#include <optional>
#include <string>
#include <vector>

#include "registration/fiducial_checks.hpp"
#include "registration/markups.hpp"
#include "registration/mesh_file.hpp"
#include "registration/registration_file.hpp"
#include "registration/rigid_fit.hpp"
#include "registration/surface_fit.hpp"

namespace holdfast::registration {

struct RegistrationLimits {
  double fre_max_mm = 0.5;  ///< of the fiducials, and of an accepted correspondence
  double fit_p_min = 1e-4;  ///< of the residuals under the stated covariances
  /// Another assignment of the fiducials within fre_max_mm is none only if its residuals under the
  /// stated covariances are less probable than this; without covariances it always is one.
  double rival_p_max = 1e-12;
  double left_out_p_min = 1e-4;  ///< of one fiducial under the others, shared among them
  double left_out_max_mm = 0.7;  ///< displacement, where no covariances are stated
  double tre_max_mm = 1.0;       ///< predicted rms at each target
  /// By how much, of it, a fused surface must lower the predicted rms (worst target; without
  /// targets, the fiducials' middle). One that does not brings its own errors and nothing else: the
  /// fiducials' registration then stays as it is.
  double fusion_gain_min = 0.1;
};

struct RegistrationInput {
  Markups fixed;                               ///< in the CT (LPS, mm)
  Markups moving;                              ///< in frame camera (mm)
  std::optional<TriangleMesh> fixed_surface;   ///< of the CT (LPS, mm)
  std::optional<TriangleMesh> moving_surface;  ///< frame camera, or rectified with its R1
  bool is_refined = false;                     ///< fuse the surfaces where that gains; needs both
  std::vector<Eigen::Vector3d> targets_ct_mm;
  std::string expected_ct;  ///< series or frame of reference UID of the planned CT; empty: any
  RegistrationLimits limits;
};

enum class RegistrationStatus {
  registered,
  too_few_fiducials,
  duplicate_label,
  no_correspondence,
  ambiguous_correspondence,
  collinear,
  invalid_numbers,
  other_ct,            ///< not the planned CT, or points and surface of two
  mirrored_ct,         ///< a reflection fits, no motion does
  fiducial_displaced,  ///< one contradicts all others
  poor_fit,
  comparison_surface,    ///< reconstructed under a lattice: it may be a period off
  no_overlap,            ///< the surfaces do not lie on each other
  surface_disagreement,  ///< they do, elsewhere than the fiducials say
  target_uncertain       ///< the predicted TRE is over its limit
};

struct CtRegistration {
  RegistrationStatus status = RegistrationStatus::invalid_numbers;
  std::string reason;  ///< one line with the figures; empty when registered
  /// Only when registered: pose, covariance, FRE and TREs; the caller adds optics and files.
  Registration registration;
  RigidFit fiducial_fit;
  std::vector<std::string> labels;  ///< "moving = fixed" of each pair, in the residuals' order
  std::vector<LeftOut> left_out;
  std::optional<SurfaceFit> surface_fit;
  bool is_fused =
      false;  ///< the surface is part of `registration`, not only asked whether it agrees
  std::vector<std::string> notes;
};

/// Pure: same input, same result. Not for the real-time path.
[[nodiscard]] CtRegistration register_ct(const RegistrationInput& input);

}  // namespace holdfast::registration
