// SPDX-License-Identifier: Apache-2.0
// `holdfast study --tracking --disturbances`.
#include <cmath>
#include <filesystem>
#include <string>

#include <fmt/format.h>
#include <nlohmann/json.hpp>
#include <opencv2/core.hpp>

#include "bridge/atomic_file.hpp"
#include "rt/commands/rig_commands.hpp"
#include "rt/study/disturbance_study.hpp"

namespace holdfast::rt {
namespace {

nlohmann::ordered_json figure(double value) {
  return std::isfinite(value) ? nlohmann::ordered_json(value) : nlohmann::ordered_json(nullptr);
}

nlohmann::ordered_json as_json(const DisturbanceRow& row) {
  nlohmann::ordered_json json{{"scene", row.scene}, {"disturbance", row.name}};
  if (!row.refusal.empty()) {
    json["refusal"] = row.refusal;
    return json;
  }
  json["frames"] = row.frames;
  json["voided"] = row.voided;
  json["statuses"] = row.statuses;
  json["reasons"] = row.reasons;
  json["rms_um"] = figure(row.rms_um);
  json["max_um"] = figure(row.max_um);
  json["plane_rms_um"] = figure(row.plane_rms_um);
  json["silently_wrong"] = row.silently_wrong;
  json["nees_mean"] = figure(row.nees_mean);
  json["nees_share_in_95"] = figure(row.nees_share_in_95);
  if (row.frames_until_found) {
    json["frames_until_found"] = *row.frames_until_found;
    json["found_in_ms"] = row.found_in_ms;
  }
  return json;
}

void print(const DisturbanceResult& result) {
  fmt::print("{:<15} {:<10} {:>6} {:>5} {:>9} {:>9} {:>5} {:>9} {:>9} {:>6} {:>7} {:>6} {:>6}\n",
             "scene", "disturbed", "frames", "void", "tracking", "degraded", "lost", "rms, um",
             "largest", "silent", "NEES", "in 95", "found");
  for (const DisturbanceRow& row : result.rows) {
    if (!row.refusal.empty()) {
      fmt::print("{:<15} {:<10} refused: {}\n", row.scene, row.name, row.refusal);
      continue;
    }
    const auto count = [&](const char* status) {
      const auto found = row.statuses.find(status);
      return found == row.statuses.end() ? 0 : found->second;
    };
    fmt::print(
        "{:<15} {:<10} {:>6} {:>5} {:>9} {:>9} {:>5} {:>9.2f} {:>9.1f} {:>6} {:>7.1f} {:>5.0f}% "
        "{:>6}\n",
        row.scene, row.name, row.frames, row.voided, count("tracking") + count("relocalised"),
        count("degraded"), count("lost"), row.rms_um, row.max_um, row.silently_wrong, row.nees_mean,
        100 * row.nees_share_in_95,
        row.frames_until_found ? fmt::format("{}", *row.frames_until_found) : "");
  }
}

}  // namespace

void study_disturbances(const DisturbanceSettings& settings, const std::string& out, bool is_json,
                        const StudyProgress& progress) {
  cv::setNumThreads(1);  // as in the daemon
  const DisturbanceResult result = run_disturbance_study(settings, out, progress);
  const std::filesystem::path folder = out;
  bridge::write_file_atomically((folder / "disturbances.csv").string(), disturbance_csv(result));
  bridge::write_file_atomically((folder / "disturbances.html").string(),
                                disturbance_html(settings, result));
  if (!is_json) return print(result);
  nlohmann::ordered_json json{{"out", out}, {"resumed", result.resumed}};
  json["rows"] = nlohmann::ordered_json::array();
  int wrong = 0;
  for (const DisturbanceRow& row : result.rows) {
    json["rows"].push_back(as_json(row));
    wrong += row.silently_wrong;
  }
  json["silently_wrong"] = wrong;
  fmt::print("{}\n", json.dump(-1, ' ', false, nlohmann::json::error_handler_t::replace));
}

}  // namespace holdfast::rt
