// SPDX-License-Identifier: Apache-2.0
#include "tests/sim/demo/pose_error.hpp"

#include <algorithm>
#include <cmath>
#include <limits>

namespace holdfast::sim {
namespace {

using std::chrono::nanoseconds;

constexpr double kNan = std::numeric_limits<double>::quiet_NaN();

}  // namespace

Eigen::Vector3d Judge::p_target(nanoseconds t) const {
  const auto T_camera_site = truth_.at(t);
  if (!T_camera_site) return Eigen::Vector3d::Constant(kNan);
  return config_.T_robot_camera * (*T_camera_site) * config_.registration.T_camera_ct *
         config_.p_target_ct_mm;
}

double Judge::error_um(const Eigen::Isometry3d& T_robot_ct, nanoseconds t) const {
  return 1000 * (T_robot_ct * config_.p_target_ct_mm - p_target(t)).norm();
}

double Judge::avoidable_um(const Eigen::Isometry3d& T_robot_ct, std::uint64_t frame,
                           nanoseconds t) const {
  const auto exposure = exposures_.find(frame);
  if (exposure == exposures_.end()) return kNan;
  const nanoseconds t_exposure = exposure->second;
  const nanoseconds period = config_.limits.frame_period;
  const Eigen::Vector3d p_seen = p_target(t_exposure);
  const Eigen::Vector3d p_expected =
      p_seen + (p_seen - p_target(t_exposure - period)) * (to_ms(t - t_exposure) / to_ms(period));
  return 1000 * (T_robot_ct * config_.p_target_ct_mm - p_expected).norm();
}

std::vector<PoseError> Judge::errors(const std::vector<RobotRow>& rows) const {
  std::vector<PoseError> errors;
  for (std::size_t i = 0; i < rows.size(); ++i) {
    if (rows[i].event != "pose") continue;
    nanoseconds until = rows[i].t_valid_until;
    for (std::size_t j = i + 1; j < rows.size(); ++j) {
      if (rows[j].event != "pose" && rows[j].event != "stopped") continue;
      until = std::min(until, rows[j].event == "stopped" ? rows[j].t_end : rows[j].t);
      break;
    }
    until = std::max(until, rows[i].t);
    const Eigen::Isometry3d& T_robot_ct = rows[i].T_robot_ct;
    const PoseError error{rows[i].t,
                          until,
                          error_um(T_robot_ct, rows[i].t_pose),
                          error_um(T_robot_ct, rows[i].t),
                          error_um(T_robot_ct, until),
                          std::max(avoidable_um(T_robot_ct, rows[i].frame, rows[i].t),
                                   avoidable_um(T_robot_ct, rows[i].frame, until))};
    if (std::isfinite(error.at_pose_um) && std::isfinite(error.at_use_end_um))
      errors.push_back(error);
  }
  return errors;
}

HazardCount count_hazards(const std::vector<PoseError>& errors, const HazardLimits& limits,
                          nanoseconds unseen_max) {
  HazardCount count;
  nanoseconds over_since{};
  bool is_over = false;
  bool is_counted = false;
  nanoseconds t_previous_until{};
  for (const PoseError& error : errors) {
    const bool is_contiguous = error.t - t_previous_until < std::chrono::milliseconds{2};
    const double limit_um = 1000 * limits.error_mm;
    const bool exceeds = std::max(error.at_use_um, error.at_use_end_um) > limit_um;
    const bool is_avoidable = !(error.avoidable_um <= limit_um);  // also when it is not known
    if (error.avoidable_um > count.avoidable_um_max) count.avoidable_um_max = error.avoidable_um;
    if (!exceeds || (is_over && !is_contiguous)) is_over = is_counted = false;
    if (exceeds && !is_over) {
      is_over = true;
      over_since = error.t;
    }
    if (is_over) {
      const double over_ms = to_ms(error.t_until - over_since);
      count.over_limit_ms_max = std::max(count.over_limit_ms_max, over_ms);
      if ((over_ms > to_ms(unseen_max) || is_avoidable) && !is_counted) {
        ++count.hazards;
        is_counted = true;
      }
    }
    t_previous_until = error.t_until;
  }
  return count;
}

}  // namespace holdfast::sim
