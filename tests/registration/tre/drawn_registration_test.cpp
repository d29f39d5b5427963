// SPDX-License-Identifier: Apache-2.0
// From pixels to a registration, many times over a lens that no model contains: is the stated error
// true, and does what belongs elsewhere end in a refusal that names it?
#include "tests/registration/tre/drawn_registration.hpp"

#include <cmath>
#include <string>

#include <Eigen/Cholesky>
#include <gtest/gtest.h>

#include "rt/core/error.hpp"

namespace holdfast::registration::test {
namespace {

DrawnMeasurement measured(std::uint32_t seed, double zoom = 1.3) {
  DrawnRig rig;
  rig.seed = seed;
  rig.zoom = zoom;
  rig.pairs = 10;
  return draw_measurement(rig, sim::make_ear_phantom(1000 + seed, sim::PhantomParts::scan_only));
}

CtRegistration registered(const DrawnMeasurement& measurement) {
  RegistrationInput input;
  input.fixed = measurement.beads;
  input.moving = markups_of(measurement.markers);
  return register_ct(input);
}

std::string refusal(const DrawnMeasurement& seen, const ZoomCalibration& calibration) {
  try {
    (void)locate_markers(seen.left, seen.right, calibration, bead_options());
  } catch (const RefusedError& error) {
    return error.what();
  }
  return {};
}

TEST(DrawnRegistration, ItsRegionContainsTheTruth) {
  RecordProperty("requirement", "SR-85");
  constexpr int kRuns = 16;
  int contained = 0;
  double squares = 0;
  for (std::uint32_t seed = 1; seed <= kRuns; ++seed) {
    const DrawnMeasurement drawn = measured(seed);
    const CtRegistration result = registered(drawn);
    ASSERT_EQ(result.status, RegistrationStatus::registered) << result.reason;
    const Registration& r = result.registration;
    const Eigen::Vector3d site = drawn.T_ct_head * Eigen::Vector3d(0, 0, drawn.optics.focus_mm);
    const Eigen::Vector3d error = r.T_camera_ct * site - drawn.T_camera_ct * site;
    const Eigen::Matrix3d covariance = target_covariance(r.T_camera_ct, r.covariance, site);
    contained += error.dot(covariance.ldlt().solve(error)) <= 7.815 ? 1 : 0;
    squares += error.squaredNorm();
  }
  EXPECT_GE(contained, 13) << "of 16; 15 expected";
  EXPECT_LT(std::sqrt(squares / kRuns), 0.12);
}

TEST(DrawnRegistration, RefusesTheCalibrationOfAnotherRigOrZoom) {
  RecordProperty("requirement", "SR-86");
  const DrawnMeasurement seen = measured(1);
  ASSERT_EQ(refusal(seen, seen.calibration), "");
  EXPECT_NE(refusal(seen, measured(2).calibration).find("another calibration"), std::string::npos)
      << refusal(seen, measured(2).calibration);
  const std::string other_zoom = refusal(seen, measured(1, 1.4).calibration);
  EXPECT_NE(other_zoom.find("another zoom"), std::string::npos) << other_zoom;
}

TEST(DrawnRegistration, RefusesAMarkerDisplacedByAMillimetre) {
  RecordProperty("requirement", "SR-86");
  DrawnMeasurement drawn = measured(1);
  drawn.beads.points[2].position_mm.x() += 1;
  for (std::size_t i = 0; i < 4; ++i)
    drawn.beads.points[i].label = markups_of(drawn.markers).points[i].label;
  const CtRegistration result = registered(drawn);
  EXPECT_EQ(result.status, RegistrationStatus::fiducial_displaced) << result.reason;
  EXPECT_NE(result.reason.find("aruco-2"), std::string::npos) << result.reason;
}

}  // namespace
}  // namespace holdfast::registration::test
