// SPDX-License-Identifier: Apache-2.0
// The direct tracker against paper B's method as a practitioner writes it with OpenCV
// (perception/paper_tracker.hpp), frame by frame in turn on the same pictures, one thread
// on one CPU each; the direct tracker's check runs beside, as in the daemon. Speed, and the error
// of both on a trajectory shaped like paper B's spiral over a surface with relief: with its true
// depth, and with a depth as wrong as a reconstruction is. Beside it, what the live view takes from
// the tracker's thread with each frame it is handed, and its own thread's work on one.
#include <algorithm>
#include <chrono>
#include <cmath>
#include <cstdio>
#include <filesystem>
#include <string>
#include <vector>

#include <opencv2/imgproc.hpp>
#include <sched.h>
#include <unistd.h>

#include "bridge/atomic_file.hpp"
#include "perception/direct_tracker.hpp"
#include "perception/paper_tracker.hpp"
#include "perception/tracker_parameters.hpp"
#include "rt/core/error.hpp"
#include "rt/live_view.hpp"
#include "tests/perception/support/moving_scene.hpp"

namespace {

using namespace holdfast;
using Clock = std::chrono::steady_clock;

constexpr double kDepthMm = 200;
constexpr int kFrames = 60;
constexpr double kPaperFrameToFrameUm = 93.2, kPaperFrameMs = 327;  // paper B, tables 1 and 2

/// NaN of nothing.
double percentile(std::vector<double> values, double share) {
  if (values.empty()) return std::nan("");
  std::sort(values.begin(), values.end());
  return values[static_cast<std::size_t>(
      std::lround(share * static_cast<double>(values.size() - 1)))];
}

struct Row {
  std::string name, unit;
  std::vector<double> ours, theirs;
};

double milliseconds(Clock::time_point since) {
  return std::chrono::duration<double, std::milli>(Clock::now() - since).count();
}

/// Of this thread: in the daemon no ordinary thread comes between.
double cpu_us() {
  timespec time{};
  clock_gettime(CLOCK_THREAD_CPUTIME_ID, &time);
  return 1e6 * static_cast<double>(time.tv_sec) + 1e-3 * static_cast<double>(time.tv_nsec);
}

/// On one CPU from here on; threads that are there already stay where they were.
void pin() {
  cpu_set_t one;
  CPU_ZERO(&one);
  CPU_SET(static_cast<std::size_t>(std::max(sched_getcpu(), 0)), &one);
  if (sched_setaffinity(0, sizeof one, &one) != 0) std::fputs("not pinned to a CPU\n", stderr);
}

/// 0.1 mm of error over some millimetres, and 0.05 mm of noise.
cv::Mat as_reconstructed(const cv::Mat& depth_mm) {
  cv::RNG random(3);
  cv::Mat coarse(8, 14, CV_32F), smooth, noise(depth_mm.size(), CV_32F);
  random.fill(coarse, cv::RNG::NORMAL, 0, 0.1);
  cv::resize(coarse, smooth, depth_mm.size(), 0, 0, cv::INTER_CUBIC);
  random.fill(noise, cv::RNG::NORMAL, 0, 0.05);
  return depth_mm + smooth + noise;
}

struct Follower {
  perception::DirectTracker tracker;
  Row absolute, step, depth, rotation;
  Eigen::Vector3d error_before_um = Eigen::Vector3d::Zero();

  perception::MotionEstimate follow(const cv::Mat& image, const Eigen::Isometry3d& T,
                                    std::chrono::nanoseconds t) {
    const auto e = tracker.track(image, t);
    if (e.status == perception::TrackingStatus::lost) return e;
    const Eigen::Vector3d p = e.p_pivot_site_mm;
    const Eigen::Vector3d error_um = 1000 * (e.T_camera_site * p - T * p);
    absolute.ours.push_back(error_um.head<2>().norm());
    step.ours.push_back((error_um - error_before_um).head<2>().norm());
    depth.ours.push_back(std::abs(error_um.z()));
    rotation.ours.push_back(
        1000 * Eigen::AngleAxisd(T.linear() * e.T_camera_site.linear().transpose()).angle());
    error_before_um = error_um;
    return e;
  }
};

Follower make_follower(const perception::CameraModel& camera, const std::string& what) {
  perception::TrackerParameters parameters;
  parameters.check.is_threaded = true;  // as in the daemon
  return {perception::DirectTracker(camera, parameters),
          {"tracker_absolute_error" + what, "um", {}, {}},
          {"tracker_frame_to_frame_error" + what, "um", {}, {}},
          {"tracker_depth_error" + what, "um", {}, {}},
          {"tracker_rotation_error" + what, "mrad", {}, {}}};
}

std::vector<Row> measure() {
  constexpr double kReliefMm = 4;
  const auto camera = test::microscope_camera(1920, 1080);
  const test::MovingScene scene(camera, test::photograph(), kDepthMm, kReliefMm);
  const cv::Mat keyframe = scene.image(Eigen::Isometry3d::Identity(), 2, 999);
  Follower exact = make_follower(camera, ""), real = make_follower(camera, "_reconstructed_depth");
  const cv::Mat depth_mm = scene.depth_mm();
  if (exact.tracker.set_keyframe(keyframe, perception::SiteDepth{depth_mm}) !=
          perception::TrackingReason::none ||
      real.tracker.set_keyframe(keyframe, perception::SiteDepth{as_reconstructed(depth_mm)}) !=
          perception::TrackingReason::none)
    return {};
  const std::filesystem::path file =
      std::filesystem::temp_directory_path() / ("live-view-bench-" + std::to_string(getpid()));
  rt::LiveView live({file}, camera, perception::ReflectionMaskParameters{});  // its thread is free
  Row handover{"live_view_handover", "us", {}, {}}, picture{"live_view_picture", "ms", {}, {}};
  pin();
  perception::PaperTracker paper(camera, perception::TrackerParameters{});
  if (paper.set_keyframe(keyframe, perception::SitePlane{kDepthMm}) !=
      perception::TrackingReason::none)
    return {};
  Row time{"tracker_1080p_frame", "ms", {}, {}};
  Eigen::Vector2d paper_error_before_um(0, 0);
  for (int i = 1; i <= kFrames; ++i) {  // a spiral of up to 2.5 mm at 2 mm/s and 30 frames/s
    const double angle = 0.12 * i, radius_mm = 2.5 * i / kFrames;
    const Eigen::Vector2d now(radius_mm * std::sin(angle), radius_mm * (1 - std::cos(angle)));
    const Eigen::Isometry3d T(Eigen::Translation3d(now.x(), now.y(), 0));
    const cv::Mat image = scene.image(T, 2, static_cast<std::uint64_t>(i));
    const std::chrono::milliseconds t(33 * i);
    auto start = Clock::now();
    const auto estimate = exact.follow(image, T, t);
    time.ours.push_back(milliseconds(start));
    cv::Mat handed = image.clone();
    const void* pixels = handed.data;
    start = Clock::now();
    const double cpu_before_us = cpu_us();
    live.offer(handed, static_cast<std::uint64_t>(i), estimate, exact.tracker);
    const double handover_us = cpu_us() - cpu_before_us;
    live.wait();
    if (handed.data != pixels) {  // taken
      handover.ours.push_back(handover_us);
      picture.ours.push_back(milliseconds(start));
    }
    start = Clock::now();
    const auto e = paper.track(image, t);
    time.theirs.push_back(milliseconds(start));
    const auto lost = perception::TrackingStatus::lost;
    if (estimate.status == lost || real.follow(image, T, t).status == lost) return {};
    if (e.status == perception::TrackingStatus::lost) return {};
    const Eigen::Vector3d p = e.p_pivot_site_mm;
    const Eigen::Vector2d paper_error_um = 1000 * (e.T_camera_site * p - T * p).head<2>();
    for (Follower* follower : {&exact, &real}) {
      follower->step.theirs.push_back((paper_error_um - paper_error_before_um).norm());
      follower->absolute.theirs.push_back(paper_error_um.norm());
    }
    paper_error_before_um = paper_error_um;
  }
  return {time,           handover,      picture,   exact.absolute, exact.step,   exact.depth,
          exact.rotation, real.absolute, real.step, real.depth,     real.rotation};
}

std::string json_of(const std::vector<Row>& rows) {
  std::string json = "[";
  for (const Row& row : rows) {
    char text[512];
    const double ours = percentile(row.ours, 0.5), theirs = percentile(row.theirs, 0.5);
    std::snprintf(text, sizeof text,
                  "%s\n {\"name\": \"%s\", \"median\": %.4f, \"p99\": %.4f, \"unit\": \"%s\", ",
                  json.size() > 1 ? "," : "", row.name.c_str(), ours, percentile(row.ours, 0.99),
                  row.unit.c_str());
    json += text;
    std::snprintf(text, sizeof text, "\"baseline\": %.4f, \"ratio\": %.4f}", theirs, theirs / ours);
    json += row.theirs.empty() ? "\"baseline\": null, \"ratio\": null}" : text;
  }
  return json + "\n]\n";
}

}  // namespace

int main(int argc, char** argv) {
  const bool has_file = argc == 3 && std::string(argv[1]) == "--json";
  if (argc != 1 && !has_file) {
    std::fputs("usage: holdfast-bench-tracker [--json FILE]\n", stderr);
    return 2;
  }
  cv::setNumThreads(1);
  const std::vector<Row> rows = measure();
  if (rows.empty()) {
    std::fputs("holdfast-bench-tracker: the tracker lost the scene\n", stderr);
    return 1;
  }
  for (const Row& row : rows)
    std::printf("%-44s ours %8.3f %s (p99 %8.3f)  OpenCV %8.3f (p99 %8.3f)  ratio %.2f\n",
                row.name.c_str(), percentile(row.ours, 0.5), row.unit.c_str(),
                percentile(row.ours, 0.99), percentile(row.theirs, 0.5),
                percentile(row.theirs, 0.99),
                percentile(row.theirs, 0.5) / percentile(row.ours, 0.5));
  std::printf("paper B: %.0f ms a frame, %.1f um frame to frame (best of six)\n", kPaperFrameMs,
              kPaperFrameToFrameUm);
  if (has_file) {
    try {
      bridge::write_file_atomically(argv[2], json_of(rows));
    } catch (const Error& error) {
      std::fprintf(stderr, "holdfast-bench-tracker: %s\n", error.what());
      return 2;
    }
  }
  return 0;
}
