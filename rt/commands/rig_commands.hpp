// SPDX-License-Identifier: Apache-2.0
// The commands that work on a rig (rt/study/rig.hpp): as those of commands.hpp.
#pragma once

#include <string>
#include <vector>

#include "rt/study/disturbance_study.hpp"
#include "rt/study/tracking_study.hpp"

namespace CLI {  // NOLINT(readability-identifier-naming)
class App;
}

namespace holdfast::rt {

void add_study(CLI::App& app);
/// `study --tracking`: writes `out`, prints the figures.
void study_tracking(const TrackingSettings& settings, const std::string& out, bool is_json,
                    const StudyProgress& progress);
/// `study --tracking --disturbances`: likewise.
void study_disturbances(const DisturbanceSettings& settings, const std::string& out, bool is_json,
                        const StudyProgress& progress);
/// `demo --setup`, given the words after it. Throws CLI::ParseError and holdfast::Error.
void run_demo_setup(std::vector<std::string> words);

}  // namespace holdfast::rt
