// SPDX-License-Identifier: Apache-2.0
// `holdfast optimize-pattern`: which projected dots give the best surface at each zoom.
#include <algorithm>
#include <cerrno>
#include <cstdlib>
#include <cstring>
#include <filesystem>
#include <fstream>
#include <memory>
#include <sstream>
#include <string>
#include <vector>

#include <fmt/format.h>
#include <nlohmann/json.hpp>
#include <opencv2/imgcodecs.hpp>
#include <unistd.h>

#include "bridge/atomic_file.hpp"
#include "bridge/command_line.hpp"
#include "registration/mesh_file.hpp"
#include "registration/pattern_judgement.hpp"
#include "registration/pattern_search.hpp"
#include "registration/pattern_table.hpp"
#include "registration/transform_file.hpp"
#include "rt/commands/commands.hpp"
#include "rt/core/error.hpp"
#include "rt/study/rig.hpp"

namespace holdfast::rt {
namespace {

using registration::BestPattern;
using registration::PatternEvaluation;

constexpr const char* kExample =
    "Example: the best dots for two zooms, on the virtual microscope\n"
    "  holdfast optimize-pattern --rig 'holdfast-sim rig --config config/or.toml' \\\n"
    "      --calibration stereo.yaml --zooms 1.2,1.3 --reference ct.ply \\\n"
    "      --transform 'T_{zoom}.tfm' --out patterns.toml --csv evaluations.csv\n"
    "The rig is started once and answers requests for pairs (docs/interfaces.md, \"Rig\"). The "
    "reference is\nthe same object as a surface, --transform (as `register --tfm` writes it) "
    "where it lies; {zoom} in\nit stands for the zoom. Every evaluation is in the CSV at once: the "
    "same command goes on "
    "where an interrupted one\nended. A neighbouring zoom begins with what the one before found. "
    "--paper searches as paper A\ndoes: ten random patterns first, then by the mean distance to "
    "the closest vertex.";

struct Options {
  std::string rig, calibration, reference, transform, out, csv, kind = "aperiodic";
  std::vector<double> zooms;
  std::vector<int> roi;
  std::vector<double> region;
  int evaluations_max = 25, threads = 2;
  std::uint64_t seed = 1;
  bool is_paper = false, is_json = false;
};

registration::PatternKind kind_of(const std::string& name) {
  using registration::PatternKind;
  return name == "lattice"  ? PatternKind::lattice
         : name == "random" ? PatternKind::random
                            : PatternKind::aperiodic;
}

/// Gone with the command.
class TemporaryFolder {
 public:
  TemporaryFolder() {
    std::string name =
        (std::filesystem::temp_directory_path() / "holdfast-pattern-XXXXXX").string();
    if (mkdtemp(name.data()) == nullptr)
      throw UnavailableError(name + ": cannot be made: " + std::strerror(errno));
    path_ = name;
  }
  ~TemporaryFolder() {
    std::error_code ignored;  // a folder left behind in the temporary place harms nobody
    std::filesystem::remove_all(path_, ignored);
  }
  TemporaryFolder(const TemporaryFolder&) = delete;
  TemporaryFolder& operator=(const TemporaryFolder&) = delete;
  [[nodiscard]] const std::filesystem::path& path() const { return path_; }

 private:
  std::filesystem::path path_;
};

registration::TriangleMesh mesh_of(const std::string& file) {
  registration::TriangleMesh mesh = registration::read_mesh(file);
  if (mesh.triangles.empty()) throw InputError(file + ": has no triangles to measure distances to");
  return mesh;
}

/// All searches of one command, and the CSV they share.
class PatternStudy {
 public:
  explicit PatternStudy(const Options& options)
      : options_(options),
        head_{kind_of(options.kind), options.is_paper, options.seed},
        calibration_(registration::read_stereo_calibration(options.calibration)),
        reference_(mesh_of(options.reference)),
        rig_(rig_command(options.rig)) {
    if (std::filesystem::exists(options.csv)) {
      std::ostringstream text;
      text << std::ifstream(options.csv).rdbuf();
      known_ = registration::parse_pattern_table(options.csv, text.str(), head_);
    }
    for (const double zoom : options.zooms)
      (void)registration::calibration_at_zoom(calibration_, zoom, false);
  }

  std::vector<BestPattern> run() {
    std::vector<BestPattern> best;
    std::vector<registration::DotsValue> neighbour;
    for (const double zoom : options_.zooms) {
      registration::PatternSearchOptions search_options;
      search_options.is_paper = options_.is_paper;
      search_options.seed = options_.seed;
      search_options.evaluations_max = options_.evaluations_max;
      if (!options_.is_paper) search_options.neighbour = neighbour;
      registration::PatternSearch search(search_options);
      search_zoom(zoom, search);
      neighbour = search.evaluations();
      const auto found = search.best();
      best.push_back(
          {zoom, found.dots, found.value, static_cast<int>(search.evaluations().size())});
    }
    return best;
  }
  [[nodiscard]] const registration::PatternTableHead& head() const { return head_; }
  [[nodiscard]] std::size_t evaluations() const { return known_.size(); }
  [[nodiscard]] std::size_t taken() const { return taken_; }

 private:
  void search_zoom(double zoom, registration::PatternSearch& search) {
    for (const PatternEvaluation& evaluation : known_)
      if (evaluation.zoom == zoom) search.add({evaluation.dots, evaluation.objective_mm});
    const auto zoom_calibration = registration::calibration_at_zoom(calibration_, zoom, false);
    registration::ReconstructionOptions options;
    options.threads = options_.threads;
    options.may_be_lattice = head_.kind == registration::PatternKind::lattice;
    if (!options_.roi.empty())
      options.roi_px = cv::Rect(options_.roi[0], options_.roi[1], options_.roi[2], options_.roi[3]);
    const cv::Size size(calibration_.image_width_px, calibration_.image_height_px);
    registration::Reconstructor reconstructor(zoom_calibration, size, options);
    const registration::EvaluationOptions evaluation_options = evaluation_at(zoom);
    while (const auto dots = search.next()) {
      if (bridge::is_interrupted()) throw InterruptedError("interrupted");
      const registration::StereoShot shot = take(zoom, *dots);
      PatternEvaluation judged = registration::judge_pattern(
          reconstructor.reconstruct(std::span(&shot, 1)), reconstructor.rectification(), reference_,
          evaluation_options, head_.is_paper);
      judged.zoom = zoom;
      judged.dots = *dots;
      search.add({*dots, judged.objective_mm});
      known_.push_back(judged);
      ++taken_;
      bridge::write_file_atomically(options_.csv, registration::pattern_table_text(head_, known_));
      progress(judged, search.evaluations().size());
    }
  }

  registration::StereoShot take(double zoom, const registration::Dots& dots) {
    PairRequest request;
    request.out = images_.path();
    request.zoom = zoom;
    request.pattern = (images_.path() / "pattern.png").string();
    std::vector<uchar> png;
    cv::imencode(".png",
                 registration::make_pattern({head_.kind, static_cast<double>(dots.dot_px),
                                             static_cast<double>(dots.distance_px), head_.seed}),
                 png);
    bridge::write_file_atomically(request.pattern, std::string{png.begin(), png.end()});
    return rig_.pair(request).shot;
  }

  [[nodiscard]] registration::EvaluationOptions evaluation_at(double zoom) const {
    std::string file = options_.transform;
    constexpr std::string_view kZoom = "{zoom}";
    if (const std::size_t at = file.find(kZoom); at != std::string::npos)
      file.replace(at, kZoom.size(), fmt::format("{}", zoom));
    registration::EvaluationOptions options;
    options.T_reference_surface = registration::read_transform(file).inverse();
    if (const auto& r = options_.region; !r.empty())
      options.region_mm =
          Eigen::AlignedBox3d(Eigen::Vector3d(r[0], r[1], r[2]), Eigen::Vector3d(r[3], r[4], r[5]));
    options.seed = options_.seed;
    return options;
  }

  void progress(const PatternEvaluation& judged, std::size_t count) const {
    const bool is_terminal = isatty(STDERR_FILENO) != 0;
    if (!is_terminal && options_.is_json) return;
    fmt::print(stderr, "zoom {}: {} of at most {}: dots {} px, {} px apart: {:.3f} mm ({})\n",
               judged.zoom, count, options_.evaluations_max, judged.dots.dot_px,
               judged.dots.distance_px, judged.objective_mm, judged.status);
  }

  const Options& options_;
  registration::PatternTableHead head_;
  registration::StereoCalibration calibration_;
  registration::ReferenceSurface reference_;
  TemporaryFolder images_;
  Rig rig_;
  std::vector<PatternEvaluation> known_;
  std::size_t taken_ = 0;
};

void run(const Options& options) {
  bridge::catch_interrupts();
  PatternStudy study(options);
  const std::vector<BestPattern> best = study.run();
  const double unknown =
      options.is_paper ? registration::kUnknownInPaperMm : registration::kUnknownMm;
  for (const BestPattern& b : best)
    if (!(b.objective_mm < unknown))
      throw RefusedError(
          fmt::format("zoom {}: none of {} patterns could be reconstructed; {} says why", b.zoom,
                      b.evaluations, options.csv));
  bridge::write_file_atomically(options.out, registration::patterns_toml(study.head(), best));
  nlohmann::ordered_json json;
  json["out"] = options.out;
  json["csv"] = options.csv;
  json["evaluations"] = study.evaluations();
  json["taken_now"] = study.taken();
  json["patterns"] = nlohmann::json::array();
  for (const BestPattern& b : best) {
    json["patterns"].push_back({{"zoom", b.zoom},
                                {"kind", options.kind},
                                {"distance_px", b.dots.distance_px},
                                {"dot_px", b.dots.dot_px},
                                {"objective_mm", b.objective_mm},
                                {"evaluations", b.evaluations}});
    if (!options.is_json)
      fmt::print("zoom {}: dots of {} px, {} px apart: {:.3f} mm, best of {} evaluations\n", b.zoom,
                 b.dots.dot_px, b.dots.distance_px, b.objective_mm, b.evaluations);
  }
  if (options.is_json) fmt::print("{}\n", json.dump());
}

}  // namespace

void add_optimize_pattern(CLI::App& app) {
  auto options = std::make_shared<Options>();
  CLI::App* command =
      app.add_subcommand("optimize-pattern", "The dots that give the best surface, per zoom.");
  command->add_option("--rig", options->rig, "Command of the rig that takes a pair under a pattern")
      ->required();
  command->add_option("--calibration", options->calibration, "stereo.yaml")->required();
  command->add_option("--zooms", options->zooms, "Zooms, neighbours in turn: 1.1,1.2,1.3")
      ->delimiter(',')
      ->required();
  command->add_option("--reference", options->reference, "The object's surface (PLY, STL)")
      ->required();
  command->add_option("--transform", options->transform, "ITK transform, reference to camera")
      ->required();
  command->add_option("--region", options->region, "x0,y0,z0,x1,y1,z1 of the reference, mm")
      ->delimiter(',')
      ->expected(6);
  command->add_option("--roi", options->roi, "x,y,w,h: only this part of the left image, px")
      ->delimiter(',')
      ->expected(4);
  command->add_option("--kind", options->kind, "Of pattern")
      ->check(CLI::IsMember({"aperiodic", "lattice", "random"}))
      ->capture_default_str();
  command->add_flag("--paper", options->is_paper, "Search and judge as paper A does");
  command->add_option("--evaluations", options->evaluations_max, "At most, for each zoom")
      ->check(CLI::Range(1, 150))
      ->capture_default_str();
  command->add_option("--seed", options->seed, "Of the search and the dots")->capture_default_str();
  command->add_option("--threads", options->threads, "Of the reconstruction")
      ->check(CLI::Range(1, 64))
      ->capture_default_str();
  command->add_option("--out", options->out, "patterns.toml")->required();
  command->add_option("--csv", options->csv, "Every evaluation; resumed from where it exists")
      ->required();
  command->add_flag("--json", options->is_json, "Print one JSON object on stdout");
  command->footer(kExample);
  command->callback([options] { run(*options); });
}

}  // namespace holdfast::rt
