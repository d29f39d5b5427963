// SPDX-License-Identifier: Apache-2.0
// `holdfast reconstruct`: the metric surface under the microscope from a stereo pair, or a burst.
#include <algorithm>
#include <cmath>
#include <deque>
#include <filesystem>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include <fmt/format.h>
#include <malloc.h>
#include <nlohmann/json.hpp>
#include <opencv2/core/utils/logger.hpp>
#include <opencv2/imgcodecs.hpp>

#include "bridge/atomic_file.hpp"
#include "bridge/command_line.hpp"
#include "bridge/image_file.hpp"
#include "registration/pattern_lattice.hpp"
#include "registration/reconstruction.hpp"
#include "rt/commands/commands.hpp"
#include "rt/commands/grey_image.hpp"
#include "rt/commands/next_pattern.hpp"
#include "rt/core/error.hpp"

namespace holdfast::rt {
namespace {

namespace fs = std::filesystem;
using registration::Reconstruction;
using registration::ReconstructionStatus;
using registration::ReconstructionTimes;

constexpr const char* kExample =
    "Example: the region of the ear, at zoom 1.3, with its depth for the tracker\n"
    "  holdfast reconstruct --left left.png --right right.png --calibration stereo.yaml --zoom 1.3 "
    "\\\n    --roi 600,400,1200,1000 --out mire.ply --depth depth.tiff\n"
    "The surface is in the rectified left camera (p = R1 * p_camera; the PLY says R1). A burst, "
    "several\nshots of the unmoved scene with different patterns, is given as --burst DIR or by "
    "repeating\n--left and --right. Exit code 1: the pair cannot be believed (too dark, saturated, "
    "no pattern,\nviews swapped, another zoom's calibration, too few matches, or a lattice, under "
    "which the surface\ncould be a period off). Project an aperiodic pattern, `holdfast pattern`'s "
    "default. For a comparison\nwith paper A, --for-comparison takes a lattice; the surface says "
    "so, and `register` refuses it.\n--pattern asks the projected image too, and says at once what "
    "the views could only show.";

struct Options {
  std::vector<std::string> left, right;
  std::string burst, calibration, pattern, out, depth, confidence, variance, reasons,
      method = "sgm";
  std::string next_pattern;
  registration::PatternParameters next{registration::PatternKind::aperiodic, 4, 4, 2};
  std::vector<int> roi;
  double zoom = 0, depth_centre_mm = 0, depth_reach_mm = 30;
  int threads = 2, repeat = 1, step = 1;
  bool is_rectified = false, may_extrapolate = false, may_be_lattice = false, is_json = false;
};

/// DIR/left_*.png and DIR/right_*.png with the same ending, as `calibrate` takes them.
void add_burst(Options& options) {
  std::error_code error;
  std::vector<std::string> left;
  for (const auto& entry : fs::directory_iterator(options.burst, error))
    if (entry.path().filename().string().rfind("left_", 0) == 0)
      left.push_back(entry.path().string());
  if (error) throw InputError(options.burst + ": cannot be read: " + error.message());
  std::sort(left.begin(), left.end());
  for (const std::string& file : left) {
    const fs::path path(file);
    options.left.push_back(file);
    options.right.push_back(
        (path.parent_path() / ("right_" + path.filename().string().substr(5))).string());
  }
  if (left.empty()) throw InputError(options.burst + ": holds no left_* image");
}

std::vector<registration::StereoShot> read_shots(const Options& options) {
  if (options.left.size() != options.right.size() || options.left.empty())
    throw InputError(fmt::format("{} left and {} right images, must be pairs", options.left.size(),
                                 options.right.size()));
  std::vector<registration::StereoShot> shots;
  for (std::size_t i = 0; i < options.left.size(); ++i)
    shots.push_back(
        {bridge::read_image_file(options.left[i]), bridge::read_image_file(options.right[i])});
  return shots;
}

void check_sizes(const Options& options, const std::vector<registration::StereoShot>& shots,
                 cv::Size size) {
  for (std::size_t i = 0; i < shots.size(); ++i)
    for (const bool is_left : {true, false}) {
      const cv::Mat& image = is_left ? shots[i].left : shots[i].right;
      if (image.size() != size)
        throw InputError(fmt::format("{}: is {}x{} px, must be {}x{} px as in {}",
                                     is_left ? options.left[i] : options.right[i], image.cols,
                                     image.rows, size.width, size.height, options.calibration));
    }
}

registration::ReconstructionOptions reconstruction_options(const Options& options) {
  registration::ReconstructionOptions result;
  if (!options.roi.empty())
    result.roi_px = cv::Rect(options.roi[0], options.roi[1], options.roi[2], options.roi[3]);
  result.depth_centre_mm = options.depth_centre_mm;
  result.depth_reach_mm = options.depth_reach_mm;
  result.is_rectified = options.is_rectified;
  result.threads = options.threads;
  result.may_be_lattice = options.may_be_lattice;
  result.is_explained = !options.reasons.empty() || !options.next_pattern.empty();
  if (options.method == "opencv") result.method = registration::MatchMethod::opencv;
  return result;
}

/// The projected image, if it is given.
void check_pattern(const Options& options) {
  if (options.pattern.empty() || options.may_be_lattice) return;
  registration::WorkerPool pool(options.threads);
  const registration::ImageRepetition found =
      registration::repetition_of(read_grey_image(options.pattern), pool);
  if (found.share > registration::kRepetitionMax)
    throw RefusedError(fmt::format(
        "{}: is a lattice: {:.2f} of it comes again {:.0f},{:.0f} px further, limit {:.2f}",
        options.pattern, found.share, found.step_px.x, found.step_px.y,
        registration::kRepetitionMax));
}

void check_next_pattern(const Options& options) {
  if (options.next_pattern.empty()) return;
  if (options.pattern.empty())
    throw InputError("--next-pattern: needs --pattern, the image that was projected");
  if (options.is_rectified || options.may_be_lattice || options.method == "opencv")
    throw InputError("--next-pattern: not with --rectified, --for-comparison or --method opencv");
  if (const auto invalid = registration::invalid_pattern(options.next)) throw InputError(*invalid);
}

double median_ms(const std::vector<ReconstructionTimes>& times,
                 std::chrono::nanoseconds ReconstructionTimes::*stage) {
  std::vector<double> ms;
  for (const ReconstructionTimes& t : times)
    ms.push_back(static_cast<double>((t.*stage).count()) / 1e6);
  const auto middle = ms.begin() + static_cast<std::ptrdiff_t>(ms.size() / 2);
  std::nth_element(ms.begin(), middle, ms.end());
  return *middle;
}

nlohmann::ordered_json timing_of(const std::vector<ReconstructionTimes>& times) {
  return {{"rectify", median_ms(times, &ReconstructionTimes::rectify)},
          {"match", median_ms(times, &ReconstructionTimes::match)},
          {"refine", median_ms(times, &ReconstructionTimes::refine)},
          {"reproject", median_ms(times, &ReconstructionTimes::reproject)},
          {"total", median_ms(times, &ReconstructionTimes::total)}};
}

template <int Rows, int Columns>
nlohmann::json rows_of(const cv::Matx<double, Rows, Columns>& matrix) {
  nlohmann::json rows = nlohmann::json::array();
  for (int r = 0; r < Rows; ++r) {
    nlohmann::json row = nlohmann::json::array();
    for (int c = 0; c < Columns; ++c) row.push_back(matrix(r, c));
    rows.push_back(row);
  }
  return rows;
}

std::string tiff_bytes(const cv::Mat1f& map) {
  std::vector<uchar> bytes;
  if (!cv::imencode(".tiff", map, bytes)) throw InputError("a map cannot be encoded as TIFF");
  return {bytes.begin(), bytes.end()};
}

/// All files or none: written beside their places first, then put there.
void write_files(const Options& options, const Reconstruction& result,
                 const registration::Rectification& geometry, const NextPattern& next) {
  constexpr float kNan = std::numeric_limits<float>::quiet_NaN();
  std::deque<bridge::AtomicFile> files;
  const auto add = [&files](const std::string& path, const std::string& bytes) {
    if (!path.empty()) files.emplace_back(path).write(bytes);
  };
  const auto add_map = [&](const std::string& path, const cv::Mat1f& map, float outside) {
    if (path.empty()) return;
    add(path,
        tiff_bytes(registration::on_whole_grid(map, result.region_px, geometry.size_px, outside)));
  };
  add(options.out, registration::ply_bytes(registration::mesh_of(result, geometry, options.step)));
  add_map(options.depth, result.depth_mm, kNan);
  add_map(options.variance, result.depth_variance_mm2, kNan);
  add_map(options.confidence, result.confidence, 0.F);
  if (!options.reasons.empty()) {
    cv::Mat1b whole(geometry.size_px, static_cast<uchar>(registration::PixelReason::outside));
    result.reasons.copyTo(whole(result.region_px));
    std::vector<uchar> png;
    cv::imencode(".png", whole, png);
    add(options.reasons, {png.begin(), png.end()});
  }
  add(options.next_pattern, next.png);
  for (bridge::AtomicFile& file : files) file.commit();
}

/// Shares of the region.
nlohmann::ordered_json reasons_of(const Reconstruction& result) {
  using registration::PixelReason;
  nlohmann::ordered_json shares = nlohmann::ordered_json::object();
  constexpr std::pair<const char*, PixelReason> kNames[] = {{"known", PixelReason::known},
                                                            {"outside", PixelReason::outside},
                                                            {"unmatched", PixelReason::unmatched},
                                                            {"uncertain", PixelReason::uncertain},
                                                            {"repeating", PixelReason::repeating}};
  for (const auto& [name, reason] : kNames)
    shares[name] =
        static_cast<double>(cv::countNonZero(result.reasons == static_cast<uchar>(reason))) /
        static_cast<double>(result.reasons.total());
  return shares;
}

void report(const Options& options, const Reconstruction& result,
            const registration::Rectification& geometry,
            const std::vector<ReconstructionTimes>& times, const NextPattern& next) {
  const auto timing = timing_of(times);
  if (options.is_json) {
    nlohmann::ordered_json json;
    json["points"] = result.points;
    json["density"] = result.density;
    if (!options.reasons.empty()) json["reasons"] = reasons_of(result);
    json["timing_ms"] = timing;
    json["rectification"] = {
        {"R1", rows_of(geometry.R1)}, {"P1", rows_of(geometry.P1)}, {"P2", rows_of(geometry.P2)}};
    json["region_px"] = {result.region_px.x, result.region_px.y, result.region_px.width,
                         result.region_px.height};
    json["vertical_disparity_px"] = result.vertical_disparity_px;
    json["ambiguous_share"] = result.ambiguous_share;
    json["image_repetition"] = result.image_repetition;
    json["is_for_comparison"] = result.is_for_comparison;
    json["method"] = options.method;
    json["shots"] = options.left.size();
    json["out"] = options.out;
    if (!options.next_pattern.empty()) json["next_pattern"] = next.report;
    fmt::print("{}\n", json.dump());
    return;
  }
  fmt::print("{}: {} points, {:.1f} % of the region; rows agree to {:.2f} px\n", options.out,
             result.points, 100 * result.density, result.vertical_disparity_px);
  for (const auto& [stage, ms] : timing.items())
    fmt::print("{:>9}  {:7.1f} ms\n", stage, ms.get<double>());
}

/// A reconstruction's maps, freed, stay with the process: to have them again from the system would
/// cost every further one a quarter of its time.
void keep_memory() {
  constexpr int kKeptBytes = 1 << 30;
  mallopt(M_MMAP_THRESHOLD, kKeptBytes);
  mallopt(M_TRIM_THRESHOLD, kKeptBytes);
}

void run(Options& options) {
  if (options.repeat > 1) keep_memory();
  cv::utils::logging::setLogLevel(cv::utils::logging::LOG_LEVEL_SILENT);
  bridge::catch_interrupts();
  if (!options.burst.empty()) add_burst(options);
  if (options.method == "opencv" && !options.reasons.empty())
    throw InputError("--reasons: --method opencv gives none");
  check_next_pattern(options);
  if (options.method == "opencv" && options.left.size() > 1)
    throw InputError("--method opencv takes one pair, not a burst");
  const auto calibration = registration::read_stereo_calibration(options.calibration);
  const auto zoom =
      registration::calibration_at_zoom(calibration, options.zoom, options.may_extrapolate);
  const cv::Size size(calibration.image_width_px, calibration.image_height_px);
  check_pattern(options);
  const auto shots = read_shots(options);
  check_sizes(options, shots, size);
  cv::setNumThreads(options.threads);
  registration::Reconstructor reconstructor(zoom, size, reconstruction_options(options));
  std::vector<ReconstructionTimes> times;
  Reconstruction result;
  for (int i = 0; i < options.repeat; ++i) {
    if (bridge::is_interrupted()) throw InterruptedError("interrupted");
    result = reconstructor.reconstruct(shots);
    if (result.status != ReconstructionStatus::done)
      throw RefusedError(fmt::format("{}, {}: {}: {}", options.left[0], options.right[0],
                                     name(result.status), result.evidence));
    times.push_back(result.times);
  }
  if (bridge::is_interrupted()) throw InterruptedError("interrupted");
  NextPattern next;
  if (!options.next_pattern.empty())
    next = next_pattern(
        {options.pattern, options.next, shots[0], zoom, result, reconstructor.rectification()});
  write_files(options, result, reconstructor.rectification(), next);
  report(options, result, reconstructor.rectification(), times, next);
}

}  // namespace

void add_reconstruct(CLI::App& app) {
  auto options = std::make_shared<Options>();
  CLI::App* reconstruct =
      app.add_subcommand("reconstruct", "The surface under the microscope from a stereo pair.");
  CLI::Option* left =
      reconstruct->add_option("--left", options->left, "Raw left image; repeatable");
  CLI::Option* right =
      reconstruct->add_option("--right", options->right, "Raw right image; repeatable");
  reconstruct
      ->add_option("--burst", options->burst, "Folder of left_* and right_* images of one scene")
      ->excludes(left)
      ->excludes(right);
  reconstruct->add_option("--calibration", options->calibration, "stereo.yaml")->required();
  reconstruct->add_option("--zoom", options->zoom, "The zoom the images were taken at")->required();
  reconstruct->add_flag("--extrapolate", options->may_extrapolate,
                        "Allow a zoom outside the calibrated ones");
  reconstruct->add_flag("--rectified", options->is_rectified, "The images are rectified already");
  reconstruct->add_option("--roi", options->roi, "x,y,w,h: only this part of the left image, px")
      ->delimiter(',')
      ->expected(4);
  reconstruct->add_option("--depth-centre-mm", options->depth_centre_mm,
                          "Middle of the depths searched (default: the working distance)");
  reconstruct->add_option("--depth-reach-mm", options->depth_reach_mm, "Depths on both sides of it")
      ->capture_default_str();
  reconstruct->add_option("--method", options->method, "sgm, or opencv: the baseline (SGBM)")
      ->check(CLI::IsMember({"sgm", "opencv"}))
      ->capture_default_str();
  reconstruct->add_option("--pattern", options->pattern,
                          "The projected image: refused where it is a lattice");
  reconstruct->add_option(
      "--next-pattern", options->next_pattern,
      "What to project next on the unmoved scene, after --pattern (of the first pair): PNG");
  reconstruct->add_option("--next-dots", options->next.dot_px, "With --next-pattern: dots, px")
      ->capture_default_str();
  reconstruct
      ->add_option("--next-distance", options->next.distance_px,
                   "With --next-pattern: gap between dots, px")
      ->capture_default_str();
  reconstruct->add_option("--next-seed", options->next.seed, "With --next-pattern: of the dots")
      ->capture_default_str();
  reconstruct->add_flag(
      "--for-comparison", options->may_be_lattice,
      "Take a lattice, if within the depths searched it fits in one place only; `register` will "
      "refuse the surface");
  reconstruct->add_option("--out", options->out, "The surface (PLY, mm, rectified left)")
      ->required();
  reconstruct->add_option("--depth", options->depth, "Depth: 32-bit float TIFF, mm, NaN unknown");
  reconstruct->add_option("--variance", options->variance, "Variance of the depth: TIFF, mm2");
  reconstruct->add_option("--confidence", options->confidence, "Confidence 0 … 1: TIFF");
  reconstruct->add_option("--reasons", options->reasons,
                          "Why each pixel is known or not, for `register --coverage`: PNG");
  reconstruct->add_option("--step", options->step, "Points every so many pixels in the PLY")
      ->check(CLI::Range(1, 64))
      ->capture_default_str();
  reconstruct
      ->add_option("--threads", options->threads, "Threads; the result does not depend on it")
      ->check(CLI::Range(1, 64))
      ->capture_default_str();
  reconstruct->add_option("--repeat", options->repeat, "Do the work so often; report median times")
      ->check(CLI::Range(1, 10000))
      ->capture_default_str();
  reconstruct->add_flag("--json", options->is_json, "Print one JSON object on stdout");
  reconstruct->footer(kExample);
  reconstruct->callback([options] { run(*options); });
}

}  // namespace holdfast::rt
