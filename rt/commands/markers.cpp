// SPDX-License-Identifier: Apache-2.0
// `holdfast markers`: the markers on the patient's holders, as points in the left camera's frame.
#include <cmath>
#include <memory>
#include <string>
#include <vector>

#include <fmt/format.h>
#include <nlohmann/json.hpp>
#include <opencv2/core/utils/logger.hpp>

#include "bridge/atomic_file.hpp"
#include "bridge/command_line.hpp"
#include "registration/marker_detection.hpp"
#include "registration/marker_triangulation.hpp"
#include "registration/markups.hpp"
#include "registration/stereo_calibration.hpp"
#include "rt/commands/commands.hpp"
#include "rt/commands/grey_image.hpp"
#include "rt/core/error.hpp"

namespace holdfast::rt {
namespace {

using registration::calibration_at_zoom;
using registration::detect_markers;
using registration::locate_markers;
using registration::LocatedMarker;
using registration::marker_dictionary;
using registration::MarkerOptions;
using registration::MarkerSet;
using registration::markups_of;
using registration::markups_text;
using registration::read_stereo_calibration;
using registration::stereo_calibration_text;
using registration::StereoCalibration;
using registration::ZoomCalibration;

constexpr const char* kExample =
    "Example: the beads 1 mm below four 4x4 markers, from a pair taken with the pattern off\n"
    "  holdfast markers --left left.png --right right.png --calibration stereo.yaml --zoom 1.3 \\\n"
    "    --offset-mm 1 --out markers.mrk.json\n"
    "Exit code 1: the images and the calibration do not fit together, or too few markers are seen.";

struct Options {
  std::string left, right, calibration, out, seated, dictionary = "4x4_50";
  double zoom = 0;
  std::vector<double> offset_sigma_mm{0.01, 0.01, 0.02};
  MarkerOptions markers;
  bool may_extrapolate = false, is_json = false;
};

cv::Mat read_grey(const std::string& path, const StereoCalibration& calibration) {
  cv::Mat image = read_grey_image(path);
  if (image.cols != calibration.image_width_px || image.rows != calibration.image_height_px)
    throw InputError(fmt::format("{}: is {}x{} px, must be {}x{} px as the calibration", path,
                                 image.cols, image.rows, calibration.image_width_px,
                                 calibration.image_height_px));
  return image;
}

void print(const Options& options, const MarkerSet& set) {
  if (options.is_json) {
    nlohmann::ordered_json json;
    json["out"] = options.out;
    for (const LocatedMarker& m : set.markers)
      json["markers"].push_back({{"label", fmt::format("aruco-{}", m.id)},
                                 {"position_mm", {m.point_mm.x(), m.point_mm.y(), m.point_mm.z()}},
                                 {"sigma_mm", std::sqrt(m.covariance_mm2.trace())},
                                 {"side_mm", m.side_mm},
                                 {"fit_px", m.fit_px}});
    json["skipped"] = set.skipped;
    fmt::print("{}\n", json.dump());
    return;
  }
  for (const std::string& one : set.skipped) fmt::print("skipped: {}\n", one);
  for (const LocatedMarker& m : set.markers)
    fmt::print(
        "aruco-{}  {:9.4f} {:9.4f} {:9.4f} mm  sigma {:.4f} mm  side {:.3f} mm  fit {:.3f} px\n",
        m.id, m.point_mm.x(), m.point_mm.y(), m.point_mm.z(), std::sqrt(m.covariance_mm2.trace()),
        m.side_mm, m.fit_px);
}

void run(Options options) {
  cv::utils::logging::setLogLevel(cv::utils::logging::LOG_LEVEL_SILENT);
  cv::setNumThreads(2);
  bridge::catch_interrupts();
  if (!(options.markers.offset_mm >= -100 && options.markers.offset_mm <= 100))
    throw InputError(
        fmt::format("--offset-mm is {:g}, must be -100 to 100 mm", options.markers.offset_mm));
  if (!(options.markers.marker_mm >= 0 && options.markers.marker_mm < 1000))
    throw InputError(
        fmt::format("--marker-mm is {:g}, must be 0 to 1000 mm", options.markers.marker_mm));
  for (Eigen::Index i = 0; i < 3; ++i)
    options.markers.offset_sigma_mm[i] = options.offset_sigma_mm[static_cast<std::size_t>(i)];
  const int dictionary = marker_dictionary(options.dictionary);
  const StereoCalibration calibration = read_stereo_calibration(options.calibration);
  const ZoomCalibration zoom =
      calibration_at_zoom(calibration, options.zoom, options.may_extrapolate);
  const cv::Mat left = read_grey(options.left, calibration);
  const cv::Mat right = read_grey(options.right, calibration);
  const MarkerSet set = locate_markers(
      detect_markers(left, dictionary, zoom.camera_matrix_left, zoom.distortion_left),
      detect_markers(right, dictionary, zoom.camera_matrix_right, zoom.distortion_right), zoom,
      options.markers);
  if (bridge::is_interrupted()) throw InterruptedError("interrupted");
  if (!options.seated.empty()) {
    StereoCalibration seated = calibration;
    seated.zooms = {set.calibration};
    bridge::write_file_atomically(options.seated, stereo_calibration_text(seated));
  }
  bridge::write_file_atomically(options.out, markups_text(markups_of(set)));
  print(options, set);
}

}  // namespace

void add_markers(CLI::App& app) {
  auto options = std::make_shared<Options>();
  CLI::App* markers = app.add_subcommand("markers", "Locate ArUco markers in a stereo pair.");
  markers->add_option("--left", options->left, "Left image, raw, pattern off")->required();
  markers->add_option("--right", options->right, "Right image, raw, pattern off")->required();
  markers->add_option("--calibration", options->calibration, "stereo.yaml of `holdfast calibrate`")
      ->required();
  markers->add_option("--zoom", options->zoom, "Zoom of the images")->required();
  markers->add_flag("--extrapolate", options->may_extrapolate, "Also outside the calibrated zooms");
  markers
      ->add_option("--offset-mm", options->markers.offset_mm,
                   "Write the point this far below each marker along its normal, mm")
      ->capture_default_str();
  markers
      ->add_option("--offset-sigma-mm", options->offset_sigma_mm,
                   "How exactly that point is made, x,y,z of the marker, mm (1 sigma)")
      ->delimiter(',')
      ->expected(3)
      ->check(CLI::Range(0.0, 10.0))
      ->capture_default_str();
  markers->add_option(
      "--marker-mm", options->markers.marker_mm,
      "Side of the black square, mm, to check and to measure by (default: not known)");
  markers
      ->add_option("--marker-sigma-mm", options->markers.marker_sigma_mm,
                   "How exactly the squares are made, mm (1 sigma); 0: only check")
      ->check(CLI::Range(0.0, 10.0))
      ->capture_default_str();
  markers->add_option("--seated", options->seated,
                      "Also write the calibration as these images show it, for `reconstruct` on "
                      "images of the same visit to the zoom");
  markers->add_option("--least", options->markers.least, "Refuse fewer markers than this")
      ->check(CLI::Range(1, 1000))
      ->capture_default_str();
  markers->add_option("--dictionary", options->dictionary, "OpenCV's name without DICT_")
      ->capture_default_str();
  markers->add_option("--out", options->out, "3D Slicer markups (.mrk.json)")->required();
  markers->add_flag("--json", options->is_json, "Print one JSON object on stdout");
  markers->footer(kExample);
  markers->callback([options] { run(*options); });
}

}  // namespace holdfast::rt
