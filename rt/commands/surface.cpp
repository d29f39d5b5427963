// SPDX-License-Identifier: Apache-2.0
// `holdfast surface`: the surface of equal HU in a CT, in patient coordinates.
#include <chrono>
#include <cmath>
#include <filesystem>
#include <memory>
#include <string>
#include <vector>

#include <fmt/format.h>

#include "bridge/atomic_file.hpp"
#include "bridge/command_line.hpp"
#include "registration/ct/isosurface.hpp"
#include "rt/commands/commands.hpp"
#include "rt/commands/ct_reading.hpp"
#include "rt/core/error.hpp"

namespace holdfast::rt {
namespace {

using Clock = std::chrono::steady_clock;

constexpr const char* kExample =
    "Example: the skin of one series, only around the left ear\n"
    "  holdfast surface --dicom ct/ --series 1.2.840.113619.2.1 --iso -200 "
    "--roi 40,-60,-20,110,40,60 \\\n    --out ct.ply\n"
    "Positions are the patient's (LPS, mm). Exit code 1: slices missing, doubled or tilted beyond "
    "repair,\nseveral series and no --series, several patients; each is named. A CT whose pixels "
    "were mirrored\nunder unchanged headers cannot be seen here: register refuses it.";

struct Options {
  std::string dicom, series, out;
  double iso_hu = 0;
  std::vector<double> roi;
  bool is_largest_only = false, is_json = false;
};

struct Timing {
  double read = 0, surface = 0, write = 0;
};

double ms_since(Clock::time_point& start) {
  const auto now = Clock::now();
  const double ms = std::chrono::duration<double, std::milli>(now - start).count();
  start = now;
  return ms;
}

bool is_stl(const std::string& out) {
  std::string extension = std::filesystem::path(out).extension().string();
  for (char& c : extension) c = static_cast<char>(std::tolower(static_cast<unsigned char>(c)));
  if (extension != ".ply" && extension != ".stl")
    throw InputError(out + ": --out must end in .ply or .stl");
  return extension == ".stl";
}

registration::IsosurfaceOptions isosurface_options(const Options& options) {
  registration::IsosurfaceOptions result;
  if (!(std::abs(options.iso_hu) <= 32767))
    throw InputError(fmt::format("--iso {} HU, must be -32767 to 32767 HU", options.iso_hu));
  result.iso_hu = options.iso_hu;
  result.is_largest_only = options.is_largest_only;
  if (options.roi.empty()) return result;
  const Eigen::Vector3d low(options.roi.data()), high(options.roi.data() + 3);
  if (!(low.array() < high.array()).all() || !low.allFinite() || !high.allFinite())
    throw InputError("--roi must be x0,y0,z0,x1,y1,z1 in mm with every first below its second");
  result.roi_mm = Eigen::AlignedBox3d(low, high);
  return result;
}

void report(const Options& options, const registration::CtVolume& volume,
            const registration::TriangleMesh& mesh, const Timing& timing) {
  Eigen::AlignedBox3f bounds;
  for (const Eigen::Vector3f& p : mesh.vertices_mm) bounds.extend(p);
  const Eigen::Vector3d low = bounds.min().cast<double>(), high = bounds.max().cast<double>();
  if (options.is_json) {
    nlohmann::ordered_json json;
    json["vertices"] = mesh.vertices_mm.size();
    json["triangles"] = mesh.triangles.size();
    json["bounds_mm"] = {{low.x(), low.y(), low.z()}, {high.x(), high.y(), high.z()}};
    json["iso_hu"] = options.iso_hu;
    add_ct_members(volume, json);
    json["timing_ms"] = {{"read", timing.read},
                         {"surface", timing.surface},
                         {"write", timing.write},
                         {"total", timing.read + timing.surface + timing.write}};
    json["out"] = options.out;
    fmt::print("{}\n", json.dump(-1, ' ', false, nlohmann::json::error_handler_t::replace));
    return;
  }
  fmt::print("{}: {} vertices, {} triangles from {} slices of series {}\n", options.out,
             mesh.vertices_mm.size(), mesh.triangles.size(), volume.size[2],
             volume.identity.series_uid);
  fmt::print("bounds {:.2f} {:.2f} {:.2f} to {:.2f} {:.2f} {:.2f} mm (LPS)\n", low.x(), low.y(),
             low.z(), high.x(), high.y(), high.z());
  fmt::print("read {:.0f} ms, surface {:.0f} ms, write {:.0f} ms\n", timing.read, timing.surface,
             timing.write);
  for (const std::string& note : volume.notes) fmt::print("note: {}\n", note);
}

void run(const Options& options) {
  const bool has_stl_name = is_stl(options.out);
  const registration::IsosurfaceOptions what = isosurface_options(options);
  bridge::catch_interrupts();
  Timing timing;
  auto start = Clock::now();
  const registration::CtVolume volume = read_ct(options.dicom, options.series);
  timing.read = ms_since(start);
  registration::TriangleMesh mesh = registration::isosurface(volume, what);
  timing.surface = ms_since(start);
  if (bridge::is_interrupted()) throw InterruptedError("interrupted");
  // 3D Slicer reads SPACE; register compares the others.
  mesh.comments = {"SPACE=LPS", "ct_series " + volume.identity.series_uid,
                   "ct_frame_of_reference " + volume.identity.frame_of_reference_uid,
                   fmt::format("iso_hu {}", options.iso_hu)};
  bridge::write_file_atomically(
      options.out, has_stl_name ? registration::stl_bytes(mesh) : registration::ply_bytes(mesh));
  timing.write = ms_since(start);
  report(options, volume, mesh, timing);
}

}  // namespace

void add_surface(CLI::App& app) {
  auto options = std::make_shared<Options>();
  CLI::App* surface = app.add_subcommand("surface", "The surface of equal HU in a CT.");
  surface->add_option("--dicom", options->dicom, "Folder of the CT's DICOM files")->required();
  surface->add_option("--iso", options->iso_hu, "HU of the surface: bone about 226, skin -200")
      ->required();
  surface->add_option("--series", options->series, "SeriesInstanceUID, where there are several");
  surface->add_option("--roi", options->roi, "x0,y0,z0,x1,y1,z1: only triangles inside, LPS mm")
      ->delimiter(',')
      ->expected(6);
  surface->add_flag("--largest", options->is_largest_only, "Only the largest connected piece");
  surface->add_option("--out", options->out, "The surface: .ply or .stl")->required();
  surface->add_flag("--json", options->is_json, "Print one JSON object on stdout");
  surface->footer(kExample);
  surface->callback([options] { run(*options); });
}

}  // namespace holdfast::rt
