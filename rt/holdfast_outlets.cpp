// SPDX-License-Identifier: Apache-2.0
// `holdfast-outlets`: what Holdfast knows, for ROS 2 and 3D Slicer to see.
#include <filesystem>
#include <optional>

#include <CLI/CLI.hpp>
#include <fmt/format.h>

#include "bridge/command_line.hpp"
#include "rt/outlets/outlets.hpp"

namespace {

struct Options {
  std::filesystem::path live_view;
  std::filesystem::path config;
  std::optional<int> domain, ros2_domain, port;
  bool is_check_only = false;
  std::string security;
};

void run(const Options& options) {
  holdfast::outlets::OutletsConfig config = holdfast::outlets::load_outlets_config(options.config);
  if (options.domain) config.observer.domain = *options.domain;
  if (!options.security.empty()) config.observer.security.use(options.security);
  if (options.ros2_domain) {
    config.ros2.is_on = true;
    config.ros2.domain = *options.ros2_domain;
  }
  if (options.port) {
    config.openigtlink.is_on = true;
    config.openigtlink.server.port = static_cast<std::uint16_t>(*options.port);
  }
  if (!options.live_view.empty()) config.live_view = options.live_view;
  holdfast::outlets::check_outlets(config);
  if (options.is_check_only) {
    fmt::print("{}: fine\n", options.config.string());
    return;
  }
  holdfast::bridge::catch_interrupts();
  holdfast::outlets::run_outlets(config);
}

}  // namespace

int main(int argc, char** argv) {
  CLI::App app{
      "Tells ROS 2 nodes (tf, pose with covariance, diagnostics) and 3D Slicer (OpenIGTLink\n"
      "transforms and status) what daemon and guard say on DDS. Only tells: with DDS Security it "
      "is "
      "an\nobserver, and takes nothing from those it tells. No pose is told while there is none to "
      "rely on.\nNot for control: a robot links holdfast_client. Research software, not a medical "
      "device.",
      "holdfast-outlets"};
  app.set_version_flag("--version", HOLDFAST_VERSION);
  app.footer(
      "Example:\n  holdfast-outlets --config config/outlets.toml --check\n"
      "  holdfast-outlets --config config/outlets.toml --ros2-domain 42\n"
      "Exit codes: 0 ended by SIGTERM or SIGINT, 2 bad configuration, 3 DDS or the port not "
      "there.");
  Options options;
  app.add_option("--config", options.config, "configuration file (TOML)")->required();
  app.add_flag("--check", options.is_check_only, "validate the configuration, and exit");
  app.add_option("--domain", options.domain, "the daemon's DDS domain, overrides the file")
      ->check(CLI::Range(0, 230));
  app.add_option("--ros2-domain", options.ros2_domain,
                 "ROS_DOMAIN_ID of the nodes to tell; switches that outlet on")
      ->check(CLI::Range(0, 230));
  app.add_option("--openigtlink-port", options.port,
                 "switches that outlet on; 0: the system chooses")
      ->check(CLI::Range(0, 65535));
  app.add_option("--security", options.security, "folder of an observer's keys");
  app.add_option("--live-view", options.live_view,
                 "file of holdfastd's [live_view]: tells pictures");
  app.callback([&options] { run(options); });
  return holdfast::bridge::run_command_line(app, argc, argv);
}
