// SPDX-License-Identifier: Apache-2.0
// holdfast-bench-dashboard: what holdfast-dashboard costs while daemon and guard publish at their
// full rates and eight pages ask 30 times a second. The pages are bare HTTP clients in this
// process: only the dashboard's own CPU time counts.
#include <algorithm>
#include <cmath>
#include <cstdio>
#include <optional>

#include <CLI/CLI.hpp>
#include <fmt/format.h>

#include "bridge/atomic_file.hpp"
#include "bridge/command_line.hpp"
#include "rt/core/clock.hpp"
#include "rt/core/error.hpp"
#include "tests/rt/dashboard_room.hpp"

namespace holdfast::dashboard::testing {
namespace {

using std::chrono::nanoseconds;

struct Options {
  int seconds = 20, pages = 8;
  bool has_live = false;
  std::string json;
};

/// User and system time of a process.
nanoseconds cpu_time(pid_t pid) {
  const std::string text = text_of(fmt::format("/proc/{}/stat", pid));
  std::istringstream fields(text.substr(text.rfind(')') + 2));
  std::string skipped;
  for (int i = 0; i < 11; ++i) fields >> skipped;  // state to cmajflt
  std::int64_t user = 0, system = 0;
  fields >> user >> system;
  return std::chrono::nanoseconds((user + system) * (1'000'000'000 / sysconf(_SC_CLK_TCK)));
}

/// One page: asks for /state 30 times a second, for /live 15 times and for /history once, on one
/// connection.
class Page {
 public:
  Page(std::uint16_t port, bool has_live) : connection_(port), has_live_(has_live) {}
  void run(nanoseconds end) {
    constexpr nanoseconds kPeriod = std::chrono::milliseconds(33);
    nanoseconds next = rt::monotonic_now();
    for (int i = 0; next < end; ++i, next += kPeriod) {
      std::this_thread::sleep_for(next - rt::monotonic_now());  // the pages' pace
      if (i % 30 == 0 && !ask("/history")) return;
      if (has_live_ && i % 2 == 0 && !ask("/live")) return;
      const nanoseconds t_asked = rt::monotonic_now();
      if (!ask("/state")) return;
      answered_.push_back(rt::monotonic_now() - t_asked);
    }
  }
  [[nodiscard]] const std::vector<nanoseconds>& answered() const { return answered_; }

 private:
  bool ask(const std::string& path) {
    return connection_.send("GET " + path + " HTTP/1.1\r\nHost: localhost\r\n\r\n") &&
           connection_.receive_one();
  }
  Connection connection_;
  bool has_live_;
  std::vector<nanoseconds> answered_;
};

/// 640x360 with as much in it as a picture of the site has.
bridge::LivePicture textured() {
  bridge::LivePicture p = played_picture();
  p.width_px = p.camera_width_px = 640;
  p.height_px = p.camera_height_px = 360;
  p.mask.assign(160 * 90, 0);
  p.pixels.clear();
  for (int y = 0; y < 360; ++y)
    for (int x = 0; x < 640; ++x)
      p.pixels.push_back(
          static_cast<std::uint8_t>(110 + 60 * std::sin(0.13 * x + 0.02 * y) * std::cos(0.17 * y) +
                                    (7919 * x + 10473 * y) % 23));
  for (int i = 0; i < 480; ++i)
    p.points.push_back({static_cast<float>(26 * i % 640), static_cast<float>(i / 24 * 18)});
  return p;
}

void run(const Options& options) {
  const fs::path folder = fs::temp_directory_path() / fmt::format("dashboard-bench-{}", getpid());
  fs::create_directories(folder);
  const dds::Participant participant({.domain = dds::test_domain(), .configuration = {}});
  PlayedRoom room(participant);
  std::vector<std::string> more;
  std::optional<PlayedCamera> camera;
  if (options.has_live) {
    camera.emplace(folder / "live_view", textured());
    more = {"--live-view", folder / "live_view"};
  }
  Dashboard dashboard(folder, "", more);
  if (dashboard.port() == 0 || !dashboard.becomes("permitted"))
    throw UnavailableError("the dashboard does not start: " + dashboard.log());

  const nanoseconds t_start = rt::monotonic_now(), cpu_start = cpu_time(dashboard.process().pid());
  const nanoseconds end = t_start + std::chrono::seconds(options.seconds);
  std::vector<std::unique_ptr<Page>> pages;
  std::vector<std::thread> threads;
  for (int i = 0; i < options.pages; ++i) {
    pages.push_back(std::make_unique<Page>(dashboard.port(), options.has_live));
    threads.emplace_back([page = pages.back().get(), end] { page->run(end); });
  }
  for (std::thread& thread : threads) thread.join();
  const double elapsed_s = std::chrono::duration<double>(rt::monotonic_now() - t_start).count();
  const double cpu_s =
      std::chrono::duration<double>(cpu_time(dashboard.process().pid()) - cpu_start).count();
  camera.reset();
  fs::remove_all(folder);

  std::vector<double> answered_ms;
  double slowest_hz = 1e9;
  for (const auto& page : pages) {
    slowest_hz = std::min(slowest_hz, static_cast<double>(page->answered().size()) / elapsed_s);
    for (const nanoseconds t : page->answered())
      answered_ms.push_back(std::chrono::duration<double, std::milli>(t).count());
  }
  if (answered_ms.empty()) throw UnavailableError("no answer came");
  std::sort(answered_ms.begin(), answered_ms.end());
  const auto at = [&](double share) {
    return answered_ms[static_cast<std::size_t>(share *
                                                static_cast<double>(answered_ms.size() - 1))];
  };
  const std::string name = fmt::format("dashboard, {} pages at 30/s{}", options.pages,
                                       options.has_live ? ", live view at 15/s" : "");
  const auto figure = [&](const char* what, double median, nlohmann::json p99, const char* unit) {
    return nlohmann::json{{"name", name + ": " + what}, {"median", median},
                          {"p99", std::move(p99)},      {"unit", unit},
                          {"baseline", nullptr},        {"ratio", nullptr}};
  };
  const nlohmann::json figures{figure("CPU", 100 * cpu_s / elapsed_s, nullptr, "% of a core"),
                               figure("updates of the slowest", slowest_hz, nullptr, "1/s"),
                               figure("question to answer", at(0.5), at(0.99), "ms")};
  if (!options.json.empty()) bridge::write_file_atomically(options.json, figures.dump(1) + "\n");
  fmt::print("{}\n", figures.dump(1));
}

}  // namespace
}  // namespace holdfast::dashboard::testing

int main(int argc, char** argv) {
  using holdfast::dashboard::testing::Options;
  CLI::App app{"What holdfast-dashboard costs with eight pages open.", "holdfast-bench-dashboard"};
  Options options;
  app.add_option("--seconds", options.seconds)->check(CLI::Range(1, 3600))->capture_default_str();
  app.add_option("--pages", options.pages)->check(CLI::Range(1, 50))->capture_default_str();
  app.add_flag("--live", options.has_live, "with a live view of 640x360");
  app.add_option("--json", options.json, "write the figures to this file");
  app.callback([&options] { holdfast::dashboard::testing::run(options); });
  return holdfast::bridge::run_command_line(app, argc, argv);
}
