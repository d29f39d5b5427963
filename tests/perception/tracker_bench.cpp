// SPDX-License-Identifier: Apache-2.0
// Tracker against a practitioner's OpenCV version of paper B (ORB 2000, brute-force cross-check,
// estimateAffine2D, cascaded), frame by frame in turn on the same pictures, one thread on one CPU.
// Speed, and the error of both on a synthetic trajectory shaped like paper B's spiral.
#include <algorithm>
#include <chrono>
#include <cmath>
#include <cstdio>
#include <string>
#include <vector>

#include <opencv2/calib3d.hpp>
#include <opencv2/features2d.hpp>
#include <sched.h>

#include "bridge/atomic_file.hpp"
#include "perception/tracker.hpp"
#include "perception/tracker_parameters.hpp"
#include "rt/core/error.hpp"
#include "tests/perception/support/moving_scene.hpp"

namespace {

using namespace holdfast;
using Clock = std::chrono::steady_clock;

constexpr double kDepthMm = 200, kPixelMm = 0.02;
constexpr int kFrames = 60;
constexpr double kPaperFrameToFrameUm = 93.2, kPaperFrameMs = 327;  // paper B, tables 1 and 2

struct Practitioner {
  cv::Ptr<cv::ORB> orb = cv::ORB::create(2000);
  cv::BFMatcher matcher{cv::NORM_HAMMING, true};
  std::vector<cv::KeyPoint> before;
  cv::Mat descriptors_before;
  cv::Matx33d chain = cv::Matx33d::eye();

  /// The motion of `p` since the frame before; the chain is cascaded as in the paper.
  cv::Point2d track(const cv::Mat& image, cv::Point2d p) {
    std::vector<cv::KeyPoint> now;
    cv::Mat descriptors;
    orb->detectAndCompute(image, {}, now, descriptors);
    cv::Point2d moved;
    if (!before.empty()) {
      std::vector<cv::DMatch> matches;
      matcher.match(descriptors_before, descriptors, matches);
      std::vector<cv::Point2f> from, to;
      for (const cv::DMatch& m : matches) {
        from.push_back(before[static_cast<std::size_t>(m.queryIdx)].pt);
        to.push_back(now[static_cast<std::size_t>(m.trainIdx)].pt);
      }
      const cv::Mat A = cv::estimateAffine2D(from, to);
      if (!A.empty()) {
        const cv::Matx33d step(A.at<double>(0, 0), A.at<double>(0, 1), A.at<double>(0, 2),
                               A.at<double>(1, 0), A.at<double>(1, 1), A.at<double>(1, 2), 0, 0, 1);
        const cv::Point2d start = at(p);
        chain = step * chain;
        moved = at(p) - start;
      }
    }
    before = std::move(now);
    descriptors_before = descriptors;
    return moved;
  }
  [[nodiscard]] cv::Point2d at(cv::Point2d p) const {
    const cv::Vec3d q = chain * cv::Vec3d(p.x, p.y, 1);
    return {q[0], q[1]};
  }
};

double percentile(std::vector<double> values, double share) {
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

std::vector<Row> measure() {
  const auto camera = test::microscope_camera(1920, 1080);
  const test::MovingScene scene(camera, test::photograph(), kDepthMm);
  perception::Tracker tracker(camera, perception::TrackerParameters{});
  Practitioner practitioner;
  Row time{"tracker_1080p_frame", "ms", {}, {}}, step{"tracker_frame_to_frame_error", "um", {}, {}},
      absolute{"tracker_absolute_error", "um", {}, {}};
  const cv::Point2d pivot(camera.cx_px, camera.cy_px);
  const cv::Mat keyframe = scene.image(Eigen::Isometry3d::Identity(), 2, 999);
  if (tracker.set_keyframe(keyframe, perception::SitePlane{kDepthMm}) !=
      perception::TrackingReason::none)
    return {};
  (void)tracker.track(keyframe, {});
  practitioner.track(keyframe, pivot);
  Eigen::Vector2d before(0, 0);
  for (int i = 1; i <= kFrames; ++i) {  // a spiral of up to 2.5 mm at 2 mm/s and 30 frames/s
    const double angle = 0.12 * i, radius_mm = 2.5 * i / kFrames;
    const Eigen::Vector2d now(radius_mm * std::sin(angle), radius_mm * (1 - std::cos(angle)));
    const Eigen::Isometry3d T(Eigen::Translation3d(now.x(), now.y(), 0));
    const cv::Mat image = scene.image(T, 2, static_cast<std::uint64_t>(i));
    auto start = Clock::now();
    const auto e = tracker.track(image, {});
    time.ours.push_back(milliseconds(start));
    start = Clock::now();
    const cv::Point2d moved = practitioner.track(image, pivot);
    time.theirs.push_back(milliseconds(start));
    if (e.status == perception::TrackingStatus::lost) return {};
    const Eigen::Vector2d truth_step = now - before;
    step.ours.push_back(
        (Eigen::Vector2d(e.frame_to_frame_dx_um, e.frame_to_frame_dy_um) - 1000 * truth_step)
            .norm());
    step.theirs.push_back(1000 *
                          (kPixelMm * Eigen::Vector2d(moved.x, moved.y) - truth_step).norm());
    const Eigen::Vector3d p = e.T_camera_site * e.p_pivot_site_mm;
    absolute.ours.push_back(1000 * (p.head<2>() - now).norm());
    const cv::Point2d q = practitioner.at(pivot) - pivot;
    absolute.theirs.push_back(1000 * (kPixelMm * Eigen::Vector2d(q.x, q.y) - now).norm());
    before = now;
  }
  return {time, step, absolute};
}

std::string json_of(const std::vector<Row>& rows) {
  std::string json = "[";
  for (const Row& row : rows) {
    char text[512];
    const double ours = percentile(row.ours, 0.5), theirs = percentile(row.theirs, 0.5);
    std::snprintf(text, sizeof text,
                  "%s\n {\"name\": \"%s\", \"median\": %.4f, \"p99\": %.4f, \"unit\": \"%s\", "
                  "\"baseline\": %.4f, \"ratio\": %.4f}",
                  json.size() > 1 ? "," : "", row.name.c_str(), ours, percentile(row.ours, 0.99),
                  row.unit.c_str(), theirs, theirs / ours);
    json += text;
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
  cpu_set_t one;
  CPU_ZERO(&one);
  CPU_SET(static_cast<std::size_t>(std::max(sched_getcpu(), 0)), &one);
  if (sched_setaffinity(0, sizeof one, &one) != 0) std::fputs("not pinned to a CPU\n", stderr);
  const std::vector<Row> rows = measure();
  if (rows.empty()) {
    std::fputs("holdfast-bench-tracker: the tracker lost the scene\n", stderr);
    return 1;
  }
  for (const Row& row : rows)
    std::printf("%-30s ours %8.3f %s (p99 %8.3f)  OpenCV %8.3f (p99 %8.3f)  ratio %.2f\n",
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
