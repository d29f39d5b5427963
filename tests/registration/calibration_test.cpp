// SPDX-License-Identifier: Apache-2.0
#include <algorithm>
#include <cmath>
#include <string>

#include <gtest/gtest.h>

#include "registration/calibration_run.hpp"
#include "rt/core/error.hpp"
#include "tests/registration/support/calibration_scene.hpp"

namespace holdfast::registration {
namespace {

using test::CalibrationScene;
using test::SceneOptions;

SceneOptions one_zoom(int pairs = 9) {
  SceneOptions options;
  options.zooms = {1.3};
  options.pairs = pairs;
  return options;
}

CalibrationOutcome calibrated(const std::vector<ZoomViews>& views,
                              const CalibrationOptions& options = {}) {
  return calibrate_stereo(views, CalibrationScene::kWidth, CalibrationScene::kHeight, options, {});
}

std::string refusal(const std::vector<ZoomViews>& views, const CalibrationOptions& options = {}) {
  try {
    (void)calibrated(views, options);
  } catch (const RefusedError& e) {
    return e.what();
  }
  return "";
}

void names(const std::string& text, const char* what) {
  EXPECT_NE(text.find(what), std::string::npos) << text;
  EXPECT_EQ(text.find('\n'), std::string::npos) << text;
}

TEST(CalibrateStereo, IsExactWhereTheModelHoldsAndNothingIsNoisy) {
  SceneOptions options = one_zoom(8);
  options.corner_noise_px = 1e-4;
  options.foreign_distortion_px = options.bend_mm = 0;
  const CalibrationScene scene(options);
  CalibrationOptions settings;
  settings.bundle.prism_prior_px = 30;  // this lens stands far off its axis
  const auto outcome = calibrated(scene.views(), settings);
  EXPECT_LT(scene.nonrigid_error_mm(outcome.calibration.zooms[0], 1.3), 0.004);
}

TEST(CalibrateStereo, PredictsItsOwnErrorHonestly) {
  const CalibrationScene scene(one_zoom(10));
  const auto outcome = calibrated(scene.views());
  const double error_mm = scene.nonrigid_error_mm(outcome.calibration.zooms[0], 1.3);
  EXPECT_LT(error_mm, 2.5 * outcome.zooms[0].predicted_nonrigid_mm);
  EXPECT_GT(error_mm, 0.1 * outcome.zooms[0].predicted_nonrigid_mm);
}

TEST(CalibrateStereo, PlainIsOpenCvsRecipe) {
  CalibrationOptions options;
  options.method = CalibrationMethod::plain;
  const CalibrationScene scene(one_zoom());
  const auto outcome = calibrated(scene.views(), options);
  EXPECT_EQ(outcome.calibration.zooms[0].distortion_left.total(), 5U);
  EXPECT_EQ(outcome.calibration.zooms[0].parameter_covariance.size(), 0);
  EXPECT_LT(outcome.calibration.zooms[0].rms_px, 0.5);
}

TEST(CalibrateStereo, RefusesTooFewPairs) {
  names(refusal(CalibrationScene(one_zoom(5)).views()), "zoom 1.3: 5 pairs");
}

TEST(CalibrateStereo, RefusesSwappedSides) {
  auto views = CalibrationScene(one_zoom()).views();
  for (BoardPair& pair : views[0].pairs) std::swap(pair.left, pair.right);
  names(refusal(views), "left and right are swapped");
}

TEST(CalibrateStereo, NamesTheOnePairWhoseSidesAreSwapped) {
  auto views = CalibrationScene(one_zoom()).views();
  std::swap(views[0].pairs[4].left, views[0].pairs[4].right);
  names(refusal(views), "left_4.png");
}

TEST(CalibrateStereo, NamesAPairOfDifferentMoments) {
  auto views = CalibrationScene(one_zoom()).views();
  for (cv::Point2d& p : views[0].pairs[2].right) p += cv::Point2d(9, 14);
  names(refusal(views), "left_2.png");
}

TEST(CalibrateStereo, RefusesFrontalViews) {
  SceneOptions options = one_zoom(12);
  options.tilt_rad = 0;
  names(refusal(CalibrationScene(options).views()), "do not constrain the model");
}

TEST(CalibrateStereo, RefusesViewsThatAreAllAlike) {
  auto views = CalibrationScene(one_zoom()).views();
  for (std::size_t i = 1; i < views[0].pairs.size(); ++i) {
    // The same pose, each with its own noise.
    for (std::size_t k = 0; k < views[0].pairs[i].left.size(); ++k) {
      const cv::Point2d noise(0.03 * std::sin(97.0 * static_cast<double>(i * 45 + k)),
                              0.03 * std::cos(57.0 * static_cast<double>(i * 45 + k)));
      views[0].pairs[i].left[k] = views[0].pairs[0].left[k] + noise;
      views[0].pairs[i].right[k] = views[0].pairs[0].right[k] - noise;
    }
  }
  names(refusal(views), "do not constrain the model");
}

TEST(CalibrateStereo, RefusesASquareSizeThatContradictsTheWorkingDistance) {
  CalibrationOptions options;
  options.focus_mm = 200;
  options.board.square_mm = 6;
  names(refusal(CalibrationScene(one_zoom()).views(), options), "the squares are not 6 mm");
}

}  // namespace
}  // namespace holdfast::registration
