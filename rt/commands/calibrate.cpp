// SPDX-License-Identifier: Apache-2.0
// `holdfast calibrate`: the stereo microscope's calibration over zoom, from images of a chessboard.
#include <cmath>
#include <cstdio>
#include <memory>
#include <optional>
#include <string>

#include <fmt/format.h>
#include <nlohmann/json.hpp>
#include <opencv2/core/utils/logger.hpp>
#include <unistd.h>

#include "bridge/atomic_file.hpp"
#include "bridge/command_line.hpp"
#include "registration/calibration_images.hpp"
#include "registration/calibration_run.hpp"
#include "registration/stereo_calibration.hpp"
#include "rt/commands/commands.hpp"
#include "rt/commands/grey_image.hpp"
#include "rt/core/error.hpp"

namespace holdfast::rt {
namespace {

using registration::BoardPattern;
using registration::BoardSearch;
using registration::BundleOptions;
using registration::calibrate_stereo;
using registration::CalibrationMethod;
using registration::CalibrationOptions;
using registration::CalibrationOutcome;
using registration::find_boards;
using registration::list_calibration_images;
using registration::SkippedPair;
using registration::stereo_calibration_text;
using registration::ViewError;
using registration::ViewReport;
using registration::ZoomReport;

constexpr const char* kExample =
    "Example: five zooms, about 19 pairs each, of a board with 9x5 inner corners\n"
    "  holdfast calibrate --images boards/ --board 9x5 --square-mm 3 --out stereo.yaml\n"
    "boards/zoom_1.1/left_00.png and right_00.png, and so on: one folder a zoom. Tilt the board "
    "in\n"
    "different directions (30 degrees are good) and bring it to every part of the field.\n"
    "Exit code 1: the views cannot carry a calibration; the reason is on stderr.";

struct Options {
  std::string images, board = "9x5", out, method = "joint";
  double square_mm = 3;
  std::optional<double> focus_mm;
  int threads = 2, coefficients = BundleOptions{}.coefficients;
  bool is_held_out = false, is_json = false;
};

BoardPattern pattern_of(const Options& options) {
  BoardPattern board;
  int read = 0;
  if (std::sscanf(options.board.c_str(), "%dx%d%n", &board.columns, &board.rows, &read) != 2 ||
      static_cast<std::size_t>(read) != options.board.size() || board.columns < 3 ||
      board.rows < 3 || board.columns > 50 || board.rows > 50)
    throw InputError("--board is '" + options.board +
                     "', must be columns x rows of inner corners, 3 to 50 each, like 9x5");
  if (board.columns == board.rows)
    throw InputError("--board is '" + options.board +
                     "', columns and rows must differ: a quarter turn could not be told");
  if (!(options.square_mm > 0.01 && options.square_mm < 1000))
    throw InputError(
        fmt::format("--square-mm is {:g}, must be 0.01 to 1000 mm", options.square_mm));
  if (options.focus_mm && !(*options.focus_mm > 1 && *options.focus_mm < 1e5))
    throw InputError(fmt::format("--focus-mm is {:g}, must be 1 to 1e5 mm", *options.focus_mm));
  board.square_mm = options.square_mm;
  return board;
}

void check_interrupt() {
  if (bridge::is_interrupted()) throw InterruptedError("interrupted");
}

cv::Mat read_grey(const std::string& path) {
  check_interrupt();
  return read_grey_image(path);
}

void tell(const std::string& what) {
  if (isatty(STDERR_FILENO) == 1) std::fprintf(stderr, "\r\033[K%s", what.c_str());
}

struct ClearLine {
  ~ClearLine() { tell(""); }
};

CalibrationOutcome calibrate(const Options& options, BoardSearch& search) {
  const BoardPattern board = pattern_of(options);
  CalibrationOptions settings;
  settings.board = board;
  settings.focus_mm = options.focus_mm;
  settings.is_held_out = options.is_held_out;
  settings.bundle.coefficients = options.coefficients;
  if (options.method == "plain") settings.method = CalibrationMethod::plain;
  const ClearLine clear;
  search = find_boards(list_calibration_images(options.images), board, options.threads, read_grey,
                       [](int done, int all) { tell(fmt::format("pair {} of {}", done, all)); });
  return calibrate_stereo(search.views, search.image.width, search.image.height, settings,
                          [](const std::string& what) {
                            check_interrupt();
                            tell(what);
                          });
}

nlohmann::ordered_json json_of(const ViewError& error) {
  return {{"reprojection_left_px", error.reprojection_left_px},
          {"reprojection_right_px", error.reprojection_right_px},
          {"epipolar_px", error.epipolar_px},
          {"board_mm", error.board_mm}};
}

nlohmann::ordered_json json_of(const ZoomReport& zoom) {
  nlohmann::ordered_json json;
  json["zoom"] = zoom.zoom;
  json["pairs_used"] = zoom.views.size();
  json["rms"] = json_of(zoom.rms);
  json["distance_mm"] = zoom.distance_mm;
  json["predicted_nonrigid_mm"] = nullptr;
  if (std::isfinite(zoom.predicted_nonrigid_mm))
    json["predicted_nonrigid_mm"] = zoom.predicted_nonrigid_mm;
  if (zoom.held_out) {
    json["held_out"] = json_of(*zoom.held_out);
    if (std::isfinite(*zoom.held_out_predicted_nonrigid_mm))
      json["held_out"]["predicted_nonrigid_mm"] = *zoom.held_out_predicted_nonrigid_mm;
  }
  for (const ViewReport& view : zoom.views) {
    nlohmann::ordered_json one = json_of(view.error);
    one["name"] = view.name;
    json["views"].push_back(one);
  }
  return json;
}

void print_json(const Options& options, const BoardSearch& search,
                const CalibrationOutcome& outcome) {
  nlohmann::ordered_json json;
  json["out"] = options.out;
  json["method"] = options.method;
  json["image_width"] = search.image.width;
  json["image_height"] = search.image.height;
  json["corner_sigma_px"] = outcome.corner_sigma_px;
  json["covariance_inflation"] = outcome.covariance_inflation;
  json["seating_px"] = outcome.seating_px;
  json["board_bend_mm"] = {outcome.bend_mm[0], outcome.bend_mm[1], outcome.bend_mm[2]};
  for (const ZoomReport& zoom : outcome.zooms) json["zooms"].push_back(json_of(zoom));
  json["skipped"] = nlohmann::ordered_json::array();
  for (const SkippedPair& skipped : search.skipped)
    json["skipped"].push_back({{"name", skipped.name}, {"reason", skipped.reason}});
  fmt::print("{}\n", json.dump());
}

void print_text(const Options& options, const BoardSearch& search,
                const CalibrationOutcome& outcome) {
  for (const SkippedPair& skipped : search.skipped) fmt::print("skipped {}\n", skipped.reason);
  for (const ZoomReport& zoom : outcome.zooms) {
    fmt::print("zoom {:g}\n", zoom.zoom);
    for (const ViewReport& view : zoom.views)
      fmt::print("  {}  left {:.3f} px  right {:.3f} px  epipolar {:.3f} px  board {:.4f} mm\n",
                 view.name, view.error.reprojection_left_px, view.error.reprojection_right_px,
                 view.error.epipolar_px, view.error.board_mm);
  }
  fmt::print("\n zoom  pairs  left px  right px  epipolar px  board mm  predicted mm{}\n",
             options.is_held_out ? "   held out: px  board mm" : "");
  for (const ZoomReport& zoom : outcome.zooms) {
    fmt::print("{:5g}  {:5}  {:7.3f}  {:8.3f}  {:11.3f}  {:8.4f}  {:12.4f}", zoom.zoom,
               zoom.views.size(), zoom.rms.reprojection_left_px, zoom.rms.reprojection_right_px,
               zoom.rms.epipolar_px, zoom.rms.board_mm, zoom.predicted_nonrigid_mm);
    if (zoom.held_out)
      fmt::print(
          "   {:12.3f}  {:8.4f}",
          std::hypot(zoom.held_out->reprojection_left_px, zoom.held_out->reprojection_right_px) /
              std::sqrt(2.0),
          zoom.held_out->board_mm);
    fmt::print("\n");
  }
  fmt::print("{}: written; predicted mm: non-rigid error in the working volume, 1 sigma\n",
             options.out);
}

void run(const Options& options) {
  cv::utils::logging::setLogLevel(cv::utils::logging::LOG_LEVEL_SILENT);
  cv::setNumThreads(1);  // the images are the parallel work
  bridge::catch_interrupts();
  BoardSearch search;
  const CalibrationOutcome outcome = calibrate(options, search);
  check_interrupt();
  bridge::write_file_atomically(options.out, stereo_calibration_text(outcome.calibration));
  if (options.is_json)
    print_json(options, search, outcome);
  else
    print_text(options, search, outcome);
}

}  // namespace

void add_calibrate(CLI::App& app) {
  auto options = std::make_shared<Options>();
  CLI::App* calibrate =
      app.add_subcommand("calibrate", "Calibrate the stereo microscope over its zooms.");
  calibrate->add_option("--images", options->images, "Folder with zoom_<zoom>/left_*, right_*")
      ->required();
  calibrate->add_option("--board", options->board, "Inner corners, columns x rows")
      ->capture_default_str();
  calibrate->add_option("--square-mm", options->square_mm, "Side of a square, mm")
      ->capture_default_str();
  calibrate->add_option("--focus-mm", options->focus_mm,
                        "Working distance as the microscope reports it, mm (default: measured)");
  calibrate
      ->add_option("--method", options->method,
                   "joint: bundle adjustment over all zooms; plain: each zoom through OpenCV")
      ->check(CLI::IsMember({"joint", "plain"}))
      ->capture_default_str();
  calibrate->add_option("--coefficients", options->coefficients, "Of the distortion, with joint")
      ->check(CLI::IsMember({5, 12}))
      ->capture_default_str();
  calibrate->add_flag("--hold-out", options->is_held_out,
                      "Also predict every inner zoom from the others");
  calibrate->add_option("--threads", options->threads, "Images at a time")
      ->check(CLI::Range(1, 64))
      ->capture_default_str();
  calibrate->add_option("--out", options->out, "The calibration (OpenCV FileStorage)")->required();
  calibrate->add_flag("--json", options->is_json, "Print one JSON object on stdout");
  calibrate->footer(kExample);
  calibrate->callback([options] { run(*options); });
}

}  // namespace holdfast::rt
