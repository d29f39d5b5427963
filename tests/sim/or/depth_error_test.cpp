// SPDX-License-Identifier: Apache-2.0
#include "tests/sim/or/depth_error.hpp"

#include <cmath>
#include <limits>

#include <gtest/gtest.h>
#include <opencv2/calib3d.hpp>

#include "registration/rectification.hpp"
#include "rt/core/error.hpp"
#include "tests/sim/or/calibration_error.hpp"
#include "tests/sim/or/ideal_calibration.hpp"

namespace holdfast::sim {
namespace {

using Eigen::Vector3d;

/// The renderer's own depth of every raw pixel, put where the pipeline's depth map would have it.
class DepthErrorOfTruth : public testing::Test {
 protected:
  void SetUp() override {
    config_.phantom = "relief";
    const Microscope microscope(config_.optics);
    RoomShot shot;
    shot.optics = microscope.at(config_.zoom, config_.visit);
    shot.T_ct_head = head_poses(config_, scene_.phantom, microscope.focus_mm()).front();
    calibration_ = ideal_calibration(microscope.at(config_.zoom)).model;
    const Geometry truth = scene_.renderer.geometry(shot, Side::left);
    const Eigen::Isometry3d T_camera_left =
        frame_of(calibration_, shot.optics) * shot.optics.T_head_left;
    const auto geometry =
        registration::rectification_of(calibration_, {kSensorWidthPx, kSensorHeightPx});
    depth_ =
        cv::Mat_<float>(kSensorHeightPx, kSensorWidthPx, std::numeric_limits<float>::quiet_NaN());
    for (int y = 0; y < depth_.rows; y += 2)  // every pixel that is looked at has even coordinates
      for (int x = 0; x < depth_.cols; ++x)
        put(truth, shot.optics.left, T_camera_left, geometry, x, y);
  }

  void put(const Geometry& truth, const OpticalChannel& left,
           const Eigen::Isometry3d& T_camera_left, const registration::Rectification& geometry,
           int x, int y) {
    const auto z = static_cast<double>(truth.depth_mm(y, x));
    if (!(z > 0)) return;
    const SightLine line = left.sight_line({x, y});
    const Vector3d p = T_camera_left * (line.origin_mm + (z - line.origin_mm.z()) * line.direction);
    const cv::Vec3d r = geometry.R1 * cv::Vec3d(p.x(), p.y(), p.z());
    const int u =
        static_cast<int>(std::lround(geometry.P1(0, 0) * r[0] / r[2] + geometry.P1(0, 2)));
    const int v =
        static_cast<int>(std::lround(geometry.P1(1, 1) * r[1] / r[2] + geometry.P1(1, 2)));
    for (int below = v; below <= v + 1; ++below)
      if (u >= 0 && below >= 0 && u < depth_.cols && below < depth_.rows)
        depth_(below, u) = static_cast<float>(r[2]);
  }

  [[nodiscard]] DepthError error() const {
    return depth_error(depth_, calibration_, config_, scene_, 0, {.step_px = 16});
  }

  RoomConfig config_ = [] {
    RoomConfig config;
    config.phantom = "relief";
    return config;
  }();
  RoomScene scene_{config_};
  registration::ZoomCalibration calibration_;
  cv::Mat_<float> depth_;
};

TEST_F(DepthErrorOfTruth, IsSmallAndSeesWhatIsAddedAndWhatIsMissing) {
  const DepthError exact = error();
  ASSERT_GT(exact.seen, 1'000U);
  EXPECT_GT(exact.coverage, 0.9);
  EXPECT_LT(exact.median_mm, 0.06);  // half a pixel on the slopes, and the lens no model holds
  EXPECT_LT(exact.share_over_1_mm_off_edges, 0.01);

  depth_ += 0.5F;
  const DepthError lifted = error();
  EXPECT_NEAR(lifted.median_mm, 0.5, 0.06);
  EXPECT_EQ(lifted.known, exact.known);

  depth_(cv::Rect(0, 0, depth_.cols / 2, depth_.rows))
      .setTo(std::numeric_limits<float>::quiet_NaN());
  const DepthError half = error();
  EXPECT_EQ(half.seen, exact.seen);
  EXPECT_LT(half.coverage, 0.75 * exact.coverage);
  EXPECT_GT(half.coverage, 0.25 * exact.coverage);
}

TEST_F(DepthErrorOfTruth, RefusesAnotherGridOrPose) {
  EXPECT_THROW(
      (void)depth_error(cv::Mat_<float>(100, 100, 200.F), calibration_, config_, scene_, 0),
      InputError);
  EXPECT_THROW((void)depth_error(depth_, calibration_, config_, scene_, 1), InputError);
}

}  // namespace
}  // namespace holdfast::sim
