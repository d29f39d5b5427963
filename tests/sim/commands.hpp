// SPDX-License-Identifier: Apache-2.0
// The subcommands of `holdfast-sim`, one source file each. Each function adds its subcommand, with
// options, help and callback, to the program.
#pragma once

#include <CLI/CLI.hpp>

namespace holdfast::sim {

void add_camera_command(CLI::App& program);
void add_can_command(CLI::App& program);
void add_ct_command(CLI::App& program);
void add_demo_command(CLI::App& program);
void add_reaction_commands(CLI::App& program);
void add_operator_command(CLI::App& program);
void add_or_command(CLI::App& program);
void add_or_error_commands(CLI::App& program);
void add_rig_command(CLI::App& app);
void add_registration_error_command(CLI::App& program);
void add_robot_command(CLI::App& program);
void add_spots_command(CLI::App& program);
void add_stereo_command(CLI::App& program);

}  // namespace holdfast::sim
