// SPDX-License-Identifier: Apache-2.0
// `holdfastd`: the real-time daemon on the robot control PC.
#include <filesystem>
#include <optional>
#include <string>

#include <CLI/CLI.hpp>
#include <fmt/format.h>
#include <spdlog/sinks/stdout_sinks.h>
#include <spdlog/spdlog.h>

#include "bridge/command_line.hpp"
#include "rt/daemon.hpp"

namespace {

struct Options {
  std::filesystem::path config;
  bool is_check_only = false;
  bool allow_non_rt = false;
  std::optional<int> domain;
  std::string camera, security;
};

void run(const Options& options) {
  holdfast::rt::DaemonConfig config = holdfast::rt::load_daemon_config(options.config);
  if (options.allow_non_rt) config.loop.allow_non_rt = true;
  if (options.domain) config.domain = *options.domain;
  if (!options.camera.empty()) config.camera.id = options.camera;
  if (!options.security.empty()) config.security.use(options.security);
  if (options.is_check_only) {
    fmt::print("{}: fine; registration {}\n", options.config.string(),
               config.registration.checksum);
    return;
  }
  spdlog::set_default_logger(spdlog::stderr_logger_mt("holdfastd"));
  spdlog::set_pattern("%Y-%m-%dT%H:%M:%S.%e %^%l%$ %v");
  spdlog::flush_on(spdlog::level::info);
  holdfast::bridge::catch_interrupts();
  holdfast::rt::run_daemon(config);
}

}  // namespace

int main(int argc, char** argv) {
  CLI::App app{
      "Keeps the registration of robot to patient and publishes compensated poses, or a stop.\n"
      "Research software, not a medical device.",
      "holdfastd"};
  app.set_version_flag("--version", HOLDFAST_VERSION);
  app.footer(
      "Example:\n  holdfastd --config config/holdfastd.toml --check\n"
      "  holdfastd --config config/holdfastd.toml\n"
      "Exit codes: 0 ended by SIGTERM or SIGINT, 2 bad configuration or input, 3 camera, DDS or\n"
      "real-time scheduling not there.");
  Options options;
  app.add_option("--config", options.config, "configuration file (TOML)")->required();
  app.add_flag("--check", options.is_check_only, "validate the configuration and exit");
  app.add_flag("--allow-non-rt", options.allow_non_rt,
               "go on without real-time scheduling; published with every health message");
  app.add_option("--domain", options.domain, "DDS domain, overrides the file")
      ->check(CLI::Range(0, 230));
  app.add_option("--camera", options.camera, "camera id or IP address, overrides the file");
  app.add_option("--security", options.security,
                 "folder of this daemon's keys (`holdfast keys`), overrides the file");
  app.callback([&options] { run(options); });
  return holdfast::bridge::run_command_line(app, argc, argv);
}
