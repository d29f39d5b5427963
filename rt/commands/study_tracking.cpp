// SPDX-License-Identifier: Apache-2.0
// `holdfast study --tracking`: paper B's experiment on the rig.
#include <cmath>
#include <filesystem>
#include <string>

#include <fmt/format.h>
#include <nlohmann/json.hpp>
#include <opencv2/core.hpp>

#include "bridge/atomic_file.hpp"
#include "rt/commands/rig_commands.hpp"
#include "rt/core/error.hpp"
#include "rt/study/tracking_report.hpp"

namespace holdfast::rt {
namespace {

nlohmann::ordered_json figure(double value) {
  return std::isfinite(value) ? nlohmann::ordered_json(value) : nlohmann::ordered_json(nullptr);
}

nlohmann::ordered_json as_json(const TrackingRow& row) {
  nlohmann::ordered_json json{{"scene", row.scene}, {"motion", row.motion}, {"method", row.method}};
  if (!row.refusal.empty()) {
    json["refusal"] = row.refusal;
    return json;
  }
  const TrackingJudgement& j = row.judged;
  json["frames"] = j.frames;
  json["lost"] = j.lost;
  json["silently_wrong"] = j.silently_wrong;
  json["step_mean_um"] = figure(j.step_mean_um);
  json["step_sd_um"] = figure(j.step_sd_um);
  json["absolute_rms_um"] = figure(j.absolute_rms_um);
  json["absolute_max_um"] = figure(j.absolute_max_um);
  json["depth_rms_um"] = figure(j.depth_rms_um);
  json["rotation_rms_mrad"] = figure(j.rotation_rms_mrad);
  for (const StageTime& stage : row.stages)
    if (stage.max_ms > 0)
      json["timing_ms"][stage.name] = {{"median", stage.median_ms}, {"p99", stage.p99_ms}};
  return json;
}

nlohmann::ordered_json as_json(const BeamRow& row) {
  nlohmann::ordered_json json{{"scene", row.scene},
                              {"motion", row.motion},
                              {"lead_ms", 1e-6 * static_cast<double>(row.lead.count())}};
  if (!row.refusal.empty()) {
    json["refusal"] = row.refusal;
    return json;
  }
  json["on_s"] = figure(row.judged.on_s);
  json["on_share"] = figure(row.judged.on_share);
  json["rms_um"] = figure(row.judged.rms_um);
  json["p99_um"] = figure(row.judged.p99_um);
  json["max_um"] = figure(row.judged.max_um);
  json["uncompensated_rms_um"] = figure(row.judged.uncompensated_rms_um);
  json["stops"] = row.stops;
  json["stop_causes"] = row.stop_causes;
  return json;
}

void print_beam(const TrackingResult& result) {
  if (result.beam.empty()) return;
  fmt::print("\n{:<15} {:<14} {:>8} {:>10} {:>8} {:>8} {:>11} {:>10} {:>6}\n", "beam", "motion",
             "lead, ms", "rms, um", "p99", "largest", "staying", "permitted", "stops");
  for (const BeamRow& row : result.beam) {
    const BeamJudgement& j = row.judged;
    const double lead_ms = 1e-6 * static_cast<double>(row.lead.count());
    if (row.refusal.empty())
      fmt::print("{:<15} {:<14} {:>8.1f} {:>10.2f} {:>8.1f} {:>8.1f} {:>11.1f} {:>8.1f} % {:>6}\n",
                 row.scene, row.motion, lead_ms, j.rms_um, j.p99_um, j.max_um,
                 j.uncompensated_rms_um, 100 * j.on_share, row.stops);
    else
      fmt::print("{:<15} {:<14} refused: {}\n", row.scene, row.motion, row.refusal);
  }
}

void print(const TrackingResult& result) {
  fmt::print("{:<15} {:<10} {:<7} {:>20} {:>12} {:>10} {:>6} {:>7}\n", "scene", "motion", "method",
             "frame to frame, um", "since key", "largest", "lost", "silent");
  for (const TrackingRow& row : result.rows) {
    const TrackingJudgement& j = row.judged;
    if (row.refusal.empty())
      fmt::print("{:<15} {:<10} {:<7} {:>11.2f} ± {:<6.2f} {:>12.2f} {:>10.1f} {:>6} {:>7}\n",
                 row.scene, row.motion, row.method, j.step_mean_um, j.step_sd_um, j.absolute_rms_um,
                 j.absolute_max_um, j.lost, j.silently_wrong);
    else
      fmt::print("{:<15} {:<10} {:<7} refused: {}\n", row.scene, row.motion, row.method,
                 row.refusal);
  }
  print_beam(result);
}

}  // namespace

void study_tracking(const TrackingSettings& settings, const std::string& out, bool is_json,
                    const StudyProgress& progress) {
  cv::setNumThreads(1);  // as in the daemon, so that the times shown are the daemon's
  const TrackingResult result = run_tracking_study(settings, out, progress);
  const std::filesystem::path folder = out;
  bridge::write_file_atomically((folder / "results.csv").string(), tracking_csv(result));
  if (!result.beam.empty())
    bridge::write_file_atomically((folder / "beam.csv").string(), beam_csv(result));
  bridge::write_file_atomically((folder / "report.html").string(), tracking_html(settings, result));
  if (!is_json) return print(result);
  nlohmann::ordered_json json{{"out", out}, {"calibration_rms_px", result.calibration_rms_px}};
  json["rows"] = nlohmann::ordered_json::array();
  for (const TrackingRow& row : result.rows) json["rows"].push_back(as_json(row));
  for (const BeamRow& row : result.beam) json["beam"].push_back(as_json(row));
  fmt::print("{}\n", json.dump(-1, ' ', false, nlohmann::json::error_handler_t::replace));
}

}  // namespace holdfast::rt
