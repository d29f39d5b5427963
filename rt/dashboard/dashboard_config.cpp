// SPDX-License-Identifier: Apache-2.0
#include <algorithm>
#include <fstream>

#include <fmt/format.h>

#include "bridge/config_file.hpp"
#include "rt/core/error.hpp"
#include "rt/dashboard/dashboard.hpp"

namespace holdfast::dashboard {
namespace {

namespace fs = std::filesystem;

/// The token stands in a file of its own that nobody else may read: not in a configuration that is
/// passed around, not on a command line that `ps` shows.
std::string read_token(const fs::path& file) {
  std::error_code error;
  const auto permissions = fs::status(file, error).permissions();
  if (error) throw InputError(fmt::format("{}: {}", file.string(), error.message()));
  if ((permissions & (fs::perms::group_all | fs::perms::others_all)) != fs::perms::none)
    throw InputError(fmt::format("{}: others may read it; chmod 600", file.string()));
  std::string token;
  std::getline(std::ifstream(file), token);
  if (token.empty()) throw InputError(fmt::format("{}: holds no token", file.string()));
  return token;
}

bridge::HttpParameters read_http(const bridge::ConfigSection& s) {
  bridge::HttpParameters http;
  http.address = s.text("address", http.address);
  http.port = static_cast<std::uint16_t>(s.integer("port", 8080, {0, 65535}));
  http.connections_max = static_cast<std::size_t>(s.integer("connections_max", 64, {1, 1000}));
  if (s.has("token_file")) http.token = read_token(s.path("token_file"));
  return http;
}

fs::path optional_path(const bridge::ConfigSection& s, std::string_view key) {
  return s.has(key) ? s.path(key) : fs::path();
}

}  // namespace

DashboardConfig load_dashboard_config(const fs::path& path) {
  const bridge::ConfigFile file(path);
  const auto root = file.root();
  DashboardConfig config;
  config.observer = observer::read_observer(root);
  config.http = read_http(root.section("http"));
  const auto surfaces = root.section("surfaces");
  config.surfaces = {optional_path(surfaces, "ct"), optional_path(surfaces, "reconstruction"),
                     optional_path(surfaces, "registration")};
  config.live_view = optional_path(root.section("live_view"), "file");
  file.refuse_unknown_keys();
  return config;
}

}  // namespace holdfast::dashboard
