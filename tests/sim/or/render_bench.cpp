// SPDX-License-Identifier: Apache-2.0
// How long the virtual microscope takes to render: the scene is built and its OR light worked out
// beforehand, nothing is encoded or written. Beside the time that passed, the processor time spent
// over two: what two idle cores would take, whatever else the machine is doing meanwhile.
#include <algorithm>
#include <chrono>
#include <cmath>
#include <cstdio>
#include <functional>
#include <string>
#include <vector>

#include <CLI/CLI.hpp>
#include <fmt/format.h>
#include <nlohmann/json.hpp>
#include <sys/resource.h>

#include "bridge/atomic_file.hpp"
#include "rt/core/error.hpp"
#include "tests/sim/or/room.hpp"

namespace {

using namespace holdfast;
using namespace holdfast::sim;
using nlohmann::json;

double processor_ms() {
  rusage usage{};
  getrusage(RUSAGE_SELF, &usage);
  const auto ms = [](const timeval& t) {
    return 1e3 * static_cast<double>(t.tv_sec) + 1e-3 * static_cast<double>(t.tv_usec);
  };
  return ms(usage.ru_utime) + ms(usage.ru_stime);
}

struct Timing {
  std::vector<double> passed_ms, processor_ms;
};

Timing timed(int runs, const std::function<void(int)>& render) {
  using Clock = std::chrono::steady_clock;
  render(0);  // light, tables and buffers
  Timing timing;
  for (int i = 1; i <= runs; ++i) {
    const double spent = processor_ms();
    const auto start = Clock::now();
    render(i);
    timing.passed_ms.push_back(
        std::chrono::duration<double, std::milli>(Clock::now() - start).count());
    timing.processor_ms.push_back(processor_ms() - spent);
  }
  return timing;
}

double percentile(std::vector<double> values, double share) {
  std::sort(values.begin(), values.end());
  return values[static_cast<std::size_t>(
      std::lround(share * static_cast<double>(values.size() - 1)))];
}

void add(json& figures, const std::string& name, Timing timing) {
  for (double& ms : timing.processor_ms) ms /= 2;
  const std::pair<const char*, const std::vector<double>*> kinds[] = {
      {"", &timing.passed_ms}, {"_processor_time_over_2", &timing.processor_ms}};
  for (const auto& [kind, values] : kinds) {
    figures.push_back({{"name", name + kind},
                       {"median", percentile(*values, 0.5)},
                       {"p99", percentile(*values, 0.99)},
                       {"unit", "ms"}});
    fmt::print("{:<62} median {:8.1f} ms  p99 {:8.1f} ms\n", name + kind, percentile(*values, 0.5),
               percentile(*values, 0.99));
  }
}

constexpr double kNoiseDn = 1.5;

// A phantom under the microscope at a pose and with lights as a configuration has them.
class Room {
 public:
  explicit Room(const RoomConfig& config)
      : phantom_(make_phantom(config)), renderer_(phantom_.surfaces, phantom_.n_view_ct) {
    const Microscope microscope(config.optics);
    shot_.optics = microscope.at(config.zoom, config.visit);
    shot_.projector = make_projector(config.optics.seed, microscope.focus_mm());
    shot_.lights = lights_of(config, shot_.projector);
    shot_.T_ct_head = head_poses(config, phantom_, microscope.focus_mm()).front();
  }
  void read_out(const cv::Rect& region) { shot_.region = region; }
  /// How far the rays that are saved change the left image, beside its noise of about 1.5 DN.
  [[nodiscard]] json compare(const std::string& name) {
    shot_.rays = Rays::all;
    const cv::Mat_<float> all(renderer_.light(shot_, Side::left));
    shot_.rays = Rays::where_needed;
    const cv::Mat_<float> some(renderer_.light(shot_, Side::left));
    double squares = 0, most = 0;
    int beyond = 0;
    for (int y = 0; y < all.rows; ++y)
      for (int x = 0; x < all.cols; ++x) {
        const double change =
            std::abs(static_cast<double>(std::min(some(y, x), 255.F) - std::min(all(y, x), 255.F)));
        squares += change * change;
        most = std::max(most, change);
        if (change > kNoiseDn) ++beyond;
      }
    const auto pixels = static_cast<double>(all.total());
    const json figures{{"name", name},
                       {"rms_dn", std::sqrt(squares / pixels)},
                       {"share_beyond_noise", beyond / pixels},
                       {"max_dn", most}};
    fmt::print("{:<30} rms {:.3f} DN, {:.4f} % beyond {} DN, at most {:.1f} DN\n", name,
               figures["rms_dn"].get<double>(), 100 * beyond / pixels, kNoiseDn, most);
    return figures;
  }
  void render_left(int i) {
    shot_.seed = static_cast<std::uint32_t>(i);
    (void)renderer_.image(shot_, Side::left);
  }
  void render_pair(int i) {
    render_left(i);
    (void)renderer_.image(shot_, Side::right);
  }

 private:
  Phantom phantom_;
  Renderer renderer_;
  RoomShot shot_;
};

json measure(int runs, const std::string& only) {
  json figures = json::array();
  RoomConfig config;
  if (only != "cavity") {
    Room room(config);
    add(figures, "render_stereo_pair_ear", timed(runs, [&](int i) { room.render_pair(i); }));
  }
  config.pattern = "diffractive";
  config.lights.microscope_light = 0;
  if (only != "cavity") {
    Room room(config);
    add(figures, "render_stereo_pair_ear_pattern",
        timed(runs, [&](int i) { room.render_pair(i); }));
  }
  if (only == "ear") return figures;
  config = {};
  config.phantom = "cavity_bone";
  Room room(config);
  add(figures, "render_stereo_pair_cavity", timed(runs, [&](int i) { room.render_pair(i); }));
  room.read_out({(kSensorWidthPx - 1920) / 2, (kSensorHeightPx - 1080) / 2, 1920, 1080});
  add(figures, "render_1080p_frame_cavity", timed(runs, [&](int i) { room.render_left(i); }));
  return figures;
}

// Saved rays against none saved, of every phantom and light.
json compare() {
  json figures = json::array();
  for (const char* phantom : {"ear", "cavity_bone", "cavity_covered", "cavity_bloody"}) {
    RoomConfig config;
    config.phantom = phantom;
    config.lights.or_light = 0.15;  // less of what hides a shadow
    figures.push_back(Room(config).compare(fmt::format("{}_lamps", phantom)));
    config.pattern = "diffractive";
    config.lights.microscope_light = 0;
    figures.push_back(Room(config).compare(fmt::format("{}_pattern", phantom)));
  }
  return figures;
}

}  // namespace

int main(int argc, char** argv) {
  CLI::App app("Times the virtual microscope's renderer.", "holdfast-bench-render");
  std::string file;
  std::string only;
  int runs = 15;
  app.add_option("--json", file, "write the figures to this file");
  app.add_option("--runs", runs, "of each kind of picture")->check(CLI::Range(1, 1000));
  app.add_option("--only", only, "one of the two phantoms")
      ->check(CLI::IsMember({"ear", "cavity"}));
  bool is_comparison = false;
  app.add_flag("--compare", is_comparison, "instead: how far the rays that are saved change it");
  CLI11_PARSE(app, argc, argv);
  try {
    const json figures = is_comparison ? compare() : measure(runs, only);
    if (!file.empty()) bridge::write_file_atomically(file, figures.dump(1) + "\n");
  } catch (const Error& error) {
    fmt::print(stderr, "holdfast-bench-render: {}\n", error.what());
    return 2;
  }
  return 0;
}
