// SPDX-License-Identifier: Apache-2.0
#include "tests/registration/study/refined_study.hpp"

#include <vector>

#include <fmt/format.h>
#include <opencv2/imgproc.hpp>

#include "registration/pattern_refinement.hpp"
#include "registration/rectified_image.hpp"

namespace holdfast::test {

namespace reg = registration;

void study_refined(const RenderedScene& scene, const std::filesystem::path& cache,
                   const PrintFigures& print) {
  const RenderedPair pair = rendered_pair(scene, cache);
  const reg::ZoomCalibration& zoom = pair.calibration.zooms.at(0);
  reg::ReconstructionOptions options;
  options.is_explained = true;
  reg::Reconstructor reconstructor(zoom, pair.shots.front().left.size(), options);
  const auto result_of = [&](const std::vector<reg::StereoShot>& shots) {
    return reconstructor.reconstruct(shots);
  };
  const reg::StereoShot& first = pair.shots.front();
  const reg::Reconstruction single = result_of({first});
  print(pair, "single", single);
  if (single.status != reg::ReconstructionStatus::done) return;
  const reg::Rectification& geometry = reconstructor.rectification();
  const cv::Mat1b before = reg::make_pattern(scene.pattern);
  const cv::Mat1b left = reg::rectified_left(first.left, zoom, geometry);
  const reg::ProjectorMap map = reg::find_projector(before, left, single);
  fmt::print("{:<28} projector: {} parts, {:.3f} px {}\n", pair.name, map.anchors, map.residual_px,
             map.evidence);
  if (!map.is_found) return;
  const reg::PatternNeeds needs = reg::pattern_needs({single, geometry, left, before, map});
  fmt::print("{:<28} needs: gap {} faint {} saturated {} other {}\n", pair.name, needs.count[1],
             needs.count[2], needs.count[3], needs.count[4]);
  RenderedRoom room(scene);
  reg::PatternParameters next = scene.pattern;
  ++next.seed;
  const auto fused = [&](const std::string& what, const cv::Mat& pattern) {
    print(pair, what, result_of({first, room.under(pattern, 1)}));
  };
  const cv::Mat plain = reg::make_pattern(next);
  const cv::Mat complement = reg::complementary_pattern(next, before);
  cv::Mat local = plain.clone(), is_needy;
  cv::resize(needs.cells > 0, is_needy, plain.size(), 0, 0, cv::INTER_NEAREST);
  complement.copyTo(local, is_needy);
  fused("plain", plain);
  fused("complement where poor", local);
  fused("complement", complement);
  fused("refined", reg::refined_pattern(next, before, needs));
}

}  // namespace holdfast::test
