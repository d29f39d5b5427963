// SPDX-License-Identifier: Apache-2.0
// holdfast-dashboard's configuration and its loop: reads every topic as an observer, serves the
// page and what it asks for. Writes nothing, on DDS or elsewhere.
#pragma once

#include <filesystem>
#include <string>

#include "bridge/http/http_server.hpp"
#include "rt/dashboard/surface_files.hpp"
#include "rt/observer/observer.hpp"

namespace holdfast::dashboard {

struct DashboardConfig {
  observer::ObserverConfig observer;
  bridge::HttpParameters http;
  SurfaceFiles surfaces;
  std::filesystem::path live_view;  ///< the file that holdfastd writes; empty: none is shown
  std::filesystem::path page;       ///< folder of the page's files; empty: those beside the program
};

/// Annotated example: config/dashboard.toml. Throws InputError naming file, line, column, key,
/// value.
[[nodiscard]] DashboardConfig load_dashboard_config(const std::filesystem::path& file);

/// Until SIGINT or SIGTERM. Throws InputError on a surface or an HTTP setting that cannot be used,
/// UnavailableError when DDS, the port or the page's files are not there.
void run_dashboard(const DashboardConfig& config);

}  // namespace holdfast::dashboard
