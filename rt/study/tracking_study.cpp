// SPDX-License-Identifier: Apache-2.0
#include "rt/study/tracking_study.hpp"

#include <cstdlib>
#include <fstream>
#include <optional>
#include <sstream>

#include <fmt/format.h>

#include "bridge/atomic_file.hpp"
#include "bridge/depth_file.hpp"
#include "perception/direct_tracker.hpp"
#include "perception/paper_tracker.hpp"
#include "perception/tracker.hpp"
#include "perception/tracker_parameters.hpp"
#include "rt/core/error.hpp"
#include "rt/study/closed_loop.hpp"
#include "rt/study/study_files.hpp"
#include "rt/study/tracking_stages.hpp"

namespace holdfast::rt {
namespace {

namespace fs = std::filesystem;
using perception::MotionEstimate;

constexpr const char* kMethods[] = {"direct", "orb", "paper"};

std::vector<StageTime> times_of(const std::vector<MotionEstimate>& estimates) {
  StageStatistics stages;
  for (std::size_t i = 1; i < estimates.size(); ++i) stages.add(estimates[i].times);
  return stages.stages();
}

/// The columns of the rig's error table.
void read_errors(const fs::path& file, TrackingRow& row) {
  std::ifstream stream(file);
  std::string line;
  std::getline(stream, line);
  while (std::getline(stream, line)) {
    std::vector<std::string> cells;
    std::istringstream text(line);
    for (std::string cell; std::getline(text, cell, ',');) cells.push_back(cell);
    if (cells.size() < 9) throw InputError(file.string() + ": is no table of errors");
    const auto value = [&](std::size_t k) { return std::strtod(cells[k].c_str(), nullptr); };
    row.x_um.push_back(value(3));
    row.y_um.push_back(value(4));
    row.error_x_um.push_back(value(5));
    row.error_y_um.push_back(value(6));
    if (cells[7].empty()) continue;
    row.step_x_um.push_back(value(7));
    row.step_y_um.push_back(value(8));
  }
}

class TrackingStudy {
 public:
  TrackingStudy(const TrackingSettings& settings, const fs::path& folder,
                const StudyProgress& progress)
      : settings_(settings), folder_(fs::absolute(folder)), progress_(progress) {
    const std::size_t each =
        settings_.motions.size() * std::size(kMethods) + settings_.beam_motions.size();
    all_ = static_cast<int>(settings_.scenes.size() * each);
  }

  TrackingResult run() {
    make_folder(folder_);
    for (const TrackingScene& scene : settings_.scenes) {
      Rig rig(scene.rig);
      if (!zoom_) calibrate(rig);
      follow_scene(rig, scene.name);
    }
    return std::move(result_);
  }

 private:
  void tell(const std::string& what) const { progress_(done_, all_, what); }

  void calibrate(Rig& rig) {
    zoom_ = calibrate_rig(rig, settings_.zoom, settings_.calibration_pairs, settings_.setup,
                          folder_, [this](const std::string& what) { tell(what); });
    result_.calibration_rms_px = zoom_->rms_px;
  }

  void follow_scene(Rig& rig, const std::string& scene) {
    const fs::path out = folder_ / scene;
    make_folder(out);
    tell(scene + ": depth");
    const cv::Mat1f depth_mm = reconstruct_rig(rig, *zoom_, settings_.setup, out);
    for (const std::string& motion : settings_.motions) {
      const SequenceRequest request = wanted(out / motion, motion, settings_.rate_hz);
      tell(fmt::format("{}, {}: frames", scene, motion));
      const RigSequence sequence = rig.sequence(request);
      const cv::Mat1f seen_mm = depth_mm(sequence.region_px).clone();
      const auto known = static_cast<double>(cv::countNonZero(seen_mm == seen_mm));
      result_.depth_coverage[scene] = known / static_cast<double>(seen_mm.total());
      bridge::write_depth_file((out / "depth.tiff").string(), seen_mm);
      for (const char* method : kMethods) {
        tell(fmt::format("{}, {}: {}", scene, motion, method));
        TrackingRow row;
        row.scene = scene;
        row.motion = motion;
        row.method = method;
        measure(rig, request, camera_of(*zoom_, sequence.region_px), seen_mm, row);
        result_.rows.push_back(std::move(row));
        ++done_;
      }
    }
    for (const std::string& motion : settings_.beam_motions) {
      steer(rig, scene, motion, depth_mm);
      ++done_;
    }
  }

  [[nodiscard]] SequenceRequest wanted(const fs::path& out, const std::string& motion,
                                       double rate_hz) const {
    SequenceRequest request;
    request.out = out / "frames";
    request.zoom = settings_.zoom;
    request.motion = motion;
    request.rate_hz = rate_hz;
    request.lamps = "microscope";  // as a surgeon works, and paper B's frames are lit
    return request;
  }

  /// Where the beam lands, with poses for now and with poses for when the robot has followed.
  void steer(Rig& rig, const std::string& scene, const std::string& motion,
             const cv::Mat1f& depth_mm) {
    const fs::path out = folder_ / scene / ("beam_" + motion);
    const SequenceRequest request = wanted(out, "still:1," + motion, settings_.beam_rate_hz);
    tell(fmt::format("{}, beam, {}: frames", scene, motion));
    const RigSequence sequence = rig.sequence(request);
    tell(fmt::format("{}, beam, {}", scene, motion));
    const Followed followed =
        follow(perception::DirectTracker(camera_of(*zoom_, sequence.region_px), {}), request.out,
               perception::SiteDepth{depth_mm(sequence.region_px).clone()});
    const std::chrono::nanoseconds lag = rig.robot_lag();
    for (const std::chrono::nanoseconds lead : {std::chrono::nanoseconds(0), lag}) {
      BeamRow row;
      row.scene = scene;
      row.motion = motion;
      row.refusal = followed.refusal;
      row.lead = lead;
      if (row.refusal.empty()) {
        ClosedLoopSettings loop;
        loop.rate_hz = settings_.beam_rate_hz;
        loop.pose_lead = lead;
        loop.p_target_site_mm = {0, 0, zoom_->focus_mm};
        const ClosedLoopRun run = run_closed_loop(followed.estimates, loop);
        const std::string name = lead.count() == 0 ? "now" : "lead";
        const BeamQuestion question{request, out / (name + "_commands.csv"),
                                    folder_ / "stereo.yaml", out / (name + "_beam.csv")};
        bridge::write_file_atomically(question.commands.string(), run.commands);
        row.judged = rig.beam_error(question);
        row.stops = run.stops;
        row.stop_causes = run.stop_causes;
      }
      result_.beam.push_back(std::move(row));
    }
    fs::remove_all(request.out);  // many, and only these two runs need them
  }

  void measure(Rig& rig, const SequenceRequest& request, const perception::CameraModel& camera,
               const cv::Mat1f& depth_mm, TrackingRow& row) {
    const perception::SiteGeometry site = perception::SiteDepth{depth_mm};
    const perception::TrackerParameters parameters;
    Followed followed;
    if (row.method == "direct")
      followed = follow(perception::DirectTracker(camera, parameters), request.out, site);
    else if (row.method == "orb")
      followed = follow(perception::Tracker(camera, parameters), request.out, site);
    else
      followed = follow(perception::PaperTracker(camera, parameters), request.out, site);
    row.refusal = followed.refusal;
    if (!row.refusal.empty()) return;
    row.stages = times_of(followed.estimates);
    const fs::path out = request.out.parent_path();
    TrackingQuestion question{request, out / (row.method + ".csv"), folder_ / "stereo.yaml",
                              out / (row.method + "_errors.csv"), std::nullopt};
    bridge::write_file_atomically(question.poses.string(), poses_csv(followed.estimates));
    row.judged = rig.tracking_error(question);
    read_errors(question.rows, row);
  }

  const TrackingSettings& settings_;
  const fs::path folder_;
  const StudyProgress& progress_;
  std::optional<registration::ZoomCalibration> zoom_;
  TrackingResult result_;
  int done_ = 0, all_ = 0;
};

}  // namespace

TrackingResult run_tracking_study(const TrackingSettings& settings, const fs::path& folder,
                                  const StudyProgress& progress) {
  return TrackingStudy(settings, folder, progress).run();
}

}  // namespace holdfast::rt
