// SPDX-License-Identifier: Apache-2.0
// `holdfast`: one command line for everything but the daemon.
#include <CLI/CLI.hpp>

#include "bridge/command_line.hpp"
#include "rt/commands/commands.hpp"
#include "rt/commands/rig_commands.hpp"

int main(int argc, char** argv) {
  CLI::App app{"Holdfast: keeps a microscope-mounted laser robot registered to the patient's ear.",
               "holdfast"};
  app.set_version_flag("--version", HOLDFAST_VERSION);
  app.require_subcommand(1);
  holdfast::rt::add_calibrate(app);
  holdfast::rt::add_console(app);
  holdfast::rt::add_demo(app);
  holdfast::rt::add_doctor(app);
  holdfast::rt::add_evaluate(app);
  holdfast::rt::add_fiducials(app);
  holdfast::rt::add_hand_eye(app);
  holdfast::rt::add_keys(app);
  holdfast::rt::add_markers(app);
  holdfast::rt::add_optimize_pattern(app);
  holdfast::rt::add_pattern(app);
  holdfast::rt::add_project(app);
  holdfast::rt::add_reconstruct(app);
  holdfast::rt::add_register(app);
  holdfast::rt::add_replay(app);
  holdfast::rt::add_study(app);
  holdfast::rt::add_surface(app);
  holdfast::rt::add_track(app);
  return holdfast::bridge::run_command_line(app, argc, argv);
}
