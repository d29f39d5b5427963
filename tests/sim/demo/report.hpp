// SPDX-License-Identifier: Apache-2.0
// An evaluation as text, JSON and plots.
#pragma once

#include <filesystem>
#include <string>

#include <nlohmann/json_fwd.hpp>

#include "tests/sim/demo/evaluation.hpp"

namespace holdfast::sim {

/// The table a person reads; `folder` is where write_report put the plots.
[[nodiscard]] std::string to_text(const Evaluation& evaluation,
                                  const std::filesystem::path& folder);
/// tracking_rms_um, latency_ms_p50, latency_ms_p99, stops, hazards, false_stops, and more.
[[nodiscard]] nlohmann::json to_json(const Evaluation& evaluation);
/// trajectory.svg, error.svg and report.txt.
void write_report(const Evaluation& evaluation, const std::filesystem::path& folder);

}  // namespace holdfast::sim
