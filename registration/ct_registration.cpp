// SPDX-License-Identifier: Apache-2.0
#include "registration/ct_registration.hpp"

#include <algorithm>
#include <cmath>

#include <fmt/format.h>

#include "registration/fiducial_pairing.hpp"
#include "registration/reconstruction.hpp"

namespace holdfast::registration {
namespace {

// Comments of a surface file that tell its CT.
constexpr const char* kSeries = "ct_series";
constexpr const char* kFrame = "ct_frame_of_reference";

std::string property(const Markups& markups, const std::string& key) {
  const auto found = markups.properties.find(key);
  return found == markups.properties.end() ? std::string{} : found->second;
}

std::string comment(const std::optional<TriangleMesh>& mesh, const std::string& key) {
  if (mesh)
    for (const std::string& line : mesh->comments)
      if (line.rfind(key + " ", 0) == 0) return line.substr(key.size() + 1);
  return {};
}

struct CtIdentity {
  std::string series, frame;
};

MaybeRefusal identify(const RegistrationInput& input, CtIdentity& identity) {
  identity = {property(input.fixed, kCtSeriesUid), property(input.fixed, kCtFrameOfReferenceUid)};
  const CtIdentity surface{comment(input.fixed_surface, kSeries),
                           comment(input.fixed_surface, kFrame)};
  if (!identity.frame.empty() && !surface.frame.empty() && identity.frame != surface.frame)
    return Refusal{RegistrationStatus::other_ct,
                   fmt::format("the fiducials are of CT frame of reference {}, the surface of {}",
                               identity.frame, surface.frame)};
  if (identity.series.empty()) identity.series = surface.series;
  if (identity.frame.empty()) identity.frame = surface.frame;
  const std::string& expected = input.expected_ct;
  if (expected.empty() || expected == identity.series || expected == identity.frame) return {};
  return Refusal{
      RegistrationStatus::other_ct,
      identity.series.empty() && identity.frame.empty()
          ? fmt::format("CT {} is planned, and the files do not say of which CT they are", expected)
          : fmt::format("CT {} is planned, the files are of series {}, frame of reference {}",
                        expected, identity.series, identity.frame)};
}

void describe(const RegistrationInput& input, const IndexPairs& pairs, const FiducialSet& set,
              CtRegistration& result) {
  for (const auto& [moving, fixed] : pairs) {
    const std::string &m = input.moving.points[moving].label, &f = input.fixed.points[fixed].label;
    result.labels.push_back(m == f ? m : fmt::format("{} = {}", m, f));
  }
  if (!set.has_covariances)
    result.notes.emplace_back(
        "not every fiducial states a covariance: the error is judged from the residuals");
}

MaybeRefusal judge_status(const RigidFit& fit, std::size_t pairs) {
  switch (fit.status) {
    case FitStatus::fitted:
      return {};
    case FitStatus::too_few:
      return Refusal{RegistrationStatus::too_few_fiducials,
                     fmt::format("{} fiducials correspond, at least 3 must", pairs)};
    case FitStatus::collinear:
      return Refusal{RegistrationStatus::collinear,
                     "the fiducials lie in a line: the rotation about it is not determined"};
    case FitStatus::invalid:
      break;
  }
  return Refusal{RegistrationStatus::invalid_numbers,
                 "a fiducial's position or covariance is not usable"};
}

MaybeRefusal judge_fit(const FiducialSet& set, const RegistrationLimits& limits,
                       CtRegistration& result) {
  const RigidFit& fit = result.fiducial_fit;
  result.left_out = leave_one_out(set, fit);
  const bool is_poor =
      fit.fre_mm > limits.fre_max_mm || (set.has_covariances && fit.p_value < limits.fit_p_min);
  if (is_poor && mirrored_fre_mm(set) < std::min(0.5 * fit.fre_mm, limits.fre_max_mm))
    return Refusal{RegistrationStatus::mirrored_ct,
                   fmt::format("FRE {:.3f} mm, {:.3f} mm after a reflection: the CT is mirrored",
                               fit.fre_mm, mirrored_fre_mm(set))};
  const auto worst =
      std::min_element(result.left_out.begin(), result.left_out.end(),
                       [](const LeftOut& l, const LeftOut& r) { return l.p_value < r.p_value; });
  if (worst != result.left_out.end()) {
    const double p_min = limits.left_out_p_min / static_cast<double>(result.left_out.size());
    const bool is_displaced = set.has_covariances ? worst->p_value < p_min
                                                  : worst->displacement_mm > limits.left_out_max_mm;
    if (is_displaced)
      return Refusal{
          RegistrationStatus::fiducial_displaced,
          fmt::format("fiducial {} is {:.2f} mm from where the others place it (p {:.1g})",
                      worst->label, worst->displacement_mm, worst->p_value)};
  }
  if (!is_poor) return {};
  return Refusal{RegistrationStatus::poor_fit,
                 fmt::format("FRE {:.3f} mm, limit {} mm; the residuals' probability under the "
                             "stated covariances is {:.1g}, limit {:.1g}",
                             fit.fre_mm, limits.fre_max_mm, fit.p_value, limits.fit_p_min)};
}

/// Asked before anything is made of the surface, used or only looked at.
MaybeRefusal judge_surface(const RegistrationInput& input) {
  if (input.moving_surface)
    for (const std::string& line : input.moving_surface->comments)
      if (line.rfind(kForComparison, 0) == 0)
        return Refusal{RegistrationStatus::comparison_surface,
                       "the reconstructed surface was made under a lattice, for a comparison only: "
                       "it may be a period of the pattern off"};
  return {};
}

std::vector<Eigen::Vector3d> camera_points(const TriangleMesh& mesh) {
  const Eigen::Matrix3d R_camera_mesh = mesh.R_rectified_camera
                                            ? Eigen::Matrix3d{mesh.R_rectified_camera->transpose()}
                                            : Eigen::Matrix3d::Identity();
  std::vector<Eigen::Vector3d> points;
  points.reserve(mesh.vertices_mm.size());
  for (const Eigen::Vector3f& vertex : mesh.vertices_mm)
    points.emplace_back(R_camera_mesh * vertex.cast<double>());
  return points;
}

MaybeRefusal fuse(const RegistrationInput& input, CtRegistration& result) {
  if (!input.fixed_surface || !input.moving_surface) return {};
  const SurfaceFitOptions options;
  result.surface_fit = fuse_surface(result.fiducial_fit, camera_points(*input.moving_surface),
                                    TriangleTree{*input.fixed_surface}, options);
  const SurfaceFit& fit = *result.surface_fit;
  switch (fit.status) {
    case SurfaceFitStatus::fused:
      return {};
    case SurfaceFitStatus::no_overlap:
      return Refusal{RegistrationStatus::no_overlap,
                     fmt::format("{:.0f} % of the reconstructed surface lies within {} mm of the "
                                 "CT's, at least {:.0f} % must",
                                 100 * fit.overlap, options.within_mm, 100 * options.overlap_min)};
    case SurfaceFitStatus::disagreement:
      return Refusal{RegistrationStatus::surface_disagreement,
                     fmt::format("the surface lies {:.2f} mm from where the fiducials place it "
                                 "(p {:.1g}, limit {:.1g})",
                                 fit.shift_mm, fit.p_value, options.disagreement_p_min)};
    case SurfaceFitStatus::not_converged:
      break;
  }
  return Refusal{RegistrationStatus::surface_disagreement, "the surfaces' fit does not converge"};
}

bool is_worth_fusing(const RegistrationInput& input, const FiducialSet& set,
                     CtRegistration& result) {
  std::vector<Eigen::Vector3d> points = input.targets_ct_mm;
  if (points.empty()) {
    points.emplace_back(Eigen::Vector3d::Zero());
    for (const FiducialPair& pair : set.pairs)
      points.front() += pair.p_ct_mm / static_cast<double>(set.pairs.size());
  }
  double before_mm2 = 0, after_mm2 = 0;
  for (const Eigen::Vector3d& p : points) {
    const RigidFit& fiducials = result.fiducial_fit;
    const SurfaceFit& fused = *result.surface_fit;
    before_mm2 = std::max(
        before_mm2, target_covariance(fiducials.T_camera_ct, fiducials.covariance, p).trace());
    after_mm2 =
        std::max(after_mm2, target_covariance(fused.T_camera_ct, fused.covariance, p).trace());
  }
  const double before_mm = std::sqrt(before_mm2), after_mm = std::sqrt(after_mm2);
  if (after_mm <= (1 - input.limits.fusion_gain_min) * before_mm) return true;
  result.notes.push_back(fmt::format(
      "the fiducials' registration stays: fused, the surface would change the predicted "
      "TRE from {:.3f} to {:.3f} mm, a gain below {:g} %",
      before_mm, after_mm, 100 * input.limits.fusion_gain_min));
  return false;
}

MaybeRefusal predict_targets(const RegistrationInput& input, Registration& registration) {
  for (const Eigen::Vector3d& target : input.targets_ct_mm) {
    TargetError error;
    error.p_target_ct_mm = target;
    error.covariance_mm2 =
        target_covariance(registration.T_camera_ct, registration.covariance, target);
    error.rms_mm = std::sqrt(error.covariance_mm2.trace());
    registration.tre.push_back(error);
    if (!(error.rms_mm <= input.limits.tre_max_mm))
      return Refusal{
          RegistrationStatus::target_uncertain,
          fmt::format("the predicted TRE at {:.1f},{:.1f},{:.1f} is {:.2f} mm, limit {} mm",
                      target.x(), target.y(), target.z(), error.rms_mm, input.limits.tre_max_mm)};
  }
  return {};
}

MaybeRefusal run(const RegistrationInput& input, CtRegistration& result) {
  CtIdentity identity;
  if (auto refusal = identify(input, identity)) return refusal;
  if (auto refusal = judge_surface(input)) return refusal;
  IndexPairs pairs;
  if (auto refusal = pair_fiducials(input, pairs)) return refusal;
  const FiducialSet set = fiducial_set(input, pairs);
  describe(input, pairs, set, result);
  result.fiducial_fit = fit_rigid(set);
  if (auto refusal = judge_status(result.fiducial_fit, set.pairs.size())) return refusal;
  if (auto refusal = judge_fit(set, input.limits, result)) return refusal;
  if (auto refusal = fuse(input, result)) return refusal;

  result.is_fused = input.is_refined && result.surface_fit && is_worth_fusing(input, set, result);
  Registration& registration = result.registration;
  registration.T_camera_ct =
      result.is_fused ? result.surface_fit->T_camera_ct : result.fiducial_fit.T_camera_ct;
  registration.covariance =
      result.is_fused ? result.surface_fit->covariance : result.fiducial_fit.covariance;
  registration.covariance =
      (0.5 * (registration.covariance + registration.covariance.transpose())).eval();
  registration.fre_mm = result.fiducial_fit.fre_mm;
  registration.ct_identity = identity.series.empty() ? identity.frame : identity.series;
  return predict_targets(input, registration);
}

}  // namespace

CtRegistration register_ct(const RegistrationInput& input) {
  CtRegistration result;
  result.status = RegistrationStatus::registered;
  if (const MaybeRefusal refusal = run(input, result)) {
    result.status = refusal->status;
    result.reason = refusal->reason;
    result.registration = {};
  }
  return result;
}

}  // namespace holdfast::registration
