// SPDX-License-Identifier: Apache-2.0
#include "tests/sim/demo/evaluation.hpp"

#include <algorithm>
#include <cmath>
#include <limits>
#include <numeric>

#include "tests/sim/demo/pose_error.hpp"
#include "tests/sim/demo/run_logs.hpp"

namespace holdfast::sim {
namespace {

using std::chrono::nanoseconds;

constexpr double kNan = std::numeric_limits<double>::quiet_NaN();
constexpr std::size_t kPlotPointsMax = 6000;

double rms(const std::vector<double>& values) {
  if (values.empty()) return kNan;
  const double sum = std::inner_product(values.begin(), values.end(), values.begin(), 0.0);
  return std::sqrt(sum / static_cast<double>(values.size()));
}

double maximum(const std::vector<double>& values) {
  return values.empty() ? kNan : *std::max_element(values.begin(), values.end());
}

std::vector<TrajectoryRecord> by_trajectory(const std::vector<SegmentSpan>& segments,
                                            const std::vector<PoseError>& errors) {
  std::vector<TrajectoryRecord> records;
  for (const SegmentSpan& segment : segments) {
    std::vector<double> at_pose, at_use;
    nanoseconds permitted{};
    for (const PoseError& error : errors) {
      if (error.t < segment.from || error.t >= segment.to) continue;
      at_pose.push_back(error.at_pose_um);
      at_use.push_back(error.at_use_um);
      permitted += error.t_until - error.t;
    }
    TrajectoryRecord record;
    record.name = segment.name;
    record.duration_s = to_ms(segment.to - segment.from) / 1000;
    record.permitted_share = to_ms(permitted) / to_ms(segment.to - segment.from);
    record.tracking_rms_um = rms(at_pose);
    record.tracking_max_um = maximum(at_pose);
    record.at_use_rms_um = rms(at_use);
    record.at_use_max_um = maximum(at_use);
    record.poses = at_pose.size();
    records.push_back(record);
  }
  return records;
}

StopRecord stop_record(const RobotRow& row, const std::vector<ExpectedStop>& expected) {
  StopRecord stop;
  const bool is_told = row.refusal == "not_permitted";
  stop.cause = is_told ? row.cause : row.refusal;
  stop.reaction_ms = is_told ? to_ms(row.t_end - row.t_evidence) : kNan;
  stop.injected_to_stop_ms = kNan;
  for (const ExpectedStop& window : expected) {
    if (row.t_end < window.from || row.t_end > window.to) continue;
    stop.expected = window.what;
    stop.injected_to_stop_ms = to_ms(row.t_end - window.from);
  }
  return stop;
}

void add_plot_series(const rt::DaemonConfig& config, const Truth& truth,
                     const std::vector<RobotRow>& rows, const Judge& judge,
                     Evaluation& evaluation) {
  const auto poses = static_cast<std::size_t>(std::count_if(
      rows.begin(), rows.end(), [](const RobotRow& row) { return row.event == "pose"; }));
  const std::size_t stride = std::max<std::size_t>(1, poses / kPlotPointsMax);
  std::size_t n = 0;
  for (const RobotRow& row : rows) {
    const bool is_break = row.event == "stopped";
    if (!is_break && (row.event != "pose" || n++ % stride != 0)) continue;
    const auto T_true = truth.at(is_break ? row.t : row.t_pose);
    if (!T_true) continue;
    const Eigen::Vector3d p_target_site = config.registration.T_camera_ct * config.p_target_ct_mm;
    const Eigen::Vector3d p_camera =
        config.T_robot_camera.inverse() * (row.T_robot_ct * config.p_target_ct_mm) - p_target_site;
    const Eigen::Vector3d p_true = *T_true * p_target_site - p_target_site;
    evaluation.t_s.push_back(to_ms(row.t - truth.begin()) / 1000);
    evaluation.x_mm.push_back(is_break ? kNan : p_camera.x());
    evaluation.y_mm.push_back(is_break ? kNan : p_camera.y());
    evaluation.true_x_mm.push_back(p_true.x());
    evaluation.true_y_mm.push_back(p_true.y());
    evaluation.error_um.push_back(is_break ? kNan : judge.error_um(row.T_robot_ct, row.t));
  }
}

}  // namespace

double percentile(std::vector<double> values, double fraction) {
  if (values.empty()) return kNan;
  const auto rank =
      static_cast<std::size_t>(std::ceil(fraction * static_cast<double>(values.size())));
  const std::size_t index = std::min(values.size() - 1, rank == 0 ? 0 : rank - 1);
  std::nth_element(values.begin(), values.begin() + static_cast<std::ptrdiff_t>(index),
                   values.end());
  return values[index];
}

Evaluation evaluate(const rt::DaemonConfig& config, const std::filesystem::path& truth_file,
                    const std::filesystem::path& events_file,
                    const std::filesystem::path& robot_file, std::vector<ExpectedStop> expected,
                    const std::map<std::uint64_t, std::uint32_t>& tracker_us,
                    const HazardLimits& limits) {
  const Truth truth{truth_file};
  const std::vector<RobotRow> rows = read_robot(robot_file);
  const std::vector<SegmentSpan> segments = read_segments(events_file, truth.end());
  for (const SegmentSpan& segment : segments)
    if (segment.name.starts_with("bump")) expected.push_back({"bump", segment.from, segment.to});

  Evaluation evaluation;
  const Judge judge{config, truth, read_exposures(events_file)};
  const std::vector<PoseError> errors = judge.errors(rows);
  evaluation.trajectories = by_trajectory(segments, errors);
  const HazardCount count = count_hazards(errors, limits, config.limits.estimate_age_max);
  evaluation.hazards = count.hazards;
  evaluation.over_limit_ms_max = count.over_limit_ms_max;
  evaluation.avoidable_um_max = count.avoidable_um_max;
  std::vector<double> tracking;
  for (const PoseError& error : errors) {
    const bool is_expected = std::any_of(expected.begin(), expected.end(), [&](const auto& window) {
      return error.t >= window.from && error.t <= window.to;
    });
    if (!is_expected) tracking.push_back(error.at_pose_um);
  }
  evaluation.tracking_rms_um = rms(tracking);
  nanoseconds permitted_since{};
  for (const RobotRow& row : rows) {
    if (row.event == "permitted") permitted_since = row.t;
    if (row.event == "stopped") {
      evaluation.permissions.push_back({permitted_since, row.t_end});
      evaluation.stops.push_back(stop_record(row, expected));
      if (evaluation.stops.back().expected.empty()) ++evaluation.false_stops;
    }
    if (row.event != "pose" || !row.is_first_of_frame) continue;
    evaluation.latency_ms.push_back(to_ms(row.t - row.t_exposure));
    const auto tracked = tracker_us.find(row.frame);
    if (tracked != tracker_us.end())
      evaluation.handover_ms.push_back(to_ms(row.t - row.t_received) - tracked->second * 1e-3);
  }
  add_plot_series(config, truth, rows, judge, evaluation);
  return evaluation;
}

}  // namespace holdfast::sim
