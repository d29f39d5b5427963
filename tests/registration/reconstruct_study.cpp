// SPDX-License-Identifier: Apache-2.0
// Rendered pairs of the virtual microscope, whose depth is known at every pixel, through the
// reconstruction and through OpenCV's SGBM: error, wrong points, coverage, and whether the stated
// variance is true. Rendering takes seconds a pair, so pairs are kept in a folder.
#include <algorithm>
#include <cmath>
#include <cstdio>
#include <cstdlib>
#include <cstring>
#include <filesystem>
#include <fstream>
#include <limits>
#include <string>
#include <vector>

#include <fmt/format.h>
#include <opencv2/calib3d.hpp>
#include <opencv2/core/utility.hpp>
#include <opencv2/imgcodecs.hpp>
#include <opencv2/imgproc.hpp>

#include "registration/pattern.hpp"
#include "registration/reconstruction.hpp"
#include "tests/registration/support/stereo_rig.hpp"
#include "tests/sim/or/ideal_calibration.hpp"
#include "tests/sim/or/room.hpp"

namespace holdfast {
namespace {

namespace fs = std::filesystem;

struct Scene {
  std::string name;
  sim::RoomConfig room;
  registration::PatternParameters pattern;
  bool has_pattern = true;
};

struct Pair {
  std::string name;
  registration::StereoShot shot;
  registration::StereoCalibration calibration;
  cv::Mat1f depth_mm;  // rectified left grid; NaN: nothing, or the right camera does not see it
};

/// Where the point that the true left camera sees at a pixel stands on the rectified grids of the
/// calibrated model, as a depth: what a perfect matcher finds. What the model itself gets wrong is
/// not the matcher's, and not in the variance that it states.
cv::Mat1f true_depth(const sim::Geometry& left, const sim::Geometry& right,
                     const sim::StereoOptics& optics, const registration::ZoomCalibration& model) {
  const cv::Size size(sim::kSensorWidthPx, sim::kSensorHeightPx);
  const registration::Rectification geometry = registration::rectification_of(model, size);
  cv::Mat1f u, v, depth(size, std::numeric_limits<float>::quiet_NaN());
  cv::initUndistortRectifyMap(model.camera_matrix_left, model.distortion_left, geometry.R1,
                              geometry.P1, size, CV_32FC1, u, v);
  std::vector<cv::Point2d> seen, rectified;
  std::vector<cv::Point> pixels;
  for (int y = 0; y < size.height; ++y)
    for (int x = 0; x < size.width; ++x) {
      const double s = static_cast<double>(u(y, x)), t = static_cast<double>(v(y, x));
      const int i = static_cast<int>(std::floor(s)), j = static_cast<int>(std::floor(t));
      if (i < 0 || j < 0 || i + 1 >= size.width || j + 1 >= size.height) continue;
      const cv::Mat1f z = left.depth_mm(cv::Rect(i, j, 2, 2));
      const auto [least, most] = std::minmax({z(0, 0), z(0, 1), z(1, 0), z(1, 1)});
      if (!(least > 0) || most - least > 0.5F) continue;
      const double a = s - i, b = t - j;
      const double mean =
          (1 - b) * ((1 - a) * static_cast<double>(z(0, 0)) + a * static_cast<double>(z(0, 1))) +
          b * ((1 - a) * static_cast<double>(z(1, 0)) + a * static_cast<double>(z(1, 1)));
      const sim::SightLine line = optics.left.sight_line({s, t});
      const Eigen::Vector3d p_right =
          optics.T_right_left() * (line.origin_mm + (mean - line.origin_mm.z()) * line.direction);
      const Eigen::Vector2d q = optics.right.project(p_right);
      const int qx = static_cast<int>(std::lround(q.x())),
                qy = static_cast<int>(std::lround(q.y()));
      if (qx < 0 || qy < 0 || qx >= size.width || qy >= size.height) continue;
      if (static_cast<double>(right.depth_mm(qy, qx)) < p_right.z() - 0.5) continue;  // hidden
      seen.emplace_back(q.x(), q.y());
      pixels.emplace_back(x, y);
    }
  cv::undistortPoints(seen, rectified, model.camera_matrix_right, model.distortion_right,
                      geometry.R2, geometry.P2, cv::TermCriteria(cv::TermCriteria::COUNT, 10, 0));
  for (std::size_t k = 0; k < pixels.size(); ++k)
    depth(pixels[k]) = static_cast<float>(geometry.depth_mm(pixels[k].x - rectified[k].x));
  return depth;
}

void render(const Scene& scene, const fs::path& folder) {
  const sim::Microscope microscope(scene.room.optics);
  const sim::Phantom phantom = sim::make_phantom(scene.room);
  sim::Renderer renderer(phantom.surfaces, phantom.n_view_ct);
  sim::RoomShot shot;
  shot.optics = microscope.at(scene.room.zoom, 0);
  shot.projector = sim::make_projector(scene.room.optics.seed, microscope.focus_mm());
  shot.lights = sim::lights_of(scene.room, shot.projector);
  if (scene.has_pattern) shot.lights.pattern = registration::make_pattern(scene.pattern);
  shot.sensor = scene.room.sensor;
  shot.T_ct_head = sim::head_poses(scene.room, phantom, microscope.focus_mm()).back();
  shot.seed = scene.room.seed * 7919U;
  fs::create_directories(folder);
  const auto model = sim::ideal_calibration(shot.optics).model;
  cv::imwrite(folder / "truth.tiff",
              true_depth(renderer.geometry(shot, sim::Side::left),
                         renderer.geometry(shot, sim::Side::right), shot.optics, model));
  if (fs::exists(folder / "stereo.yaml")) return;  // the images are there
  cv::imwrite(folder / "left.png", renderer.image(shot, sim::Side::left));
  cv::imwrite(folder / "right.png", renderer.image(shot, sim::Side::right));
  std::ofstream(folder / "stereo.yaml") << registration::stereo_calibration_text(
      {sim::kSensorWidthPx, sim::kSensorHeightPx, {model}});
}

Pair pair_of(const Scene& scene, const fs::path& cache) {
  const fs::path folder = cache / scene.name;
  if (!fs::exists(folder / "truth.tiff")) render(scene, folder);
  return {scene.name,
          {cv::imread(folder / "left.png", cv::IMREAD_UNCHANGED),
           cv::imread(folder / "right.png", cv::IMREAD_UNCHANGED)},
          registration::read_stereo_calibration(folder / "stereo.yaml"),
          cv::imread(folder / "truth.tiff", cv::IMREAD_UNCHANGED)};
}

struct Figures {
  double coverage = 0;  // of the pixels with truth, away from depth edges
  double median_mm = 0, p95_mm = 0;
  double wrong = 0;      // share of the known more than 1 mm wrong, away from depth edges
  double wrong_all = 0;  // the same, everywhere with truth
  double squared = 0;    // mean squared error over stated variance, each cut at 25
  double ratio_68 = 0;   // 68th percentile of error over stated sigma
};

double quantile(std::vector<double>& values, double share) {
  if (values.empty()) return std::numeric_limits<double>::quiet_NaN();
  const auto at =
      values.begin() + static_cast<std::ptrdiff_t>(share * static_cast<double>(values.size() - 1));
  std::nth_element(values.begin(), at, values.end());
  return *at;
}

Figures figures_of(const Pair& pair, const registration::Reconstruction& result) {
  // Near a depth edge: within 12 px of a step of 1 mm, or of what one view does not see.
  cv::Mat1f least, most, filled = pair.depth_mm.clone();
  cv::patchNaNs(filled, 0);
  const cv::Mat window = cv::Mat::ones(25, 25, CV_8U);
  cv::erode(filled, least, window);
  cv::dilate(filled, most, window);
  Figures f;
  std::vector<double> errors, ratios;
  double known = 0, all = 0, wrong = 0, wrong_all = 0, known_all = 0;
  for (int y = 0; y < result.depth_mm.rows; y += 3)
    for (int x = 0; x < result.depth_mm.cols; x += 3) {
      const cv::Point at(result.region_px.x + x, result.region_px.y + y);
      const float truth = pair.depth_mm(at);
      if (std::isnan(truth)) continue;
      const bool is_edge = most(at) - least(at) > 3;
      const double error = std::abs(static_cast<double>(result.depth_mm(y, x) - truth));
      const bool is_known = !std::isnan(error);
      known_all += is_known ? 1 : 0;
      wrong_all += error > 1 ? 1 : 0;
      if (is_edge) continue;
      ++all;
      if (!is_known) continue;
      ++known;
      wrong += error > 1 ? 1 : 0;
      errors.push_back(error);
      const double variance = static_cast<double>(result.depth_variance_mm2(y, x));
      ratios.push_back(error / std::sqrt(variance));
      f.squared += std::min(error * error / variance, 25.0);
    }
  f.coverage = known / all;
  f.wrong = wrong / known;
  f.wrong_all = wrong_all / known_all;
  f.squared /= known;
  f.median_mm = quantile(errors, 0.5);
  f.p95_mm = quantile(errors, 0.95);
  f.ratio_68 = quantile(ratios, 0.68);
  return f;
}

void judge(const Pair& pair, registration::MatchMethod method) {
  registration::ReconstructionOptions options;
  options.method = method;
  options.ambiguous_share_max = 1;
  registration::Reconstructor reconstructor(pair.calibration.zooms.at(0), pair.shot.left.size(),
                                            options);
  const auto result = reconstructor.reconstruct(std::span(&pair.shot, 1));
  if (result.status != registration::ReconstructionStatus::done) {
    fmt::print("{:<34} refused: {}: {}\n", pair.name, name(result.status), result.evidence);
    return;
  }
  const Figures f = figures_of(pair, result);
  fmt::print(
      "{:<34} {:<6} cover {:.3f}  median {:.4f}  p95 {:.3f} mm  >1mm {:.4f} (all {:.4f})  "
      "nse {:.2f}  r68 {:.2f}  amb {:.3f}\n",
      pair.name, method == registration::MatchMethod::sgm ? "ours" : "SGBM", f.coverage,
      f.median_mm, f.p95_mm, f.wrong, f.wrong_all, f.squared, f.ratio_68, result.ambiguous_share);
  std::fflush(stdout);
}

std::vector<Scene> scenes() {
  std::vector<Scene> all;
  const auto add = [&all](std::string name, std::uint32_t seed, double zoom, auto change) {
    Scene scene;
    scene.name = std::move(name);
    scene.room.seed = scene.room.phantom_seed = scene.room.optics.seed = seed;
    scene.room.zoom = zoom;
    scene.room.poses = 2;  // the second is tilted and shifted
    scene.room.lights.microscope_light = 0;
    scene.room.lights.or_light = 0.25;
    scene.pattern.seed = seed;
    change(scene);
    all.push_back(scene);
  };
  const auto dots = [](double size, double gap, registration::PatternKind kind) {
    return [=](Scene& s) { s.pattern = {kind, size, gap, s.pattern.seed}; };
  };
  using registration::PatternKind;
  add("ear1_zoom1.3_aperiodic_4_4", 1, 1.3, dots(4, 4, PatternKind::aperiodic));
  add("ear2_zoom1.1_aperiodic_3_3", 2, 1.1, dots(3, 3, PatternKind::aperiodic));
  add("ear3_zoom1.5_aperiodic_6_4", 3, 1.5, dots(6, 4, PatternKind::aperiodic));
  add("ear4_zoom1.3_lattice_4_4", 4, 1.3, dots(4, 4, PatternKind::lattice));
  add("ear5_zoom1.2_random_4_4", 5, 1.2, dots(4, 4, PatternKind::random));
  add("ear6_zoom1.4_no_pattern", 6, 1.4, [](Scene& s) {
    s.has_pattern = false;
    s.room.lights.or_light = 0.35;
    s.room.lights.microscope_light = 0.6;
  });
  add("ear1007_zoom1.3_aperiodic_4_4", 1007, 1.3, dots(4, 4, PatternKind::aperiodic));
  return all;
}

/// One random pose over one random relief with dots of random size, turn and place.
test::StereoRig random_rig(std::uint32_t seed, bool is_lattice) {
  cv::RNG random(seed);
  test::StereoRig rig;
  rig.image_px = {320, 256};
  rig.is_lattice = is_lattice;
  rig.seed = seed;
  rig.dot_pitch_mm = random.uniform(0.5, 1.6);
  rig.dot_radius_mm = rig.dot_pitch_mm * random.uniform(0.2, 0.38);
  rig.dots_turn_rad = random.uniform(-0.3, 0.3);
  rig.dots_shift_mm = random.uniform(0.0, 2.0);
  rig.relief_mm = random.uniform(0.5, 4.0);
  rig.distance_mm = random.uniform(190.0, 210.0);
  rig.contrast_grey = random.uniform(60.0, 150.0);
  rig.texture_grey = random.uniform(0.0, 8.0);
  rig.noise_grey = random.uniform(0.5, 3.0);
  return rig;
}

/// How many reconstructions of `poses` scenes slip (more than 0.5 % of the points further than 2 mm
/// away), with and without the refusal, and how many are refused.
void study_slips(int poses, bool is_lattice) {
  int refused = 0, refused_for_slip = 0, slipped = 0, undetected = 0;
  for (int i = 0; i < poses; ++i) {
    const test::StereoRig rig = random_rig(static_cast<std::uint32_t>(i + 1), is_lattice);
    const registration::StereoShot shot{rig.left(), rig.right()};
    const auto run = [&](bool has_check) {
      registration::ReconstructionOptions options;
      options.match = registration::match_parameters_for(rig.image_px);
      if (!has_check) options.match->repetition.correlation_min = 2;  // never reached
      registration::Reconstructor reconstructor(rig.calibration(), rig.image_px, options);
      auto result = reconstructor.reconstruct(std::span(&shot, 1));
      double wrong = 0, known = 0;
      for (int y = 0; y < result.depth_mm.rows; y += 3)
        for (int x = 0; x < result.depth_mm.cols; x += 3) {
          const double z = static_cast<double>(result.depth_mm(y, x));
          if (std::isnan(z)) continue;
          ++known;
          wrong +=
              std::abs(z - rig.true_depth_mm(reconstructor.rectification(), result.region_px.x + x,
                                             result.region_px.y + y)) > 2
                  ? 1
                  : 0;
        }
      return std::pair(result.status, known > 0 && wrong > 0.005 * known);
    };
    const auto [status, is_wrong] = run(true);
    refused += status != registration::ReconstructionStatus::done ? 1 : 0;
    refused_for_slip += status == registration::ReconstructionStatus::period_slip ? 1 : 0;
    undetected += is_wrong ? 1 : 0;
    slipped += run(false).second ? 1 : 0;
  }
  fmt::print(
      "{}: {} poses: {} slip without the check, {} with it; {} refused, {} of them as "
      "repeating\n",
      is_lattice ? "lattice" : "aperiodic", poses, slipped, undetected, refused, refused_for_slip);
}

int study(int argc, char** argv) {
  if (argc < 2 || argv[1][0] == '-') {
    std::fputs(
        "usage: holdfast-study-reconstruct CACHE_FOLDER [only names that contain this]\n"
        "       holdfast-study-reconstruct slips POSES\n",
        stderr);
    return 2;
  }
  cv::setNumThreads(2);
  if (std::strcmp(argv[1], "slips") == 0) {
    const int poses = argc > 2 ? std::atoi(argv[2]) : 1000;
    study_slips(poses, true);
    study_slips(poses, false);
    return 0;
  }
  for (const Scene& scene : scenes()) {
    if (argc > 2 && scene.name.find(argv[2]) == std::string::npos) continue;
    const Pair pair = pair_of(scene, argv[1]);
    judge(pair, registration::MatchMethod::sgm);
    if (argc <= 3) judge(pair, registration::MatchMethod::opencv);
  }
  return 0;
}

}  // namespace
}  // namespace holdfast

int main(int argc, char** argv) {
  return holdfast::study(argc, argv);
}
