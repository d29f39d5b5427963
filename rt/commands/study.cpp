// SPDX-License-Identifier: Apache-2.0
// `holdfast study`: paper A's comparison on the rig, with its tables beside ours.
#include "rt/study/study.hpp"

#include <algorithm>
#include <cstdio>
#include <fstream>
#include <memory>
#include <sstream>
#include <string>

#include <CLI/CLI.hpp>
#include <fmt/format.h>
#include <nlohmann/json.hpp>
#include <opencv2/core.hpp>
#include <opencv2/core/utils/logger.hpp>
#include <unistd.h>

#include "bridge/atomic_file.hpp"
#include "bridge/command_line.hpp"
#include "rt/commands/rig_commands.hpp"
#include "rt/core/error.hpp"
#include "rt/study/illumination.hpp"
#include "rt/study/pattern_choice.hpp"
#include "rt/study/rig.hpp"
#include "rt/study/study_report.hpp"

namespace holdfast::rt {
namespace {

constexpr const char* kExample =
    "Example: paper A's 200 pairs on the virtual rig; interrupted, the same line goes on with it\n"
    "  holdfast study --out study/\n"
    "and a first look in a few minutes: one zoom, one repeat\n"
    "  holdfast study --out look/ --zooms 1.3 --repeats 1\n"
    "Paper B's experiment, its three scenes and two paths, and a first look at one of each\n"
    "  holdfast study --tracking --out tracking/\n"
    "  holdfast study --tracking --out look/ --scenes cavity_bone --motions spiral:0.2\n"
    "and where the beam of a robot lands that follows, compensated and not\n"
    "  holdfast study --tracking --out beam/ --scenes cavity_bone --motions spiral:0.2 --beam\n"
    "What the tracker says under shocks, blood, smoke and the like (disturbances.html); one of "
    "them\n"
    "  holdfast study --tracking --disturbances --out disturbed/\n"
    "  holdfast study --tracking --disturbances --out disturbed/ --only smoke\n"
    "Writes report.html (one self-contained page) and results.csv (every reconstruction); "
    "settings\n"
    "are in study.json before the first image is made. A rig is a program that answers requests "
    "as\n"
    "`holdfast-sim rig` does.";

struct Options {
  StudySettings settings;
  registration::PatternParameters pattern;
  std::string out, rig, patterns;
  std::uint32_t phantom_seed = 1000;
  bool is_lattice = false, is_json = false;

  TrackingSettings tracking;
  std::vector<std::string> scenes{"cavity_bone", "cavity_covered", "cavity_bloody"};
  std::vector<std::string> beam_motions{"still:2", "linear:0.2", "breathing", "tilt", "bump"};
  bool is_tracking = false, is_beam = false, is_disturbed = false;
  bool are_scenes_default = true, is_rate_default = true;
  std::vector<std::string> only;
};

void show(int done, int all, const std::string& what) {
  if (bridge::is_interrupted()) throw InterruptedError("interrupted");
  if (isatty(STDERR_FILENO) != 1) return;
  constexpr int kWidth = 30;
  const int full = all > 0 ? kWidth * done / all : 0;
  fmt::print(stderr, "\r\033[K[{}{}] {}/{} {}", std::string(static_cast<std::size_t>(full), '#'),
             std::string(static_cast<std::size_t>(kWidth - full), '.'), done, all, what);
  std::fflush(stderr);
}

struct ClearLine {
  ~ClearLine() {
    if (isatty(STDERR_FILENO) == 1) std::fputs("\r\033[K", stderr);
  }
};

void prepare(Options& options) {
  std::vector<double>& zooms = options.settings.zooms;
  std::sort(zooms.begin(), zooms.end());
  if (std::adjacent_find(zooms.begin(), zooms.end()) != zooms.end())
    throw InputError("--zooms: one is given twice");
  if (options.is_lattice) options.pattern.kind = registration::PatternKind::lattice;
  if (const auto invalid = registration::invalid_pattern(options.pattern))
    throw InputError(*invalid);
  options.settings.patterns.assign(zooms.size(), options.pattern);
  if (!options.patterns.empty()) {
    const auto best = read_best_patterns(options.patterns);
    for (std::size_t i = 0; i < zooms.size(); ++i)
      options.settings.patterns[i] = pattern_for(zooms[i], best);
  }
  options.settings.rig =
      options.rig.empty() ? virtual_rig({"--seed", fmt::format("{}", options.settings.seed),
                                         "--phantom-seed", fmt::format("{}", options.phantom_seed)})
                          : rig_command(options.rig);
}

std::string bytes_of(const std::filesystem::path& file) {
  std::ostringstream bytes;
  bytes << std::ifstream(file, std::ios::binary).rdbuf();
  return bytes.str();
}

void write_results(const Options& options, const StudyResult& result) {
  const std::filesystem::path out = options.out;
  std::vector<ReportPicture> pictures;
  for (const StudyPicture& picture : result.heat_maps)
    pictures.push_back({picture.title, bytes_of(picture.file)});
  bridge::write_file_atomically((out / "results.csv").string(), csv_text(result.rows));
  bridge::write_file_atomically(
      (out / "report.html").string(),
      study_html(options.settings, result.rows, result.calibration_rms_px, pictures));
}

void report(const Options& options, const StudyResult& result) {
  nlohmann::ordered_json json;
  json["out"] = options.out;
  json["reconstructions"] = result.rows.size();
  json["refused"] = std::count_if(result.rows.begin(), result.rows.end(),
                                  [](const StudyRow& row) { return !row.refusal.empty(); });
  json["resumed_pairs"] = result.resumed;
  json["calibration_rms_px"] = result.calibration_rms_px;
  if (!options.is_json)
    fmt::print("{:>5} {:<11} {:<7} {:>15} {:>10} {:>12} {:>10} {:>8}\n", "zoom", "light", "method",
               "closest, mm", "truth p50", "over 1 mm, %", "covered, %", "refused");
  for (const double zoom : options.settings.zooms)
    for (const Illumination illumination : kIlluminations)
      for (const char* method : {"opencv", "sgm", "burst"}) {
        const bool is_burst = std::string(method) == "burst";
        if (is_burst && (options.settings.shots < 2 || illumination != Illumination::adaptive))
          continue;
        const StudyCell cell = cell_of(result.rows, zoom, std::string(name(illumination)), method);
        nlohmann::json row = as_json(cell.mean);
        row["repeats"] = cell.repeats;
        row["refused"] = cell.refused;
        row.erase("repeat");
        json["cells"].push_back(nlohmann::ordered_json(row));
        if (!options.is_json)
          fmt::print("{:>5g} {:<11} {:<7} {:>7.3f} ± {:.3f} {:>10.3f} {:>12.2f} {:>10.1f} {:>8}\n",
                     zoom, name(illumination), method, cell.mean.closest_mean_mm,
                     cell.mean.closest_sd_mm, cell.mean.truth_median_mm,
                     100 * cell.mean.truth_over_1_mm, 100 * cell.mean.coverage, cell.refused);
      }
  if (options.is_json)
    fmt::print("{}\n", json.dump(-1, ' ', false, nlohmann::json::error_handler_t::replace));
  else
    fmt::print("{}/report.html: {} reconstructions, {} refused\n", options.out, result.rows.size(),
               json["refused"].get<int>());
}

void run_disturbances(const Options& options) {
  const TrackingSettings& t = options.tracking;
  DisturbanceSettings s;
  s.scenes = t.scenes;
  if (options.rig.empty() && options.are_scenes_default) s.scenes.resize(1);
  s.zoom = t.zoom;
  if (!options.is_rate_default) s.rate_hz = t.rate_hz;
  s.calibration_pairs = t.calibration_pairs;
  s.setup = t.setup;
  for (const Disturbance& disturbance : all_disturbances())
    if (options.only.empty() ||
        std::find(options.only.begin(), options.only.end(), disturbance.name) != options.only.end())
      s.disturbances.push_back(disturbance);
  study_disturbances(s, options.out, options.is_json, show);
}

/// Each scene is a room of its own.
void run_tracking(Options& options) {
  TrackingSettings& s = options.tracking;
  s.calibration_pairs = options.settings.calibration_pairs;
  s.setup = options.settings.setup;
  if (options.is_beam) s.beam_motions = options.beam_motions;
  if (options.settings.zooms.size() == 1) s.zoom = options.settings.zooms.front();
  if (!options.rig.empty()) s.scenes = {{"rig", rig_command(options.rig)}};
  for (const std::string& scene : options.scenes)
    if (options.rig.empty())
      s.scenes.push_back({scene, virtual_rig({"--seed", fmt::format("{}", options.settings.seed),
                                              "--phantom", scene})});
  const ClearLine clear;
  if (options.is_disturbed) return run_disturbances(options);
  study_tracking(s, options.out, options.is_json, show);
}

void run(Options options) {
  cv::utils::logging::setLogLevel(cv::utils::logging::LOG_LEVEL_SILENT);
  bridge::catch_interrupts();
  if (options.is_tracking) return run_tracking(options);
  prepare(options);
  cv::setNumThreads(options.settings.setup.threads);
  StudyResult result;
  {
    const ClearLine clear;
    result = run_study(options.settings, options.out, show);
  }
  write_results(options, result);
  report(options, result);
}

}  // namespace

void add_study(CLI::App& app) {
  auto options = std::make_shared<Options>();
  StudySettings& s = options->settings;
  CLI::App* study = app.add_subcommand(
      "study", "Paper A's comparison: zooms x illuminations x repeats, beside its tables.");
  study->add_option("--out", options->out, "Folder; a study that stands there is gone on with")
      ->required();
  study->add_option("--zooms", s.zooms, "Zooms, 1.1 to 1.5")
      ->delimiter(',')
      ->check(CLI::Range(1.1, 1.5));
  study->add_option("--repeats", s.repeats, "Positions of the ear for each zoom and light")
      ->check(CLI::Range(1, 1000))
      ->capture_default_str();
  study->add_option("--seed", s.seed, "Of the virtual rig, the positions and the drawing")
      ->capture_default_str();
  study
      ->add_option("--phantom-seed", options->phantom_seed,
                   "The ear's shape; from 1000 on: held out")
      ->capture_default_str();
  study->add_option("--pairs", s.calibration_pairs, "Calibration pairs a zoom")
      ->check(CLI::Range(6, 200))
      ->capture_default_str();
  study->add_option("--points", s.points, "Drawn of each reconstruction")
      ->check(CLI::Range(10, 1'000'000))
      ->capture_default_str();
  study
      ->add_option("--shots", s.shots,
                   "Of a burst with as many adaptive patterns, measured beside the single shot")
      ->check(CLI::Range(1, 31))
      ->capture_default_str();
  study->add_option("--dots", options->pattern.dot_px, "Adaptive pattern: diameter of a dot, px")
      ->capture_default_str();
  study->add_option("--distance", options->pattern.distance_px, "Adaptive pattern: gap, px")
      ->capture_default_str();
  study->add_option("--patterns", options->patterns,
                    "patterns.toml of optimize-pattern, in place of --dots and --distance");
  study->add_flag("--lattice", options->is_lattice, "Paper A's regular pattern");
  study->add_option("--rig", options->rig,
                    "Command of the rig (default: holdfast-sim rig beside this)");
  study->add_option("--threads", s.setup.threads, "Of the reconstruction")
      ->check(CLI::Range(1, 64))
      ->capture_default_str();
  study->add_flag(
      "--tracking", options->is_tracking,
      "Paper B's experiment instead: scenes x motions, three methods on the same frames");
  study->add_option("--scenes", options->scenes, "With --tracking: what the virtual rig shows")
      ->delimiter(',')
      ->capture_default_str();
  study
      ->add_option("--motions", options->tracking.motions,
                   "With --tracking: linear, spiral, breathing, tilt, lift, roll, bump; with :F "
                   "larger or smaller")
      ->delimiter(',')
      ->default_val(std::vector<std::string>{"linear", "spiral"});
  study
      ->add_option("--rate", options->tracking.rate_hz,
                   "With --tracking: frames/s (with --disturbances 30 unless given)")
      ->check(CLI::Range(1.0, 240.0))
      ->capture_default_str();
  study->add_flag("--beam", options->is_beam,
                  "With --tracking: also where the beam lands of a robot that follows");
  study->add_flag("--disturbances", options->is_disturbed,
                  "With --tracking: instead of paper B's paths, of one scene unless --scenes says "
                  "otherwise");
  std::vector<std::string> names;
  for (const Disturbance& disturbance : all_disturbances()) names.push_back(disturbance.name);
  study->add_option("--only", options->only, "With --disturbances: of them these")
      ->delimiter(',')
      ->check(CLI::IsMember(names));
  study->add_option("--beam-motions", options->beam_motions, "With --beam")
      ->delimiter(',')
      ->capture_default_str();
  study->add_option("--beam-rate", options->tracking.beam_rate_hz, "With --beam: frames/s")
      ->check(CLI::Range(10.0, 240.0))
      ->capture_default_str();
  study->add_flag("--json", options->is_json, "Print one JSON object on stdout");
  study->footer(kExample);
  study->callback([options, study] {
    options->are_scenes_default = study->count("--scenes") == 0;
    options->is_rate_default = study->count("--rate") == 0;
    run(*options);
  });
}

}  // namespace holdfast::rt
