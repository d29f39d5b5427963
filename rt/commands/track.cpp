// SPDX-License-Identifier: Apache-2.0
// `holdfast track`: follows the site through a recorded sequence, against its first frame, and
// writes the trajectory.
#include <algorithm>
#include <cstdio>
#include <cstdlib>
#include <map>
#include <memory>
#include <optional>
#include <set>
#include <string>
#include <vector>

#include <fmt/format.h>
#include <nlohmann/json.hpp>
#include <opencv2/core/utils/logger.hpp>
#include <unistd.h>

#include "bridge/atomic_file.hpp"
#include "bridge/camera_file.hpp"
#include "bridge/command_line.hpp"
#include "bridge/depth_file.hpp"
#include "bridge/image_file.hpp"
#include "bridge/image_sequence.hpp"
#include "bridge/surface_depth.hpp"
#include "perception/direct_tracker.hpp"
#include "perception/paper_tracker.hpp"
#include "perception/site.hpp"
#include "perception/tracker.hpp"
#include "perception/tracker_parameters.hpp"
#include "registration/rectification.hpp"
#include "registration/stereo_calibration.hpp"
#include "rt/commands/commands.hpp"
#include "rt/core/error.hpp"
#include "rt/study/stage_statistics.hpp"
#include "rt/study/trajectory_file.hpp"

namespace holdfast::rt {
namespace {

using perception::MotionEstimate;
using perception::TrackingReason;
using perception::TrackingStatus;

constexpr const char* kExample =
    "Example: a recording of the site with the depth that `holdfast reconstruct` made\n"
    "  holdfast track --frames recording/ --calibration stereo.yaml --zoom 1.3 --depth d.tiff "
    "--out poses.csv\n"
    "or 200 mm below a calibrated camera, nothing more known\n"
    "  holdfast track --frames recording/ --camera camera.yaml --plane-mm 200 --out poses.csv\n"
    "The first frame is the keyframe. With --depth or --surface the motion has six degrees of "
    "freedom;\nwith --plane-mm it is planar. --method: direct aligns every frame to the keyframe "
    "directly and\nchecks it with ORB features every third frame; orb uses the features alone; "
    "paper cascades affine\nmotions from frame to frame as published: it drifts, for comparison "
    "only. Exit code 1: the first\nframe cannot serve, or every other was lost.";

struct Options {
  std::string frames, camera, calibration, depth, surface, mask, out, tum, method = "direct";
  std::optional<double> plane_mm, fps, zoom;
  int features = perception::FeatureParameters{}.count;
  bool is_json = false;
};

struct Outcome {
  int frames = 0;
  std::map<TrackingStatus, int> count;
  std::map<TrackingReason, int> reasons;              // of the frames that are not tracked
  TrackingReason last_reason = TrackingReason::none;  // of the newest lost frame
  std::string csv = trajectory_header(), tum;
  StageStatistics stages;
  struct Ties {  // keyframes tied to the first
    std::set<int> used;
    int frames = 0, doubted = 0,
        seen_again = 0;      // by one; a tie in doubt; the first seen meanwhile
    double jump_um_max = 0;  // of the latter
  } ties;

  void add(const bridge::SequenceFrame& frame, const MotionEstimate& estimate);
};

void Outcome::add(const bridge::SequenceFrame& frame, const MotionEstimate& estimate) {
  ++frames;
  ++count[estimate.status];
  if (estimate.reason != TrackingReason::none) ++reasons[estimate.reason];
  if (estimate.status == TrackingStatus::lost) last_reason = estimate.reason;
  csv += trajectory_row(frame.index, frame.t, estimate);
  tum += tum_row(frame.t, estimate);
  stages.add(estimate.times);
  if (estimate.reason == TrackingReason::tie_doubtful) ++ties.doubted;
  if (estimate.status == TrackingStatus::lost) return;
  if (estimate.keyframe > 0) {
    ties.used.insert(estimate.keyframe);
    ++ties.frames;
  }
  if (estimate.has_tie_jump) {
    ++ties.seen_again;
    ties.jump_um_max = std::max(ties.jump_um_max, estimate.tie_jump_um);
  }
}

cv::Mat mask_of(const Options& options, const perception::CameraModel& camera) {
  if (options.mask.empty()) return {};
  cv::Mat mask = bridge::read_image_file(options.mask);
  if (mask.type() != CV_8UC1) throw InputError(options.mask + ": must be 8-bit grey");
  if (mask.cols != camera.width_px || mask.rows != camera.height_px)
    throw InputError(fmt::format("{}: is {}x{} px, must be {}x{} px as the camera", options.mask,
                                 mask.cols, mask.rows, camera.width_px, camera.height_px));
  return mask;
}

/// The first frame becomes the keyframe; its row is the identity by definition, its evidence that
/// of finding itself again.
template <typename AnyTracker>
MotionEstimate take_keyframe(AnyTracker& tracker, const bridge::SequenceFrame& frame,
                             const perception::SiteGeometry& geometry, const cv::Mat& mask) {
  const TrackingReason reason = tracker.set_keyframe(frame.image, geometry, mask);
  if (reason != TrackingReason::none)
    throw RefusedError(
        fmt::format("{}: cannot serve as the keyframe: {}", frame.name, name(reason)));
  MotionEstimate estimate = tracker.track(frame.image, frame.t);
  if (estimate.status == TrackingStatus::lost)
    throw RefusedError(
        fmt::format("{}: cannot serve as the keyframe: it is not found again in "
                    "itself: {}",
                    frame.name, name(estimate.reason)));
  estimate.T_camera_site.setIdentity();
  estimate.dx_um = estimate.dy_um = estimate.rotation_rad = 0;
  estimate.scale = 1;
  return estimate;
}

class Progress {
 public:
  explicit Progress(int total) : total_(total), is_shown_(isatty(STDERR_FILENO) == 1) {}
  ~Progress() {
    if (is_shown_) std::fputs("\r\033[K", stderr);
  }
  Progress(const Progress&) = delete;
  Progress& operator=(const Progress&) = delete;
  void show(int frame) const {
    if (!is_shown_) return;
    if (total_ > 0)
      std::fprintf(stderr, "\rframe %d of %d", frame + 1, total_);
    else
      std::fprintf(stderr, "\rframe %d", frame + 1);
  }

 private:
  int total_;
  bool is_shown_;
};

/// What the frames are seen with: a camera and, with a stereo calibration, where its depth lives.
struct Viewer {
  perception::CameraModel camera;
  std::optional<registration::Rectification> rectification;
};

Viewer viewer_of(const Options& options) {
  if (options.calibration.empty()) return {bridge::read_camera_file(options.camera), std::nullopt};
  const auto calibration = registration::read_stereo_calibration(options.calibration);
  const auto zoom = registration::calibration_at_zoom(calibration, *options.zoom);
  Viewer viewer;
  viewer.camera.width_px = calibration.image_width_px;
  viewer.camera.height_px = calibration.image_height_px;
  const cv::Matx33d& K = zoom.camera_matrix_left;
  viewer.camera.fx_px = K(0, 0);
  viewer.camera.fy_px = K(1, 1);
  viewer.camera.cx_px = K(0, 2);
  viewer.camera.cy_px = K(1, 2);
  viewer.camera.distortion = zoom.distortion_left.clone();
  viewer.rectification = registration::rectification_of(
      zoom, cv::Size(calibration.image_width_px, calibration.image_height_px));
  if (const auto what = perception::invalid_camera(viewer.camera))
    throw InputError(options.calibration + ": left camera: " + *what);
  return viewer;
}

/// With a stereo calibration the depth lies on the rectified left grid.
perception::SiteDepth depth_of(const Options& options, const Viewer& viewer) {
  perception::SiteDepth site;
  const perception::CameraModel& camera = viewer.camera;
  if (options.depth.empty()) {
    site.depth_mm = bridge::depth_from_surface_file(options.surface, camera);
    return site;
  }
  site.depth_mm = bridge::read_depth_file(options.depth, camera.width_px, camera.height_px);
  if (!viewer.rectification) return site;
  const registration::Rectification& r = *viewer.rectification;
  site.grid = perception::PixelGrid{r.P1(0, 0), r.P1(1, 1), r.P1(0, 2), r.P1(1, 2)};
  for (int i = 0; i < 3; ++i)
    for (int j = 0; j < 3; ++j) site.R_depth_camera(i, j) = r.R1(i, j);
  return site;
}

perception::SiteGeometry geometry_of(const Options& options, const Viewer& viewer) {
  perception::SiteGeometry geometry;
  std::string source = "--plane-mm";
  if (options.plane_mm) {
    geometry = perception::SitePlane{*options.plane_mm};
  } else {
    source = options.depth.empty() ? options.surface : options.depth;
    geometry = depth_of(options, viewer);
  }
  if (const auto what = perception::invalid_geometry(viewer.camera, geometry))
    throw InputError(source + ": " + *what);
  return geometry;
}

template <typename AnyTracker>
Outcome follow_with(AnyTracker tracker, const Options& options, bridge::ImageSequence& sequence,
                    const Viewer& viewer) {
  const perception::CameraModel& camera = viewer.camera;
  const perception::SiteGeometry geometry = geometry_of(options, viewer);
  const cv::Mat mask = mask_of(options, camera);
  const Progress progress(sequence.size());
  Outcome outcome;
  while (const auto frame = sequence.next()) {
    if (bridge::is_interrupted()) throw InterruptedError("interrupted");
    if (frame->image.cols != camera.width_px || frame->image.rows != camera.height_px)
      throw InputError(fmt::format("{}: is {}x{} px, must be {}x{} px as the camera", frame->name,
                                   frame->image.cols, frame->image.rows, camera.width_px,
                                   camera.height_px));
    progress.show(frame->index);
    outcome.add(*frame, frame->index == 0 ? take_keyframe(tracker, *frame, geometry, mask)
                                          : tracker.track(frame->image, frame->t));
  }
  const int followed = outcome.frames - 1;
  if (followed > 0 && outcome.count[TrackingStatus::lost] == followed)
    throw RefusedError(fmt::format("{}: all {} frames after the keyframe are lost, the last: {}",
                                   options.frames, followed, name(outcome.last_reason)));
  return outcome;
}

Outcome follow(const Options& options, bridge::ImageSequence& sequence, const Viewer& viewer) {
  perception::TrackerParameters parameters;
  parameters.features.count = options.features;
  if (const auto what = perception::invalid_parameter(parameters)) throw InputError(*what);
  if (options.method == "paper")
    return follow_with(perception::PaperTracker(viewer.camera, parameters), options, sequence,
                       viewer);
  if (options.method == "orb")
    return follow_with(perception::Tracker(viewer.camera, parameters), options, sequence, viewer);
  return follow_with(perception::DirectTracker(viewer.camera, parameters), options, sequence,
                     viewer);
}

const char* text(bridge::TimeSource source) {
  switch (source) {
    case bridge::TimeSource::timestamps_file:
      return "timestamps.csv";
    case bridge::TimeSource::given_rate:
      return "--fps";
    case bridge::TimeSource::video_rate:
      return "the video's frame rate";
    case bridge::TimeSource::assumed_rate:
      break;
  }
  return "assumed 30 frames/s";
}

void report(const Options& options, Outcome& outcome, bridge::TimeSource times) {
  if (options.is_json) {
    nlohmann::ordered_json json;
    json["frames"] = outcome.frames;
    for (const auto status : {TrackingStatus::lost, TrackingStatus::tracking,
                              TrackingStatus::relocalised, TrackingStatus::degraded})
      json[std::string(name(status))] = outcome.count[status];
    json["reasons"] = nlohmann::ordered_json::object();
    for (const auto& [reason, frames] : outcome.reasons)
      json["reasons"][std::string(name(reason))] = frames;
    const Outcome::Ties& ties = outcome.ties;
    json["tied_keyframes"] = {{"used", ties.used.size()},
                              {"frames", ties.frames},
                              {"doubted", ties.doubted},
                              {"first_seen_again", ties.seen_again},
                              {"jump_um_max", ties.jump_um_max}};
    json["times"] = text(times);
    for (const StageTime& stage : outcome.stages.stages())
      json["timing_ms"][stage.name] = {{"median", stage.median_ms}, {"p99", stage.p99_ms}};
    json["out"] = options.out;
    fmt::print("{}\n", json.dump());
    return;
  }
  fmt::print("{}: {} frames, {} tracking, {} relocalised, {} degraded, {} lost; times: {}\n",
             options.out, outcome.frames, outcome.count[TrackingStatus::tracking],
             outcome.count[TrackingStatus::relocalised], outcome.count[TrackingStatus::degraded],
             outcome.count[TrackingStatus::lost], text(times));
  for (const auto& [reason, frames] : outcome.reasons)
    fmt::print("{:>7}  {}\n", frames, name(reason));
  for (const StageTime& stage : outcome.stages.stages())
    if (stage.max_ms > 0)
      fmt::print("{:>7}  median {:7.2f} ms  p99 {:7.2f} ms\n", stage.name, stage.median_ms,
                 stage.p99_ms);
}

void run(const Options& options) {
  // The decoders' own chatter would break the one line that a failure prints.
  cv::utils::logging::setLogLevel(cv::utils::logging::LOG_LEVEL_SILENT);
  setenv("OPENCV_FFMPEG_LOGLEVEL", "-8", 0);
  cv::setNumThreads(1);  // as in the daemon, so that the times shown are the daemon's
  bridge::catch_interrupts();
  if (options.calibration.empty() == options.camera.empty())
    throw InputError("either --camera or --calibration with --zoom must be given");
  if (options.calibration.empty() != !options.zoom)
    throw InputError("--calibration and --zoom go together");
  const Viewer viewer = viewer_of(options);
  bridge::ImageSequence sequence(options.frames, options.fps);
  Outcome outcome = follow(options, sequence, viewer);
  bridge::AtomicFile csv(options.out);
  csv.write(outcome.csv);
  if (!options.tum.empty()) bridge::write_file_atomically(options.tum, outcome.tum);
  csv.commit();
  report(options, outcome, sequence.time_source());
}

}  // namespace

void add_track(CLI::App& app) {
  auto options = std::make_shared<Options>();
  CLI::App* track = app.add_subcommand("track", "Follow the site through a recorded sequence.");
  track->add_option("--frames", options->frames, "Folder of images in name order, or a video")
      ->required();
  track->add_option("--camera", options->camera, "camera.yaml as OpenCV's calibration writes it");
  track->add_option("--calibration", options->calibration,
                    "Instead of --camera: stereo.yaml; the frames are the left camera's");
  track->add_option("--zoom", options->zoom, "With --calibration: the zoom of the recording");
  CLI::Option_group* site = track->add_option_group("site", "What is known of the site's shape");
  site->add_option("--plane-mm", options->plane_mm, "A plane facing the camera at this depth, mm");
  site->add_option("--depth", options->depth,
                   "Depth on the keyframe's undistorted pixel grid, with --calibration on the "
                   "rectified left grid: 32-bit float TIFF, mm");
  site->add_option("--surface", options->surface,
                   "PLY, mm, in the camera's frame, or rectified with a comment R1");
  site->require_option(1);
  track->add_option(
      "--mask", options->mask,
      "8-bit image of the keyframe's size; 0 = the keyframe's content here is not used");
  track->add_option("--method", options->method, "How the motion is found")
      ->check(CLI::IsMember({"direct", "orb", "paper"}))
      ->capture_default_str();
  track->add_option("--fps", options->fps, "Frame rate; overrides timestamps.csv");
  track->add_option("--features", options->features, "ORB features per frame")
      ->capture_default_str();
  track->add_option("--out", options->out, "The trajectory, one row a frame (CSV)")->required();
  track->add_option("--tum", options->tum, "The same poses in TUM format (m)");
  track->add_flag("--json", options->is_json, "Print one JSON object on stdout");
  track->footer(kExample);
  track->callback([options] { run(*options); });
}

}  // namespace holdfast::rt
