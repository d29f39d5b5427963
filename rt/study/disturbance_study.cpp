// SPDX-License-Identifier: Apache-2.0
#include "rt/study/disturbance_study.hpp"

#include <array>
#include <chrono>
#include <cmath>
#include <cstdlib>
#include <fstream>
#include <memory>
#include <sstream>
#include <utility>

#include <Eigen/Cholesky>
#include <Eigen/Geometry>
#include <fmt/format.h>
#include <opencv2/core.hpp>

#include "bridge/atomic_file.hpp"
#include "bridge/depth_file.hpp"
#include "perception/direct_tracker.hpp"
#include "perception/tracker_parameters.hpp"
#include "rt/core/error.hpp"
#include "rt/study/study_files.hpp"
#include "rt/study/tracking_stages.hpp"

namespace holdfast::rt {
namespace {

namespace fs = std::filesystem;
using perception::MotionEstimate;
using perception::TrackingStatus;

std::string read_text(const fs::path& path) {
  std::ostringstream text;
  text << std::ifstream(path, std::ios::binary).rdbuf();
  return text.str();
}

double seconds_of(const MotionEstimate& estimate, const MotionEstimate& first) {
  return std::chrono::duration<double>(estimate.t_exposure - first.t_exposure).count();
}

/// A frame of the rig's error table, and what the tracker said of its own error.
DisturbedFrame judged_frame(const std::vector<std::string>& cells, const MotionEstimate& estimate) {
  const auto value = [&](std::size_t k) { return std::strtod(cells[k].c_str(), nullptr); };
  Eigen::Matrix<double, 6, 1> error;
  error << value(5) / 1000, value(6) / 1000, value(9) / 1000, value(11) / 1000, value(12) / 1000,
      value(13) / 1000;
  DisturbedFrame frame;
  frame.status = cells[2];
  frame.error_um = 1000 * error.head<3>().norm();
  frame.plane_error_um = 1000 * error.head<2>().norm();
  frame.nees = error.dot(estimate.covariance.ldlt().solve(error));
  return frame;
}

class DisturbanceStudy {
 public:
  DisturbanceStudy(const DisturbanceSettings& settings, const fs::path& folder,
                   const StudyProgress& progress)
      : settings_(settings), folder_(fs::absolute(folder)), progress_(progress) {}

  DisturbanceResult run() {
    make_folder(folder_);
    all_ = static_cast<int>(settings_.scenes.size() * settings_.disturbances.size());
    for (const TrackingScene& scene : settings_.scenes) {
      std::unique_ptr<Rig> rig;  // started when something is left to be made
      depth_mm_.release();
      for (const Disturbance& disturbance : settings_.disturbances) {
        result_.rows.push_back(row(scene, disturbance, rig));
        ++done_;
      }
    }
    return std::move(result_);
  }

 private:
  void tell(const std::string& what) const { progress_(done_, all_, what); }

  /// Everything that a row depends on, but the programs themselves.
  [[nodiscard]] std::string stamp(const TrackingScene& scene, const Disturbance& d) const {
    return fmt::format("{} | {} | {} | {} | {:g}/s | zoom {:g} | {} pairs", rig_text(scene.rig),
                       d.name, d.motion, d.picture, settings_.rate_hz, settings_.zoom,
                       settings_.calibration_pairs);
  }

  DisturbanceRow row(const TrackingScene& scene, const Disturbance& disturbance,
                     std::unique_ptr<Rig>& rig) {
    const fs::path out = folder_ / scene.name / disturbance.name;
    const std::string stamp_line = stamp(scene, disturbance) + "\n";
    if (const std::string kept = read_text(out / "row.json"); kept.starts_with(stamp_line))
      if (auto row = row_of(kept.substr(stamp_line.size()))) {
        ++result_.resumed;
        return *row;
      }
    if (!rig) rig = std::make_unique<Rig>(scene.rig);
    make_folder(out);
    prepare(*rig, scene);
    DisturbanceRow row = measure(*rig, disturbance, out);
    row.scene = scene.name;
    row.name = disturbance.name;
    bridge::write_file_atomically((out / "row.json").string(), stamp_line + row_text(row));
    return row;
  }

  /// Calibration and depth, once a folder and once a scene.
  void prepare(Rig& rig, const TrackingScene& scene) {
    if (!zoom_)
      zoom_ = calibrate_rig(rig, settings_.zoom, settings_.calibration_pairs, settings_.setup,
                            folder_, [this](const std::string& what) { tell(what); });
    if (!depth_mm_.empty()) return;
    tell(scene.name + ": depth");
    depth_mm_ = reconstruct_rig(rig, *zoom_, settings_.setup, folder_ / scene.name);
  }

  DisturbanceRow measure(Rig& rig, const Disturbance& disturbance, const fs::path& out) {
    SequenceRequest request;
    request.out = out / "frames";
    request.zoom = settings_.zoom;
    request.motion = disturbance.motion;
    request.rate_hz = settings_.rate_hz;
    request.lamps = "microscope";
    request.disturbances = disturbance.picture;
    tell(disturbance.name + ": frames");
    const RigSequence sequence = rig.sequence(request);
    tell(disturbance.name + ": tracking");
    const cv::Mat1f depth_mm = depth_mm_(sequence.region_px).clone();
    const perception::TrackerParameters parameters;
    const Followed followed =
        follow(perception::DirectTracker(camera_of(*zoom_, sequence.region_px), parameters),
               request.out, perception::SiteDepth{depth_mm});
    DisturbanceRow row;
    row.refusal = followed.refusal;
    if (row.refusal.empty()) judge(rig, request, disturbance, followed.estimates, row);
    fs::remove_all(request.out);
    return row;
  }

  void judge(Rig& rig, const SequenceRequest& request, const Disturbance& disturbance,
             const std::vector<MotionEstimate>& estimates, DisturbanceRow& row) const {
    const fs::path out = request.out.parent_path();
    const Eigen::Vector3d& p = estimates.front().p_pivot_site_mm;
    TrackingQuestion question{request, out / "poses.csv", folder_ / "stereo.yaml",
                              out / "errors.csv", std::array<double, 3>{p.x(), p.y(), p.z()}};
    bridge::write_file_atomically(question.poses.string(), poses_csv(estimates));
    (void)rig.tracking_error(question);
    count(estimates, disturbance, row);
    std::ifstream table(question.rows);
    std::string line;
    std::getline(table, line);
    while (std::getline(table, line)) {
      std::vector<std::string> cells;
      std::istringstream text(line);
      for (std::string cell; std::getline(text, cell, ',');) cells.push_back(cell);
      const std::size_t i = cells.empty() ? 0 : std::strtoul(cells[0].c_str(), nullptr, 10);
      if (cells.size() != 14 || i < 1 || i >= estimates.size())
        throw InputError(question.rows.string() + ": is no table of errors");
      DisturbedFrame frame = judged_frame(cells, estimates[i]);
      frame.t_s = seconds_of(estimates[i], estimates.front());
      if (!is_void(disturbance, frame.t_s)) row.poses.push_back(frame);
    }
    summarise(row);
  }

  [[nodiscard]] static bool is_void(const Disturbance& d, double t_s) {
    return d.other_zoom_from_s && t_s >= *d.other_zoom_from_s &&
           t_s < d.other_zoom_to_s.value_or(t_s + 1);
  }

  static void count(const std::vector<MotionEstimate>& estimates, const Disturbance& disturbance,
                    DisturbanceRow& row) {
    int clear = 0;
    for (std::size_t i = 1; i < estimates.size(); ++i) {
      const MotionEstimate& e = estimates[i];
      const double t_s = seconds_of(e, estimates.front());
      ++row.frames;
      if (is_void(disturbance, t_s)) {
        ++row.voided;
        continue;
      }
      ++row.statuses[std::string(perception::name(e.status))];
      if (e.reason != perception::TrackingReason::none)
        ++row.reasons[std::string(perception::name(e.reason))];
      if (!disturbance.clear_again_s || t_s < *disturbance.clear_again_s) continue;
      if (!row.frames_until_found && e.status != TrackingStatus::lost) {
        row.frames_until_found = clear;
        row.found_in_ms = std::chrono::duration<double, std::milli>(e.times.total).count();
      }
      ++clear;
    }
  }

  const DisturbanceSettings& settings_;
  const fs::path folder_;
  const StudyProgress& progress_;
  std::optional<registration::ZoomCalibration> zoom_;
  cv::Mat1f depth_mm_;  ///< of the scene at hand
  DisturbanceResult result_;
  int done_ = 0, all_ = 0;
};

}  // namespace

std::vector<Disturbance> all_disturbances() {
  return {
      {"shock", "bump:1,bump:2", "", {}, {}, {}},
      {"breathing", "breathing:4", "", {}, {}, {}},
      {"tilt", "tilt:3", "", {}, {}, {}},
      {"depth", "lift:2", "", {}, {}, {}},
      {"rotation", "roll:5", "", {}, {}, {}},
      {"zoom", "still:2", "zoom:0.5:0.8:1.4", 1.3, 0.5, 1.3},
      {"blood", "breathing:4", "blood:0.3:3", {}, {}, {}},
      {"smoke", "breathing:4", "smoke:0.3:3.2", {}, {}, {}},
      {"flicker", "breathing:4", "flicker:0.2:3.8", {}, {}, {}},
      {"defocus", "breathing:4", "defocus:0.3:3.2", {}, {}, {}},
      // The site moves while nothing of it is seen, and again in clear view.
      {"occlusion", "still:0.6,away:1.5,still:0.3", "occlusion:0.2:1.3", 1.5, {}, {}},
  };
}

DisturbanceResult run_disturbance_study(const DisturbanceSettings& settings, const fs::path& folder,
                                        const StudyProgress& progress) {
  return DisturbanceStudy(settings, folder, progress).run();
}

}  // namespace holdfast::rt
