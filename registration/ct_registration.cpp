// SPDX-License-Identifier: Apache-2.0
#include "registration/ct_registration.hpp"

#include <algorithm>
#include <cmath>
#include <map>
#include <set>

#include <fmt/format.h>

namespace holdfast::registration {
namespace {

// Comments of a surface file that tell its CT.
constexpr const char* kSeries = "ct_series";
constexpr const char* kFrame = "ct_frame_of_reference";

/// Ends the registration with a reason.
struct Refusal {
  RegistrationStatus status;
  std::string reason;
};
using MaybeRefusal = std::optional<Refusal>;

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

MaybeRefusal duplicate(const Markups& markups, const char* which) {
  std::set<std::string> seen;
  for (const MarkupPoint& point : markups.points)
    if (!point.label.empty() && !seen.insert(point.label).second)
      return Refusal{RegistrationStatus::duplicate_label,
                     fmt::format("two {} fiducials are called {}", which, point.label)};
  return {};
}

using IndexPairs = std::vector<std::pair<std::size_t, std::size_t>>;  // moving, fixed

IndexPairs by_label(const RegistrationInput& input) {
  std::map<std::string, std::size_t> fixed;
  for (std::size_t i = 0; i < input.fixed.points.size(); ++i)
    if (!input.fixed.points[i].label.empty()) fixed[input.fixed.points[i].label] = i;
  IndexPairs pairs;
  for (std::size_t i = 0; i < input.moving.points.size(); ++i)
    if (const auto found = fixed.find(input.moving.points[i].label); found != fixed.end())
      pairs.emplace_back(i, found->second);
  return pairs;
}

std::vector<Eigen::Vector3d> positions(const Markups& markups, bool is_mirrored = false) {
  std::vector<Eigen::Vector3d> result;
  for (const MarkupPoint& point : markups.points) {
    result.push_back(point.position_mm);
    if (is_mirrored) result.back().x() = -result.back().x();
  }
  return result;
}

MaybeRefusal by_geometry(const RegistrationInput& input, IndexPairs& pairs) {
  const std::vector<Eigen::Vector3d> moving = positions(input.moving);
  const double limit = input.limits.fre_max_mm;
  const Correspondence found = find_correspondence(positions(input.fixed), moving, limit);
  switch (found.status) {
    case CorrespondenceStatus::found:
      for (std::size_t i = 0; i < moving.size(); ++i)
        pairs.emplace_back(i, found.fixed_of_moving[i]);
      return {};
    case CorrespondenceStatus::ambiguous:
      return Refusal{
          RegistrationStatus::ambiguous_correspondence,
          fmt::format("two assignments fit, FRE {:.3f} and {:.3f} mm, limit {} mm: label "
                      "the fiducials or place them less alike",
                      found.fre_mm, found.second_fre_mm, limit)};
    case CorrespondenceStatus::too_many:
      return Refusal{RegistrationStatus::no_correspondence,
                     fmt::format("{} camera and {} CT fiducials without a common label, at most 16 "
                                 "and 64 are searched",
                                 moving.size(), input.fixed.points.size())};
    case CorrespondenceStatus::none:
      break;
  }
  if (find_correspondence(positions(input.fixed, true), moving, limit).status ==
      CorrespondenceStatus::found)
    return Refusal{RegistrationStatus::mirrored_ct,
                   "the fiducials fit only after a reflection: the CT is mirrored"};
  return Refusal{RegistrationStatus::no_correspondence,
                 fmt::format("no assignment of the {} camera fiducials to the {} of the CT has an "
                             "FRE of at most {} mm: another patient, a moved marker, or too few",
                             moving.size(), input.fixed.points.size(), limit)};
}

/// The joint covariance of the chosen moving points, in their order; empty when there is none.
Eigen::MatrixXd chosen_joint(const Markups& moving, const IndexPairs& pairs) {
  if (moving.joint_covariance_mm2.size() == 0) return {};
  const auto n = static_cast<Eigen::Index>(pairs.size());
  Eigen::MatrixXd joint(3 * n, 3 * n);
  for (Eigen::Index i = 0; i < n; ++i)
    for (Eigen::Index j = 0; j < n; ++j)
      joint.block<3, 3>(3 * i, 3 * j) = moving.joint_covariance_mm2.block<3, 3>(
          3 * static_cast<Eigen::Index>(pairs[static_cast<std::size_t>(i)].first),
          3 * static_cast<Eigen::Index>(pairs[static_cast<std::size_t>(j)].first));
  return joint;
}

FiducialSet fiducial_set(const RegistrationInput& input, const IndexPairs& pairs,
                         CtRegistration& result) {
  FiducialSet set;
  set.has_covariances = true;
  for (const auto& [moving, fixed] : pairs) {
    const MarkupPoint& m = input.moving.points[moving];
    const MarkupPoint& f = input.fixed.points[fixed];
    set.has_covariances = set.has_covariances && m.covariance_mm2 && f.covariance_mm2;
    set.pairs.push_back({m.label, f.position_mm, m.position_mm,
                         f.covariance_mm2.value_or(Eigen::Matrix3d::Zero()),
                         m.covariance_mm2.value_or(Eigen::Matrix3d::Zero())});
    result.labels.push_back(m.label == f.label ? m.label
                                               : fmt::format("{} = {}", m.label, f.label));
  }
  if (set.has_covariances)
    set.joint_covariance_camera_mm2 = chosen_joint(input.moving, pairs);
  else
    result.notes.emplace_back(
        "not every fiducial states a covariance: the error is judged from the residuals");
  return set;
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
  if (auto refusal = duplicate(input.fixed, "CT")) return refusal;
  if (auto refusal = duplicate(input.moving, "camera")) return refusal;
  if (input.moving.points.size() < 3 || input.fixed.points.size() < 3)
    return Refusal{RegistrationStatus::too_few_fiducials,
                   fmt::format("{} camera and {} CT fiducials, at least 3 of each are needed",
                               input.moving.points.size(), input.fixed.points.size())};
  IndexPairs pairs = by_label(input);
  if (pairs.empty())
    if (auto refusal = by_geometry(input, pairs)) return refusal;
  const FiducialSet set = fiducial_set(input, pairs, result);
  result.fiducial_fit = fit_rigid(set);
  if (auto refusal = judge_status(result.fiducial_fit, set.pairs.size())) return refusal;
  if (auto refusal = judge_fit(set, input.limits, result)) return refusal;
  if (auto refusal = fuse(input, result)) return refusal;

  const bool is_fused = input.is_refined && result.surface_fit;
  Registration& registration = result.registration;
  registration.T_camera_ct =
      is_fused ? result.surface_fit->T_camera_ct : result.fiducial_fit.T_camera_ct;
  registration.covariance =
      is_fused ? result.surface_fit->covariance : result.fiducial_fit.covariance;
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
