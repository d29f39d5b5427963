// SPDX-License-Identifier: Apache-2.0
// What the programs of a run have written down: the truth, the robot's acts, the segments of the
// motion and the exposures. Throws InputError on a file that cannot be read.
#pragma once

#include <chrono>
#include <cstdint>
#include <filesystem>
#include <map>
#include <optional>
#include <string>
#include <vector>

#include <Eigen/Geometry>

namespace holdfast::sim {

[[nodiscard]] inline double to_ms(std::chrono::nanoseconds t) {
  return static_cast<double>(t.count()) * 1e-6;
}

/// T_camera_site over time, interpolated between the simulator's rows.
class Truth {
 public:
  explicit Truth(const std::filesystem::path& file);
  /// Empty before the first row and from the last on.
  [[nodiscard]] std::optional<Eigen::Isometry3d> at(std::chrono::nanoseconds t) const;
  [[nodiscard]] std::chrono::nanoseconds begin() const {
    return t_.empty() ? std::chrono::nanoseconds{} : t_.front();
  }
  [[nodiscard]] std::chrono::nanoseconds end() const {
    return t_.empty() ? std::chrono::nanoseconds{} : t_.back();
  }

 private:
  std::vector<std::chrono::nanoseconds> t_;
  std::vector<Eigen::Isometry3d> poses_;
};

/// One line of the robot's log. `event` is permitted, pose or stopped.
struct RobotRow {
  std::string event, refusal, cause;
  std::chrono::nanoseconds t{}, t_end{}, t_pose{}, t_exposure{}, t_received{}, t_valid_until{},
      t_evidence{};
  std::uint64_t frame = 0;
  bool is_first_of_frame = false;
  Eigen::Isometry3d T_robot_ct = Eigen::Isometry3d::Identity();
};

[[nodiscard]] std::vector<RobotRow> read_robot(const std::filesystem::path& file);

/// A segment of the motion; the last one ends at `end`.
struct SegmentSpan {
  std::string name;
  std::chrono::nanoseconds from{}, to{};
};

[[nodiscard]] std::vector<SegmentSpan> read_segments(const std::filesystem::path& file,
                                                     std::chrono::nanoseconds end);

/// Mid-exposure by frame id, as the camera itself has it: the stamps that arrived may be wrong.
[[nodiscard]] std::map<std::uint64_t, std::chrono::nanoseconds> read_exposures(
    const std::filesystem::path& file);

}  // namespace holdfast::sim
