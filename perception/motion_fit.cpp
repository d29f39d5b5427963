// SPDX-License-Identifier: Apache-2.0
#include "perception/motion_fit.hpp"

#include <algorithm>
#include <array>
#include <cmath>

#include "perception/patch_alignment.hpp"

namespace holdfast::perception {
namespace {

constexpr int kCells = 8;  // per side of the image

FitSetup setup_of(const MotionProblem& problem) {
  FitSetup setup;
  setup.f_px = problem.camera.f_px();
  setup.freedom = problem.site.is_plane() ? Freedom::planar : Freedom::rigid;
  setup.p_pivot_site_mm = problem.site.p_pivot_mm();
  return setup;
}

/// Matches whose site point is known, as observations; `kept` names the match of each.
Observations observe(const MotionProblem& problem, std::vector<Match>& kept) {
  std::vector<cv::Point2d> pixels;
  for (const Match& match : problem.matches) {
    if (!problem.p_site_mm[static_cast<std::size_t>(match.first)].allFinite()) continue;
    kept.push_back(match);
    pixels.emplace_back(problem.target.features.pixels[static_cast<std::size_t>(match.second)]);
  }
  const auto rays = to_normalised(problem.camera, pixels);
  Observations observations(rays.size());
  for (std::size_t i = 0; i < rays.size(); ++i)
    observations[i] = {problem.p_site_mm[static_cast<std::size_t>(kept[i].first)],
                       problem.camera.f_px() * Eigen::Vector2d(rays[i].x, rays[i].y)};
  return observations;
}

/// How many of the matches that contradict `fit` agree on a motion of their own.
int rival_inliers(const Observations& observations, FitSetup setup, const PoseFit& fit,
                  const TrackerParameters& parameters) {
  ConsensusParameters consensus;
  consensus.seed = parameters.model.seed;
  consensus.iterations = 100;
  consensus.threshold_px = parameters.model.coarse_threshold_px;
  consensus.inliers_min = std::max(8, static_cast<int>(parameters.health.rival_share_min *
                                                       static_cast<double>(fit.inliers.size())));
  Observations others;
  for (const Observation& o : observations)
    if (reprojection_error_px(o, fit.T_camera_site, setup.f_px) > 2 * consensus.threshold_px)
      others.push_back(o);
  setup.freedom = Freedom::planar;
  const auto rival = find_consensus(others, setup, consensus);
  return rival ? static_cast<int>(rival->inliers.size()) : 0;
}

/// The in-plane rotation and scale between the two views: how a small patch is deformed.
cv::Matx22d patch_warp(const MotionProblem& problem, const Eigen::Isometry3d& T_target_site) {
  const Eigen::Vector3d pivot = problem.site.p_pivot_mm();
  const Eigen::Isometry3d T_target_source =
      T_target_site * problem.T_source_site.inverse(Eigen::Isometry);
  const Eigen::Matrix3d R = T_target_source.linear();
  const double scale = (problem.T_source_site * pivot).z() / (T_target_site * pivot).z();
  return {scale * R(0, 0), scale * R(0, 1), scale * R(1, 0), scale * R(1, 1)};
}

/// The inliers of the consensus, at most points_max, each found again to a fraction of a pixel.
Observations align(const MotionProblem& problem, const std::vector<Match>& kept,
                   const Observations& observations, const PoseFit& coarse) {
  const auto& model = problem.parameters.model;
  const double f = problem.camera.f_px();
  const std::size_t total = coarse.inliers.size();
  const std::size_t stride = (total + static_cast<std::size_t>(model.points_max) - 1) /
                             static_cast<std::size_t>(model.points_max);
  std::vector<std::size_t> chosen;
  std::vector<cv::Point2d> rays;
  for (std::size_t k = 0; k < total; k += std::max<std::size_t>(stride, 1)) {
    chosen.push_back(static_cast<std::size_t>(coarse.inliers[k]));
    const Eigen::Vector3d p = coarse.T_camera_site * observations[chosen.back()].p_site_mm;
    rays.emplace_back(p.x() / p.z(), p.y() / p.z());
  }
  const auto predicted = to_pixels(problem.camera, rays);
  const cv::Matx22d warp = patch_warp(problem, coarse.T_camera_site);

  std::vector<std::size_t> aligned;
  std::vector<cv::Point2d> pixels;
  constexpr double kNearPx = 1.5, kReachPx = 3;
  for (std::size_t k = 0; k < chosen.size(); ++k) {
    const Match& match = kept[chosen[k]];
    const cv::Point2d seen = problem.target.features.pixels[static_cast<std::size_t>(match.second)];
    // The model is the better start unless relief makes this point depart from it.
    const cv::Point2d start = cv::norm(seen - predicted[k]) < kNearPx ? predicted[k] : seen;
    const cv::Point centre(problem.source.features.pixels[static_cast<std::size_t>(match.first)]);
    const auto patch = align_patch(problem.source.images.grey, centre, problem.target.images.grey,
                                   start, warp, kReachPx);
    if (!patch || patch->zncc < model.zncc_min) continue;
    aligned.push_back(chosen[k]);
    pixels.push_back(patch->pixel);
  }
  const auto seen = to_normalised(problem.camera, pixels);
  Observations fine(seen.size());
  for (std::size_t i = 0; i < seen.size(); ++i)
    fine[i] = {observations[aligned[i]].p_site_mm, f * Eigen::Vector2d(seen[i].x, seen[i].y)};
  return fine;
}

/// Number of the kCells x kCells image cells that hold an inlier.
int occupied_cells(const CameraModel& camera, const Observations& observations,
                   const PoseFit& fit) {
  std::array<bool, static_cast<std::size_t>(kCells * kCells)> cells{};
  for (const int i : fit.inliers) {
    const Eigen::Vector2d& seen = observations[static_cast<std::size_t>(i)].seen_px;
    const double x = (seen.x() / camera.f_px() * camera.fx_px + camera.cx_px) / camera.width_px;
    const double y = (seen.y() / camera.f_px() * camera.fy_px + camera.cy_px) / camera.height_px;
    const int column = std::clamp(static_cast<int>(x * kCells), 0, kCells - 1);
    const int row = std::clamp(static_cast<int>(y * kCells), 0, kCells - 1);
    const int index = row * kCells + column;
    cells[static_cast<std::size_t>(index)] = true;
  }
  return static_cast<int>(std::count(cells.begin(), cells.end(), true));
}

/// Independent error of each point, an error that all points of a cell share, and the error of the
/// site's shape, which grows with the distance moved and is common to all.
Matrix6d covariance_of(const MotionProblem& problem, const PoseFit& fit, int cells) {
  const auto& u = problem.parameters.uncertainty;
  const Eigen::Vector3d pivot = problem.site.p_pivot_mm();
  const Eigen::Vector3d moved_mm = fit.T_camera_site * pivot - pivot;
  const double depth_mm = pivot.z();
  const Eigen::Vector3d turned = Eigen::AngleAxisd(fit.T_camera_site.linear()).angle() *
                                 Eigen::AngleAxisd(fit.T_camera_site.linear()).axis();
  const double shape_mm = problem.site.is_plane() ? u.relief_sigma_mm : u.depth_sigma_mm;
  const double shape_error_mm = shape_mm * (moved_mm.norm() / depth_mm + turned.head<2>().norm());
  const double shape_error_px = shape_error_mm * problem.camera.f_px() / depth_mm;
  const double own = std::pow(std::max(fit.sigma_px, u.noise_floor_px), 2);
  const double shared = u.shared_error_px * u.shared_error_px + shape_error_px * shape_error_px;
  const double per_cell = static_cast<double>(fit.inliers.size()) / std::max(cells, 1);
  Matrix6d covariance = (own + shared * per_cell) * fit.unit_covariance;
  covariance.topLeftCorner<2, 2>().diagonal().array() += shape_error_mm * shape_error_mm;
  if (problem.site.is_plane())
    covariance.diagonal().segment<2>(3).array() += u.tilt_sigma_rad * u.tilt_sigma_rad;
  return covariance;
}

}  // namespace

MotionResult fit_motion(const MotionProblem& problem) {
  const TrackerParameters& parameters = problem.parameters;
  std::vector<Match> kept;
  const Observations observations = observe(problem, kept);
  if (static_cast<int>(observations.size()) < parameters.health.inliers_min)
    return {std::nullopt, TrackingReason::too_few_matches};

  ConsensusParameters consensus;
  consensus.seed = parameters.model.seed;
  consensus.iterations = parameters.model.iterations;
  consensus.threshold_px = parameters.model.coarse_threshold_px;
  consensus.parallax_px = parameters.model.parallax_px;
  consensus.inliers_min = parameters.health.inliers_min;
  const FitSetup setup = setup_of(problem);
  const auto coarse = find_consensus(observations, setup, consensus);
  if (!coarse) return {std::nullopt, TrackingReason::too_few_inliers};

  MotionFit fit;
  fit.coarse_inliers = static_cast<int>(coarse->inliers.size());
  fit.rival_inliers = rival_inliers(observations, setup, *coarse, parameters);
  const Observations aligned = align(problem, kept, observations, *coarse);
  const auto fine =
      refine(aligned, setup, coarse->T_camera_site, parameters.model.fine_threshold_px);
  if (!fine || static_cast<int>(fine->inliers.size()) < parameters.health.inliers_min)
    return {std::nullopt, TrackingReason::too_few_inliers};
  fit.pose = *fine;
  const int cells = occupied_cells(problem.camera, aligned, fit.pose);
  fit.spread = static_cast<double>(cells) / (kCells * kCells);
  fit.covariance = covariance_of(problem, fit.pose, cells);
  return {fit, TrackingReason::none};
}

}  // namespace holdfast::perception
