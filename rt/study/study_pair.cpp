// SPDX-License-Identifier: Apache-2.0
#include "rt/study/study_pair.hpp"

#include <array>
#include <chrono>
#include <cmath>
#include <span>

#include <fmt/format.h>

#include "registration/ct_registration.hpp"
#include "registration/evaluation.hpp"
#include "registration/rectification.hpp"
#include "rt/core/error.hpp"

namespace holdfast::rt {
namespace {

using Eigen::Isometry3d;
using registration::MatchMethod;
using registration::Reconstruction;

constexpr int kStepPx = 2;  // of the reconstruction's points that are drawn from
constexpr std::size_t kHeatMapPoints = 120'000;
constexpr double kHeatMapMaxMm = 1;

struct Method {
  const char* name;
  MatchMethod method;
  bool is_burst = false;
};
constexpr std::array<Method, 3> kMethods{{{"sgm", MatchMethod::sgm},
                                          {"opencv", MatchMethod::opencv},
                                          {"burst", MatchMethod::sgm, true}}};

Isometry3d as_rotation(const cv::Matx33d& m) {
  Isometry3d T = Isometry3d::Identity();
  for (int r = 0; r < 3; ++r)
    for (int c = 0; c < 3; ++c) T.linear()(r, c) = m(r, c);
  return T;
}

/// Horn's fit of the beads, as in the paper; the surfaces that are to be judged have no say in it.
/// `seated` becomes the calibration as the markers show it.
std::optional<Isometry3d> register_by_markers(const StudyBench& bench, const StudyPair& pair,
                                              registration::ZoomCalibration& seated,
                                              StudyRow& row) {
  try {
    registration::RegistrationInput input;
    input.fixed = bench.ct.beads;
    const registration::MarkerSet markers =
        locate_beads(pair.markers, bench.calibration, bench.setup);
    seated = markers.calibration;
    input.moving = registration::markups_of(markers);
    for (registration::Markups* points :
         {&input.fixed, &input.moving}) {  // Horn weighs them equally
      points->joint_covariance_mm2.resize(0, 0);
      for (registration::MarkupPoint& point : points->points) point.covariance_mm2.reset();
    }
    const registration::CtRegistration result = registration::register_ct(input);
    if (result.status == registration::RegistrationStatus::registered) {
      row.fre_mm = result.registration.fre_mm;
      return result.registration.T_camera_ct;
    }
    row.refusal = "registration: " + result.reason;
  } catch (const RefusedError& error) {
    row.refusal = fmt::format("markers: {}", error.what());
  }
  return {};
}

/// As in use; what is refused there for having too little or repeating itself is measured all the
/// same, both methods alike, and `row` keeps the reason.
Reconstruction reconstructed(const registration::ZoomCalibration& calibration,
                             std::span<const registration::StereoShot> shots, MatchMethod method,
                             int threads, StudyRow& row) {
  using Status = registration::ReconstructionStatus;
  registration::ReconstructionOptions options;
  options.method = method;
  options.threads = threads;
  const auto run = [&] {
    registration::Reconstructor reconstructor(calibration, shots.front().left.size(), options);
    return reconstructor.reconstruct(shots);
  };
  Reconstruction surface = run();
  if (surface.status != Status::done)
    row.refusal = fmt::format("{}: {}", registration::name(surface.status), surface.evidence);
  if (surface.status == Status::no_surface || surface.status == Status::period_slip ||
      surface.status == Status::lattice) {
    options.may_be_lattice = true;
    options.density_min = 0;
    options.ambiguous_share_max = 1;
    surface = run();
  }
  row.time_ms = std::chrono::duration<double, std::milli>(surface.times.total).count();
  row.points = static_cast<double>(surface.points);
  row.density = surface.density;
  return surface;
}

/// The points between the fiducials, rectified left frame.
registration::TriangleMesh cloud_of(const Reconstruction& surface, const Isometry3d& T_ct_rectified,
                                    const FiducialRegion& region) {
  registration::TriangleMesh cloud;
  for (int y = 0; y < surface.points_mm.rows; y += kStepPx)
    for (int x = 0; x < surface.points_mm.cols; x += kStepPx) {
      const cv::Vec3f& p = surface.points_mm(y, x);
      if (!std::isfinite(p[2])) continue;
      const Eigen::Vector3f point(p[0], p[1], p[2]);
      if (region.contains(T_ct_rectified * point.cast<double>()))
        cloud.vertices_mm.push_back(point);
    }
  return cloud;
}

/// The CT as the camera sees it, so that a heat map is drawn along the direction of view.
registration::TriangleMesh turned(const registration::TriangleMesh& ct,
                                  const Isometry3d& T_rectified_ct) {
  registration::TriangleMesh mesh;
  mesh.triangles = ct.triangles;
  mesh.vertices_mm.reserve(ct.vertices_mm.size());
  for (const Eigen::Vector3f& p : ct.vertices_mm)
    mesh.vertices_mm.emplace_back((T_rectified_ct * p.cast<double>()).cast<float>());
  return mesh;
}

void fill(const registration::Evaluation& evaluation, StudyRow& row) {
  row.closest_mean_mm = evaluation.to_vertex.mean_mm;
  row.closest_sd_mm = evaluation.to_vertex.sd_mm;
  row.closest_rmse_mm = evaluation.to_vertex.rmse_mm;
  row.closest_p95_mm = evaluation.to_vertex.p95_mm;
  row.triangle_mean_mm = evaluation.to_triangle.mean_mm;
  row.triangle_median_mm = evaluation.to_triangle.median_mm;
  row.triangle_p95_mm = evaluation.to_triangle.p95_mm;
}

}  // namespace

std::vector<StudyRow> measure_pair(
    const StudyBench& bench, const StudyPair& pair, const StudyRow& identity,
    const DepthJudge& judge,
    const std::function<void(const std::string& method, const cv::Mat&)>& heat_map) {
  StudyRow common = identity;
  registration::ZoomCalibration seated = bench.calibration;
  const auto T_camera_ct = register_by_markers(bench, pair, seated, common);
  std::vector<StudyRow> rows;
  for (const Method& method : kMethods) {
    if (method.is_burst && pair.burst.empty()) continue;
    const std::span<const registration::StereoShot> shots =
        method.is_burst ? std::span(pair.burst) : std::span(&pair.shot, 1);
    StudyRow& row = rows.emplace_back(common);
    row.method = method.name;
    const Reconstruction surface =
        reconstructed(seated, shots, method.method, bench.setup.threads, row);
    if (surface.status != registration::ReconstructionStatus::done) continue;
    const registration::Rectification geometry =
        registration::rectification_of(seated, pair.shot.left.size());
    judge(registration::on_whole_grid(surface.depth_mm, surface.region_px, geometry.size_px,
                                      std::nanf("")),
          seated, row);
    if (!T_camera_ct) continue;
    const Isometry3d T_rectified_ct = as_rotation(geometry.R1) * *T_camera_ct;
    const registration::TriangleMesh cloud =
        cloud_of(surface, T_rectified_ct.inverse(), bench.region);
    const registration::TriangleMesh ct = turned(bench.ct.surface, T_rectified_ct);
    registration::EvaluationOptions drawing;
    drawing.points = static_cast<std::size_t>(bench.points);
    drawing.seed = bench.seed;
    if (cloud.vertices_mm.empty()) {
      if (row.refusal.empty()) row.refusal = "no point of the surface lies between the fiducials";
      continue;
    }
    fill(registration::evaluate_surface(cloud, ct, drawing), row);
    if (!heat_map) continue;
    drawing.points = kHeatMapPoints;
    heat_map(method.name, registration::heat_map(registration::evaluate_surface(cloud, ct, drawing),
                                                 kHeatMapMaxMm));
  }
  return rows;
}

}  // namespace holdfast::rt
