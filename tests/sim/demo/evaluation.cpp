// SPDX-License-Identifier: Apache-2.0
#include "tests/sim/demo/evaluation.hpp"

#include <algorithm>
#include <cinttypes>
#include <cmath>
#include <cstdio>
#include <limits>
#include <numeric>
#include <optional>

#include "tests/sim/demo/csv_table.hpp"

namespace holdfast::sim {
namespace {

using std::chrono::nanoseconds;

constexpr double kNan = std::numeric_limits<double>::quiet_NaN();
constexpr std::size_t kPlotPointsMax = 6000;

double to_ms(nanoseconds t) {
  return static_cast<double>(t.count()) * 1e-6;
}

Eigen::Isometry3d pose_from(const CsvTable& table, std::size_t row, std::size_t first_column) {
  const auto at = [&](std::size_t i) { return table.number(row, first_column + i); };
  return Eigen::Translation3d{at(0), at(1), at(2)} *
         Eigen::Quaterniond{at(6), at(3), at(4), at(5)}.normalized();
}

/// T_camera_site over time, interpolated between the simulator's rows.
class Truth {
 public:
  explicit Truth(const std::filesystem::path& file) {
    const CsvTable table{file};
    const std::size_t t = table.column("t_monotonic_ns"), first = table.column("tx_mm");
    for (std::size_t row = 0; row < table.rows(); ++row) {
      t_.push_back(nanoseconds{table.integer(row, t)});
      poses_.push_back(pose_from(table, row, first));
    }
  }
  [[nodiscard]] std::optional<Eigen::Isometry3d> at(nanoseconds t) const {
    const auto after = std::upper_bound(t_.begin(), t_.end(), t);
    if (after == t_.begin() || after == t_.end()) return std::nullopt;
    const auto i = static_cast<std::size_t>(after - t_.begin());
    const double share = static_cast<double>((t - t_[i - 1]).count()) /
                         static_cast<double>((t_[i] - t_[i - 1]).count());
    const Eigen::Quaterniond a{poses_[i - 1].linear()}, b{poses_[i].linear()};
    Eigen::Isometry3d pose = Eigen::Isometry3d::Identity();
    pose.translation() =
        (1 - share) * poses_[i - 1].translation() + share * poses_[i].translation();
    pose.linear() = a.slerp(share, b).toRotationMatrix();
    return pose;
  }
  [[nodiscard]] nanoseconds begin() const { return t_.empty() ? nanoseconds{} : t_.front(); }
  [[nodiscard]] nanoseconds end() const { return t_.empty() ? nanoseconds{} : t_.back(); }

 private:
  std::vector<nanoseconds> t_;
  std::vector<Eigen::Isometry3d> poses_;
};

struct RobotRow {
  std::string event, refusal, cause;
  nanoseconds t{}, t_end{}, t_pose{}, t_exposure{}, t_received{}, t_valid_until{}, t_evidence{};
  std::uint64_t frame = 0;
  bool is_first_of_frame = false;
  Eigen::Isometry3d T_robot_ct = Eigen::Isometry3d::Identity();
};

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

struct SegmentSpan {
  std::string name;
  nanoseconds from{}, to{};
};

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

/// Mid-exposure by frame id, as the camera itself has it: the stamps that arrived may be wrong.
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

double rms(const std::vector<double>& values) {
  if (values.empty()) return kNan;
  const double sum = std::inner_product(values.begin(), values.end(), values.begin(), 0.0);
  return std::sqrt(sum / static_cast<double>(values.size()));
}

double maximum(const std::vector<double>& values) {
  return values.empty() ? kNan : *std::max_element(values.begin(), values.end());
}

/// The errors at the target of one pose the robot acted on.
struct PoseError {
  nanoseconds t{};           // when the robot began to act on it
  nanoseconds t_until{};     // when it ceased to
  double at_pose_um = 0;     // against the truth at the instant that the pose is for
  double at_use_um = 0;      // when the robot began to act on it
  double at_use_end_um = 0;  // when it ceased to
  double avoidable_um = 0;   // the larger distance from the perfect observer's, of both instants
};

class Judge {
 public:
  Judge(const rt::DaemonConfig& config, const Truth& truth,
        std::map<std::uint64_t, nanoseconds> exposures)
      : config_(config), truth_(truth), exposures_(std::move(exposures)) {}

  [[nodiscard]] double error_um(const Eigen::Isometry3d& T_robot_ct, nanoseconds t) const {
    return 1000 * (T_robot_ct * config_.p_target_ct_mm - p_target(t)).norm();
  }

  /// Distance from where a perfect observer of all frames up to `frame` expects the target at t;
  /// NaN for a frame that the camera has not sent.
  [[nodiscard]] double avoidable_um(const Eigen::Isometry3d& T_robot_ct, std::uint64_t frame,
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

  [[nodiscard]] std::vector<PoseError> errors(const std::vector<RobotRow>& rows) const {
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

 private:
  /// Where the target truly was, robot axes; NaN where the truth is not known.
  [[nodiscard]] Eigen::Vector3d p_target(nanoseconds t) const {
    const auto T_camera_site = truth_.at(t);
    if (!T_camera_site) return Eigen::Vector3d::Constant(kNan);
    return config_.T_robot_camera * (*T_camera_site) * config_.registration.T_camera_ct *
           config_.p_target_ct_mm;
  }

  const rt::DaemonConfig& config_;
  const Truth& truth_;
  const std::map<std::uint64_t, nanoseconds> exposures_;
};

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

void count_hazards(const std::vector<PoseError>& errors, const HazardLimits& limits,
                   nanoseconds unseen_max, Evaluation& evaluation) {
  nanoseconds over_since{};
  bool is_over = false;
  bool is_counted = false;
  nanoseconds t_previous_until{};
  for (const PoseError& error : errors) {
    const bool is_contiguous = error.t - t_previous_until < std::chrono::milliseconds{2};
    const double limit_um = 1000 * limits.error_mm;
    const bool exceeds = std::max(error.at_use_um, error.at_use_end_um) > limit_um;
    const bool is_avoidable = !(error.avoidable_um <= limit_um);  // also when it is not known
    if (error.avoidable_um > evaluation.avoidable_um_max)
      evaluation.avoidable_um_max = error.avoidable_um;
    if (!exceeds || (is_over && !is_contiguous)) is_over = is_counted = false;
    if (exceeds && !is_over) {
      is_over = true;
      over_since = error.t;
    }
    if (is_over) {
      const double over_ms = to_ms(error.t_until - over_since);
      evaluation.over_limit_ms_max = std::max(evaluation.over_limit_ms_max, over_ms);
      if ((over_ms > to_ms(unseen_max) || is_avoidable) && !is_counted) {
        ++evaluation.hazards;
        is_counted = true;
      }
    }
    t_previous_until = error.t_until;
  }
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
  count_hazards(errors, limits, config.limits.estimate_age_max, evaluation);
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
