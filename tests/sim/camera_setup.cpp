// SPDX-License-Identifier: Apache-2.0
#include "tests/sim/camera_setup.hpp"

#include <system_error>

#include <fmt/core.h>
#include <opencv2/imgcodecs.hpp>

#include "rt/core/error.hpp"

namespace holdfast::sim {
namespace {

cv::Mat keyframe(Scene& scene, bridge::PixelFormat format) {
  const bool is_grey =
      format == bridge::PixelFormat::mono8 || format == bridge::PixelFormat::mono12;
  const cv::Size size(scene.parameters().width_px, scene.parameters().height_px);
  cv::Mat image(size, is_grey ? CV_8UC1 : CV_8UC3);
  scene.render({}, {}, is_grey ? bridge::PixelFormat::mono8 : bridge::PixelFormat::bgr8,
               cv::Rect({0, 0}, size), image.data);
  return image;
}

// Written beside its name, with the same ending, and moved there.
void write_image(const std::filesystem::path& path, const cv::Mat& image) {
  const auto partial = path.parent_path() / ("." + path.filename().string());
  std::error_code error;
  bool is_written = false;
  try {
    is_written = cv::imwrite(partial.string(), image);
  } catch (const cv::Exception&) {
    is_written = false;
  }
  if (is_written) std::filesystem::rename(partial, path, error);
  if (!is_written || error) throw InputError(fmt::format("{}: cannot be written", path.string()));
}

void write_camera(const std::filesystem::path& path, const Scene& scene) {
  const auto partial = path.parent_path() / ("." + path.filename().string());
  cv::FileStorage file(partial.string(), cv::FileStorage::WRITE);
  if (!file.isOpened()) throw InputError(fmt::format("{}: cannot be written", path.string()));
  const Eigen::Vector2d centre = scene.principal_point_px();
  const cv::Mat matrix = (cv::Mat_<double>(3, 3) << scene.focal_px(), 0, centre.x(), 0,
                          scene.focal_px(), centre.y(), 0, 0, 1);
  file << "image_width" << scene.parameters().width_px;
  file << "image_height" << scene.parameters().height_px;
  file << "camera_matrix" << matrix;
  file << "distortion_coefficients" << cv::Mat::zeros(5, 1, CV_64F);
  file.release();
  std::error_code error;
  std::filesystem::rename(partial, path, error);
  if (error) throw InputError(fmt::format("{}: cannot be written", path.string()));
}

}  // namespace

void write_setup(Scene& scene, bridge::PixelFormat format, const std::filesystem::path& directory) {
  std::error_code error;
  std::filesystem::create_directories(directory, error);
  if (error)
    throw InputError(fmt::format("{}: cannot be made: {}", directory.string(), error.message()));
  const cv::Mat depth(scene.parameters().height_px, scene.parameters().width_px, CV_32F,
                      cv::Scalar(scene.parameters().depth_mm));
  write_image(directory / "keyframe.png", keyframe(scene, format));
  write_image(directory / "depth.tiff", depth);
  write_camera(directory / "camera.yaml", scene);
}

}  // namespace holdfast::sim
