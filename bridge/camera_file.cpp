// SPDX-License-Identifier: Apache-2.0
#include "bridge/camera_file.hpp"

#include <cmath>
#include <filesystem>
#include <stdexcept>

#include "registration/opencv_yaml.hpp"
#include "rt/core/error.hpp"

namespace holdfast::bridge {
namespace {

constexpr std::uintmax_t kSizeMaxBytes = 4 * 1024 * 1024;

cv::FileNode required(const cv::FileStorage& storage, const std::string& path, const char* key) {
  const cv::FileNode node = storage[key];
  if (node.empty()) throw InputError(path + ": " + key + " is missing");
  return node;
}

int integer(const cv::FileStorage& storage, const std::string& path, const char* key) {
  const cv::FileNode node = required(storage, path, key);
  if (!node.isInt()) throw InputError(path + ": " + key + " must be a whole number");
  return static_cast<int>(node);
}

cv::Mat matrix(const cv::FileStorage& storage, const std::string& path, const char* key) {
  const cv::FileNode node = required(storage, path, key);
  cv::Mat values, doubles;
  // Not beyond: OpenCV takes the memory for what a file claims before it looks for the numbers.
  constexpr int kSideMax = 256;
  const auto is_small = [&node](const char* side) {
    const cv::FileNode length = node[side];
    return length.isInt() && static_cast<int>(length) <= kSideMax;
  };
  if (node.isMap() && is_small("rows") && is_small("cols")) node >> values;
  if (values.empty() || values.channels() != 1)
    throw InputError(path + ": " + key + " must be an OpenCV matrix");
  values.convertTo(doubles, CV_64F);
  return doubles;
}

perception::CameraModel parse(const cv::FileStorage& storage, const std::string& path) {
  perception::CameraModel camera;
  camera.width_px = integer(storage, path, "image_width");
  camera.height_px = integer(storage, path, "image_height");
  const cv::Mat K = matrix(storage, path, "camera_matrix");
  if (K.rows != 3 || K.cols != 3) throw InputError(path + ": camera_matrix must be 3x3");
  for (const auto& [row, column, value] :
       {std::tuple{0, 1, 0.0}, {1, 0, 0.0}, {2, 0, 0.0}, {2, 1, 0.0}, {2, 2, 1.0}})
    if (!(std::abs(K.at<double>(row, column) - value) < 1e-9))
      throw InputError(path + ": camera_matrix[" + std::to_string(row) + "][" +
                       std::to_string(column) + "] is " +
                       std::to_string(K.at<double>(row, column)) + ", must be " +
                       std::to_string(value));
  camera.fx_px = K.at<double>(0, 0);
  camera.fy_px = K.at<double>(1, 1);
  camera.cx_px = K.at<double>(0, 2);
  camera.cy_px = K.at<double>(1, 2);
  camera.distortion = matrix(storage, path, "distortion_coefficients");
  return camera;
}

}  // namespace

perception::CameraModel read_camera_file(const std::string& path) {
  std::error_code error;
  const auto size = std::filesystem::file_size(path, error);
  if (error) throw InputError(path + ": cannot be read: " + error.message());
  if (size > kSizeMaxBytes)
    throw InputError(path + ": is " + std::to_string(size) + " bytes, must be at most " +
                     std::to_string(kSizeMaxBytes));
  perception::CameraModel camera;
  registration::require_one_document(path);
  try {
    const cv::FileStorage storage(path, cv::FileStorage::READ);
    if (!storage.isOpened()) throw InputError(path + ": is not an OpenCV FileStorage file");
    camera = parse(storage, path);
  } catch (const cv::Exception& e) {
    throw InputError(path + ": is not an OpenCV FileStorage file: " + e.err);
  } catch (const std::length_error&) {  // OpenCV's own, of a broken text
    throw InputError(path + ": is not an OpenCV FileStorage file");
  }
  if (const auto what = perception::invalid_camera(camera)) throw InputError(path + ": " + *what);
  return camera;
}

}  // namespace holdfast::bridge
