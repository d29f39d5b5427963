// SPDX-License-Identifier: Apache-2.0
#include "tests/sim/or/room_pictures.hpp"

#include <algorithm>
#include <cmath>
#include <vector>

#include <opencv2/imgcodecs.hpp>
#include <opencv2/imgproc.hpp>

#include "bridge/atomic_file.hpp"
#include "registration/pattern.hpp"
#include "tests/sim/or/ct_scanner.hpp"
#include "tests/sim/or/room_output.hpp"

namespace holdfast::sim {
namespace {

namespace fs = std::filesystem;

constexpr int kWidthPx = 820;
constexpr std::size_t kBytesMax = 120'000;
constexpr int kPictures = 9;

// The best quality that fits.
void write_small(const fs::path& path, const cv::Mat& image) {
  cv::Mat small;
  const double scale = static_cast<double>(kWidthPx) / image.cols;
  cv::resize(image, small, {}, scale, scale, scale < 1 ? cv::INTER_AREA : cv::INTER_CUBIC);
  std::vector<std::uint8_t> bytes;
  for (int quality = 88; quality >= 40; quality -= 8) {
    cv::imencode(".jpg", small, bytes, {cv::IMWRITE_JPEG_QUALITY, quality});
    if (bytes.size() <= kBytesMax) break;
  }
  bridge::write_file_atomically(path.string(),
                                {reinterpret_cast<const char*>(bytes.data()), bytes.size()});
}

cv::Mat beside(const cv::Mat& left, const cv::Mat& right) {
  cv::Mat both;
  cv::hconcat(left, right, both);
  return both;
}

// Paper A's pattern: dots of 5 projector pixels, 12 apart.
cv::Mat regular_dots() {
  registration::PatternParameters dots;
  dots.kind = registration::PatternKind::lattice;
  dots.dot_px = 5;
  dots.distance_px = 7;
  return registration::make_pattern(dots);
}

// One after another, with the count of them.
struct Album {
  const fs::path& folder;
  const Progress& progress;
  RoomFiles files;
  void add(const char* name, const cv::Mat& image) {
    write_small(folder / name, image);
    progress(++files.files, kPictures);
  }
};

RoomShot shot_of(const RoomConfig& config, const Phantom& phantom, const Microscope& microscope) {
  RoomShot shot;
  shot.optics = microscope.at(config.zoom, config.visit);
  shot.projector = make_projector(config.optics.seed, microscope.focus_mm());
  shot.T_ct_head = head_poses(config, phantom, microscope.focus_mm()).front();
  return shot;
}

void add_ear(Album& album, const Phantom& ear) {
  RoomConfig config;
  config.zoom = 1.1;
  const Microscope microscope(config.optics);
  Renderer renderer(ear.surfaces, ear.n_view_ct);
  RoomShot shot = shot_of(config, ear, microscope);
  shot.lights.or_light = 0.8;
  shot.lights.microscope_light = 0;
  album.add("ear_or_light.jpg", renderer.image(shot, Side::left));
  shot.lights.or_light = 0;
  shot.lights.microscope_light = 0.9;
  album.add("ear_microscope_light.jpg", renderer.image(shot, Side::left));
  shot.lights.or_light = 0.05;
  shot.lights.microscope_light = 0;
  shot.lights.speckle = 0.3;
  shot.lights.pattern = diffractive_dots(config.seed, 6000, 0.5, shot.projector);
  album.add("ear_random_pattern.jpg",
            beside(renderer.image(shot, Side::left), renderer.image(shot, Side::right)));
  shot.lights.speckle = 0;
  shot.lights.pattern = regular_dots();
  album.add("ear_dots.jpg", renderer.image(shot, Side::left));
}

void add_cavity(Album& album, const char* name, const char* phantom_name) {
  RoomConfig config;
  config.phantom = phantom_name;
  const Phantom phantom = make_phantom(config);
  Renderer renderer(phantom.surfaces, phantom.n_view_ct);
  const RoomShot shot = shot_of(config, phantom, Microscope(config.optics));
  album.add(name, renderer.image(shot, Side::left));
}

// Bone window; the slice nearest to the first bead.
void add_ct(Album& album, const Phantom& ear) {
  const CtVolume volume = scan(ear, {});
  const Eigen::Vector3d normal = volume.row_step_mm.cross(volume.column_step_mm).normalized();
  const double at = normal.dot(ear.markers.front().p_bead_ct_mm - volume.origin_mm) /
                    normal.dot(volume.slice_step_mm);
  const auto last = static_cast<double>(volume.slices.size() - 1);
  const auto slice = static_cast<std::size_t>(std::lround(std::clamp(at, 0.0, last)));
  cv::Mat image;
  volume.slices[slice].convertTo(image, CV_8U, 255.0 / 2500, 1000 * 255.0 / 2500);
  album.add("ear_ct_slice.jpg", image);
}

// Three views (rows) of both cameras, at the first and the last zoom.
void add_calibration(Album& album) {
  const RoomConfig config;
  const Microscope microscope(config.optics);
  Renderer renderer({config.board.surface()}, -Eigen::Vector3d::UnitZ());
  RoomShot shot;
  shot.lights.or_light = config.calibration_or_light;
  std::vector<cv::Mat> rows;
  for (const int view : {3, 8, 14}) {
    cv::Mat row;
    for (const double zoom : {Microscope::kZoomMin, Microscope::kZoomMax}) {
      shot.optics = microscope.at(zoom, config.visit);
      shot.T_ct_head =
          board_poses(config.board, shot.optics, config.board_poses)[static_cast<std::size_t>(view)]
              .inverse();
      const cv::Mat pair =
          beside(renderer.image(shot, Side::left), renderer.image(shot, Side::right));
      row = row.empty() ? pair : beside(row, pair);
    }
    rows.push_back(row);
  }
  cv::Mat montage;
  cv::vconcat(rows, montage);
  album.add("calibration_views.jpg", montage);
}

}  // namespace

RoomFiles write_pictures(const fs::path& out, const Progress& progress) {
  make_folder(out);
  Album album{out, progress, {}};
  add_calibration(album);
  add_cavity(album, "cavity_bone.jpg", "cavity_bone");
  add_cavity(album, "cavity_covered.jpg", "cavity_covered");
  add_cavity(album, "cavity_bloody.jpg", "cavity_bloody");
  const Phantom ear = make_ear_phantom(RoomConfig{}.phantom_seed);
  add_ear(album, ear);
  add_ct(album, ear);
  return album.files;
}

}  // namespace holdfast::sim
