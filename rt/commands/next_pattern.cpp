// SPDX-License-Identifier: Apache-2.0
#include "rt/commands/next_pattern.hpp"

#include <utility>
#include <vector>

#include <fmt/format.h>
#include <opencv2/imgcodecs.hpp>

#include "registration/pattern_refinement.hpp"
#include "registration/rectified_image.hpp"
#include "rt/commands/grey_image.hpp"
#include "rt/core/error.hpp"

namespace holdfast::rt {

NextPattern next_pattern(const NextPatternRequest& request) {
  using registration::PatternNeed;
  const cv::Mat1b before = read_grey_image(request.pattern_file);
  const cv::Size wanted(registration::kPatternWidthPx, registration::kPatternHeightPx);
  if (before.size() != wanted)
    throw InputError(fmt::format("{}: is {}x{} px, must be {}x{} px as projected",
                                 request.pattern_file, before.cols, before.rows, wanted.width,
                                 wanted.height));
  const cv::Mat1b left =
      registration::rectified_left(request.shot.left, request.zoom, request.geometry);
  const registration::ProjectorMap map =
      registration::find_projector(before, left, request.surface);
  if (!map.is_found)
    throw RefusedError(fmt::format("{}: is not what the left image shows: {}", request.pattern_file,
                                   map.evidence));
  const registration::PatternNeeds needs =
      registration::pattern_needs({request.surface, request.geometry, left, before, map});
  std::vector<uchar> png;
  cv::imencode(".png", registration::refined_pattern(request.next, before, needs), png);
  NextPattern result;
  result.png.assign(png.begin(), png.end());
  result.report["projector"] = {{"parts", map.anchors}, {"residual_px", map.residual_px}};
  constexpr std::pair<const char*, PatternNeed> kNames[] = {{"none", PatternNeed::none},
                                                            {"gap", PatternNeed::gap},
                                                            {"faint", PatternNeed::faint},
                                                            {"saturated", PatternNeed::saturated},
                                                            {"other", PatternNeed::other}};
  for (const auto& [name, need] : kNames)
    result.report["needs"][name] = needs.count.at(static_cast<std::size_t>(need));
  return result;
}

}  // namespace holdfast::rt
