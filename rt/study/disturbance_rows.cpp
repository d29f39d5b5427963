// SPDX-License-Identifier: Apache-2.0
// A row of the disturbances: its figures, and how it is kept.
#include <algorithm>
#include <cmath>
#include <limits>

#include <nlohmann/json.hpp>

#include "rt/study/disturbance_study.hpp"

namespace holdfast::rt {
namespace {

using nlohmann::json;

bool is_trusted(const DisturbedFrame& frame) {
  return frame.status == "tracking" || frame.status == "relocalised";
}

}  // namespace

void summarise(DisturbanceRow& row) {
  double squares = 0, plane_squares = 0, nees = 0;
  int trusted = 0, inside = 0;
  row.max_um = 0;
  row.silently_wrong = 0;
  for (const DisturbedFrame& frame : row.poses) {
    if (!is_trusted(frame)) continue;
    ++trusted;
    squares += frame.error_um * frame.error_um;
    plane_squares += frame.plane_error_um * frame.plane_error_um;
    nees += frame.nees;
    row.max_um = std::max(row.max_um, frame.error_um);
    if (!(frame.error_um <= kSilentlyWrongUm)) ++row.silently_wrong;
    if (frame.nees <= kChiSquared6Bound95) ++inside;
  }
  const double n = trusted > 0 ? trusted : std::numeric_limits<double>::quiet_NaN();
  row.rms_um = std::sqrt(squares / n);
  row.plane_rms_um = std::sqrt(plane_squares / n);
  row.nees_mean = nees / n;
  row.nees_share_in_95 = inside / n;
  if (trusted == 0) row.max_um = n;
}

std::string row_text(const DisturbanceRow& row) {
  json text{{"scene", row.scene},     {"name", row.name},       {"refusal", row.refusal},
            {"frames", row.frames},   {"voided", row.voided},   {"statuses", row.statuses},
            {"reasons", row.reasons}, {"poses", json::array()}, {"found_in_ms", row.found_in_ms}};
  if (row.frames_until_found) text["frames_until_found"] = *row.frames_until_found;
  for (const DisturbedFrame& f : row.poses)
    text["poses"].push_back({f.t_s, f.status, f.error_um, f.plane_error_um, f.nees});
  return text.dump() + "\n";
}

std::optional<DisturbanceRow> row_of(const std::string& text) {
  try {
    const json kept = json::parse(text);
    DisturbanceRow row;
    kept.at("scene").get_to(row.scene);
    kept.at("name").get_to(row.name);
    kept.at("refusal").get_to(row.refusal);
    kept.at("frames").get_to(row.frames);
    kept.at("voided").get_to(row.voided);
    kept.at("statuses").get_to(row.statuses);
    kept.at("reasons").get_to(row.reasons);
    kept.at("found_in_ms").get_to(row.found_in_ms);
    if (kept.contains("frames_until_found"))
      row.frames_until_found = kept.at("frames_until_found").get<int>();
    for (const json& f : kept.at("poses"))
      row.poses.push_back({f.at(0).get<double>(), f.at(1).get<std::string>(), f.at(2).get<double>(),
                           f.at(3).get<double>(), f.at(4).get<double>()});
    summarise(row);
    return row;
  } catch (const json::exception&) {
    return std::nullopt;
  }
}

}  // namespace holdfast::rt
