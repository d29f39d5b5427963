// SPDX-License-Identifier: Apache-2.0
#include <cmath>
#include <string>

#include <gtest/gtest.h>
#include <opencv2/aruco.hpp>

#include "registration/marker_detection.hpp"
#include "registration/marker_triangulation.hpp"
#include "rt/core/error.hpp"
#include "tests/registration/support/flat_render.hpp"

namespace holdfast::registration {
namespace {

constexpr double kSideMm = 6;
const Eigen::Vector2d kCentres[3] = {{-14, -6}, {12, -3}, {-1, 9}};

class Markers : public ::testing::Test {
 protected:
  Markers() {
    T_right_left_ =
        (Eigen::Translation3d(24, 0, 1.4) * Eigen::AngleAxisd(-0.12, Eigen::Vector3d::UnitY()))
            .inverse();
    T_camera_plane_ = Eigen::Translation3d(0.5, -1, 200) *
                      Eigen::AngleAxisd(0.25, Eigen::Vector3d::UnitY()) *
                      Eigen::AngleAxisd(CV_PI - 0.2, Eigen::Vector3d::UnitX());
    zoom_.zoom = 1.3;
    zoom_.focus_mm = 200;
    zoom_.camera_matrix_left = zoom_.camera_matrix_right = view(true).camera_matrix();
    zoom_.distortion_left = cv::Mat::zeros(1, 5, CV_64F);
    zoom_.distortion_right = cv::Mat::zeros(1, 5, CV_64F);
    for (int r = 0; r < 3; ++r) {
      for (int c = 0; c < 3; ++c) zoom_.R(r, c) = T_right_left_(r, c);
      zoom_.T[r] = T_right_left_(r, 3);
    }
    const auto words = cv::aruco::getPredefinedDictionary(cv::aruco::DICT_4X4_50);
    for (int id = 0; id < 3; ++id) cv::aruco::drawMarker(words, id, 6, bits_[id]);
  }

  /// z of the plane (out of the print) points towards the cameras.
  [[nodiscard]] test::FlatView view(bool is_left) const {
    test::FlatView v;
    v.seed = is_left ? 1 : 2;
    v.T_camera_plane = is_left ? T_camera_plane_ : T_right_left_ * T_camera_plane_;
    return v;
  }
  [[nodiscard]] double print(double x, double y) const {
    for (int id = 0; id < 3; ++id) {
      const int column =
          static_cast<int>(std::floor((x - kCentres[id].x() + kSideMm / 2) / kSideMm * 6));
      const int row =
          static_cast<int>(std::floor((kCentres[id].y() + kSideMm / 2 - y) / kSideMm * 6));
      if (column >= 0 && row >= 0 && column < 6 && row < 6)
        return bits_[id].at<std::uint8_t>(row, column) != 0 ? 200 : 30;
    }
    return 200;
  }
  [[nodiscard]] std::vector<DetectedMarker> detected(bool is_left) const {
    return detect_markers(
        test::render(view(is_left), [this](double x, double y) { return print(x, y); }),
        marker_dictionary("4x4_50"), zoom_.camera_matrix_left, zoom_.distortion_left);
  }
  [[nodiscard]] std::string refusal(const std::vector<DetectedMarker>& left,
                                    const std::vector<DetectedMarker>& right,
                                    const MarkerOptions& options = {}) const {
    try {
      (void)locate_markers(left, right, zoom_, options);
    } catch (const RefusedError& e) {
      return e.what();
    }
    return "";
  }

  Eigen::Isometry3d T_right_left_, T_camera_plane_;
  ZoomCalibration zoom_;
  cv::Mat bits_[3];
};

TEST_F(Markers, CentresAndBeadsAreFoundToAFewHundredthsOfAMillimetre) {
  const auto left = detected(true), right = detected(false);
  for (const double offset_mm : {0.0, 1.0}) {
    MarkerOptions options;
    options.offset_mm = offset_mm;
    const MarkerSet set = locate_markers(left, right, zoom_, options);
    ASSERT_EQ(set.markers.size(), 3U);
    for (const LocatedMarker& m : set.markers) {
      const Eigen::Vector2d centre = kCentres[m.id];
      const Eigen::Vector3d truth =
          T_camera_plane_ * Eigen::Vector3d(centre.x(), centre.y(), -offset_mm);
      const Eigen::Vector3d error = m.point_mm - truth;
      EXPECT_LT(error.norm(), 0.03) << "aruco-" << m.id;
      EXPECT_NEAR(m.side_mm, kSideMm, 0.02);
      EXPECT_LT(error.dot(m.covariance_mm2.ldlt().solve(error)), 25);  // within 5 sigma
      EXPECT_LT(std::sqrt(m.covariance_mm2.trace()), 0.1);
    }
  }
}

TEST_F(Markers, ABeadIsKnownNoBetterThanItsHolderIsMade) {
  const auto left = detected(true), right = detected(false);
  MarkerOptions options;
  options.offset_mm = 1;
  const MarkerSet made = locate_markers(left, right, zoom_, options);
  const Eigen::Matrix3d R = made.markers[0].T_camera_marker.linear();
  options.offset_sigma_mm.setZero();
  const MarkerSet ideal = locate_markers(left, right, zoom_, options);
  const Eigen::Matrix3d added =
      R.transpose() * (made.markers[0].covariance_mm2 - ideal.markers[0].covariance_mm2) * R;
  EXPECT_NEAR(added(0, 0), 1e-4, 1e-7);
  EXPECT_NEAR(added(2, 2), 4e-4, 1e-7);
  EXPECT_NEAR(added(0, 2), 0, 1e-7);
  options.offset_mm = 0;  // the print itself
  options.offset_sigma_mm.setConstant(1);
  EXPECT_LT(locate_markers(left, right, zoom_, options).markers[0].covariance_mm2.trace(), 0.01);
}

TEST_F(Markers, TheCalibrationsUncertaintyIsSharedByAllMarkers) {
  const auto left = detected(true), right = detected(false);
  const MarkerSet without = locate_markers(left, right, zoom_, {});
  zoom_.parameter_covariance = Eigen::MatrixXd::Zero(24, 24);
  zoom_.parameter_covariance(21, 21) = 0.01;  // T.x: 0.1 mm, so 0.4 % of the depth
  const MarkerSet with = locate_markers(left, right, zoom_, {});
  const double sigma_z =
      std::sqrt(with.markers[0].covariance_mm2(2, 2) - without.markers[0].covariance_mm2(2, 2));
  EXPECT_NEAR(sigma_z, 200 * 0.1 / 24, 0.1);
  EXPECT_GT(with.joint_covariance_mm2(2, 5), 0.9 * sigma_z * sigma_z);
  EXPECT_EQ(without.joint_covariance_mm2(2, 5), 0);
}

TEST_F(Markers, TellHowTheZoomIsSeatedThisTime) {
  const auto left = detected(true), right = detected(false);
  const auto error_mm = [&](const MarkerSet& set) {
    double squares = 0;
    for (const LocatedMarker& m : set.markers) {
      const Eigen::Vector2d centre = kCentres[m.id];
      const Eigen::Vector3d truth = T_camera_plane_ * Eigen::Vector3d(centre.x(), centre.y(), 0);
      squares += (m.point_mm - truth).squaredNorm() / 3;
    }
    return std::sqrt(squares);
  };
  // Calibrated as it was seated then, 0.3 px elsewhere in x and y: 0.13 mm of depth.
  zoom_.camera_matrix_right(0, 2) += 0.3;
  zoom_.camera_matrix_right(1, 2) -= 0.3;
  MarkerOptions options;
  const MarkerSet unaware = locate_markers(left, right, zoom_, options);
  EXPECT_GT(error_mm(unaware), 0.1);
  EXPECT_GT(unaware.markers[0].fit_px, 0.12);
  zoom_.parameter_covariance = Eigen::MatrixXd::Zero(24, 24);
  for (const Eigen::Index i : {2, 3, 11, 12}) zoom_.parameter_covariance(i, i) = 0.2 * 0.2;
  const MarkerSet aware = locate_markers(left, right, zoom_, options);  // y only: lines must meet
  EXPECT_LT(aware.markers[0].fit_px, 0.06);
  EXPECT_LT(aware.calibration.parameter_covariance(12, 12), 0.6 * 0.2 * 0.2);
  options.marker_mm = kSideMm;
  options.marker_sigma_mm = 1e-3;
  const MarkerSet measured = locate_markers(left, right, zoom_, options);  // x too: depth is size
  EXPECT_LT(error_mm(measured), 0.06);
  for (const MarkerSet* set : {&aware, &measured}) {
    Eigen::VectorXd error(9);
    for (std::size_t i = 0; i < 3; ++i)
      error.segment<3>(static_cast<Eigen::Index>(3 * i)) =
          set->markers[i].point_mm -
          T_camera_plane_ * Eigen::Vector3d(kCentres[i].x(), kCentres[i].y(), 0);
    EXPECT_LT(error.dot(set->joint_covariance_mm2.ldlt().solve(error)), 28);  // 99.9 % of 9
  }
}

TEST_F(Markers, RefusalsNameTheMarker) {
  const auto left = detected(true), right = detected(false);
  const auto names = [](const std::string& text, const char* what) {
    EXPECT_NE(text.find(what), std::string::npos) << text;
  };
  EXPECT_EQ(refusal(left, right), "");
  names(refusal({}, {}), "its dots hide the markers");
  const std::vector<DetectedMarker> fewer = {right.at(0), right.at(2)};
  names(refusal(left, fewer), "aruco-1 is seen in the left image only");
  const std::vector<DetectedMarker> twice = {left.at(0), left.at(0), left.at(1), left.at(2)};
  names(refusal(twice, right), "aruco-0 is twice in the left image");
  names(refusal(right, left), "swapped");
  MarkerOptions options;
  options.marker_mm = 7;
  names(refusal(left, right, options), "its side measures 6.0");
}

}  // namespace
}  // namespace holdfast::registration
