// SPDX-License-Identifier: Apache-2.0
// The two studies of `holdfast-sim` over many virtual microscopes; added with the commands that
// judge one result (or_error_commands.cpp).
#pragma once

#include <CLI/CLI.hpp>

namespace holdfast::sim {

void add_calibration_study_command(CLI::App& program);
void add_marker_study_command(CLI::App& program);

}  // namespace holdfast::sim
