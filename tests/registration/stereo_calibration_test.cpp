// SPDX-License-Identifier: Apache-2.0
#include "registration/stereo_calibration.hpp"

#include <cmath>
#include <filesystem>
#include <fstream>
#include <functional>

#include <Eigen/Eigenvalues>
#include <gtest/gtest.h>
#include <opencv2/calib3d.hpp>

#include "rt/core/error.hpp"

namespace holdfast::registration {
namespace {

/// A microscope whose parameters are quadratic in log zoom, so that parabolas must be exact.
ZoomCalibration at(double zoom, int coefficients = 5) {
  const double x = std::log(zoom);
  ZoomCalibration z;
  z.zoom = zoom;
  z.focus_mm = 200;
  const double f = 3500 * zoom;
  // Quadratic in log zoom: the principal point as an angle, the distortion in pixels.
  z.camera_matrix_left = {f, 0, 1227.5 + 0.01 * f * x, 0, f * 1.001, 1026.5 - 0.008 * f * x * x, 0,
                          0, 1};
  z.camera_matrix_right = {f * 1.002, 0, 1227.5 - 0.002 * f, 0, f, 1026.5 + 0.001 * f, 0, 0, 1};
  z.distortion_left = cv::Mat::zeros(1, coefficients, CV_64F);
  z.distortion_left.at<double>(0) = (-0.1 + 0.1 * x - 0.1 * x * x) * zoom * zoom;
  z.distortion_right = z.distortion_left.clone();
  cv::Rodrigues(cv::Vec3d(0.001, -0.12 + 0.002 * x, 0.003), z.R);
  z.T = {-24, 0.1, 1.5 + x};
  z.rms_px = 0.1;
  z.pairs_used = 19;
  const Eigen::Index size = 2 * (4 + coefficients) + 6;
  z.parameter_covariance = Eigen::MatrixXd::Identity(size, size) * 1e-4;
  return z;
}

StereoCalibration microscope() {
  return {2456, 2054, {at(1.1), at(1.2), at(1.3), at(1.4), at(1.5)}};
}

std::string written(const std::string& text) {
  const std::string path =
      (std::filesystem::path(::testing::TempDir()) /
       (std::string(::testing::UnitTest::GetInstance()->current_test_info()->name()) + ".yaml"))
          .string();
  std::ofstream(path) << text;
  return path;
}

/// What the reader says of a calibration spoilt by `spoil`; empty when it accepts it.
std::string refusal(const std::function<void(StereoCalibration&)>& spoil) {
  StereoCalibration calibration = microscope();
  spoil(calibration);
  try {
    (void)read_stereo_calibration(written(stereo_calibration_text(calibration)));
  } catch (const InputError& e) {
    return e.what();
  }
  return "";
}

void expect_near(const ZoomCalibration& a, const ZoomCalibration& b, double tolerance) {
  EXPECT_LT((parameter_vector(a) - parameter_vector(b)).cwiseAbs().maxCoeff(), tolerance);
}

TEST(StereoCalibrationFile, ReadsBackExactlyWhatWasWritten) {
  const StereoCalibration original = microscope();
  const auto read = read_stereo_calibration(written(stereo_calibration_text(original)));
  ASSERT_EQ(read.zooms.size(), 5U);
  EXPECT_EQ(read.image_width_px, 2456);
  for (std::size_t k = 0; k < 5; ++k) {
    expect_near(read.zooms[k], original.zooms[k], 1e-12);
    EXPECT_EQ(read.zooms[k].parameter_covariance, original.zooms[k].parameter_covariance);
    EXPECT_EQ(read.zooms[k].pairs_used, 19);
    EXPECT_EQ(read.zooms[k].focus_mm, 200);
  }
}

TEST(StereoCalibrationFile, AnUnknownCovarianceStaysUnknown) {
  StereoCalibration original = microscope();
  for (ZoomCalibration& zoom : original.zooms) zoom.parameter_covariance.resize(0, 0);
  const auto read = read_stereo_calibration(written(stereo_calibration_text(original)));
  EXPECT_EQ(read.zooms[0].parameter_covariance.size(), 0);
  EXPECT_EQ(calibration_at_zoom(read, 1.25).parameter_covariance.size(), 0);
}

TEST(StereoCalibrationFile, RefusesWhatCannotBeMeasuredWithAndNamesIt) {
  const auto names = [](const std::string& text, const char* what) {
    EXPECT_NE(text.find(what), std::string::npos) << text;
    EXPECT_EQ(text.find('\n'), std::string::npos) << text;
  };
  EXPECT_EQ(refusal([](auto&) {}), "");
  names(refusal([](auto& c) { std::swap(c.zooms[0], c.zooms[1]); }), "zooms[1]: zoom is 1.1");
  names(refusal([](auto& c) { c.zooms[1].zoom = c.zooms[0].zoom; }), "zooms[1]: zoom is 1.1");
  names(refusal([](auto& c) { c.zooms.clear(); }), "zooms");
  names(refusal([](auto& c) { c.zooms[2].R(0, 0) = 0.9; }), "zooms[2]: R is no rotation");
  names(refusal([](auto& c) { c.zooms[2].R = -c.zooms[2].R; }), "R is no rotation");
  names(refusal([](auto& c) { c.zooms[0].T = {0, 0, 0}; }), "the length of T is 0");
  names(refusal([](auto& c) { c.zooms[0].T[0] = std::nan(""); }), "T");
  names(refusal([](auto& c) { c.zooms[3].distortion_left.template at<double>(0) = -60; }),
        "undoing distortion_left");
  names(refusal([](auto& c) { c.zooms[3].distortion_right = cv::Mat::zeros(1, 4, CV_64F); }),
        "distortion_right has 4 coefficients");
  names(refusal([](auto& c) { c.zooms[0].camera_matrix_right(0, 0) = -1; }), "focal length");
  names(refusal([](auto& c) { c.zooms[0].parameter_covariance(3, 3) = -1e-4; }), "variance");
  names(refusal([](auto& c) { c.zooms[0].parameter_covariance(3, 4) = 1e-4; }), "not symmetric");
  names(refusal([](auto& c) {
          auto& m = c.zooms[0].parameter_covariance;
          m(3, 4) = m(4, 3) = 2e-4;
        }),
        "least eigenvalue");
  names(refusal([](auto& c) { c.zooms[0].parameter_covariance.conservativeResize(6, 6); }),
        "is 6x6, must be 24x24");
  names(refusal([](auto& c) { c.image_width_px = 0; }), "image_width is 0");
}

TEST(StereoCalibrationFile, RefusesAFileThatIsNone) {
  for (const char* text : {"", "no yaml at all", "%YAML:1.0\n---\nimage_width: 10\n",
                           "%YAML:1.0\n---\nimage_width: \"ten\"\n",
                           "%YAML:1.0\n---\nimage_width: 640\nimage_height: 480\nzooms: 3\n",
                           "%YAML:1.0\n---\nimage_width: 640\nimage_height: 480\nzooms: [ 3 ]\n"})
    EXPECT_THROW((void)read_stereo_calibration(written(text)), InputError) << text;
  EXPECT_THROW((void)read_stereo_calibration("/nowhere/stereo.yaml"), InputError);
  const std::string whole = stereo_calibration_text(microscope());
  EXPECT_THROW((void)read_stereo_calibration(written(whole.substr(0, whole.size() / 2))),
               InputError);
}

TEST(CalibrationAtZoom, IsTheRecordWhereItWasCalibrated) {
  const StereoCalibration calibration = microscope();
  for (const double zoom : {1.1, 1.3, 1.5})
    expect_near(calibration_at_zoom(calibration, zoom), at(zoom), 1e-15);
}

TEST(CalibrationAtZoom, IsExactBetweenWhereTheOpticsAreQuadratic) {
  const StereoCalibration calibration = microscope();
  for (const double zoom : {1.12, 1.25, 1.333, 1.48}) {
    const ZoomCalibration z = calibration_at_zoom(calibration, zoom);
    expect_near(z, at(zoom), 1e-8);
    EXPECT_EQ(z.zoom, zoom);
    EXPECT_NEAR(z.focus_mm, 200, 1e-9);
  }
}

TEST(CalibrationAtZoom, IsContinuousAcrossARecord) {
  StereoCalibration calibration = microscope();
  calibration.zooms[2].T[2] += 0.3;  // not smooth
  for (const double zoom : {1.2, 1.3, 1.4})
    expect_near(calibration_at_zoom(calibration, zoom - 2e-6),
                calibration_at_zoom(calibration, zoom + 2e-6), 0.05);
}

TEST(CalibrationAtZoom, CoversItsOwnErrorWhereTheOpticsAreNotSmooth) {
  StereoCalibration calibration = microscope();
  calibration.zooms[2].T[2] += 0.3;  // between 1.2 and 1.4 nobody can know where T goes
  const Eigen::Index tz = 2 * (4 + 5) + 5;
  const auto smooth = calibration_at_zoom(microscope(), 1.25).parameter_covariance;
  const auto rough = calibration_at_zoom(calibration, 1.25).parameter_covariance;
  EXPECT_GE(smooth(tz, tz), 1e-4);
  EXPECT_GT(std::sqrt(rough(tz, tz)), 0.05);
  EXPECT_GE(Eigen::SelfAdjointEigenSolver<Eigen::MatrixXd>(rough).eigenvalues().minCoeff(), -1e-9);
}

TEST(CalibrationAtZoom, WhatIsUnknownTogetherStaysTogether) {
  // A principal point that shifts while its camera turns: known at no zoom, and seen at none.
  StereoCalibration calibration = microscope();
  const auto unseen = [](const ZoomCalibration& z) {
    Eigen::VectorXd direction = Eigen::VectorXd::Zero(24);
    direction[9 + 2] = 20;  // cx of the right camera, px; R about y
    direction[19] = -20 / z.camera_matrix_right(0, 0);
    return direction;
  };
  for (ZoomCalibration& z : calibration.zooms)
    z.parameter_covariance = unseen(z) * unseen(z).transpose();
  const ZoomCalibration z = calibration_at_zoom(calibration, 1.25);
  Eigen::VectorXd seen = Eigen::VectorXd::Zero(24);  // cx + f * turn: what an image shows, px
  seen[9 + 2] = 1;
  seen[19] = z.camera_matrix_right(0, 0);
  EXPECT_GT(z.parameter_covariance(11, 11), 20 * 20);
  EXPECT_LT(std::sqrt(seen.dot(z.parameter_covariance * seen)), 0.05);
}

TEST(CalibrationAtZoom, RefusesOutsideTheCalibratedRangeUnlessTold) {
  const StereoCalibration calibration = microscope();
  for (const double zoom : {1.0, 1.6, std::nan("")})
    EXPECT_THROW((void)calibration_at_zoom(calibration, zoom), InputError);
  const ZoomCalibration z = calibration_at_zoom(calibration, 1.6, true);
  EXPECT_NEAR(z.camera_matrix_left(0, 0), 3500 * 1.6, 1);
  const Eigen::Index cy = 3;
  EXPECT_GT(z.parameter_covariance(cy, cy), 2e-4);
}

TEST(CalibrationAtZoom, ASingleRecordServesItsOwnZoomOnly) {
  const StereoCalibration calibration{2456, 2054, {at(1.2)}};
  EXPECT_EQ(calibration_at_zoom(calibration, 1.2).zoom, 1.2);
  EXPECT_THROW((void)calibration_at_zoom(calibration, 1.21, true), InputError);
}

TEST(CalibrationAtZoom, JoinsRecordsOfDifferentDistortionLength) {
  const StereoCalibration calibration{2456, 2054, {at(1.1, 5), at(1.2, 8), at(1.3, 5)}};
  const ZoomCalibration z = calibration_at_zoom(calibration, 1.15);
  EXPECT_EQ(z.distortion_left.total(), 8U);
  EXPECT_EQ(z.parameter_covariance.rows(), 30);
  expect_near(z, at(1.15, 8), 1e-8);
}

TEST(ParameterVector, ComesBack) {
  const ZoomCalibration z = at(1.3, 12);
  EXPECT_EQ(parameter_vector(z).size(), 38);
  expect_near(with_parameters(at(1.1, 12), parameter_vector(z)), z, 1e-12);
}

}  // namespace
}  // namespace holdfast::registration
