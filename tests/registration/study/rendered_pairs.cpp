// SPDX-License-Identifier: Apache-2.0
#include "tests/registration/study/rendered_pairs.hpp"

#include <algorithm>
#include <cmath>
#include <fstream>
#include <limits>
#include <utility>

#include <fmt/format.h>
#include <opencv2/calib3d.hpp>
#include <opencv2/imgcodecs.hpp>

#include "registration/rectification.hpp"
#include "tests/sim/or/ideal_calibration.hpp"
#include "tests/sim/or/renderer.hpp"

namespace holdfast::test {
namespace {

namespace fs = std::filesystem;
using Eigen::Vector3d;

constexpr double kSameMm = 0.1;  // a ray that ends this near a point has met it

/// What the room truly shows, on the rectified left grid of a calibrated model.
class Truth {
 public:
  Truth(const sim::RoomShot& shot, const sim::Phantom& phantom, sim::Renderer& renderer,
        const registration::ZoomCalibration& model)
      : shot_(shot),
        phantom_(phantom),
        renderer_(renderer),
        model_(model),
        geometry_(registration::rectification_of(model, size())),
        left_(renderer.geometry(shot, sim::Side::left)),
        right_(renderer.geometry(shot, sim::Side::right)),
        depth_mm(size(), std::numeric_limits<float>::quiet_NaN()),
        seen(size(), uchar{0}) {
    cv::Mat1f u, v;
    cv::initUndistortRectifyMap(model.camera_matrix_left, model.distortion_left, geometry_.R1,
                                geometry_.P1, size(), CV_32FC1, u, v);
    for (int y = 0; y < depth_mm.rows; ++y)
      for (int x = 0; x < depth_mm.cols; ++x)
        add({x, y}, static_cast<double>(u(y, x)), static_cast<double>(v(y, x)));
    set_depths();
  }

 private:
  static cv::Size size() { return {sim::kSensorWidthPx, sim::kSensorHeightPx}; }

  /// Depth along the true left camera's axis: linear within a surface, the nearest pixel's at an
  /// edge; 0 where nothing is.
  [[nodiscard]] double depth_at(double s, double t) const {
    const int i = static_cast<int>(std::floor(s)), j = static_cast<int>(std::floor(t));
    if (i < 0 || j < 0 || i + 1 >= left_.depth_mm.cols || j + 1 >= left_.depth_mm.rows) return 0;
    const cv::Mat1f z = left_.depth_mm(cv::Rect(i, j, 2, 2));
    const auto [least, most] = std::minmax({z(0, 0), z(0, 1), z(1, 0), z(1, 1)});
    const double a = s - i, b = t - j;
    if (!(least > 0) || most - least > 0.5F)
      return static_cast<double>(z(b < 0.5 ? 0 : 1, a < 0.5 ? 0 : 1));
    return (1 - b) * ((1 - a) * static_cast<double>(z(0, 0)) + a * static_cast<double>(z(0, 1))) +
           b * ((1 - a) * static_cast<double>(z(1, 0)) + a * static_cast<double>(z(1, 1)));
  }

  void add(cv::Point pixel, double s, double t) {
    const double depth = depth_at(s, t);
    if (!(depth > 0)) return;
    const sim::SightLine line = shot_.optics.left.sight_line({s, t});
    const Vector3d p_left = line.origin_mm + (depth - line.origin_mm.z()) * line.direction;
    const Vector3d p_right = shot_.optics.T_right_left() * p_left;
    const Eigen::Vector2d q = shot_.optics.right.project(p_right);
    const int qx = static_cast<int>(std::lround(q.x())), qy = static_cast<int>(std::lround(q.y()));
    if (qx < 0 || qy < 0 || qx >= size().width || qy >= size().height) return;
    if (static_cast<double>(right_.depth_mm(qy, qx)) < p_right.z() - 0.5) return;  // hidden
    in_right_.emplace_back(q.x(), q.y());
    pixels_.push_back(pixel);
    const Vector3d p_head = shot_.optics.T_head_left * p_left;
    const Vector3d p_ct = shot_.T_ct_head * p_head;
    if (!phantom_.region_of_interest_mm.contains(p_ct)) return;
    seen(pixel) = seen_by_both;
    if (is_lit(p_head, p_ct)) seen(pixel) |= seen_lit;
  }

  [[nodiscard]] bool is_lit(const Vector3d& p_head, const Vector3d& p_ct) const {
    const Eigen::Vector2d on_mirrors = shot_.projector.project(p_head);
    if (!(on_mirrors.x() >= 0 && on_mirrors.y() >= 0 && on_mirrors.x() < sim::kProjectorWidthPx &&
          on_mirrors.y() < sim::kProjectorHeightPx))
      return false;
    Eigen::Isometry3d T_ct_pupil = shot_.T_ct_head;  // axes as the head's
    T_ct_pupil.translate(shot_.projector.p_head_mm);
    const Vector3d way = p_head - shot_.projector.p_head_mm;
    const auto hit = renderer_.first_hit({Vector3d::Zero(), way / way.z()}, T_ct_pupil);
    return hit && (*hit - p_ct).norm() < kSameMm;
  }

  /// Where the points stand on the rectified grids of the model, as depths: what a perfect matcher
  /// finds. What the model itself gets wrong is not the matcher's, nor in the variance it states.
  void set_depths() {
    std::vector<cv::Point2d> rectified;
    cv::undistortPoints(in_right_, rectified, model_.camera_matrix_right, model_.distortion_right,
                        geometry_.R2, geometry_.P2,
                        cv::TermCriteria(cv::TermCriteria::COUNT, 10, 0));
    for (std::size_t k = 0; k < pixels_.size(); ++k)
      depth_mm(pixels_[k]) = static_cast<float>(geometry_.depth_mm(pixels_[k].x - rectified[k].x));
  }

  const sim::RoomShot& shot_;
  const sim::Phantom& phantom_;
  sim::Renderer& renderer_;
  const registration::ZoomCalibration& model_;
  registration::Rectification geometry_;
  sim::Geometry left_, right_;
  std::vector<cv::Point2d> in_right_;
  std::vector<cv::Point> pixels_;

 public:
  cv::Mat1f depth_mm;
  cv::Mat1b seen;
};

// The rig's light through the pattern's filter, and a pattern under plain OR light.
constexpr double kFilteredOrLight = 0.05, kUnfilteredOrLight = 0.25;

RenderedScene scene_of(std::string name, std::uint32_t seed, double zoom, int pose) {
  RenderedScene scene;
  scene.name = std::move(name);
  scene.room.seed = scene.room.phantom_seed = scene.room.optics.seed = seed;
  scene.room.zoom = zoom;
  scene.room.poses = pose + 1;  // all but the first are tilted and shifted
  scene.room.lights.microscope_light = 0;
  scene.room.lights.or_light = kFilteredOrLight;
  scene.pattern.seed = seed;
  return scene;
}

}  // namespace

std::vector<RenderedScene> training_scenes() {
  using registration::PatternKind;
  std::vector<RenderedScene> all;
  for (const auto& [seed, zoom, pose] : std::vector<std::tuple<std::uint32_t, double, int>>{
           {11, 1.3, 0}, {12, 1.1, 1}, {13, 1.5, 2}, {14, 1.3, 3}})
    all.push_back(scene_of(fmt::format("ear{}_zoom{}_pose{}", seed, zoom, pose), seed, zoom, pose));
  const auto unfiltered = [&all](std::string name, std::uint32_t seed, double zoom,
                                 PatternKind kind, double dot_px, double distance_px) {
    RenderedScene& scene = all.emplace_back(scene_of(std::move(name), seed, zoom, 1));
    scene.room.lights.or_light = kUnfilteredOrLight;
    scene.pattern = {kind, dot_px, distance_px, seed};
  };
  unfiltered("ear2_zoom1.1_or_3_3", 2, 1.1, PatternKind::aperiodic, 3, 3);
  unfiltered("ear3_zoom1.5_or_6_4", 3, 1.5, PatternKind::aperiodic, 6, 4);
  unfiltered("ear4_zoom1.3_or_lattice_4_4", 4, 1.3, PatternKind::lattice, 4, 4);
  unfiltered("ear5_zoom1.2_or_random_4_4", 5, 1.2, PatternKind::random, 4, 4);
  RenderedScene& plain = all.emplace_back(scene_of("ear6_zoom1.4_no_pattern", 6, 1.4, 1));
  plain.has_pattern = false;
  plain.room.lights.or_light = 0.35;
  plain.room.lights.microscope_light = 0.6;
  RenderedScene& burst = all.emplace_back(scene_of("ear15_zoom1.3_burst", 15, 1.3, 1));
  burst.shots = 12;
  return all;
}

std::vector<RenderedScene> held_out_scenes() {
  std::vector<RenderedScene> all;
  for (const auto& [seed, zoom] : std::vector<std::pair<std::uint32_t, double>>{
           {1011, 1.1}, {1012, 1.2}, {1013, 1.3}, {1014, 1.4}, {1015, 1.5}})
    all.push_back(scene_of(fmt::format("ear{}_zoom{}", seed, zoom), seed, zoom, 1));
  return all;
}

struct RenderedRoom::Impl {
  sim::Phantom phantom;
  sim::Renderer renderer;
  sim::RoomShot shot;
  std::uint32_t seed;

  explicit Impl(const RenderedScene& scene)
      : phantom(sim::make_phantom(scene.room)),
        renderer(phantom.surfaces, phantom.n_view_ct),
        seed(scene.room.seed) {
    const sim::Microscope microscope(scene.room.optics);
    shot.optics = microscope.at(scene.room.zoom, 0);
    shot.projector = sim::make_projector(scene.room.optics.seed, microscope.focus_mm());
    shot.lights = sim::lights_of(scene.room, shot.projector);
    shot.sensor = scene.room.sensor;
    shot.T_ct_head = sim::head_poses(scene.room, phantom, microscope.focus_mm()).back();
  }
  registration::StereoShot under(const cv::Mat& pattern, int number) {
    shot.lights.pattern = pattern;
    shot.seed = seed * 7919U + static_cast<std::uint32_t>(number);
    return {renderer.image(shot, sim::Side::left), renderer.image(shot, sim::Side::right)};
  }
  void render(const RenderedScene& scene, const fs::path& folder) {
    fs::create_directories(folder);
    for (int i = 0; i < scene.shots; ++i) {
      registration::PatternParameters pattern = scene.pattern;
      pattern.seed += static_cast<std::uint64_t>(i);
      const auto pair =
          under(scene.has_pattern ? registration::make_pattern(pattern) : shot.lights.pattern, i);
      cv::imwrite(folder / fmt::format("left_{:02}.png", i), pair.left);
      cv::imwrite(folder / fmt::format("right_{:02}.png", i), pair.right);
    }
    const auto model = sim::ideal_calibration(shot.optics).model;
    std::ofstream(folder / "stereo.yaml") << registration::stereo_calibration_text(
        {sim::kSensorWidthPx, sim::kSensorHeightPx, {model}});
    const Truth truth(shot, phantom, renderer, model);
    cv::imwrite(folder / "seen.png", truth.seen);
    cv::imwrite(folder / "truth.tiff", truth.depth_mm);  // the last: whole, or rendered again
  }
};

std::vector<RenderedScene> refinement_scenes() {
  std::vector<RenderedScene> all;
  for (const auto& [seed, zoom] :
       std::vector<std::pair<std::uint32_t, double>>{{21, 1.1}, {1016, 1.3}, {1017, 1.5}}) {
    RenderedScene& fine =
        all.emplace_back(scene_of(fmt::format("ear{}_zoom{}_fine", seed, zoom), seed, zoom, 1));
    fine.pattern.dot_px = 2;
    fine.pattern.distance_px = 1;
  }
  RenderedScene& bright = all.emplace_back(scene_of("ear22_zoom1.3_bright", 22, 1.3, 1));
  bright.room.sensor.exposure = 2.5;
  RenderedScene& dark = all.emplace_back(scene_of("ear23_zoom1.3_dark", 23, 1.3, 1));
  dark.room.sensor.exposure = 0.2;
  return all;
}

RenderedRoom::RenderedRoom(const RenderedScene& scene) : impl_(std::make_unique<Impl>(scene)) {}
RenderedRoom::~RenderedRoom() = default;
registration::StereoShot RenderedRoom::under(const cv::Mat& pattern, int shot) {
  return impl_->under(pattern, shot);
}

RenderedPair rendered_pair(const RenderedScene& scene, const fs::path& cache) {
  const fs::path folder = cache / scene.name;
  if (!fs::exists(folder / "truth.tiff")) RenderedRoom(scene).impl_->render(scene, folder);
  RenderedPair pair{scene.name,
                    {},
                    registration::read_stereo_calibration(folder / "stereo.yaml"),
                    cv::imread(folder / "truth.tiff", cv::IMREAD_UNCHANGED),
                    cv::imread(folder / "seen.png", cv::IMREAD_UNCHANGED)};
  for (int i = 0; i < scene.shots; ++i)
    pair.shots.push_back(
        {cv::imread(folder / fmt::format("left_{:02}.png", i), cv::IMREAD_UNCHANGED),
         cv::imread(folder / fmt::format("right_{:02}.png", i), cv::IMREAD_UNCHANGED)});
  return pair;
}

}  // namespace holdfast::test
