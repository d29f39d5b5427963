// SPDX-License-Identifier: Apache-2.0
// `holdfast fiducials`: centres of bead markers in a CT.
#include <memory>
#include <optional>
#include <string>

#include <fmt/format.h>

#include "bridge/atomic_file.hpp"
#include "bridge/command_line.hpp"
#include "registration/ct/bead_search.hpp"
#include "rt/commands/commands.hpp"
#include "rt/commands/ct_reading.hpp"
#include "rt/core/error.hpp"

namespace holdfast::rt {
namespace {

constexpr const char* kExample =
    "Example: the four beads under the markers of the phantom\n"
    "  holdfast fiducials --dicom ct/ --diameter-mm 1.5 --count 4 --out xspots.mrk.json\n"
    "Points are bead-1, bead-2, ... ascending in x (LPS, mm), with covariance. Exit code 1: no "
    "bead, or\nnot --count of them; what was found and what was rejected, and why, is named.";

struct Options {
  std::string dicom, series, out;
  double diameter_mm = 0;
  std::optional<int> count;
  bool is_json = false;
};

void report(const Options& options, const registration::CtVolume& volume,
            const registration::BeadSearch& search) {
  if (!options.is_json) {
    for (std::size_t k = 0; k < search.beads.size(); ++k) {
      const registration::BeadFit& bead = search.beads[k];
      fmt::print("bead-{}: {:.3f} {:.3f} {:.3f} mm, contrast {:.0f} HU, sphericity {:.2f}\n", k + 1,
                 bead.p_ct_mm.x(), bead.p_ct_mm.y(), bead.p_ct_mm.z(), bead.contrast_hu,
                 bead.sphericity);
    }
    for (const auto& [p, reason] : search.rejected)
      fmt::print("no bead at {:.2f} {:.2f} {:.2f} mm: {}\n", p.x(), p.y(), p.z(), reason);
    for (const std::string& note : volume.notes) fmt::print("note: {}\n", note);
    return;
  }
  nlohmann::ordered_json json;
  json["beads"] = json["rejected"] = nlohmann::json::array();
  for (const registration::BeadFit& bead : search.beads)
    json["beads"].push_back({{"label", fmt::format("bead-{}", json["beads"].size() + 1)},
                             {"position", {bead.p_ct_mm.x(), bead.p_ct_mm.y(), bead.p_ct_mm.z()}},
                             {"contrast_hu", bead.contrast_hu},
                             {"is_clipped", bead.is_clipped},
                             {"sphericity", bead.sphericity},
                             {"residual_share", bead.residual_share}});
  for (const auto& [p, reason] : search.rejected)
    json["rejected"].push_back({{"position", {p.x(), p.y(), p.z()}}, {"reason", reason}});
  add_ct_members(volume, json);
  json["out"] = options.out;
  fmt::print("{}\n", json.dump(-1, ' ', false, nlohmann::json::error_handler_t::replace));
}

void run(const Options& options) {
  if (!(options.diameter_mm >= 0.5 && options.diameter_mm <= 10))
    throw InputError(fmt::format("--diameter-mm {}, must be 0.5 to 10 mm", options.diameter_mm));
  bridge::catch_interrupts();
  const registration::CtVolume volume = read_ct(options.dicom, options.series);
  const registration::BeadSearch search = registration::find_beads(volume, options.diameter_mm);
  const std::string text = registration::markups_text(registration::Markups{
      registration::bead_points(search, options.count), ct_properties(volume), {}});
  if (bridge::is_interrupted()) throw InterruptedError("interrupted");
  bridge::write_file_atomically(options.out, text);
  report(options, volume, search);
}

}  // namespace

void add_fiducials(CLI::App& app) {
  auto options = std::make_shared<Options>();
  CLI::App* fiducials = app.add_subcommand("fiducials", "Centres of bead markers in a CT.");
  fiducials->add_option("--dicom", options->dicom, "Folder of the CT's DICOM files")->required();
  fiducials->add_option("--diameter-mm", options->diameter_mm, "The beads' diameter")->required();
  fiducials->add_option("--series", options->series, "SeriesInstanceUID, where there are several");
  fiducials->add_option("--count", options->count, "How many beads there must be")
      ->check(CLI::Range(1, 1000));
  fiducials->add_option("--out", options->out, "3D Slicer markups (.mrk.json)")->required();
  fiducials->add_flag("--json", options->is_json, "Print one JSON object on stdout");
  fiducials->footer(kExample);
  fiducials->callback([options] { run(*options); });
}

}  // namespace holdfast::rt
