// SPDX-License-Identifier: Apache-2.0
// `holdfast-sim`: the virtual operating room. What it simulates speaks the real protocols; its
// truth stays inside it.
#include <CLI/CLI.hpp>

#include "bridge/command_line.hpp"
#include "tests/sim/commands.hpp"

int main(int argc, char** argv) {
  CLI::App app{"Holdfast's virtual operating room: cameras, robot, operator.", "holdfast-sim"};
  app.set_version_flag("--version", HOLDFAST_VERSION);
  app.require_subcommand(1);
  holdfast::sim::add_camera_command(app);
  holdfast::sim::add_can_command(app);
  holdfast::sim::add_ct_command(app);
  holdfast::sim::add_demo_command(app);
  holdfast::sim::add_reaction_commands(app);
  holdfast::sim::add_operator_command(app);
  holdfast::sim::add_or_command(app);
  holdfast::sim::add_or_error_commands(app);
  holdfast::sim::add_rig_command(app);
  holdfast::sim::add_registration_error_command(app);
  holdfast::sim::add_robot_command(app);
  holdfast::sim::add_spots_command(app);
  holdfast::sim::add_stereo_command(app);
  return holdfast::bridge::run_command_line(app, argc, argv);
}
