// SPDX-License-Identifier: Apache-2.0
#include "perception/camera_model.hpp"

#include <cmath>
#include <sstream>

#include <opencv2/calib3d.hpp>

namespace holdfast::perception {
namespace {

cv::Matx33d matrix(const CameraModel& camera) {
  return {camera.fx_px, 0, camera.cx_px, 0, camera.fy_px, camera.cy_px, 0, 0, 1};
}

std::string line(const char* what, double value, const std::string& limit) {
  std::ostringstream out;
  out << what << " is " << value << ", must be " << limit;
  return out.str();
}

std::optional<std::string> invalid_distortion(const CameraModel& camera) {
  const auto& d = camera.distortion;
  const auto n = static_cast<int>(d.total());
  if (n != 0 && n != 4 && n != 5 && n != 8 && n != 12 && n != 14)
    return line("the number of distortion coefficients", n, "0, 4, 5, 8, 12 or 14");
  if (n != 0 && (d.type() != CV_64FC1 || (d.rows != 1 && d.cols != 1) || !d.isContinuous()))
    return std::string("distortion must be one row or column of doubles");
  for (int i = 0; i < n; ++i)
    if (!(std::abs(d.at<double>(i)) < 1e6))
      return line("a distortion coefficient", d.at<double>(i), "a number below 1e6");
  return std::nullopt;
}

/// Undoing the distortion is iterative: it must lead back to every pixel of the border.
std::optional<std::string> not_invertible(const CameraModel& camera) {
  constexpr double kToleratedPx = 0.01;
  constexpr int kSteps = 16;
  std::vector<cv::Point2d> border;
  const double right = camera.width_px - 1.0, bottom = camera.height_px - 1.0;
  for (int i = 0; i <= kSteps; ++i) {
    const double x = right * i / kSteps, y = bottom * i / kSteps;
    border.insert(border.end(), {{x, 0}, {x, bottom}, {0, y}, {right, y}});
  }
  const auto back = to_pixels(camera, to_normalised(camera, border));
  for (std::size_t i = 0; i < border.size(); ++i) {
    const double error_px = cv::norm(back[i] - border[i]);
    if (!(error_px < kToleratedPx))
      return line("the error of undoing the distortion at the image border", error_px,
                  "below 0.01 px");
  }
  return std::nullopt;
}

}  // namespace

bool CameraModel::is_distorted() const {
  for (std::size_t i = 0; i < distortion.total(); ++i)
    if (distortion.at<double>(static_cast<int>(i)) != 0) return true;
  return false;
}

std::optional<std::string> invalid_camera(const CameraModel& camera) {
  const int w = camera.width_px, h = camera.height_px;
  if (w < 16 || w > 32768) return line("image_width", w, "16 to 32768 px");
  if (h < 16 || h > 32768) return line("image_height", h, "16 to 32768 px");
  for (const double f : {camera.fx_px, camera.fy_px})
    if (!(f >= 0.1 * w && f <= 1e4 * w))
      return line("the focal length", f, "0.1 to 1e4 image widths, in px");
  if (!(std::abs(camera.fx_px / camera.fy_px - 1) < 0.5))
    return line("fx/fy", camera.fx_px / camera.fy_px, "0.5 to 1.5");
  if (!(camera.cx_px > -w && camera.cx_px < 2.0 * w))
    return line("cx", camera.cx_px, "within one image width of the image, in px");
  if (!(camera.cy_px > -h && camera.cy_px < 2.0 * h))
    return line("cy", camera.cy_px, "within one image height of the image, in px");
  if (auto what = invalid_distortion(camera)) return what;
  return camera.is_distorted() ? not_invertible(camera) : std::nullopt;
}

std::vector<cv::Point2d> to_normalised(const CameraModel& camera,
                                       const std::vector<cv::Point2d>& pixels) {
  std::vector<cv::Point2d> normalised(pixels.size());
  if (pixels.empty()) return normalised;
  if (camera.is_distorted()) {
    const cv::TermCriteria until(cv::TermCriteria::COUNT | cv::TermCriteria::EPS, 40, 1e-6);
    cv::undistortPoints(pixels, normalised, matrix(camera), camera.distortion, cv::noArray(),
                        cv::noArray(), until);
    return normalised;
  }
  for (std::size_t i = 0; i < pixels.size(); ++i)
    normalised[i] = {(pixels[i].x - camera.cx_px) / camera.fx_px,
                     (pixels[i].y - camera.cy_px) / camera.fy_px};
  return normalised;
}

std::vector<cv::Point2d> to_pixels(const CameraModel& camera,
                                   const std::vector<cv::Point2d>& normalised) {
  std::vector<cv::Point2d> pixels(normalised.size());
  if (normalised.empty()) return pixels;
  if (camera.is_distorted()) {
    std::vector<cv::Point3d> rays(normalised.size());
    for (std::size_t i = 0; i < rays.size(); ++i) rays[i] = {normalised[i].x, normalised[i].y, 1};
    cv::projectPoints(rays, cv::Vec3d(), cv::Vec3d(), matrix(camera), camera.distortion, pixels);
    return pixels;
  }
  for (std::size_t i = 0; i < pixels.size(); ++i)
    pixels[i] = {normalised[i].x * camera.fx_px + camera.cx_px,
                 normalised[i].y * camera.fy_px + camera.cy_px};
  return pixels;
}

}  // namespace holdfast::perception
