// SPDX-License-Identifier: Apache-2.0
// `holdfast register`: where the CT lies in the camera, from fiducials and surfaces.
#include <charconv>
#include <cmath>
#include <filesystem>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include <fmt/format.h>
#include <nlohmann/json.hpp>

#include "bridge/atomic_file.hpp"
#include "bridge/command_line.hpp"
#include "bridge/image_file.hpp"
#include "registration/coverage_map.hpp"
#include "registration/ct_registration.hpp"
#include "registration/transform_file.hpp"
#include "rt/commands/commands.hpp"
#include "rt/core/error.hpp"

namespace holdfast::rt {
namespace {

constexpr const char* kExample =
    "Example: four beads of the CT, four markers of the microscope, refined by the surfaces\n"
    "  holdfast register --fixed xspots.mrk.json --moving m.mrk.json --fixed-surface ct.ply \\\n"
    "      --moving-surface mire.ply --refine --target 12.0,-8.5,21.0 --out registration.json\n"
    "With --coverage c.ply --reasons r.png: which parts of the CT's surface the reconstruction "
    "covers, "
    "and why\nnot the others.\n"
    "Points with equal labels correspond; without a common label the assignment is searched.\n"
    "Exit code 1: the registration is refused; the reason is on stderr and nothing is written.\n"
    "A CT whose pixels are mirrored, headers intact, is found here: no motion fits it.";

struct Options {
  std::string fixed, moving, fixed_surface, moving_surface, out, tfm, expected_ct, keyframe, depth;
  std::string coverage, reasons;
  std::vector<std::string> targets;
  double zoom = 0, focus_mm = 0;
  bool is_refined = false, is_json = false;
  registration::RegistrationLimits limits;
};

Eigen::Vector3d point_of(const std::string& text) {
  Eigen::Vector3d p;
  const char* at = text.data();
  const char* const end = at + text.size();
  for (int axis = 0; axis < 3; ++axis) {
    const auto [next, error] = std::from_chars(at, end, p(axis));
    const bool is_separated = axis == 2 ? next == end : next != end && *next == ',';
    if (error != std::errc{} || !is_separated || !std::isfinite(p(axis)))
      throw InputError(fmt::format("--target {}: three numbers x,y,z in mm are needed", text));
    at = next + 1;
  }
  return p;
}

registration::RegistrationInput read_input(const Options& options) {
  registration::RegistrationInput input;
  input.fixed = registration::read_markups_file(options.fixed);
  input.moving = registration::read_markups_file(options.moving);
  if (options.fixed_surface.empty() != options.moving_surface.empty())
    throw InputError("--fixed-surface and --moving-surface are given together or not at all");
  if (options.is_refined && options.fixed_surface.empty())
    throw InputError("--refine needs --fixed-surface and --moving-surface");
  if (!options.coverage.empty() && options.fixed_surface.empty())
    throw InputError("--coverage needs --fixed-surface and --moving-surface");
  if (!options.reasons.empty() && options.coverage.empty())
    throw InputError("--reasons needs --coverage");
  if (!options.fixed_surface.empty()) {
    input.fixed_surface = registration::read_mesh(options.fixed_surface);
    input.moving_surface = registration::read_mesh(options.moving_surface);
    if (input.fixed_surface->triangles.empty())
      throw InputError(fmt::format("{}: has no triangles", options.fixed_surface));
  }
  input.is_refined = options.is_refined;
  for (const std::string& target : options.targets) input.targets_ct_mm.push_back(point_of(target));
  input.expected_ct = options.expected_ct;
  input.limits = options.limits;
  return input;
}

/// Empty when it is not asked for.
std::optional<registration::CoverageMap> covered(const Options& options,
                                                 const registration::RegistrationInput& input,
                                                 const registration::CtRegistration& result) {
  if (options.coverage.empty()) return {};
  const auto view = registration::view_of(*input.moving_surface);
  if (!view)
    throw InputError(fmt::format(
        "{}: does not say through which cameras it was made, as `reconstruct` writes it",
        options.moving_surface));
  cv::Mat1b reasons;
  if (!options.reasons.empty()) {
    const cv::Mat image = bridge::read_image_file(options.reasons);
    if (image.type() != CV_8UC1 || image.size() != view->size_px)
      throw InputError(fmt::format(
          "{}: is {}x{} px, must be the 8-bit grey image of {}x{} px that "
          "`reconstruct --reasons` wrote",
          options.reasons, image.cols, image.rows, view->size_px.width, view->size_px.height));
    reasons = image;
  }
  return registration::coverage_map(*input.fixed_surface, result.registration.T_camera_ct,
                                    *input.moving_surface, *view, reasons, {});
}

nlohmann::json coverage_json(const registration::CoverageMap& map) {
  nlohmann::json areas;
  for (std::size_t k = 0; k < registration::kCoverages; ++k)
    areas[std::string(name(static_cast<registration::Coverage>(k)))] = map.area_mm2.at(k);
  return {{"visible_mm2", map.visible_mm2},
          {"covered_share", map.covered_share},
          {"area_mm2", areas},
          {"agreement_mean_mm", map.agreement_mean_mm},
          {"agreement_rms_mm", map.agreement_rms_mm}};
}

void report(const registration::CoverageMap& map) {
  fmt::print("coverage: {:.1f} % of the {:.0f} mm2 that both cameras see, {:.3f} mm off\n",
             100 * map.covered_share, map.visible_mm2, map.agreement_mean_mm);
  for (std::size_t k = 0; k < registration::kCoverages; ++k)
    fmt::print("  {:<13} {:9.1f} mm2\n", name(static_cast<registration::Coverage>(k)),
               map.area_mm2.at(k));
}

/// The sealed file's members, and beside them the evidence.
nlohmann::json summary(const std::string& sealed, const registration::CtRegistration& result) {
  nlohmann::json json = nlohmann::json::parse(sealed);
  json["fiducials"] = nlohmann::json::array();
  for (std::size_t i = 0; i < result.labels.size(); ++i)
    json["fiducials"].push_back(
        {{"label", result.labels[i]}, {"residual_mm", result.fiducial_fit.residuals_mm[i]}});
  for (const registration::LeftOut& left_out : result.left_out)
    json["leave_one_out"].push_back({{"label", left_out.label},
                                     {"displacement_mm", left_out.displacement_mm},
                                     {"p_value", left_out.p_value}});
  if (result.surface_fit)
    json["surface_fit"] = {{"is_fused", result.is_fused},
                           {"overlap", result.surface_fit->overlap},
                           {"noise_mm", result.surface_fit->noise_mm},
                           {"field_mm", result.surface_fit->field_mm},
                           {"shift_mm", result.surface_fit->shift_mm},
                           {"p_value", result.surface_fit->p_value}};
  json["notes"] = result.notes;
  return json;
}

void report(const registration::CtRegistration& result) {
  const registration::Registration& registration = result.registration;
  fmt::print("registered: FRE {:.3f} mm over {} fiducials\n", registration.fre_mm,
             result.labels.size());
  for (std::size_t i = 0; i < result.labels.size(); ++i)
    fmt::print("  {:<24} residual {:.3f} mm\n", result.labels[i],
               result.fiducial_fit.residuals_mm[i]);
  if (result.surface_fit)
    fmt::print("surfaces: closest points {:.3f} mm mean, {:.3f} mm rms, overlap {:.0f} %\n",
               result.surface_fit->closest_point_mean_mm, result.surface_fit->closest_point_rmse_mm,
               100 * result.surface_fit->overlap);
  for (const registration::TargetError& target : registration.tre)
    fmt::print("predicted TRE at {:.1f},{:.1f},{:.1f}: {:.3f} mm rms\n", target.p_target_ct_mm.x(),
               target.p_target_ct_mm.y(), target.p_target_ct_mm.z(), target.rms_mm);
  for (const std::string& note : result.notes) fmt::print("note: {}\n", note);
}

void run(const Options& options) {
  const registration::RegistrationInput input = read_input(options);
  registration::CtRegistration result = registration::register_ct(input);
  if (result.status != registration::RegistrationStatus::registered)
    throw RefusedError(result.reason);
  registration::Registration& registration = result.registration;
  registration.zoom = options.zoom;
  registration.focus_mm = options.focus_mm;
  const auto path_of = [](const std::string& file) {
    return file.empty() ? std::filesystem::path{} : std::filesystem::absolute(file);
  };
  registration.keyframe = path_of(options.keyframe);
  registration.depth = path_of(options.depth);
  if (result.surface_fit)
    registration.closest_point = registration::SurfaceAgreement{
        result.surface_fit->closest_point_mean_mm, result.surface_fit->closest_point_rmse_mm,
        result.surface_fit->overlap};
  const auto coverage = covered(options, input, result);
  const std::string sealed = registration::sealed_registration(
      registration, std::filesystem::absolute(options.out).parent_path());
  bridge::write_file_atomically(options.out, sealed);
  if (!options.tfm.empty())
    bridge::write_file_atomically(options.tfm,
                                  registration::transform_text(registration.T_camera_ct));
  if (coverage)
    bridge::write_file_atomically(options.coverage,
                                  registration::coverage_ply(*input.fixed_surface, *coverage));
  if (options.is_json) {
    nlohmann::json json = summary(sealed, result);
    if (coverage) json["coverage"] = coverage_json(*coverage);
    fmt::print("{}\n", json.dump(-1, ' ', false, nlohmann::json::error_handler_t::replace));
  } else {
    report(result);
    if (coverage) report(*coverage);
  }
}

}  // namespace

void add_register(CLI::App& app) {
  auto options = std::make_shared<Options>();
  CLI::App* command = app.add_subcommand("register", "Where the CT lies in the camera.");
  command->add_option("--fixed", options->fixed, "The CT's fiducials (.mrk.json)")->required();
  command->add_option("--moving", options->moving, "The same in the camera (.mrk.json)")
      ->required();
  command->add_option("--fixed-surface", options->fixed_surface, "The CT's surface (PLY, STL)");
  command->add_option("--moving-surface", options->moving_surface, "The reconstruction (PLY)");
  command->add_flag("--refine", options->is_refined,
                    "Fuse the surfaces with the fiducials, where that gains");
  command->add_option("--coverage", options->coverage,
                      "Which parts of the CT's surface were reconstructed, and why the others were "
                      "not: PLY, a colour and a number a face");
  command->add_option("--reasons", options->reasons,
                      "For it: what `reconstruct --reasons` wrote beside the reconstruction");
  command->add_option("--target", options->targets, "x,y,z in the CT, mm; repeatable");
  command->add_option("--expect-ct", options->expected_ct,
                      "Series or frame of reference UID of the planned CT; another is refused");
  command->add_option("--zoom", options->zoom, "Of the microscope, for the file")
      ->check(CLI::Range(0.0, 100.0));
  command->add_option("--focus-mm", options->focus_mm, "Working distance, for the file")
      ->check(CLI::Range(0.0, 10'000.0));
  command->add_option("--keyframe", options->keyframe, "The image the registration belongs to");
  command->add_option("--depth", options->depth, "Its depth (float TIFF, mm)");
  command->add_option("--fre-max-mm", options->limits.fre_max_mm, "Refuse a larger FRE")
      ->check(CLI::Range(1e-3, 100.0))
      ->capture_default_str();
  command->add_option("--tre-max-mm", options->limits.tre_max_mm, "Refuse a larger predicted TRE")
      ->check(CLI::Range(1e-3, 100.0))
      ->capture_default_str();
  command->add_option("--out", options->out, "registration.json")->required();
  command->add_option("--tfm", options->tfm, "Also as ITK transform, for 3D Slicer");
  command->add_flag("--json", options->is_json, "Print one JSON object on stdout");
  command->footer(kExample);
  command->callback([options] { run(*options); });
}

}  // namespace holdfast::rt
