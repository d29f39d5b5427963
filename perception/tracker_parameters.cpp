// SPDX-License-Identifier: Apache-2.0
#include "perception/tracker_parameters.hpp"

#include <sstream>

namespace holdfast::perception {
namespace {

struct Range {
  const char* name;
  double value, low, high;
  const char* unit;
};

}  // namespace

std::optional<std::string> invalid_parameter(const TrackerParameters& p) {
  const Range ranges[] = {
      {"mask.tau_intensity", p.mask.tau_intensity, 0.1, 1, "of the maximum"},
      {"mask.tau_saturation", p.mask.tau_saturation, 0, 1, "of the maximum"},
      {"mask.tau_intensity_grey", p.mask.tau_intensity_grey, 0.1, 1, "of the maximum"},
      {"mask.intensity_min", double(p.mask.intensity_min), 0, 255, "grey levels"},
      {"mask.dilation_px", double(p.mask.dilation_px), 0, 64, "px"},
      {"features.count", double(p.features.count), 100, 10000, "features"},
      {"features.fast_threshold", double(p.features.fast_threshold), 2, 128, "grey levels"},
      {"features.levels", double(p.features.levels), 1, 8, "levels"},
      {"features.level_scale", p.features.level_scale, 1.05, 2, ""},
      {"features.cell_px", double(p.features.cell_px), 16, 512, "px"},
      {"match.distance_max", double(p.match.distance_max), 8, 128, "bits"},
      {"match.ratio_max", p.match.ratio_max, 0.3, 1, ""},
      {"match.search_radius_px", p.match.search_radius_px, 4, 1000, "px"},
      {"model.iterations", double(p.model.iterations), 20, 100000, "samples"},
      {"model.coarse_threshold_px", p.model.coarse_threshold_px, 0.5, 50, "px"},
      {"model.parallax_px", p.model.parallax_px, 0, 500, "px"},
      {"model.fine_threshold_px", p.model.fine_threshold_px, 0.05, 20, "px"},
      {"model.zncc_min", p.model.zncc_min, 0, 1, ""},
      {"model.points_max", double(p.model.points_max), 20, 10000, "points"},
      {"uncertainty.noise_floor_px", p.uncertainty.noise_floor_px, 1e-4, 10, "px"},
      {"uncertainty.shared_error_px", p.uncertainty.shared_error_px, 1e-4, 10, "px"},
      {"uncertainty.tilt_sigma_rad", p.uncertainty.tilt_sigma_rad, 1e-6, 1, "rad"},
      {"uncertainty.relief_sigma_mm", p.uncertainty.relief_sigma_mm, 0, 100, "mm"},
      {"uncertainty.depth_sigma_mm", p.uncertainty.depth_sigma_mm, 0, 100, "mm"},
      {"health.features_min", double(p.health.features_min), 8, 10000, "features"},
      {"health.inliers_min", double(p.health.inliers_min), 8, 10000, "inliers"},
      {"health.inliers_good", double(p.health.inliers_good), 8, 10000, "inliers"},
      {"health.inlier_share_min", p.health.inlier_share_min, 0.05, 1, "of the matches"},
      {"health.inlier_share_good", p.health.inlier_share_good, 0.05, 1, "of the matches"},
      {"health.spread_min", p.health.spread_min, 0.015, 1, "of the cells"},
      {"health.spread_good", p.health.spread_good, 0.015, 1, "of the cells"},
      {"health.rival_share_min", p.health.rival_share_min, 0.05, 1, "of the inliers"},
      {"health.rival_share_lost", p.health.rival_share_lost, 0.05, 1, "of the inliers"},
      {"health.rms_good_px", p.health.rms_good_px, 0.01, 50, "px"},
      {"health.scale_change_max", p.health.scale_change_max, 0.001, 0.9, ""},
      {"health.rotation_max_rad", p.health.rotation_max_rad, 0.001, 3.2, "rad"},
      {"health.drift_good_um", p.health.drift_good_um, 0.1, 1e5, "um"},
      {"direct.patches", double(p.direct.patches), 50, 20000, "patches"},
      {"direct.texture_min", p.direct.texture_min, 1, 1e6, "grey levels^2/px^2"},
      {"direct.zncc_min", p.direct.zncc_min, 0.1, 0.95, ""},
      {"direct.recall_zncc", p.direct.recall_zncc, 0, 1, ""},
      {"direct.shared_error_px", p.direct.shared_error_px, 1e-4, 10, "px"},
      {"direct.common_error_px", p.direct.common_error_px, 1e-5, 10, "px"},
      {"direct.inliers_min", double(p.direct.inliers_min), 12, 20000, "patches"},
      {"direct.inliers_good", double(p.direct.inliers_good), 12, 20000, "patches"},
      {"direct.share_min", p.direct.share_min, 0.05, 1, "of the visible patches"},
      {"direct.share_good", p.direct.share_good, 0.05, 1, "of the visible patches"},
      {"direct.witnesses", double(p.direct.witnesses), 1, 20000, "patches"},
      {"direct.sharpness_ratio_good", p.direct.sharpness_ratio_good, 1.01, 3, "of 1"},
      {"direct.witness_share_good", p.direct.witness_share_good, 0.05, 1, "of the witnesses"},
      {"direct.chain_patches", double(p.direct.chain_patches), 16, 2000, "patches"},
      {"check.every_frames", double(p.check.every_frames), 0, 1e6, "frames"},
      {"check.limit_um", p.check.limit_um, 1, 1e5, "um"},
      {"check.limit_sigma", p.check.limit_sigma, 1, 1e3, "sigma"},
      {"check.failures_max", double(p.check.failures_max), 1, 1e9, "checks"},
      {"ties.keyframes_max", double(p.ties.keyframes_max), 0, 32, "keyframes"},
      {"ties.overlap_min", p.ties.overlap_min, 0.05, 0.9, "of the patches"},
      {"ties.strain_new", p.ties.strain_new, 0.05, 1, ""},
      {"ties.strain_leave", p.ties.strain_leave, 0.05, 1, ""},
      {"ties.share_good", p.ties.share_good, 0.05, 1, "of the visible patches"},
      {"ties.proofs", double(p.ties.proofs), 1, 1000, "frames"},
      {"ties.watch_every", double(p.ties.watch_every), 1, 1e6, "frames"},
      {"ties.limit_um", p.ties.limit_um, 0, 1e5, "um"},
      {"ties.limit_sigma", p.ties.limit_sigma, 1, 1e3, "sigma"},
      {"ties.sigma_max_um", p.ties.sigma_max_um, 0.01, 1e5, "um"},
      {"ties.rotation_sigma_max_rad", p.ties.rotation_sigma_max_rad, 1e-6, 1, "rad"},
      {"health.chain_length_max", double(p.health.chain_length_max), 1, 1e9, "frames"},
      {"health.change_share_max", p.health.change_share_max, 0.01, 2, "of the blocks"},
      {"health.change_spread_max", p.health.change_spread_max, 0.01, 1, "of the cells"},
  };
  for (const Range& range : ranges) {
    if (range.value >= range.low && range.value <= range.high) continue;  // false for NaN
    std::ostringstream line;
    line << range.name << " is " << range.value << ", must be " << range.low << " to " << range.high
         << ' ' << range.unit;
    return line.str();
  }
  return std::nullopt;
}

}  // namespace holdfast::perception
