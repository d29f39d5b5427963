// SPDX-License-Identifier: Apache-2.0
// The subcommands of `holdfast`, one source file each. Each function adds its subcommand, with
// options, help and callback, to the program.
#pragma once

#include <CLI/CLI.hpp>

namespace holdfast::rt {

void add_calibrate(CLI::App& app);
void add_console(CLI::App& app);
void add_demo(CLI::App& app);
void add_doctor(CLI::App& app);
void add_evaluate(CLI::App& app);
void add_fiducials(CLI::App& app);
void add_hand_eye(CLI::App& app);
void add_keys(CLI::App& app);
void add_markers(CLI::App& app);
void add_optimize_pattern(CLI::App& app);
void add_pattern(CLI::App& app);
void add_project(CLI::App& app);
void add_reconstruct(CLI::App& app);
void add_register(CLI::App& app);
void add_replay(CLI::App& app);
void add_surface(CLI::App& app);
void add_track(CLI::App& app);

}  // namespace holdfast::rt
