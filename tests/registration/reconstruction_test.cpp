// SPDX-License-Identifier: Apache-2.0
// Raw pairs of an analytic microscope through the whole reconstruction: the surface against the
// truth, its stated variance, and every refusal.
#include "registration/reconstruction.hpp"

#include <algorithm>
#include <cmath>
#include <vector>

#include <Eigen/Geometry>
#include <gtest/gtest.h>
#include <opencv2/imgproc.hpp>

#include "rt/core/error.hpp"
#include "tests/registration/support/stereo_rig.hpp"

namespace holdfast::registration {
namespace {

using Status = ReconstructionStatus;
using test::StereoRig;

struct Errors {
  double median_mm = 0, share_above_1mm = 0;
  double ratio_68 = 0;       // 68th percentile of error over predicted sigma; 1 where that is true
  double squared_ratio = 0;  // mean of (error over sigma)², each cut at 25; likewise
  double trusted_wrong = 0;  // share more than 1 mm wrong, and by more than 5 of those sigmas
  std::size_t count = 0;
};

Errors errors_of(const StereoRig& rig, const Rectification& geometry,
                 const Reconstruction& result) {
  std::vector<double> errors, ratios;
  std::size_t wrong = 0, trusted_wrong = 0;
  double squares = 0;
  for (int y = 0; y < result.depth_mm.rows; y += 3)
    for (int x = 0; x < result.depth_mm.cols; x += 3) {
      const double depth = static_cast<double>(result.depth_mm(y, x));
      if (std::isnan(depth)) continue;
      const double error = std::abs(
          depth - rig.true_depth_mm(geometry, result.region_px.x + x, result.region_px.y + y));
      errors.push_back(error);
      ratios.push_back(error / std::sqrt(static_cast<double>(result.depth_variance_mm2(y, x))));
      squares += std::min(ratios.back() * ratios.back(), 25.0);
      if (error > 1) ++wrong;
      if (error > 1 && ratios.back() > 5) ++trusted_wrong;
    }
  if (errors.empty()) return {};
  const auto quantile = [](std::vector<double>& values, double share) {
    const auto at =
        values.begin() + static_cast<std::ptrdiff_t>(share * static_cast<double>(values.size()));
    std::nth_element(values.begin(), at, values.end());
    return *at;
  };
  const double n = static_cast<double>(errors.size());
  return {quantile(errors, 0.5), static_cast<double>(wrong) / n,         quantile(ratios, 0.68),
          squares / n,           static_cast<double>(trusted_wrong) / n, errors.size()};
}

Reconstruction reconstruct(const StereoRig& rig, const StereoShot& shot,
                           const ReconstructionOptions& options = {}) {
  Reconstructor reconstructor(rig.calibration(), rig.image_px, options);
  return reconstructor.reconstruct(std::span(&shot, 1));
}

TEST(Reconstruction, SurfaceIsTheTrueOneAndBetterThanTheBaselines) {
  const StereoRig rig;
  const StereoShot shot{rig.left(), rig.right()};
  ReconstructionOptions baseline;
  baseline.method = MatchMethod::opencv;
  const Reconstruction ours = reconstruct(rig, shot), theirs = reconstruct(rig, shot, baseline);
  ASSERT_EQ(ours.status, Status::done) << ours.evidence;
  ASSERT_EQ(theirs.status, Status::done) << theirs.evidence;
  const Rectification geometry = rectification_of(rig.calibration(), rig.image_px);
  const Errors error = errors_of(rig, geometry, ours),
               error_opencv = errors_of(rig, geometry, theirs);
  EXPECT_GT(ours.density, 0.9);
  EXPECT_LT(error.median_mm, 0.03);  // 1 px of disparity is 0.8 mm here
  EXPECT_LT(error.share_above_1mm, 0.005);
  EXPECT_LT(error.median_mm, error_opencv.median_mm / 3);
}

TEST(Reconstruction, StatedVarianceIsThatOfTheErrorInScenesOfManyKinds) {
  StereoRig noisy, shallow, fine, dark;
  noisy.noise_grey = 5;
  shallow.relief_mm = 0.5;
  fine.dot_pitch_mm = 0.8;
  fine.dot_radius_mm = 0.25;
  dark.contrast_grey = 40;
  dark.seed = 7;
  for (const StereoRig& rig : {StereoRig{}, noisy, shallow, fine, dark}) {
    const Reconstruction result = reconstruct(rig, {rig.left(), rig.right()});
    ASSERT_EQ(result.status, Status::done) << result.evidence;
    const Errors error = errors_of(rig, rectification_of(rig.calibration(), rig.image_px), result);
    EXPECT_GT(error.squared_ratio, 0.4) << "the stated variance is too large";
    EXPECT_LT(error.squared_ratio, 2.0) << "the stated variance is too small";
    EXPECT_GT(error.ratio_68, 0.55);
    EXPECT_LT(error.ratio_68, 1.3);
  }
}

TEST(Reconstruction, KnowsTheSurfaceBetweenDotsInTheDark) {
  // As the pattern's filter leaves it: gaps of 60 px with nothing in them but the sensor's noise.
  StereoRig rig;
  rig.image_px = {560, 400};
  rig.focal_px = 4000;
  rig.relief_mm = 1.5;
  rig.dot_pitch_mm = 1.2;
  rig.dot_radius_mm = 0.3;
  rig.ambient_grey = 2;
  rig.texture_grey = 0;
  ReconstructionOptions options;
  options.match = match_parameters_for({2456, 2054});
  options.depth_reach_mm = 12;
  Reconstruction result = reconstruct(rig, {rig.left(), rig.right()}, options);
  ASSERT_EQ(result.status, Status::done) << result.evidence;
  constexpr int kRimPx = 64;  // what only one view shows
  const cv::Rect inside(kRimPx, 0, result.depth_mm.cols - 2 * kRimPx, result.depth_mm.rows);
  result.depth_mm = result.depth_mm(inside);
  result.depth_variance_mm2 = result.depth_variance_mm2(inside);
  result.region_px.x += kRimPx;
  const Errors error = errors_of(rig, rectification_of(rig.calibration(), rig.image_px), result);
  EXPECT_GT(9 * error.count, 0.97 * inside.area());  // every third row and column
  EXPECT_LT(error.share_above_1mm, 0.01);
  EXPECT_LT(error.squared_ratio, 2.5);
}

TEST(Reconstruction, PointsDepthAndDisparityAreOneSurface) {
  const StereoRig rig;
  const Reconstruction result = reconstruct(rig, {rig.left(), rig.right()});
  ASSERT_EQ(result.status, Status::done) << result.evidence;
  const Rectification geometry = rectification_of(rig.calibration(), rig.image_px);
  std::size_t known = 0;
  for (int y = 0; y < result.depth_mm.rows; ++y)
    for (int x = 0; x < result.depth_mm.cols; ++x) {
      const float depth = result.depth_mm(y, x);
      EXPECT_EQ(std::isnan(depth), std::isnan(result.disparity_px(y, x)));
      if (std::isnan(depth)) {
        EXPECT_EQ(result.confidence(y, x), 0);
        continue;
      }
      ++known;
      const cv::Point3d p = geometry.point_mm(result.region_px.x + x, result.region_px.y + y,
                                              static_cast<double>(result.disparity_px(y, x)));
      const cv::Vec3f q = result.points_mm(y, x);
      ASSERT_NEAR(p.x, q[0], 1e-3);
      ASSERT_NEAR(p.y, q[1], 1e-3);
      ASSERT_NEAR(p.z, q[2], 2e-3);
      ASSERT_EQ(q[2], depth);
    }
  EXPECT_EQ(known, result.points);
}

TEST(Reconstruction, ReasonsSayWhyAPixelIsUnknown) {
  const StereoRig rig;
  StereoShot shot{rig.left(), rig.right()};
  shot.left(cv::Rect(150, 120, 80, 80)) = 60;  // nothing to be matched
  ReconstructionOptions options;
  options.is_explained = true;
  const Reconstruction result = reconstruct(rig, shot, options);
  ASSERT_EQ(result.status, Status::done) << result.evidence;
  ASSERT_EQ(result.reasons.size(), result.depth_mm.size());
  const auto reason = [&](int x, int y) { return static_cast<PixelReason>(result.reasons(y, x)); };
  int outside = 0;
  for (int y = 0; y < result.depth_mm.rows; ++y)
    for (int x = 0; x < result.depth_mm.cols; ++x) {
      ASSERT_EQ(std::isnan(result.depth_mm(y, x)), reason(x, y) != PixelReason::known);
      outside += reason(x, y) == PixelReason::outside ? 1 : 0;
    }
  EXPECT_GT(outside, result.reasons.rows) << "what only the left view shows";
  const cv::Rect painted = rectified_region(
      rig.calibration(), rectification_of(rig.calibration(), rig.image_px), {150, 120, 80, 80});
  const cv::Point flat = (painted.tl() + painted.br()) / 2;
  EXPECT_EQ(reason(flat.x, flat.y), PixelReason::unmatched);
  EXPECT_TRUE(reconstruct(rig, shot).reasons.empty()) << "only when asked for";
}

TEST(Reconstruction, RegionIsThatPartOfTheWhole) {
  const StereoRig rig;
  ReconstructionOptions options;
  options.roi_px = cv::Rect(120, 80, 160, 140);
  const Reconstruction part = reconstruct(rig, {rig.left(), rig.right()}, options);
  ASSERT_EQ(part.status, Status::done) << part.evidence;
  EXPECT_NEAR(part.region_px.width, 160, 12);
  EXPECT_NEAR(part.region_px.height, 140, 12);
  const Rectification geometry = rectification_of(rig.calibration(), rig.image_px);
  EXPECT_LT(errors_of(rig, geometry, part).median_mm, 0.05);
  const cv::Mat1f whole = on_whole_grid(part.depth_mm, part.region_px, rig.image_px, NAN);
  EXPECT_EQ(whole.size(), rig.image_px);
  EXPECT_TRUE(std::isnan(whole(0, 0)));
}

TEST(Reconstruction, DoesNotDependOnTheThreads) {
  const StereoRig rig;
  const StereoShot shot{rig.left(), rig.right()};
  ReconstructionOptions options;
  options.threads = 1;
  cv::Mat1f one = reconstruct(rig, shot, options).depth_mm;
  options.threads = 5;
  cv::Mat1f five = reconstruct(rig, shot, options).depth_mm;
  ASSERT_FALSE(one.empty());
  ASSERT_EQ(one.size(), five.size());
  cv::patchNaNs(one, 0);
  cv::patchNaNs(five, 0);
  EXPECT_EQ(cv::countNonZero(one != five), 0);
}

TEST(Reconstruction, BurstOfNoisyShotsIsBetterThanOne) {
  StereoRig rig;
  rig.noise_grey = 5;
  std::vector<StereoShot> shots;
  for (rig.seed = 10; rig.seed < 14; ++rig.seed) shots.push_back({rig.left(), rig.right()});
  Reconstructor reconstructor(rig.calibration(), rig.image_px, {});
  const Reconstruction single = reconstructor.reconstruct(std::span(shots.data(), 1));
  const Reconstruction burst = reconstructor.reconstruct(shots);
  ASSERT_EQ(single.status, Status::done) << single.evidence;
  ASSERT_EQ(burst.status, Status::done) << burst.evidence;
  const Rectification& geometry = reconstructor.rectification();
  const Errors one = errors_of(rig, geometry, single), four = errors_of(rig, geometry, burst);
  EXPECT_LT(four.median_mm, 0.7 * one.median_mm);
  EXPECT_GE(four.count, one.count);
}

TEST(Reconstruction, MeshLooksAtTheCameraAndCarriesR1) {
  const StereoRig rig;
  const Reconstruction result = reconstruct(rig, {rig.left(), rig.right()});
  const Rectification geometry = rectification_of(rig.calibration(), rig.image_px);
  const TriangleMesh mesh = mesh_of(result, geometry, 2);
  ASSERT_GT(mesh.triangles.size(), 10000U);
  ASSERT_TRUE(mesh.R_rectified_camera);
  EXPECT_DOUBLE_EQ((*mesh.R_rectified_camera)(0, 2), geometry.R1(0, 2));
  std::size_t towards = 0;
  for (const auto& t : mesh.triangles) {
    const Eigen::Vector3f a = mesh.vertices_mm[t[0]], b = mesh.vertices_mm[t[1]],
                          c = mesh.vertices_mm[t[2]];
    if ((b - a).cross(c - a).dot(a) < 0) ++towards;
  }
  EXPECT_EQ(towards, mesh.triangles.size());
}

void expect_refused(const StereoRig& rig, const StereoShot& shot, Status status,
                    const ReconstructionOptions& options = {}) {
  const Reconstruction result = reconstruct(rig, shot, options);
  EXPECT_EQ(name(result.status), name(status)) << result.evidence;
  EXPECT_FALSE(result.evidence.empty());
  EXPECT_TRUE(result.points_mm.empty() && result.depth_mm.empty() && result.disparity_px.empty() &&
              result.depth_variance_mm2.empty() && result.confidence.empty())
      << "a refusal hands out no surface";
}

TEST(ReconstructionRefusal, NamesBlackSaturatedAndUnlit) {
  const StereoRig rig;
  const cv::Mat1b good = rig.left(), black(rig.image_px, uchar{2}), white(rig.image_px, uchar{255});
  expect_refused(rig, {good, black}, Status::too_dark);
  expect_refused(rig, {white, good}, Status::saturated);
  StereoRig unlit = rig;
  unlit.contrast_grey = 0;
  unlit.texture_grey = 0;
  unlit.ambient_grey = 80;
  expect_refused(rig, {unlit.left(), unlit.right()}, Status::no_pattern);
}

TEST(ReconstructionRefusal, NamesSwappedViews) {
  const StereoRig rig;
  expect_refused(rig, {rig.right(), rig.left()}, Status::views_swapped);
}

TEST(ReconstructionRefusal, NamesAnotherZoom) {
  StereoRig other;
  other.focal_px *= 1.09;
  expect_refused(StereoRig{}, {other.left(), other.right()}, Status::wrong_optics);
}

TEST(ReconstructionRefusal, NamesAnotherRig) {
  StereoRig other;
  other.pitch_rad = 0.0035;
  expect_refused(StereoRig{}, {other.left(), other.right()}, Status::wrong_optics);
}

StereoRig repeating_rig() {
  StereoRig rig;
  rig.is_lattice = true;
  rig.dot_pitch_mm = 0.6;
  rig.dot_radius_mm = 0.2;
  rig.relief_mm = 1;
  rig.texture_grey = 0;
  return rig;
}

TEST(ReconstructionRefusal, NamesALattice) {
  RecordProperty("requirement", "SR-96");
  for (const double turn_rad : {0.0, 0.1}) {
    StereoRig rig = repeating_rig();
    rig.dots_turn_rad = turn_rad;
    const StereoShot shot{rig.left(), rig.right()};
    expect_refused(rig, shot, Status::lattice);
    ReconstructionOptions baseline;
    baseline.method = MatchMethod::opencv;
    expect_refused(rig, shot, Status::lattice, baseline);
    ReconstructionOptions comparison;
    comparison.may_be_lattice = true;
    expect_refused(rig, shot, Status::period_slip, comparison);
  }
}

/// One shot of a burst is enough: what the others show may not be seen everywhere.
TEST(ReconstructionRefusal, NamesALatticeInABurst) {
  RecordProperty("requirement", "SR-96");
  const StereoRig good, repeating = repeating_rig();
  const StereoShot shots[] = {{good.left(), good.right()}, {repeating.left(), repeating.right()}};
  Reconstructor reconstructor(good.calibration(), good.image_px, {});
  EXPECT_EQ(reconstructor.reconstruct(shots).status, Status::lattice);
}

/// Without the refusal the surface is wrong, and nothing else says so.
TEST(ReconstructionRefusal, OfARepeatingPatternIsAllThatStandsAgainstASlip) {
  const StereoRig rig = repeating_rig();
  ReconstructionOptions options;
  options.ambiguous_share_max = 1;
  options.may_be_lattice = true;
  options.match = match_parameters_for(rig.image_px);
  options.match->repetition.correlation_min = 2;  // never
  const Reconstruction result = reconstruct(rig, {rig.left(), rig.right()}, options);
  ASSERT_EQ(result.status, Status::done) << result.evidence;
  const Errors error = errors_of(rig, rectification_of(rig.calibration(), rig.image_px), result);
  EXPECT_GT(error.share_above_1mm, 0.2);
}

TEST(Reconstruction, LatticeServesForComparisonWhereLessThanAPeriodIsSearched) {
  RecordProperty("requirement", "SR-96");
  StereoRig rig = repeating_rig();
  rig.dot_pitch_mm = 2.2;  // 18 mm of depth
  rig.dot_radius_mm = 0.7;
  rig.relief_mm = 0.5;
  ReconstructionOptions options;
  options.depth_reach_mm = 4;
  expect_refused(rig, {rig.left(), rig.right()}, Status::lattice, options);
  options.may_be_lattice = true;
  const Reconstruction result = reconstruct(rig, {rig.left(), rig.right()}, options);
  ASSERT_EQ(result.status, Status::done) << result.evidence;
  const Errors error = errors_of(rig, rectification_of(rig.calibration(), rig.image_px), result);
  EXPECT_LT(error.share_above_1mm, 0.01);
  EXPECT_TRUE(result.is_for_comparison);
  const Rectification geometry = rectification_of(rig.calibration(), rig.image_px);
  const auto says_so = [](const Reconstruction& surface, const Rectification& of) {
    const auto comments = mesh_of(surface, of).comments;
    return std::any_of(comments.begin(), comments.end(),
                       [](const std::string& line) { return line.rfind(kForComparison, 0) == 0; });
  };
  EXPECT_TRUE(says_so(result, geometry));
  // The option alone does not brand a surface: its pattern does.
  const StereoRig good;
  const Reconstruction other = reconstruct(good, {good.left(), good.right()}, options);
  ASSERT_EQ(other.status, Status::done) << other.evidence;
  EXPECT_FALSE(other.is_for_comparison || says_so(other, geometry));
}

TEST(ReconstructionRefusal, NamesAWrongSize) {
  const StereoRig rig;
  const cv::Mat1b good = rig.left();
  expect_refused(rig, {good, good.rowRange(0, 300).clone()}, Status::wrong_size);
}

TEST(ReconstructionRefusal, NamesOptionsThatCannotServe) {
  const StereoRig rig;
  ReconstructionOptions options;
  options.roi_px = cv::Rect(300, 0, 200, 100);
  EXPECT_THROW(Reconstructor(rig.calibration(), rig.image_px, options), InputError);
  options = {};
  options.depth_reach_mm = 500;
  EXPECT_THROW(Reconstructor(rig.calibration(), rig.image_px, options), InputError);
  ZoomCalibration swapped = rig.calibration();
  swapped.T = -swapped.T;
  EXPECT_THROW(Reconstructor(swapped, rig.image_px, {}), InputError);
}

}  // namespace
}  // namespace holdfast::registration
