// SPDX-License-Identifier: Apache-2.0
#include "perception/feature_check.hpp"

#include <algorithm>

#include "perception/keyframe_view.hpp"

namespace holdfast::perception {

FeatureCheck::FeatureCheck(const CameraModel& camera, const TrackerParameters& parameters)
    : camera_(camera), parameters_(parameters), detector_(parameters.features) {
  camera_.distortion = camera.distortion.clone();
}

TrackingReason FeatureCheck::set_keyframe(const cv::Mat& image, const Site& site,
                                          const cv::Mat& mask, const cv::Mat& moving_half) {
  auto seen = see_keyframe(image, site, mask, moving_half, camera_, parameters_, detector_);
  if (!seen) return TrackingReason::too_few_features;
  site_ = site;
  keyframe_ = std::move(seen->view);
  p_site_mm_ = std::move(seen->p_site_mm);
  moving_half_ = moving_half.clone();
  return TrackingReason::none;
}

TrackingReason FeatureCheck::judge(const MotionFit& fit, int matches) const {
  const HealthParameters& health = parameters_.health;
  const double share = static_cast<double>(fit.coarse_inliers) / std::max(matches, 1);
  const double rival = static_cast<double>(fit.rival_inliers) / std::max(fit.coarse_inliers, 1);
  if (share < health.inlier_share_min || rival >= health.rival_share_lost ||
      !fit.covariance.allFinite())
    return TrackingReason::inconsistent_motion;
  if (fit.spread < health.spread_min) return TrackingReason::inliers_bunched;
  return TrackingReason::none;
}

FeatureMotion FeatureCheck::fit(const std::vector<Match>& matches) {
  FeatureMotion out;
  out.features = current_.features.size();
  out.matches = static_cast<int>(matches.size());
  MotionResult result = fit_motion({camera_, parameters_, site_, keyframe_, p_site_mm_,
                                    Eigen::Isometry3d::Identity(), current_, matches});
  out.reason = result.reason;
  if (!result.fit) return out;
  out.reason = judge(*result.fit, out.matches);
  if (out.reason == TrackingReason::none) out.fit = std::move(result.fit);
  return out;
}

FeatureMotion FeatureCheck::find(const cv::Mat& image,
                                 const std::optional<Eigen::Isometry3d>& T_predicted) {
  make_grey_and_mask(image, parameters_.mask, current_.images);
  if (!moving_half_.empty()) current_.images.keep_half &= moving_half_;
  detector_.detect(current_.images.grey, current_.images.half, current_.images.keep_half,
                   current_.features);
  if (current_.features.size() < parameters_.health.features_min) {
    FeatureMotion out;
    out.features = current_.features.size();
    out.reason = TrackingReason::too_few_features;
    return out;
  }
  FeatureMotion everywhere =
      fit(match_all(keyframe_.features, current_.features, parameters_.match));
  const bool is_starved = everywhere.reason == TrackingReason::too_few_matches ||
                          everywhere.reason == TrackingReason::too_few_inliers;
  if (!is_starved || !T_predicted) return everywhere;
  std::vector<cv::Point2d> rays;
  for (const Eigen::Vector3d& p_site : p_site_mm_) {
    const Eigen::Vector3d p = *T_predicted * p_site;
    rays.emplace_back(p.x() / p.z(), p.y() / p.z());
  }
  return fit(match_near(keyframe_.features, to_pixels(camera_, rays), current_.features,
                        parameters_.match));
}

}  // namespace holdfast::perception
