// SPDX-License-Identifier: Apache-2.0
#include "tests/sim/demo/report.hpp"

#include <cmath>

#include <fmt/format.h>
#include <nlohmann/json.hpp>

#include "bridge/atomic_file.hpp"
#include "tests/sim/demo/svg_plot.hpp"

namespace holdfast::sim {
namespace {

std::string figure(double value, int decimals) {
  return std::isfinite(value) ? fmt::format("{:.{}f}", value, decimals) : "-";
}

nlohmann::json number_or_null(double value) {
  return std::isfinite(value) ? nlohmann::json(value) : nlohmann::json(nullptr);
}

}  // namespace

std::string to_text(const Evaluation& evaluation, const std::filesystem::path& folder) {
  std::string text =
      "\ntrajectory     duration  permitted    poses   error at its instant   error at use\n"
      "                      s          %             rms / max, um          rms / max, um\n";
  for (const TrajectoryRecord& t : evaluation.trajectories)
    text += fmt::format("{:<14} {:>8.1f} {:>10.1f} {:>8}   {:>8} / {:<8}    {:>8} / {:<8}\n",
                        t.name, t.duration_s, 100 * t.permitted_share, t.poses,
                        figure(t.tracking_rms_um, 1), figure(t.tracking_max_um, 1),
                        figure(t.at_use_rms_um, 1), figure(t.at_use_max_um, 1));
  text +=
      "\nstop           behind it      evidence to robot   injection to robot\n"
      "                                             ms                   ms\n";
  for (const StopRecord& s : evaluation.stops)
    text += fmt::format("{:<22} {:<10} {:>12} {:>20}\n", s.cause,
                        s.expected.empty() ? "none" : s.expected, figure(s.reaction_ms, 2),
                        figure(s.injected_to_stop_ms, 1));
  text += fmt::format(
      "\nexposure to robot: p50 {} ms, p99 {} ms over {} frames\n"
      "arrival at the PC to robot, less the tracker's time: p50 {} ms, p99 {} ms\n"
      "hazards {}   longest permitted over the error limit {} ms   false stops {}\n"
      "largest distance of a pose used from what its newest frame could show: {} um\n"
      "plots: {}\n",
      figure(percentile(evaluation.latency_ms, 0.5), 2),
      figure(percentile(evaluation.latency_ms, 0.99), 2), evaluation.latency_ms.size(),
      figure(percentile(evaluation.handover_ms, 0.5), 2),
      figure(percentile(evaluation.handover_ms, 0.99), 2), evaluation.hazards,
      figure(evaluation.over_limit_ms_max, 1), evaluation.false_stops,
      figure(evaluation.avoidable_um_max, 1), (folder / "{trajectory,error}.svg").string());
  return text;
}

nlohmann::json to_json(const Evaluation& evaluation) {
  nlohmann::json json;
  json["tracking_rms_um"] = number_or_null(evaluation.tracking_rms_um);
  json["latency_ms_p50"] = number_or_null(percentile(evaluation.latency_ms, 0.5));
  json["latency_ms_p99"] = number_or_null(percentile(evaluation.latency_ms, 0.99));
  json["handover_ms_p50"] = number_or_null(percentile(evaluation.handover_ms, 0.5));
  json["handover_ms_p99"] = number_or_null(percentile(evaluation.handover_ms, 0.99));
  json["hazards"] = evaluation.hazards;
  json["false_stops"] = evaluation.false_stops;
  json["over_limit_ms_max"] = evaluation.over_limit_ms_max;
  json["avoidable_um_max"] = evaluation.avoidable_um_max;
  json["stops"] = nlohmann::json::array();
  for (const StopRecord& s : evaluation.stops)
    json["stops"].push_back({{"cause", s.cause},
                             {"expected", s.expected},
                             {"reaction_ms", number_or_null(s.reaction_ms)},
                             {"injected_to_stop_ms", number_or_null(s.injected_to_stop_ms)}});
  json["trajectories"] = nlohmann::json::array();
  for (const TrajectoryRecord& t : evaluation.trajectories)
    json["trajectories"].push_back({{"name", t.name},
                                    {"duration_s", t.duration_s},
                                    {"permitted_share", t.permitted_share},
                                    {"tracking_rms_um", number_or_null(t.tracking_rms_um)},
                                    {"tracking_max_um", number_or_null(t.tracking_max_um)},
                                    {"at_use_rms_um", number_or_null(t.at_use_rms_um)},
                                    {"at_use_max_um", number_or_null(t.at_use_max_um)},
                                    {"poses", t.poses}});
  return json;
}

void write_report(const Evaluation& evaluation, const std::filesystem::path& folder) {
  Plot path;
  path.title = "Target in the camera's plane: where it was, and where the robot was told it is";
  path.x_label = "x, mm";
  path.y_label = "y, mm";
  path.has_equal_scale = true;
  path.height_px = 700;
  path.series = {{"truth", "#1f77b4", evaluation.true_x_mm, evaluation.true_y_mm},
                 {"compensated pose", "#d62728", evaluation.x_mm, evaluation.y_mm}};
  bridge::write_file_atomically((folder / "trajectory.svg").string(), to_svg(path));

  Plot error;
  error.title = "Error at the target when the robot acts on the pose; gaps: not permitted";
  error.x_label = "time, s";
  error.y_label = "error, um";
  error.series = {{"error", "#d62728", evaluation.t_s, evaluation.error_um}};
  bridge::write_file_atomically((folder / "error.svg").string(), to_svg(error));
  bridge::write_file_atomically((folder / "report.txt").string(), to_text(evaluation, folder));
}

}  // namespace holdfast::sim
