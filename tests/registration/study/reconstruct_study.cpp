// SPDX-License-Identifier: Apache-2.0
// Rendered pairs of the virtual microscope, whose depth is known at every pixel, through the
// reconstruction and through OpenCV's SGBM: error, wrong points, coverage, and whether the stated
// variance is true. And how often a repeating pattern slips (slip_study.hpp), and is known as one
// (lattice_study.hpp).
#include <algorithm>
#include <cmath>
#include <cstdio>
#include <cstdlib>
#include <cstring>
#include <limits>
#include <string>
#include <vector>

#include <fmt/format.h>
#include <opencv2/core/utility.hpp>

#include "registration/reconstruction.hpp"
#include "tests/registration/study/lattice_study.hpp"
#include "tests/registration/study/refined_study.hpp"
#include "tests/registration/study/rendered_pairs.hpp"
#include "tests/registration/study/slip_study.hpp"

namespace holdfast::test {
namespace {

struct Figures {
  double coverage = 0;      // of what both cameras see in the region of interest
  double coverage_lit = 0;  // of that, where the projector shines
  double lit = 0;           // its share
  double median_mm = 0, p95_mm = 0;
  double wrong = 0;            // share of the known more than 1 mm wrong
  double wrong_off_edges = 0;  // and of those away from depth edges
  double squared = 0;          // mean squared error over stated variance, each cut at 25
  double ratio_68 = 0;         // 68th percentile of error over stated sigma
};

double quantile(std::vector<double>& values, double share) {
  if (values.empty()) return std::numeric_limits<double>::quiet_NaN();
  const auto at =
      values.begin() + static_cast<std::ptrdiff_t>(share * static_cast<double>(values.size() - 1));
  std::nth_element(values.begin(), at, values.end());
  return *at;
}

/// As the rig's depth-error has it: 8 px on, the depth departs from a plane's by half a millimetre.
bool is_at_edge(const cv::Mat1f& depth_mm, cv::Point at) {
  constexpr int kReachPx = 8;
  constexpr float kJumpMm = 0.5F;
  const cv::Rect whole({}, depth_mm.size());
  const float here = depth_mm(at);
  for (const cv::Point way : {cv::Point(kReachPx, 0), cv::Point(0, kReachPx)}) {
    if (!whole.contains(at - way) || !whole.contains(at + way)) return true;
    const float before = depth_mm(at - way) - here, after = depth_mm(at + way) - here;
    if (std::isnan(before) || std::isnan(after)) return true;
    const bool is_step = std::abs(before) > kJumpMm || std::abs(after) > kJumpMm;
    if (is_step && std::abs(before + after) > kJumpMm) return true;
  }
  return false;
}

Figures figures_of(const RenderedPair& pair, const registration::Reconstruction& result) {
  Figures f;
  std::vector<double> errors, ratios;
  double seen = 0, lit = 0, known = 0, known_lit = 0, wrong = 0, off_edges = 0, wrong_off_edges = 0;
  for (int y = 0; y < result.depth_mm.rows; y += 4)
    for (int x = 0; x < result.depth_mm.cols; x += 4) {
      const cv::Point at(result.region_px.x + x, result.region_px.y + y);
      if ((pair.seen(at) & seen_by_both) == 0) continue;
      const bool is_lit = (pair.seen(at) & seen_lit) != 0;
      ++seen;
      lit += is_lit ? 1 : 0;
      const double error = std::abs(static_cast<double>(result.depth_mm(y, x) - pair.depth_mm(at)));
      if (std::isnan(error)) continue;
      ++known;
      known_lit += is_lit ? 1 : 0;
      wrong += error > 1 ? 1 : 0;
      errors.push_back(error);
      const auto variance = static_cast<double>(result.depth_variance_mm2(y, x));
      ratios.push_back(error / std::sqrt(variance));
      f.squared += std::min(error * error / variance, 25.0);
      if (is_at_edge(pair.depth_mm, at)) continue;
      ++off_edges;
      wrong_off_edges += error > 1 ? 1 : 0;
    }
  f.coverage = known / seen;
  f.coverage_lit = known_lit / lit;
  f.lit = lit / seen;
  f.wrong = wrong / known;
  f.wrong_off_edges = wrong_off_edges / off_edges;
  f.squared /= known;
  f.median_mm = quantile(errors, 0.5);
  f.p95_mm = quantile(errors, 0.95);
  f.ratio_68 = quantile(ratios, 0.68);
  return f;
}

void print_figures(const RenderedPair& pair, const std::string& what,
                   const registration::Reconstruction& result) {
  if (result.status != registration::ReconstructionStatus::done) {
    fmt::print("{:<28} {} refused: {}: {}\n", pair.name, what, name(result.status),
               result.evidence);
    return;
  }
  const Figures f = figures_of(pair, result);
  fmt::print(
      "{:<28} {} cover {:.2f} (lit {:.2f} of {:.2f}) %  p50 {:.4f} p95 {:.3f} mm  "
      ">1mm {:.2f} (off edges {:.2f}) %  nse {:.2f} r68 {:.2f} amb {:.3f}\n",
      pair.name, what, 100 * f.coverage, 100 * f.coverage_lit, 100 * f.lit, f.median_mm, f.p95_mm,
      100 * f.wrong, 100 * f.wrong_off_edges, f.squared, f.ratio_68, result.ambiguous_share);
  std::fflush(stdout);
}

void judge(const RenderedPair& pair, std::size_t shots, registration::MatchMethod method) {
  registration::ReconstructionOptions options;
  options.method = method;
  options.ambiguous_share_max = 1;
  options.may_be_lattice = true;
  registration::Reconstructor reconstructor(pair.calibration.zooms.at(0),
                                            pair.shots.front().left.size(), options);
  const auto result = reconstructor.reconstruct(std::span(pair.shots).first(shots));
  print_figures(
      pair,
      fmt::format("{:>2} {}", shots, method == registration::MatchMethod::sgm ? "ours" : "SGBM"),
      result);
}

int study(int argc, char** argv) {
  const std::string what = argc > 1 ? argv[1] : "";
  const bool is_held_out = what == "held-out";
  if (argc < 3 || (what != "training" && !is_held_out && what != "slips" && what != "lattices" &&
                   what != "refined")) {
    std::fputs(
        "usage: holdfast-study-reconstruct training|held-out CACHE_FOLDER [only names that contain "
        "this]\n"
        "       holdfast-study-reconstruct slips POSES aperiodic|lattice\n"
        "       holdfast-study-reconstruct lattices CACHE_FOLDER\n"
        "       holdfast-study-reconstruct refined CACHE_FOLDER [only names that contain this]\n",
        stderr);
    return 2;
  }
  cv::setNumThreads(2);
  if (what == "slips") {
    study_slips(1, std::atoi(argv[2]), argc > 3 && std::strcmp(argv[3], "lattice") == 0);
    return 0;
  }
  if (what == "lattices") {
    study_lattices(argv[2]);
    return 0;
  }
  const auto is_meant = [&](const RenderedScene& scene) {
    return argc < 4 || scene.name.find(argv[3]) != std::string::npos;
  };
  if (what == "refined") {
    for (const std::vector<RenderedScene>& scenes :
         {refinement_scenes(), training_scenes(), held_out_scenes()})
      for (const RenderedScene& scene : scenes)
        if (is_meant(scene) && scene.has_pattern &&
            scene.pattern.kind == registration::PatternKind::aperiodic)
          study_refined(scene, argv[2], print_figures);
    return 0;
  }
  for (const RenderedScene& scene : is_held_out ? held_out_scenes() : training_scenes()) {
    if (!is_meant(scene)) continue;
    const RenderedPair pair = rendered_pair(scene, argv[2]);
    judge(pair, 1, registration::MatchMethod::opencv);
    for (const std::size_t shots : {1U, 2U, 4U, 8U, 12U})
      if (shots <= pair.shots.size()) judge(pair, shots, registration::MatchMethod::sgm);
  }
  return 0;
}

}  // namespace
}  // namespace holdfast::test

int main(int argc, char** argv) {
  return holdfast::test::study(argc, argv);
}
