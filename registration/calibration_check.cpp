// SPDX-License-Identifier: Apache-2.0
#include "registration/calibration_check.hpp"

#include <cmath>
#include <vector>

#include <Eigen/Eigenvalues>
#include <fmt/format.h>
#include <opencv2/calib3d.hpp>

namespace holdfast::registration {
namespace {

using Verdict = std::optional<std::string>;

Verdict line(const std::string& key, double value, const std::string& limit) {
  return fmt::format("{} is {:g}, must be {}", key, value, limit);
}

Verdict invalid_matrix(const cv::Matx33d& K, int width_px, int height_px, const std::string& side) {
  const std::string key = "camera_matrix_" + side;
  for (const auto& [r, c, value] :
       {std::tuple{0, 1, 0.0}, {1, 0, 0.0}, {2, 0, 0.0}, {2, 1, 0.0}, {2, 2, 1.0}})
    if (!(std::abs(K(r, c) - value) < 1e-9))
      return line(fmt::format("{}[{}][{}]", key, r, c), K(r, c), fmt::format("{:g}", value));
  for (const double f : {K(0, 0), K(1, 1)})
    if (!(f >= 0.1 * width_px && f <= 1e4 * width_px))
      return line("the focal length in " + key, f, "0.1 to 1e4 image widths, in px");
  if (!(std::abs(K(0, 0) / K(1, 1) - 1) < 0.5))
    return line("fx/fy in " + key, K(0, 0) / K(1, 1), "0.5 to 1.5");
  if (!(K(0, 2) > -width_px && K(0, 2) < 2.0 * width_px))
    return line("cx in " + key, K(0, 2), "within one image width of the image, in px");
  if (!(K(1, 2) > -height_px && K(1, 2) < 2.0 * height_px))
    return line("cy in " + key, K(1, 2), "within one image height of the image, in px");
  return std::nullopt;
}

/// Undoing the distortion is iterative: it must lead back to every pixel.
Verdict invalid_distortion(const cv::Matx33d& K, const cv::Mat& distortion, int width_px,
                           int height_px, const std::string& side) {
  const std::string key = "distortion_" + side;
  const std::size_t n = distortion.total();
  if (n != 4 && n != 5 && n != 8 && n != 12 && n != 14)
    return line("the number of coefficients in " + key, static_cast<double>(n),
                "4, 5, 8, 12 or 14");
  for (int i = 0; i < static_cast<int>(n); ++i)
    if (!(std::abs(distortion.at<double>(i)) < 1e6))
      return line(fmt::format("{}[{}]", key, i), distortion.at<double>(i), "a number below 1e6");
  constexpr int kSteps = 16;
  constexpr double kToleratedPx = 0.01;
  std::vector<cv::Point2d> pixels, rays, back;
  for (int i = 0; i <= kSteps; ++i)
    for (int j = 0; j <= kSteps; ++j)
      pixels.emplace_back((width_px - 1.0) * i / kSteps, (height_px - 1.0) * j / kSteps);
  const cv::TermCriteria until(cv::TermCriteria::COUNT | cv::TermCriteria::EPS, 40, 1e-9);
  cv::undistortPoints(pixels, rays, K, distortion, cv::noArray(), cv::noArray(), until);
  std::vector<cv::Point3d> points;
  for (const cv::Point2d& ray : rays) points.emplace_back(ray.x, ray.y, 1);
  cv::projectPoints(points, cv::Vec3d(), cv::Vec3d(), K, distortion, back);
  for (std::size_t i = 0; i < pixels.size(); ++i)
    if (const double error_px = cv::norm(back[i] - pixels[i]); !(error_px < kToleratedPx))
      return line("the error of undoing " + key + " within the image", error_px, "below 0.01 px");
  return std::nullopt;
}

Verdict invalid_covariance(const Eigen::MatrixXd& covariance, Eigen::Index size) {
  if (covariance.size() == 0) return std::nullopt;
  if (covariance.rows() != size || covariance.cols() != size)
    return fmt::format("parameter_covariance is {}x{}, must be {}x{}", covariance.rows(),
                       covariance.cols(), size, size);
  if (!covariance.allFinite())
    return std::string("parameter_covariance holds a value that is not finite");
  if (!(covariance.diagonal().minCoeff() >= 0))
    return line("a variance in parameter_covariance", covariance.diagonal().minCoeff(),
                "0 or more");
  // Pixels and radians differ by 10^10: judged as correlations.
  const Eigen::VectorXd scale = covariance.diagonal().unaryExpr(
      [](double variance) { return variance > 0 ? 1 / std::sqrt(variance) : 1.0; });
  const Eigen::MatrixXd correlation = scale.asDiagonal() * covariance * scale.asDiagonal();
  if (!((correlation - correlation.transpose()).cwiseAbs().maxCoeff() < 1e-6))
    return std::string("parameter_covariance is not symmetric");
  const double least =
      Eigen::SelfAdjointEigenSolver<Eigen::MatrixXd>(correlation, Eigen::EigenvaluesOnly)
          .eigenvalues()
          .minCoeff();
  if (!(least > -1e-6))
    return line("the least eigenvalue of parameter_covariance, as correlations,", least,
                "0 or more");
  return std::nullopt;
}

}  // namespace

Verdict invalid_zoom(const ZoomCalibration& zoom, int image_width_px, int image_height_px) {
  if (!(zoom.zoom > 0 && zoom.zoom < 1e3)) return line("zoom", zoom.zoom, "above 0, below 1000");
  if (!(zoom.focus_mm > 0 && zoom.focus_mm < 1e5))
    return line("focus_mm", zoom.focus_mm, "above 0, below 1e5 mm");
  for (const bool is_left : {true, false}) {
    const cv::Matx33d& K = is_left ? zoom.camera_matrix_left : zoom.camera_matrix_right;
    const cv::Mat& distortion = is_left ? zoom.distortion_left : zoom.distortion_right;
    const std::string side = is_left ? "left" : "right";
    if (auto what = invalid_matrix(K, image_width_px, image_height_px, side)) return what;
    if (auto what = invalid_distortion(K, distortion, image_width_px, image_height_px, side))
      return what;
  }
  const std::size_t n = zoom.distortion_left.total();
  if (n != zoom.distortion_right.total())
    return fmt::format("distortion_right has {} coefficients, must have {} as the left",
                       zoom.distortion_right.total(), n);
  if (!(cv::norm(zoom.R * zoom.R.t() - cv::Matx33d::eye()) < 1e-5 && cv::determinant(zoom.R) > 0))
    return std::string("R is no rotation");
  if (!(cv::norm(zoom.T) > 1e-3 && cv::norm(zoom.T) < 1e4))
    return line("the length of T", cv::norm(zoom.T), "0.001 to 10000 mm");
  if (!(zoom.rms_px >= 0 && zoom.rms_px < 1e3)) return line("rms_px", zoom.rms_px, "0 to 1000 px");
  if (zoom.pairs_used < 0) return line("pairs_used", zoom.pairs_used, "0 or more");
  return invalid_covariance(zoom.parameter_covariance, 2 * (4 + static_cast<Eigen::Index>(n)) + 6);
}

Verdict invalid_calibration(const StereoCalibration& calibration) {
  const int w = calibration.image_width_px, h = calibration.image_height_px;
  if (w < 16 || w > 32768) return line("image_width", w, "16 to 32768 px");
  if (h < 16 || h > 32768) return line("image_height", h, "16 to 32768 px");
  if (calibration.zooms.empty()) return std::string("zooms holds none");
  double last = 0;
  for (std::size_t k = 0; k < calibration.zooms.size(); ++k) {
    const ZoomCalibration& zoom = calibration.zooms[k];
    if (const auto what = invalid_zoom(zoom, w, h)) return fmt::format("zooms[{}]: {}", k, *what);
    if (!(zoom.zoom > last))
      return fmt::format("zooms[{}]: zoom is {:g}, must be above {:g}, the one before", k,
                         zoom.zoom, last);
    last = zoom.zoom;
  }
  return std::nullopt;
}

}  // namespace holdfast::registration
