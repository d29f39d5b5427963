// SPDX-License-Identifier: Apache-2.0
// How wrong each pose was that the robot acted on, and which of it counts as a hazard.
#pragma once

#include <chrono>
#include <cstdint>
#include <map>
#include <utility>
#include <vector>

#include <Eigen/Geometry>

#include "rt/daemon_config.hpp"
#include "tests/sim/demo/evaluation.hpp"
#include "tests/sim/demo/run_logs.hpp"

namespace holdfast::sim {

/// The errors at the target of one pose the robot acted on.
struct PoseError {
  std::chrono::nanoseconds t{};        ///< when the robot began to act on it
  std::chrono::nanoseconds t_until{};  ///< when it ceased to
  double at_pose_um = 0;               ///< against the truth at the instant that the pose is for
  double at_use_um = 0;                ///< when the robot began to act on it
  double at_use_end_um = 0;            ///< when it ceased to
  double avoidable_um = 0;  ///< the larger distance from the perfect observer's, of both instants
};

/// Holds poses against the truth.
class Judge {
 public:
  /// Keeps references to `config` and `truth`; `exposures` as from read_exposures().
  Judge(const rt::DaemonConfig& config, const Truth& truth,
        std::map<std::uint64_t, std::chrono::nanoseconds> exposures)
      : config_(config), truth_(truth), exposures_(std::move(exposures)) {}

  /// Of the target under this pose against where it truly was at `t`; NaN where that is not known.
  [[nodiscard]] double error_um(const Eigen::Isometry3d& T_robot_ct,
                                std::chrono::nanoseconds t) const;
  /// Of all poses in `rows` whose truth is known.
  [[nodiscard]] std::vector<PoseError> errors(const std::vector<RobotRow>& rows) const;

 private:
  /// Distance from where a perfect observer of all frames up to `frame` expects the target at t;
  /// NaN for a frame that the camera has not sent.
  [[nodiscard]] double avoidable_um(const Eigen::Isometry3d& T_robot_ct, std::uint64_t frame,
                                    std::chrono::nanoseconds t) const;
  /// Where the target truly was, robot axes; NaN where the truth is not known.
  [[nodiscard]] Eigen::Vector3d p_target(std::chrono::nanoseconds t) const;

  const rt::DaemonConfig& config_;
  const Truth& truth_;
  const std::map<std::uint64_t, std::chrono::nanoseconds> exposures_;
};

struct HazardCount {
  int hazards = 0;
  double over_limit_ms_max = 0, avoidable_um_max = 0;  ///< as in Evaluation
};
/// `unseen_max`: for how long a motion may go unseen. `errors` in the order of time.
[[nodiscard]] HazardCount count_hazards(const std::vector<PoseError>& errors,
                                        const HazardLimits& limits,
                                        std::chrono::nanoseconds unseen_max);

}  // namespace holdfast::sim
