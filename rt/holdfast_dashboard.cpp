// SPDX-License-Identifier: Apache-2.0
// `holdfast-dashboard`: a page for a second monitor, fed from DDS.
#include <filesystem>
#include <optional>

#include <CLI/CLI.hpp>
#include <fmt/format.h>

#include "bridge/command_line.hpp"
#include "rt/dashboard/dashboard.hpp"

namespace {

struct Options {
  std::filesystem::path live_view;
  std::filesystem::path config;
  std::optional<int> domain, port;
  bool is_check_only = false;
  std::string security;
  holdfast::dashboard::SurfaceFiles surfaces;
};

void take(std::filesystem::path& from, const std::filesystem::path& given) {
  if (!given.empty()) from = given;
}

void run(const Options& options) {
  holdfast::dashboard::DashboardConfig config =
      holdfast::dashboard::load_dashboard_config(options.config);
  if (options.domain) config.observer.domain = *options.domain;
  if (options.port) config.http.port = static_cast<std::uint16_t>(*options.port);
  if (!options.security.empty()) config.observer.security.use(options.security);
  take(config.surfaces.ct, options.surfaces.ct);
  take(config.surfaces.reconstruction, options.surfaces.reconstruction);
  take(config.surfaces.registration, options.surfaces.registration);
  take(config.live_view, options.live_view);
  if (options.is_check_only) {
    holdfast::bridge::check_http(config.http);
    (void)holdfast::dashboard::read_surfaces(config.surfaces);
    fmt::print("{}: fine\n", options.config.string());
    return;
  }
  holdfast::bridge::catch_interrupts();
  holdfast::dashboard::run_dashboard(config);
}

}  // namespace

int main(int argc, char** argv) {
  CLI::App app{
      "Shows what daemon, guard and robot say on DDS, as a page: permission with its reason, "
      "errors,\nlatencies, stops, devices, registration, surfaces. Reads only; with DDS Security "
      "as observer.\nNot for control: a robot stops by itself. Research software, not a medical "
      "device.",
      "holdfast-dashboard"};
  app.set_version_flag("--version", HOLDFAST_VERSION);
  app.footer(
      "Example:\n  holdfast-dashboard --config config/dashboard.toml --check\n"
      "  holdfast-dashboard --config config/dashboard.toml --ct ct.ply --reconstruction mire.ply "
      "--registration registration.json\n"
      "then open http://127.0.0.1:8080/\n"
      "Exit codes: 0 ended by SIGTERM or SIGINT, 2 bad configuration, 3 DDS, the port or the "
      "page's files not there.");
  Options options;
  app.add_option("--config", options.config, "configuration file (TOML)")->required();
  app.add_flag("--check", options.is_check_only, "validate configuration and surfaces, and exit");
  app.add_option("--domain", options.domain, "DDS domain, overrides the file")
      ->check(CLI::Range(0, 230));
  app.add_option("--port", options.port, "of the page, overrides the file; 0: the system chooses")
      ->check(CLI::Range(0, 65535));
  app.add_option("--security", options.security, "folder of an observer's keys");
  app.add_option("--ct", options.surfaces.ct, "CT surface (PLY, STL) for the 3D view");
  app.add_option("--reconstruction", options.surfaces.reconstruction, "reconstructed surface");
  app.add_option("--registration", options.surfaces.registration,
                 "registration.json that places the CT");
  app.add_option("--live-view", options.live_view, "file of holdfastd's [live_view]");
  app.callback([&options] { run(options); });
  return holdfast::bridge::run_command_line(app, argc, argv);
}
