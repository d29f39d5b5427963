// SPDX-License-Identifier: Apache-2.0
#include "rt/dashboard/dashboard.hpp"

#include <fstream>
#include <sstream>
#include <string_view>

#include <fmt/format.h>

#include "bridge/command_line.hpp"
#include "rt/core/error.hpp"
#include "rt/dashboard/live_answer.hpp"
#include "rt/dashboard/snapshot.hpp"
#include "rt/observer/observer.hpp"

namespace holdfast::dashboard {
namespace {

using bridge::HttpBody;
using bridge::dds::Clocks;
using bridge::dds::read_clocks;
using observer::Observer;
using std::chrono::milliseconds;

constexpr nanoseconds kLookPeriod = milliseconds(5);
/// An answer is composed once and given to all who ask meanwhile: a quarter of the pages' period.
constexpr nanoseconds kAnswerKept = milliseconds(10);

/// Nothing from elsewhere, nothing inline, nobody's frame.
constexpr std::string_view kContentSecurityPolicy =
    "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self'; connect-src 'self'; "
    "base-uri 'none'; form-action 'none'; frame-ancestors 'none'";

struct PageFile {
  const char *path, *file, *content_type;
};
constexpr PageFile kPageFiles[] = {
    {"/", "index.html", "text/html; charset=utf-8"},
    {"/icon.svg", "icon.svg", "image/svg+xml"},
    {"/style.css", "style.css", "text/css; charset=utf-8"},
    {"/uplot.css", "uplot.css", "text/css; charset=utf-8"},
    {"/main.js", "main.js", "text/javascript; charset=utf-8"},
    {"/freshness.js", "freshness.js", "text/javascript; charset=utf-8"},
    {"/live.js", "live.js", "text/javascript; charset=utf-8"},
    {"/figures.js", "figures.js", "text/javascript; charset=utf-8"},
    {"/plots.js", "plots.js", "text/javascript; charset=utf-8"},
    {"/surfaces.js", "surfaces.js", "text/javascript; charset=utf-8"},
    {"/uplot.js", "uplot.js", "text/javascript; charset=utf-8"},
    {"/three.module.js", "three.module.js", "text/javascript; charset=utf-8"},
    {"/three.core.js", "three.core.js", "text/javascript; charset=utf-8"}};

std::string content(const std::filesystem::path& file) {
  std::ifstream stream(file, std::ios::binary);
  std::ostringstream text;
  text << stream.rdbuf();
  if (!stream)
    throw UnavailableError(fmt::format("{}: the page's file is not there", file.string()));
  return text.str();
}

std::filesystem::path page_beside_program() {
  return std::filesystem::read_symlink("/proc/self/exe").parent_path().parent_path() /
         "share/holdfast/dashboard";
}

/// An answer kept for the others who ask at the same time.
template <class F>
std::function<HttpBody()> shared_answer(F compose) {
  return [compose, kept = HttpBody(), t_kept = nanoseconds()]() mutable {
    const Clocks now = read_clocks();
    if (!kept || now.monotonic - t_kept > kAnswerKept) {
      kept = std::make_shared<const std::string>(compose(now));
      t_kept = now.monotonic;
    }
    return kept;
  };
}

void add_page(bridge::HttpServer& server, const std::filesystem::path& folder) {
  for (const PageFile& file : kPageFiles)
    server.add(file.path, file.content_type,
               std::make_shared<const std::string>(content(folder / file.file)));
}

/// The surfaces, and a list of those that there are.
void add_surfaces(bridge::HttpServer& server, const SurfaceFiles& files) {
  std::string names;
  for (PackedSurface& surface : read_surfaces(files)) {
    names += (names.empty() ? "\"" : ",\"") + surface.name + "\"";
    server.add("/surfaces/" + surface.name, "application/octet-stream",
               std::make_shared<const std::string>(std::move(surface.bytes)));
  }
  server.add("/surfaces", "application/json",
             std::make_shared<const std::string>("[" + names + "]"));
}

}  // namespace

void run_dashboard(const DashboardConfig& config) {
  bridge::HttpParameters http = config.http;
  http.content_security_policy = kContentSecurityPolicy;
  bridge::HttpServer server(http);
  add_page(server, config.page.empty() ? page_beside_program() : config.page);
  add_surfaces(server, config.surfaces);
  Observer observer(config.observer);
  server.add("/state", "application/json",
             shared_answer([&observer](Clocks now) { return state_json(observer.state(), now); }));
  server.add("/history", "application/json",
             shared_answer([&observer](Clocks) { return history_json(observer.state()); }));
  LiveAnswer live(config.live_view);
  server.add("/live", "application/octet-stream",
             shared_answer([&live](Clocks now) { return live.compose(now); }));
  fmt::print(stderr, "dashboard: domain {} on http://{}:{}/\n", config.observer.domain,
             http.address, server.port());
  server.run(kLookPeriod, [&observer] {
    observer.look();
    return !bridge::is_interrupted();
  });
}

}  // namespace holdfast::dashboard
