// SPDX-License-Identifier: Apache-2.0
#include "perception/direct_keyframe.hpp"

#include <algorithm>
#include <utility>

#include "perception/reflection_mask.hpp"

namespace holdfast::perception {
namespace {

constexpr int kPatchesMin = 40;  // of a keyframe

/// Of a mask of the full size (0: not kept): a pixel of half size is kept when all of its four are.
cv::Mat kept_of_half(const cv::Mat& mask, cv::Size half) {
  cv::Mat kept(half, CV_8UC1);
  for (int y = 0; y < half.height; ++y) {
    const uchar *top = mask.ptr(2 * y), *bottom = mask.ptr(2 * y + 1);
    uchar* out = kept.ptr(y);
    for (int x = 0; x < half.width; ++x) {
      const bool is_kept =
          top[2 * x] != 0 && top[2 * x + 1] != 0 && bottom[2 * x] != 0 && bottom[2 * x + 1] != 0;
      out[x] = is_kept ? 255 : 0;
    }
  }
  return kept;
}

}  // namespace

DirectKeyframeResult make_direct_keyframe(const GivenKeyframe& given, const cv::Mat& moving_half,
                                          const CameraModel& camera,
                                          const TrackerParameters& parameters) {
  const auto& [image, site, mask] = given;
  const Freedom freedom = site.is_plane() ? Freedom::planar : Freedom::rigid;
  FeatureReview features(camera, parameters);
  if (const auto reason = features.set_keyframe(image, site, mask, moving_half);
      reason != TrackingReason::none)
    return {std::nullopt, reason};
  GreyAndMask grey_and_mask;
  make_grey_and_mask(image, parameters.mask, grey_and_mask);
  cv::Mat keep_half = grey_and_mask.keep_half;
  if (!mask.empty()) keep_half &= kept_of_half(mask, keep_half.size());
  if (!moving_half.empty()) keep_half &= moving_half;
  Pyramid levels;
  make_pyramid(image, levels);
  DirectKeyframe made{given,
                      StillnessCheck(camera, site, parameters.health, levels),
                      make_template(levels, keep_half, camera, site, parameters.direct),
                      make_witnesses(levels, keep_half, camera, site, parameters.direct),
                      DirectAligner(camera, parameters, freedom, site.p_pivot_mm()),
                      FrameChain(camera, parameters, freedom, site.p_pivot_mm()),
                      std::move(features)};
  std::size_t most = 0;
  for (const TemplateLevel& level : made.patches) most = std::max(most, level.size());
  if (made.patches[0].size() < static_cast<std::size_t>(kPatchesMin))
    return {std::nullopt, TrackingReason::too_few_features};
  made.aligner.reserve(most);
  return {std::move(made), TrackingReason::none};
}

}  // namespace holdfast::perception
