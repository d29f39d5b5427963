// SPDX-License-Identifier: Apache-2.0
// `holdfast-guard`: watches the daemon from outside and withdraws permission on its own.
#include <filesystem>
#include <optional>

#include <CLI/CLI.hpp>
#include <fmt/format.h>

#include "bridge/command_line.hpp"
#include "rt/guard/guard.hpp"

namespace {

struct Options {
  std::filesystem::path config;
  std::optional<int> domain;
  bool is_check_only = false;
  std::string security;
};

void run(const Options& options) {
  holdfast::guard::GuardConfig config = holdfast::guard::load_guard_config(options.config);
  if (options.domain) config.domain = *options.domain;
  if (!options.security.empty()) config.security.use(options.security);
  if (options.is_check_only) {
    fmt::print("{}: fine\n", options.config.string());
    return;
  }
  holdfast::bridge::catch_interrupts();
  holdfast::guard::run_guard(config);
}

}  // namespace

int main(int argc, char** argv) {
  CLI::App app{
      "Watches holdfastd's messages and the robot's from its own process, with limits of its own,\n"
      "and publishes a permission of its own: a robot needs both, and both fresh.\n"
      "Research software, not a medical device.",
      "holdfast-guard"};
  app.set_version_flag("--version", HOLDFAST_VERSION);
  app.footer(
      "Example:\n  holdfast-guard --config config/guard.toml --check\n"
      "  holdfast-guard --config config/guard.toml\n"
      "Exit codes: 0 ended by SIGTERM or SIGINT, 2 bad configuration, 3 DDS, real-time scheduling\n"
      "or the watchdog device not there.");
  Options options;
  app.add_option("--config", options.config, "configuration file (TOML)")->required();
  app.add_flag("--check", options.is_check_only, "validate the configuration and exit");
  app.add_option("--domain", options.domain, "DDS domain, overrides the file")
      ->check(CLI::Range(0, 230));
  app.add_option("--security", options.security, "folder of the guard's keys, overrides the file");
  app.callback([&options] { run(options); });
  return holdfast::bridge::run_command_line(app, argc, argv);
}
