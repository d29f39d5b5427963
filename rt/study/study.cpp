// SPDX-License-Identifier: Apache-2.0
#include "rt/study/study.hpp"

#include <cmath>
#include <fstream>
#include <functional>
#include <memory>
#include <optional>
#include <sstream>

#include <fmt/format.h>
#include <nlohmann/json.hpp>
#include <opencv2/imgcodecs.hpp>

#include "bridge/atomic_file.hpp"
#include "bridge/depth_file.hpp"
#include "registration/pattern_refinement.hpp"
#include "rt/core/error.hpp"
#include "rt/study/illumination.hpp"
#include "rt/study/rig.hpp"
#include "rt/study/study_files.hpp"
#include "rt/study/study_pair.hpp"

namespace holdfast::rt {
namespace {

using nlohmann::json;
namespace fs = std::filesystem;

std::optional<json> read_json(const fs::path& path) {
  std::ifstream stream(path);
  if (!stream) return {};
  json value = json::parse(stream, nullptr, false);
  return value.is_discarded() ? std::nullopt : std::optional(value);
}

json as_json(const StudySettings& s) {
  json patterns = json::array();
  for (const registration::PatternParameters& p : s.patterns)
    patterns.push_back({{"kind", static_cast<int>(p.kind)},
                        {"dot_px", p.dot_px},
                        {"distance_px", p.distance_px},
                        {"seed", p.seed}});
  json settings{{"zooms", s.zooms},
                {"repeats", s.repeats},
                {"rig", rig_text(s.rig)},
                {"seed", s.seed},
                {"calibration_pairs", s.calibration_pairs},
                {"points", s.points},
                {"iso_hu", s.setup.iso_hu},
                {"patterns", patterns}};
  if (s.shots > 1) settings["shots"] = s.shots;
  return settings;
}

/// Written before the first image: what is measured later cannot change what was asked. More
/// repeats of the same study may be asked for.
void freeze(const StudySettings& settings, const fs::path& folder) {
  json asked = as_json(settings);
  const fs::path file = folder / "study.json";
  if (auto there = read_json(file)) {
    const json repeats = there->value("repeats", json());
    (*there)["repeats"] = asked["repeats"];
    for (const auto& [key, value] : asked.items())
      if (there->value(key, json()) != value)
        throw InputError(fmt::format("{}: is of a study with {} = {}, not {}: choose another --out",
                                     file.string(), key, there->value(key, json()).dump(),
                                     value.dump()));
    if (repeats == asked["repeats"]) return;
  }
  bridge::write_file_atomically(file.string(), asked.dump(1) + "\n");
}

cv::Mat burst_pattern(registration::PatternParameters pattern, int shot) {
  const bool is_second = shot % 2 == 1 && pattern.kind == registration::PatternKind::aperiodic;
  pattern.seed += static_cast<std::uint64_t>(shot);
  if (!is_second) return registration::make_pattern(pattern);
  registration::PatternParameters first = pattern;
  --first.seed;
  return registration::complementary_pattern(pattern, registration::make_pattern(first));
}

class Study {
 public:
  Study(const StudySettings& settings, const fs::path& folder, const StudyProgress& progress)
      : settings_(settings), folder_(fs::absolute(folder)), progress_(progress) {
    all_ = static_cast<int>(settings_.zooms.size() * kIlluminations.size()) * settings_.repeats;
  }

  StudyResult run() {
    make_folder(folder_);
    freeze(settings_, folder_);
    for (const char* name : {"cells", "heat", "patterns", "work"}) make_folder(folder_ / name);
    calibrate();
    const CtSide ct = scan();
    const FiducialRegion region(ct.beads);
    const auto calibration =
        registration::read_stereo_calibration((folder_ / "stereo.yaml").string());
    for (const registration::ZoomCalibration& zoom : calibration.zooms)
      result_.calibration_rms_px = std::max(result_.calibration_rms_px, zoom.rms_px);
    for (std::size_t zoom = 0; zoom < settings_.zooms.size(); ++zoom) {
      const auto at_zoom = registration::calibration_at_zoom(calibration, settings_.zooms[zoom]);
      const StudyBench bench{
          ct, region, at_zoom, settings_.setup, settings_.points, settings_.seed};
      for (const Illumination illumination : kIlluminations)
        for (int repeat = 0; repeat < settings_.repeats; ++repeat)
          pair(bench, zoom, illumination, repeat);
    }
    std::error_code ignored;
    fs::remove_all(folder_ / "work", ignored);
    return std::move(result_);
  }

 private:
  Rig& rig() {
    if (!rig_) rig_ = std::make_unique<Rig>(settings_.rig);
    return *rig_;
  }
  void tell(const std::string& what) const { progress_(done_, all_, what); }

  void calibrate() {
    const fs::path out = folder_ / "stereo.yaml", images = folder_ / "work/boards";
    if (fs::exists(out)) return;
    fs::remove_all(images);
    for (const double zoom : settings_.zooms) {
      tell(fmt::format("calibration images at zoom {:g}", zoom));
      rig().boards(zoom, settings_.calibration_pairs, images);
    }
    const registration::CalibrationOutcome outcome =
        calibrate_images(images, settings_.setup, [this](const std::string& what) { tell(what); });
    bridge::write_file_atomically(out.string(),
                                  registration::stereo_calibration_text(outcome.calibration));
    fs::remove_all(images);
  }

  CtSide scan() {
    const fs::path dicom = folder_ / "dicom", fresh = folder_ / "work/dicom";
    if (!fs::exists(dicom)) {
      tell("CT");
      fs::remove_all(fresh);
      rig().ct(fresh);
      fs::rename(fresh, dicom);  // whole, or not there
    }
    CtSide side = read_ct_side(dicom, settings_.setup);
    bridge::write_file_atomically((folder_ / "ct.ply").string(),
                                  registration::ply_bytes(side.surface));
    bridge::write_file_atomically((folder_ / "fiducials.mrk.json").string(),
                                  registration::markups_text(side.beads));
    return side;
  }

  /// `shot` of a burst: dots of their own, and two and two light everything once.
  [[nodiscard]] fs::path pattern_at(std::size_t zoom, int shot = 0) const {
    const std::string name = fmt::format("adaptive_{:g}", settings_.zooms[zoom]);
    fs::path file =
        folder_ / "patterns" / (name + (shot > 0 ? fmt::format("_{}.png", shot) : ".png"));
    if (!fs::exists(file)) write_png(file, burst_pattern(settings_.patterns[zoom], shot));
    return file;
  }
  void add_burst(std::size_t zoom, PairRequest request, StudyPair& pair) {
    pair.burst = {pair.shot};
    request.has_off = false;
    for (int shot = 1; shot < settings_.shots; ++shot) {
      request.pattern = pattern_at(zoom, shot).string();
      pair.burst.push_back(rig().pair(request).shot);
    }
  }

  void pair(const StudyBench& bench, std::size_t zoom, Illumination illumination, int repeat) {
    const std::string cell =
        fmt::format("{:g}_{}_{:02}", settings_.zooms[zoom], name(illumination), repeat);
    const bool has_heat_map = zoom + 1 == settings_.zooms.size() && repeat == 0;
    const fs::path file = folder_ / "cells" / (cell + ".json");
    if (const auto there = read_json(file)) {
      for (const json& row : *there) result_.rows.push_back(row_of(row));
      ++result_.resumed;
    } else {
      tell(cell);
      const std::vector<StudyRow> rows = measure(bench, zoom, illumination, repeat, has_heat_map);
      json text = json::array();
      for (const StudyRow& row : rows) text.push_back(rt::as_json(row));
      bridge::write_file_atomically(file.string(), text.dump(1) + "\n");
      result_.rows.insert(result_.rows.end(), rows.begin(), rows.end());
    }
    ++done_;
    tell(cell);
    if (has_heat_map) list_heat_maps(illumination, settings_.zooms[zoom]);
  }

  std::vector<StudyRow> measure(const StudyBench& bench, std::size_t zoom,
                                Illumination illumination, int repeat, bool has_heat_map) {
    const fs::path work = folder_ / "work/pair";
    PairRequest request = lit_by(illumination, pattern_at(zoom));
    request.out = work;
    request.zoom = settings_.zooms[zoom];
    request.pose = repeat;
    const RigPair images = rig().pair(request);
    StudyPair pair{images.shot, request.has_off ? images.off : images.shot, {}};
    if (illumination == Illumination::adaptive && settings_.shots > 1)
      add_burst(zoom, request, pair);
    StudyRow identity;
    identity.zoom = request.zoom;
    identity.illumination = name(illumination);
    identity.repeat = repeat;
    const auto judge = [&](const cv::Mat& depth_mm, const registration::ZoomCalibration& seated,
                           StudyRow& row) {
      const DepthQuestion question{work / "depth.tiff", work / "seated.yaml", request.zoom, repeat};
      bridge::write_depth_file(question.depth.string(), depth_mm);
      registration::StereoCalibration calibration;
      calibration.image_width_px = pair.shot.left.cols;
      calibration.image_height_px = pair.shot.left.rows;
      calibration.zooms = {seated};
      bridge::write_file_atomically(question.calibration.string(),
                                    registration::stereo_calibration_text(calibration));
      row.judge(rig().depth_error(question));
    };
    const auto keep = [&](const std::string& method, const cv::Mat& map) {
      if (!map.empty()) write_png(heat_file(illumination, method), map);
    };
    auto rows = measure_pair(bench, pair, identity, judge,
                             has_heat_map ? keep : decltype(std::function(keep))());
    fs::remove_all(work);
    return rows;
  }

  [[nodiscard]] fs::path heat_file(Illumination illumination, const std::string& method) const {
    return folder_ / "heat" / fmt::format("{}_{}.png", name(illumination), method);
  }
  void list_heat_maps(Illumination illumination, double zoom) {
    for (const char* method : {"sgm", "opencv", "burst"})
      if (const fs::path file = heat_file(illumination, method); fs::exists(file))
        result_.heat_maps.push_back(
            {fmt::format("{}, zoom {:g}, {}", name(illumination), zoom, method), file});
  }

  const StudySettings& settings_;
  const fs::path folder_;
  const StudyProgress& progress_;
  std::unique_ptr<Rig> rig_;
  StudyResult result_;
  int done_ = 0, all_ = 0;
};

}  // namespace

StudyResult run_study(const StudySettings& settings, const fs::path& folder,
                      const StudyProgress& progress) {
  if (settings.patterns.size() != settings.zooms.size())
    throw InputError(
        fmt::format("{} patterns for {} zooms", settings.patterns.size(), settings.zooms.size()));
  return Study(settings, folder, progress).run();
}

}  // namespace holdfast::rt
