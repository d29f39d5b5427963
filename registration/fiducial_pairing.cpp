// SPDX-License-Identifier: Apache-2.0
#include "registration/fiducial_pairing.hpp"

#include <algorithm>
#include <map>
#include <set>

#include <fmt/format.h>

namespace holdfast::registration {
namespace {

MaybeRefusal duplicate(const Markups& markups, const char* which) {
  std::set<std::string> seen;
  for (const MarkupPoint& point : markups.points)
    if (!point.label.empty() && !seen.insert(point.label).second)
      return Refusal{RegistrationStatus::duplicate_label,
                     fmt::format("two {} fiducials are called {}", which, point.label)};
  return {};
}

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

IndexPairs pairs_of(const std::vector<std::size_t>& fixed_of_moving) {
  IndexPairs pairs;
  for (std::size_t i = 0; i < fixed_of_moving.size(); ++i)
    pairs.emplace_back(i, fixed_of_moving[i]);
  return pairs;
}

/// Whether all other assignments contradict the stated covariances so flatly that they are none.
bool is_without_rival(const RegistrationInput& input, const Correspondence& found) {
  if (found.candidate_count > found.candidates.size()) return false;
  return std::all_of(found.candidates.begin() + 1, found.candidates.end(), [&](const auto& rival) {
    const FiducialSet set = fiducial_set(input, pairs_of(rival));
    if (!set.has_covariances) return false;
    const RigidFit fit = fit_rigid(set);
    return fit.status == FitStatus::fitted && fit.p_value < input.limits.rival_p_max;
  });
}

MaybeRefusal by_geometry(const RegistrationInput& input, IndexPairs& pairs) {
  const std::vector<Eigen::Vector3d> moving = positions(input.moving);
  const double limit = input.limits.fre_max_mm;
  const Correspondence found = find_correspondence(positions(input.fixed), moving, limit);
  switch (found.status) {
    case CorrespondenceStatus::found:
      pairs = pairs_of(found.fixed_of_moving);
      return {};
    case CorrespondenceStatus::ambiguous:
      if (is_without_rival(input, found)) {
        pairs = pairs_of(found.candidates.front());
        return {};
      }
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

}  // namespace

FiducialSet fiducial_set(const RegistrationInput& input, const IndexPairs& pairs) {
  FiducialSet set;
  set.has_covariances = true;
  for (const auto& [moving, fixed] : pairs) {
    const MarkupPoint& m = input.moving.points[moving];
    const MarkupPoint& f = input.fixed.points[fixed];
    set.has_covariances = set.has_covariances && m.covariance_mm2 && f.covariance_mm2;
    set.pairs.push_back({m.label, f.position_mm, m.position_mm,
                         f.covariance_mm2.value_or(Eigen::Matrix3d::Zero()),
                         m.covariance_mm2.value_or(Eigen::Matrix3d::Zero())});
  }
  if (set.has_covariances) set.joint_covariance_camera_mm2 = chosen_joint(input.moving, pairs);
  return set;
}

MaybeRefusal pair_fiducials(const RegistrationInput& input, IndexPairs& pairs) {
  if (auto refusal = duplicate(input.fixed, "CT")) return refusal;
  if (auto refusal = duplicate(input.moving, "camera")) return refusal;
  if (input.moving.points.size() < 3 || input.fixed.points.size() < 3)
    return Refusal{RegistrationStatus::too_few_fiducials,
                   fmt::format("{} camera and {} CT fiducials, at least 3 of each are needed",
                               input.moving.points.size(), input.fixed.points.size())};
  pairs = by_label(input);
  return pairs.empty() ? by_geometry(input, pairs) : std::nullopt;
}

}  // namespace holdfast::registration
