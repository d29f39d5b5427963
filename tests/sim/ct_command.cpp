// SPDX-License-Identifier: Apache-2.0
// `holdfast-sim ct`.
#include <cstdio>
#include <map>
#include <memory>
#include <string>
#include <vector>

#include <fmt/core.h>
#include <nlohmann/json.hpp>
#include <unistd.h>

#include "bridge/atomic_file.hpp"
#include "bridge/command_line.hpp"
#include "rt/core/error.hpp"
#include "tests/sim/commands.hpp"
#include "tests/sim/or/ct_scanner.hpp"
#include "tests/sim/or/dicom_series.hpp"
#include "tests/sim/or/phantom.hpp"
#include "tests/sim/or/room_output.hpp"

namespace holdfast::sim {
namespace {

constexpr double kTiltDeg = 12;
constexpr double kFillingBelowFocusMm = 16;

const std::map<std::string, DicomFault> file_faults{
    {"gap", DicomFault::gap},
    {"duplicate", DicomFault::duplicate},
    {"conflicting-duplicate", DicomFault::conflicting_duplicate},
    {"mixed", DicomFault::mixed},
    {"second-patient", DicomFault::second_patient},
    {"truncated", DicomFault::truncated},
    {"mirrored", DicomFault::mirrored}};

const std::map<std::string, DicomTransfer> transfers{{"explicit", DicomTransfer::explicit_little},
                                                     {"implicit", DicomTransfer::implicit_little},
                                                     {"big-endian", DicomTransfer::explicit_big},
                                                     {"jpeg", DicomTransfer::jpeg_lossless},
                                                     {"rle", DicomTransfer::rle}};

struct Options {
  std::string phantom = "ear", out, truth, transfer = "explicit";
  std::vector<std::string> faults;
  std::uint32_t seed = 1;
  CtScannerParameters scanner;
  bool json = false;
};

Phantom make_phantom(const Options& options) {
  const auto parts = PhantomParts::scan_only;
  if (options.phantom == "ear") return make_ear_phantom(options.seed, parts);
  const CavityRealism realism = options.phantom == "cavity"    ? CavityRealism::bone
                                : options.phantom == "covered" ? CavityRealism::covered
                                                               : CavityRealism::bloody;
  return make_cavity_phantom(options.seed, realism, parts);
}

void show_progress(double fraction) {
  if (bridge::is_interrupted()) throw InterruptedError("interrupted");
  if (isatty(STDERR_FILENO) != 0)
    std::fprintf(stderr, "\rscanning: %3.0f %%%s", 100 * fraction, fraction < 1 ? "" : "\n");
}

void run(Options options) {
  bridge::catch_interrupts();
  DicomSeriesParameters files;
  files.seed = options.seed;
  files.transfer = transfers.at(options.transfer);
  options.scanner.seed = options.seed;
  options.scanner.progress = show_progress;
  std::fprintf(stderr, "making the %s phantom\n", options.phantom.c_str());
  Phantom phantom = make_phantom(options);
  for (const std::string& fault : options.faults) {
    if (fault == "tilt")
      options.scanner.gantry_tilt_deg = kTiltDeg;
    else if (fault == "filling") {
      const Eigen::Vector3d p_filling_ct_mm =
          phantom.p_focus_ct_mm - kFillingBelowFocusMm * phantom.n_view_ct;
      phantom = with_filling(std::move(phantom), p_filling_ct_mm);
    } else
      files.faults.insert(file_faults.at(fault));
  }
  const CtVolume volume = scan(phantom, options.scanner);
  const DicomSeries series = write_dicom_series(volume, files, options.out);
  if (!options.truth.empty())
    bridge::write_file_atomically(options.truth, ct_truth(phantom, series).dump(2) + "\n");
  const nlohmann::json result{{"folder", options.out},
                              {"series_uid", series.series_uid},
                              {"files", series.files.size()},
                              {"columns", volume.slices.front().cols},
                              {"rows", volume.slices.front().rows},
                              {"slices", volume.slices.size()}};
  const std::string text =
      fmt::format("{}: {} files, series {}", options.out, series.files.size(), series.series_uid);
  std::puts((options.json ? result.dump() : text).c_str());
}

}  // namespace

void add_ct_command(CLI::App& program) {
  const auto options = std::make_shared<Options>();
  CLI::App& command =
      *program.add_subcommand("ct", "A CT scan of a phantom as a folder of DICOM files.");
  command.footer("Example: holdfast-sim ct --phantom ear --seed 3 --out ct --truth truth.json");
  command.add_option("--phantom", options->phantom, "ear, or the cavity at a level of realism")
      ->check(CLI::IsMember({"ear", "cavity", "covered", "bloody"}))
      ->capture_default_str();
  command.add_option("--seed", options->seed, "of phantom, scan and files; from 1000: evaluation")
      ->capture_default_str();
  command.add_option("--out", options->out, "folder to be made; must be empty or absent")
      ->required();
  std::vector<std::string> faults{"tilt", "filling"};
  for (const auto& [name, fault] : file_faults) faults.push_back(name);
  command.add_option("--fault", options->faults, "what is wrong with it; repeatable")
      ->check(CLI::IsMember(faults));
  command.add_option("--transfer", options->transfer, "transfer syntax")
      ->check(CLI::IsMember(transfers))
      ->capture_default_str();
  command.add_option("--pixel-mm", options->scanner.pixel_mm)->capture_default_str();
  command.add_option("--slice-mm", options->scanner.slice_mm, "thickness and distance")
      ->capture_default_str();
  command.add_option("--noise-hu", options->scanner.noise_hu)->capture_default_str();
  command.add_option("--oblique-deg", options->scanner.oblique_deg, "turn of the grid")
      ->capture_default_str();
  command.add_option("--truth", options->truth, "JSON of the true markers and beads, frame ct");
  command.add_flag("--json", options->json, "one JSON object on stdout");
  command.callback([options] { run(*options); });
}

}  // namespace holdfast::sim
