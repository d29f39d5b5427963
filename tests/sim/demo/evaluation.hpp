// SPDX-License-Identifier: Apache-2.0
// What the robot did, held against the truth: the only place where both are known.
#pragma once

#include <cstdint>
#include <filesystem>
#include <map>
#include <string>
#include <vector>

#include <Eigen/Geometry>

#include "rt/daemon_config.hpp"

namespace holdfast::sim {

/// A permission is hazardous when the true error at the target is over the limit
/// - for longer than Limits::estimate_age_max: for that long, and no longer, a motion may go
/// unseen;
/// - at all, when the pose is also further than the limit from what a perfect observer would have
///   said: one who knows the true motion up to the pose's newest frame, and lets the velocity of
///   the frame period before it go on. Then it is not for want of a frame that the pose is wrong.
struct HazardLimits {
  double error_mm = 0.5;
};

/// A stretch in which a withdrawal is what we want: an injected fault, or a bump.
struct ExpectedStop {
  std::string what;
  std::chrono::nanoseconds from{}, to{};
};

struct StopRecord {
  std::string cause;     ///< safety/reason.hpp, or the client's own refusal
  std::string expected;  ///< the injection behind it; empty: a false stop
  double reaction_ms =
      0;  ///< arrival of the evidence (or the deadline that passed) to the robot's end
  double injected_to_stop_ms = 0;  ///< from the injection to the robot's end; NaN without one
};

struct TrajectoryRecord {
  std::string name;
  double duration_s = 0;
  double permitted_share = 0;
  double tracking_rms_um = 0, tracking_max_um = 0;  ///< pose against truth at the instant it is for
  double at_use_rms_um = 0, at_use_max_um = 0;  ///< pose against truth at the instant it is used
  std::size_t poses = 0;
};

struct Evaluation {
  struct Interval {
    std::chrono::nanoseconds from{}, to{};
  };
  std::vector<Interval> permissions;  ///< when the robot was permitted, by its own log
  std::vector<TrajectoryRecord> trajectories;
  std::vector<StopRecord> stops;
  int hazards = 0;
  int false_stops = 0;
  double over_limit_ms_max = 0;    ///< longest permitted stretch with the error over the limit
  double avoidable_um_max = 0;     ///< largest distance of a pose used from the perfect observer's
  double tracking_rms_um = 0;      ///< over all trajectories but bumps
  std::vector<double> latency_ms;  ///< exposure to robot, first pose of each frame
  std::vector<double>
      handover_ms;  ///< arrival at the PC to robot, the same, less the tracker's time
  // For the plots
  std::vector<double> t_s, x_mm, y_mm, true_x_mm, true_y_mm, error_um;
};

/// `tracker_us`: the tracker's time by frame id, from the health messages.
[[nodiscard]] Evaluation evaluate(const rt::DaemonConfig& config,
                                  const std::filesystem::path& truth_file,
                                  const std::filesystem::path& events_file,
                                  const std::filesystem::path& robot_file,
                                  std::vector<ExpectedStop> expected,
                                  const std::map<std::uint64_t, std::uint32_t>& tracker_us,
                                  const HazardLimits& limits);

/// The value that `fraction` of the values do not exceed (nearest rank); NaN when there are none.
[[nodiscard]] double percentile(std::vector<double> values, double fraction);

}  // namespace holdfast::sim
