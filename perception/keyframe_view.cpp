// SPDX-License-Identifier: Apache-2.0
#include "perception/keyframe_view.hpp"

namespace holdfast::perception {

std::optional<KeyframeView> see_keyframe(const cv::Mat& image, const Site& site,
                                         const cv::Mat& mask, const cv::Mat& moving_half,
                                         const CameraModel& camera,
                                         const TrackerParameters& parameters,
                                         FeatureDetector& detector) {
  constexpr int kSettling = 12;
  KeyframeView out;
  make_grey_and_mask(image, parameters.mask, out.view.images);
  if (!moving_half.empty()) out.view.images.keep_half &= moving_half;
  Features found;
  detector.reset();
  for (int i = 0; i < kSettling; ++i)
    detector.detect(out.view.images.grey, out.view.images.half, out.view.images.keep_half, found);
  const std::vector<cv::Point2d> pixels(found.pixels.begin(), found.pixels.end());
  const auto rays = to_normalised(camera, pixels);
  Features& kept = out.view.features;
  for (std::size_t i = 0; i < pixels.size(); ++i) {
    const auto point = site.lift({rays[i].x, rays[i].y});
    if (!point || (!mask.empty() && mask.at<uchar>(cv::Point(pixels[i])) == 0)) continue;
    kept.pixels.push_back(found.pixels[i]);
    kept.descriptors.push_back(found.descriptors[i]);
    kept.strengths.push_back(found.strengths[i]);
    out.p_site_mm.push_back(*point);
  }
  if (kept.size() < parameters.health.features_min) return std::nullopt;
  return out;
}

}  // namespace holdfast::perception
