// SPDX-License-Identifier: Apache-2.0
#include "tests/registration/study/lattice_study.hpp"

#include <algorithm>
#include <cstdio>
#include <map>
#include <memory>
#include <string>
#include <vector>

#include <fmt/format.h>
#include <opencv2/imgcodecs.hpp>

#include "registration/pattern.hpp"
#include "registration/pattern_lattice.hpp"
#include "registration/pattern_table.hpp"
#include "tests/sim/or/renderer.hpp"
#include "tests/sim/or/room.hpp"

namespace holdfast::test {
namespace {

namespace fs = std::filesystem;
using registration::PatternKind;

struct View {
  double zoom = 1.3;
  double or_light = 0.05;  // 0.05: through the pattern's filter
  registration::PatternParameters pattern;
  bool has_pattern = true;

  [[nodiscard]] std::string name() const {
    if (!has_pattern) return fmt::format("none_zoom{}_or{}", zoom, or_light);
    return fmt::format("{}_{}_{}_zoom{}_or{}", registration::name(pattern.kind), pattern.dot_px,
                       pattern.distance_px, zoom, or_light);
  }
};

std::vector<View> views() {
  constexpr std::pair<double, double> kDots[] = {{2, 1},  {2, 4},  {2, 10}, {3, 2},
                                                 {4, 4},  {6, 3},  {8, 8},  {10, 1},
                                                 {12, 5}, {16, 1}, {16, 4}, {16, 10}};
  std::vector<View> all;
  for (const double zoom : {1.1, 1.2, 1.3, 1.4, 1.5})
    for (const double or_light : {0.05, 0.25}) {
      for (const PatternKind kind :
           {PatternKind::lattice, PatternKind::aperiodic, PatternKind::random})
        for (const auto& [dot_px, distance_px] : kDots)
          all.push_back({zoom, or_light, {kind, dot_px, distance_px, 1}});
      all.push_back({zoom, or_light, {}, false});
    }
  return all;
}

/// Each zoom another ear, tilted and shifted.
class Room {
 public:
  explicit Room(double zoom)
      : config_(config_at(zoom)),
        microscope_(config_.optics),
        phantom_(sim::make_phantom(config_)),
        renderer_(phantom_.surfaces, phantom_.n_view_ct) {}

  cv::Mat render(const View& view) {
    sim::RoomShot shot;
    shot.optics = microscope_.at(config_.zoom, 0);
    shot.projector = sim::make_projector(config_.optics.seed, microscope_.focus_mm());
    shot.sensor = config_.sensor;
    shot.T_ct_head = sim::head_poses(config_, phantom_, microscope_.focus_mm()).back();
    sim::RoomConfig lit = config_;
    lit.lights.or_light = view.or_light;
    shot.lights = sim::lights_of(lit, shot.projector);
    if (view.has_pattern) shot.lights.pattern = registration::make_pattern(view.pattern);
    return renderer_.image(shot, sim::Side::left);
  }

 private:
  static sim::RoomConfig config_at(double zoom) {
    sim::RoomConfig config;
    config.seed = config.phantom_seed = config.optics.seed =
        20 + static_cast<std::uint32_t>(10 * zoom);
    config.zoom = zoom;
    config.poses = 2;
    config.lights.microscope_light = 0;
    return config;
  }

  sim::RoomConfig config_;
  sim::Microscope microscope_;
  sim::Phantom phantom_;
  sim::Renderer renderer_;
};

struct Range {
  double least = 2, most = 0;
  int images = 0, refused = 0;
};

}  // namespace

void study_lattices(const fs::path& cache) {
  fs::create_directories(cache);
  registration::WorkerPool pool(2);
  std::map<std::string, Range> ranges;
  std::unique_ptr<Room> room;
  double room_zoom = 0;
  for (const View& view : views()) {
    const fs::path file = cache / (view.name() + ".png");
    if (!fs::exists(file)) {
      if (room_zoom != view.zoom) room = std::make_unique<Room>(view.zoom);
      room_zoom = view.zoom;
      cv::imwrite(file, room->render(view));
    }
    const cv::Mat1b image = cv::imread(file, cv::IMREAD_GRAYSCALE);
    const registration::ImageRepetition found = registration::repetition_of(image, pool);
    fmt::print("{:<36} {:.3f} at {:.0f},{:.0f} px in {} parts\n", view.name(), found.share,
               found.step_px.x, found.step_px.y, found.parts);
    Range& range =
        ranges[view.has_pattern ? std::string(registration::name(view.pattern.kind)) : "none"];
    range.least = std::min(range.least, found.share);
    range.most = std::max(range.most, found.share);
    ++range.images;
    range.refused += found.share > registration::kRepetitionMax ? 1 : 0;
  }
  for (const auto& [kind, range] : ranges)
    fmt::print("{:<10} {} images: {:.3f} to {:.3f} repeats; {} over {}\n", kind, range.images,
               range.least, range.most, range.refused, registration::kRepetitionMax);
}

}  // namespace holdfast::test
