// SPDX-License-Identifier: Apache-2.0
// One reconstruction, ours and with OpenCV's SGBM (paper A's baseline), in turn on the same pair in
// the same process, two threads: wall and CPU time (which a busy machine hardly changes) of a
// 2456x2054 frame of an analytic microscope, whole and half, and two real pairs with ground truth.
// Times, and the errors of both against the truth.
#include <algorithm>
#include <chrono>
#include <cmath>
#include <cstdio>
#include <cstring>
#include <ctime>
#include <fstream>
#include <string>
#include <vector>

#include <malloc.h>
#include <opencv2/core/utility.hpp>

#include "registration/reconstruction.hpp"
#include "tests/registration/support/real_stereo.hpp"
#include "tests/registration/support/stereo_rig.hpp"

namespace {

using namespace holdfast;
using Clock = std::chrono::steady_clock;

struct Row {
  std::string name, unit;
  std::vector<double> ours, theirs;
};

double quantile(std::vector<double> values, double share) {
  std::sort(values.begin(), values.end());
  return values[static_cast<std::size_t>(
      std::lround(share * static_cast<double>(values.size() - 1)))];
}

/// Of all threads of this process.
double cpu_milliseconds() {
  return 1e3 * static_cast<double>(std::clock()) / CLOCKS_PER_SEC;
}

double milliseconds(Clock::time_point since) {
  return std::chrono::duration<double, std::milli>(Clock::now() - since).count();
}

/// Median error against the truth, share of the pixels more than 1 mm wrong (of the known ones).
std::pair<double, double> errors(const test::StereoRig& rig,
                                 const registration::Reconstructor& reconstructor,
                                 const registration::Reconstruction& result) {
  std::vector<double> all;
  double wrong = 0;
  for (int y = 20; y < result.depth_mm.rows - 20; y += 9)
    for (int x = 20; x < result.depth_mm.cols - 20; x += 9) {
      const double error =
          std::abs(static_cast<double>(result.depth_mm(y, x)) -
                   rig.true_depth_mm(reconstructor.rectification(), result.region_px.x + x,
                                     result.region_px.y + y));
      if (std::isnan(error)) continue;
      all.push_back(error);
      wrong += error > 1 ? 1 : 0;
    }
  return {quantile(all, 0.5), wrong / static_cast<double>(all.size())};
}

bool bench_rig(int repeats, std::vector<Row>& rows) {
  test::StereoRig rig;
  rig.image_px = {2456, 2054};
  rig.focal_px = 4000;
  rig.relief_mm = 6;
  rig.noise_grey = 2;
  const registration::StereoShot shot{rig.left(), rig.right()};
  for (const bool is_whole : {true, false}) {
    registration::ReconstructionOptions options, baseline;
    if (!is_whole) options.roi_px = cv::Rect(450, 270, 1556, 1514);  // about half the frame
    baseline.roi_px = options.roi_px;
    baseline.method = registration::MatchMethod::opencv;
    registration::Reconstructor ours(rig.calibration(), rig.image_px, options),
        theirs(rig.calibration(), rig.image_px, baseline);
    const std::string name = is_whole ? "reconstruct_full_frame" : "reconstruct_roi";
    Row time{name, "ms", {}, {}}, cpu{name + "_cpu", "ms", {}, {}},
        match{name + "_match_and_refine", "ms", {}, {}};
    registration::Reconstruction a, b;
    for (int i = 0; i < repeats; ++i) {
      const auto add = [](registration::Reconstructor& r, const registration::StereoShot& s,
                          std::vector<double>& total, std::vector<double>& of_cpu,
                          std::vector<double>& matching) {
        const double before = cpu_milliseconds();
        registration::Reconstruction result = r.reconstruct(std::span(&s, 1));
        of_cpu.push_back(cpu_milliseconds() - before);
        total.push_back(static_cast<double>(result.times.total.count()) / 1e6);
        matching.push_back(static_cast<double>((result.times.match + result.times.refine).count()) /
                           1e6);
        return result;
      };
      a = add(ours, shot, time.ours, cpu.ours, match.ours);
      b = add(theirs, shot, time.theirs, cpu.theirs, match.theirs);
    }
    if (a.status != registration::ReconstructionStatus::done) return false;
    const auto [median_a, wrong_a] = errors(rig, ours, a);
    const auto [median_b, wrong_b] = errors(rig, theirs, b);
    rows.insert(rows.end(), {time,
                             cpu,
                             match,
                             {name + "_median_error", "mm", {median_a}, {median_b}},
                             {name + "_wrong_above_1mm", "share", {wrong_a}, {wrong_b}},
                             {name + "_density", "share", {a.density}, {b.density}}});
  }
  return true;
}

void bench_real(const std::string& name, const test::RealStereo& pair, int repeats,
                std::vector<Row>& rows) {
  if (pair.truth_px.empty()) {
    std::fprintf(stderr, "%s: not installed, left out\n", name.c_str());
    return;
  }
  registration::MatchParameters ours = registration::match_parameters_for(pair.left.size());
  registration::MatchParameters theirs = ours;
  theirs.method = registration::MatchMethod::opencv;
  const auto range = registration::whole_range(ours, pair.range);
  const auto views = test::matchable(pair, ours, range);
  registration::WorkerPool pool(2);
  Row time{name, "ms", {}, {}};
  registration::DisparityMap a, b;
  for (int i = 0; i < repeats; ++i) {
    auto start = Clock::now();
    a = match_disparity(std::span(&views, 1), range, ours, pool);
    time.ours.push_back(milliseconds(start));
    start = Clock::now();
    b = match_disparity(std::span(&views, 1), range, theirs, pool);
    time.theirs.push_back(milliseconds(start));
  }
  const auto x = test::errors_of(a.disparity_px, pair.truth_px);
  const auto y = test::errors_of(b.disparity_px, pair.truth_px);
  rows.insert(rows.end(), {time,
                           {name + "_bad_2px", "share", {x.bad_2px}, {y.bad_2px}},
                           {name + "_good_2px_of_all", "share", {x.good_2px}, {y.good_2px}},
                           {name + "_median_error", "px", {x.median_px}, {y.median_px}}});
}

std::string json_of(const std::vector<Row>& rows) {
  std::string json = "[";
  for (const Row& row : rows) {
    char text[512];
    const double ours = quantile(row.ours, 0.5), theirs = quantile(row.theirs, 0.5);
    std::snprintf(text, sizeof text,
                  "%s\n {\"name\": \"%s\", \"median\": %.5f, \"p99\": %.5f, \"unit\": \"%s\", "
                  "\"baseline\": %.5f, \"ratio\": %.4f}",
                  json.size() > 1 ? "," : "", row.name.c_str(), ours, quantile(row.ours, 0.99),
                  row.unit.c_str(), theirs, ours > 0 ? theirs / ours : 0);
    json += text;
  }
  return json + "\n]\n";
}

}  // namespace

int main(int argc, char** argv) {
  bool is_quick = false;
  const char* out = nullptr;
  for (int i = 1; i < argc; ++i) {
    if (std::strcmp(argv[i], "--quick") == 0) {
      is_quick = true;
    } else if (std::strcmp(argv[i], "--json") == 0 && i + 1 < argc) {
      out = argv[++i];
    } else {
      std::fputs("usage: holdfast-bench-reconstruct [--quick] [--json FILE]\n", stderr);
      return 2;
    }
  }
  cv::setNumThreads(2);
  mallopt(M_MMAP_THRESHOLD, 1 << 30);  // as `holdfast reconstruct` does
  mallopt(M_TRIM_THRESHOLD, 1 << 30);
  const int repeats = is_quick ? 3 : 15;
  std::vector<Row> rows;
  bench_real("stereo_motorcycle", test::motorcycle(), repeats, rows);
  bench_real("stereo_aloe", test::aloe(), repeats, rows);
  if (!bench_rig(repeats, rows)) {
    std::fputs("holdfast-bench-reconstruct: our reconstruction was refused\n", stderr);
    return 1;
  }
  for (const Row& row : rows)
    std::printf("%-42s ours %9.4f  SGBM %9.4f %s\n", row.name.c_str(), quantile(row.ours, 0.5),
                quantile(row.theirs, 0.5), row.unit.c_str());
  if (out != nullptr) {
    std::ofstream file(out);
    file << json_of(rows);
    if (!file.flush()) return 2;
  }
  return 0;
}
