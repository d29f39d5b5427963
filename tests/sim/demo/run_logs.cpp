// SPDX-License-Identifier: Apache-2.0
#include "tests/sim/demo/run_logs.hpp"

#include <algorithm>
#include <cinttypes>
#include <cstdio>

#include "tests/sim/csv_table.hpp"

namespace holdfast::sim {
namespace {

using std::chrono::nanoseconds;

Eigen::Isometry3d pose_from(const CsvTable& table, std::size_t row, std::size_t first_column) {
  const auto at = [&](std::size_t i) { return table.number(row, first_column + i); };
  return Eigen::Translation3d{at(0), at(1), at(2)} *
         Eigen::Quaterniond{at(6), at(3), at(4), at(5)}.normalized();
}

}  // namespace

Truth::Truth(const std::filesystem::path& file) {
  const CsvTable table{file};
  const std::size_t t = table.column("t_monotonic_ns"), first = table.column("tx_mm");
  for (std::size_t row = 0; row < table.rows(); ++row) {
    t_.push_back(nanoseconds{table.integer(row, t)});
    poses_.push_back(pose_from(table, row, first));
  }
}

std::optional<Eigen::Isometry3d> Truth::at(nanoseconds t) const {
  const auto after = std::upper_bound(t_.begin(), t_.end(), t);
  if (after == t_.begin() || after == t_.end()) return std::nullopt;
  const auto i = static_cast<std::size_t>(after - t_.begin());
  const double share = static_cast<double>((t - t_[i - 1]).count()) /
                       static_cast<double>((t_[i] - t_[i - 1]).count());
  const Eigen::Quaterniond a{poses_[i - 1].linear()}, b{poses_[i].linear()};
  Eigen::Isometry3d pose = Eigen::Isometry3d::Identity();
  pose.translation() = (1 - share) * poses_[i - 1].translation() + share * poses_[i].translation();
  pose.linear() = a.slerp(share, b).toRotationMatrix();
  return pose;
}

std::vector<RobotRow> read_robot(const std::filesystem::path& file) {
  const CsvTable table{file};
  const auto column = [&](const char* name) { return table.column(name); };
  std::vector<RobotRow> rows;
  for (std::size_t i = 0; i < table.rows(); ++i) {
    const auto time = [&](const char* name) { return nanoseconds{table.integer(i, column(name))}; };
    RobotRow row;
    row.event = table.text(i, column("event"));
    row.refusal = table.text(i, column("refusal"));
    row.cause = table.text(i, column("cause"));
    row.t = time("t_monotonic_ns");
    row.t_end = time("t_permission_end_ns");
    row.t_pose = time("t_pose_ns");
    row.t_exposure = time("t_exposure_ns");
    row.t_received = time("t_frame_received_ns");
    row.t_valid_until = time("t_valid_until_ns");
    row.t_evidence = time("t_evidence_ns");
    row.frame = static_cast<std::uint64_t>(table.integer(i, column("frame")));
    row.is_first_of_frame = table.integer(i, column("first_of_frame")) != 0;
    if (row.event == "pose") row.T_robot_ct = pose_from(table, i, column("tx_mm"));
    rows.push_back(std::move(row));
  }
  return rows;
}

std::vector<SegmentSpan> read_segments(const std::filesystem::path& file, nanoseconds end) {
  const CsvTable table{file};
  const std::size_t t = table.column("t_monotonic_ns"), event = table.column("event"),
                    detail = table.column("detail");
  std::vector<SegmentSpan> segments;
  for (std::size_t row = 0; row < table.rows(); ++row) {
    if (table.text(row, event) != "segment") continue;
    const nanoseconds start{table.integer(row, t)};
    if (!segments.empty()) segments.back().to = start;
    segments.push_back({table.text(row, detail), start, end});
  }
  return segments;
}

std::map<std::uint64_t, nanoseconds> read_exposures(const std::filesystem::path& file) {
  const CsvTable table{file};
  const std::size_t event = table.column("event"), detail = table.column("detail");
  std::map<std::uint64_t, nanoseconds> exposures;
  for (std::size_t row = 0; row < table.rows(); ++row) {
    if (table.text(row, event) != "frame") continue;
    std::uint64_t id = 0;
    std::int64_t t_ns = 0;
    const std::string& text = table.text(row, detail);
    if (std::sscanf(text.c_str(), "id=%" SCNu64 " mid_exposure_ns=%" SCNd64, &id, &t_ns) == 2)
      exposures[id] = nanoseconds{t_ns};
  }
  return exposures;
}

}  // namespace holdfast::sim
