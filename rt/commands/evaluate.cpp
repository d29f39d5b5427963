// SPDX-License-Identifier: Apache-2.0
// `holdfast evaluate`: how far a reconstruction is from a reference surface.
#include <charconv>
#include <memory>
#include <string>
#include <string_view>
#include <vector>

#include <fmt/format.h>
#include <nlohmann/json.hpp>
#include <opencv2/imgcodecs.hpp>

#include "bridge/atomic_file.hpp"
#include "registration/evaluation.hpp"
#include "registration/transform_file.hpp"
#include "rt/commands/commands.hpp"
#include "rt/core/error.hpp"

namespace holdfast::rt {
namespace {

constexpr const char* kExample =
    "Example: a registered reconstruction against the CT, in the ear, with a heat map along z\n"
    "  holdfast evaluate --surface mire.ply --reference ct.ply --transform T.tfm \\\n"
    "      --roi=-30,-20,-15,30,20,25 --points 5000 --seed 1 --heatmap heat.png\n"
    "T.tfm is as `register --tfm` writes it (CT to camera); a surface with an R1 comment is "
    "turned\n"
    "from the rectified frame to the camera's first.";

struct Options {
  std::string surface, reference, transform, roi, heatmap;
  std::size_t points = 5000;
  std::uint64_t seed = 1;
  double scale_max_mm = 1;
  bool is_json = false;
};

Eigen::AlignedBox3d box_of(const std::string& text) {
  double v[6] = {};
  const char* at = text.data();
  const char* const end = at + text.size();
  for (int i = 0; i < 6; ++i) {
    const auto [next, error] = std::from_chars(at, end, v[i]);
    if (error != std::errc{} || (i < 5 ? next == end || *next != ',' : next != end))
      throw InputError(
          fmt::format("--roi {}: six numbers x0,y0,z0,x1,y1,z1 in mm are needed", text));
    at = next + 1;
  }
  const Eigen::Vector3d low{v[0], v[1], v[2]}, high{v[3], v[4], v[5]};
  if (!((high - low).minCoeff() > 0))
    throw InputError(fmt::format("--roi {}: each of x1,y1,z1 must be above x0,y0,z0", text));
  return {low, high};
}

nlohmann::json figures(const registration::DistanceFigures& f) {
  return {{"count", f.count},         {"mean_mm", f.mean_mm},
          {"sd_mm", f.sd_mm},         {"rmse_mm", f.rmse_mm},
          {"median_mm", f.median_mm}, {"p90_mm", f.p90_mm},
          {"p95_mm", f.p95_mm},       {"p99_mm", f.p99_mm},
          {"max_mm", f.max_mm},       {"share_over_1_mm", f.share_over_1_mm}};
}

void print_row(const char* name, const registration::DistanceFigures& f) {
  fmt::print("{:<22} {:>8.3f} {:>8.3f} {:>8.3f} {:>8.3f} {:>8.3f} {:>8.3f} {:>8.3f} {:>7.1f} %\n",
             name, f.mean_mm, f.sd_mm, f.rmse_mm, f.median_mm, f.p95_mm, f.p99_mm, f.max_mm,
             100 * f.share_over_1_mm);
}

void run(const Options& options) {
  const registration::TriangleMesh surface = registration::read_mesh(options.surface);
  const registration::TriangleMesh reference = registration::read_mesh(options.reference);
  registration::EvaluationOptions evaluation_options;
  if (!options.transform.empty())
    evaluation_options.T_reference_surface =
        registration::read_transform(options.transform).inverse();
  if (surface.R_rectified_camera)
    evaluation_options.T_reference_surface =
        evaluation_options.T_reference_surface *
        Eigen::Isometry3d{Eigen::Matrix3d{surface.R_rectified_camera->transpose()}};
  if (!options.roi.empty()) evaluation_options.region_mm = box_of(options.roi);
  evaluation_options.points = options.points;
  evaluation_options.seed = options.seed;
  const registration::Evaluation evaluation =
      registration::evaluate_surface(surface, reference, evaluation_options);
  if (evaluation.points_in_region == 0)
    throw RefusedError(fmt::format("no point of {} lies in the region", options.surface));
  if (!options.heatmap.empty()) {
    std::vector<std::uint8_t> png;
    cv::imencode(".png", registration::heat_map(evaluation, options.scale_max_mm), png);
    bridge::write_file_atomically(
        options.heatmap, std::string_view{reinterpret_cast<const char*>(png.data()), png.size()});
  }
  if (options.is_json) {
    nlohmann::json json;
    json["points_in_region"] = evaluation.points_in_region;
    json["closest_point"] = figures(evaluation.to_vertex);
    if (evaluation.to_triangle.count > 0)
      json["point_to_triangle"] = figures(evaluation.to_triangle);
    fmt::print("{}\n", json.dump());
    return;
  }
  fmt::print("{} of {} points in the region, mm\n", evaluation.to_vertex.count,
             evaluation.points_in_region);
  fmt::print("{:<22} {:>8} {:>8} {:>8} {:>8} {:>8} {:>8} {:>8} {:>9}\n", "", "mean", "sd", "rmse",
             "median", "p95", "p99", "max", "> 1 mm");
  print_row("closest vertex", evaluation.to_vertex);
  if (evaluation.to_triangle.count > 0) print_row("point to triangle", evaluation.to_triangle);
}

}  // namespace

void add_evaluate(CLI::App& app) {
  auto options = std::make_shared<Options>();
  CLI::App* command = app.add_subcommand("evaluate", "How far one surface is from another.");
  command->add_option("--surface", options->surface, "The reconstruction (PLY)")->required();
  command->add_option("--reference", options->reference, "The reference (PLY, STL)")->required();
  command->add_option("--transform", options->transform, "ITK transform, reference to surface");
  command->add_option("--roi", options->roi, "x0,y0,z0,x1,y1,z1 in the reference's frame, mm");
  command->add_option("--points", options->points, "How many are drawn")
      ->check(CLI::Range(std::size_t{1}, std::size_t{100'000'000}))
      ->capture_default_str();
  command->add_option("--seed", options->seed, "Of the drawing")->capture_default_str();
  command->add_option("--heatmap", options->heatmap, "The distances along z (PNG)");
  command->add_option("--scale-max-mm", options->scale_max_mm, "Upper end of the heat map's scale")
      ->check(CLI::Range(1e-3, 1e3))
      ->capture_default_str();
  command->add_flag("--json", options->is_json, "Print one JSON object on stdout");
  command->footer(kExample);
  command->callback([options] { run(*options); });
}

}  // namespace holdfast::rt
