// SPDX-License-Identifier: Apache-2.0
#include "registration/stereo_calibration.hpp"

#include <filesystem>

#include <fmt/format.h>
#include <opencv2/calib3d.hpp>
#include <opencv2/core/eigen.hpp>

#include "registration/calibration_check.hpp"
#include "registration/opencv_yaml.hpp"
#include "rt/core/error.hpp"

namespace holdfast::registration {
namespace {

constexpr std::uintmax_t kSizeMaxBytes = 16U << 20U;

/// Reads the members of one map; every failure names the file and the member.
class Reader {
 public:
  Reader(const cv::FileNode& node, const std::string& where) : node_(node), where_(where) {}

  [[noreturn]] void fail(const std::string& what) const { throw InputError(where_ + ": " + what); }

  [[nodiscard]] cv::FileNode member(const char* key) const {
    const cv::FileNode value = node_[key];
    if (value.empty()) fail(fmt::format("{} is missing", key));
    return value;
  }
  [[nodiscard]] bool has(const char* key) const { return !node_[key].empty(); }
  [[nodiscard]] double number(const char* key) const {
    const cv::FileNode value = member(key);
    if (!value.isInt() && !value.isReal()) fail(fmt::format("{} must be a number", key));
    return static_cast<double>(value);
  }
  [[nodiscard]] int integer(const char* key) const {
    const cv::FileNode value = member(key);
    if (!value.isInt()) fail(fmt::format("{} must be a whole number", key));
    return static_cast<int>(value);
  }
  [[nodiscard]] cv::Mat matrix(const char* key) const {
    const cv::FileNode value = member(key);
    cv::Mat stored, doubles;
    // Not beyond: OpenCV takes the memory for what a file claims before it looks for the numbers.
    constexpr int kSideMax = 256;
    const auto is_small = [&value](const char* side) {
      const cv::FileNode length = value[side];
      return length.isInt() && static_cast<int>(length) <= kSideMax;
    };
    if (value.isMap() && is_small("rows") && is_small("cols")) value >> stored;
    if (stored.empty() || stored.channels() != 1 || stored.dims != 2)
      fail(fmt::format("{} must be an OpenCV matrix", key));
    stored.convertTo(doubles, CV_64F);
    return doubles;
  }
  [[nodiscard]] cv::Mat matrix(const char* key, int rows, int cols) const {
    cv::Mat value = matrix(key);
    if (value.rows != rows || value.cols != cols)
      fail(fmt::format("{} is {}x{}, must be {}x{}", key, value.rows, value.cols, rows, cols));
    return value;
  }
  [[nodiscard]] cv::Mat distortion(const char* key) const {
    cv::Mat value = matrix(key);
    if (value.rows != 1 && value.cols != 1)
      fail(fmt::format("{} is {}x{}, must be one row", key, value.rows, value.cols));
    return value.reshape(1, 1).clone();
  }

 private:
  cv::FileNode node_;
  std::string where_;
};

ZoomCalibration read_zoom(const Reader& reader) {
  ZoomCalibration zoom;
  zoom.zoom = reader.number("zoom");
  zoom.focus_mm = reader.number("focus_mm");
  zoom.camera_matrix_left = cv::Matx33d(reader.matrix("camera_matrix_left", 3, 3));
  zoom.camera_matrix_right = cv::Matx33d(reader.matrix("camera_matrix_right", 3, 3));
  zoom.distortion_left = reader.distortion("distortion_left");
  zoom.distortion_right = reader.distortion("distortion_right");
  zoom.R = cv::Matx33d(reader.matrix("R", 3, 3));
  const cv::Mat T = reader.matrix("T").reshape(1, 1);
  if (T.total() != 3) reader.fail(fmt::format("T has {} numbers, must have 3", T.total()));
  zoom.T = {T.at<double>(0), T.at<double>(1), T.at<double>(2)};
  zoom.rms_px = reader.number("rms_px");
  zoom.pairs_used = reader.integer("pairs_used");
  if (reader.has("parameter_covariance"))
    cv::cv2eigen(reader.matrix("parameter_covariance"), zoom.parameter_covariance);
  return zoom;
}

StereoCalibration parse(const cv::FileStorage& storage, const std::string& path) {
  const Reader top(storage.root(), path);
  StereoCalibration calibration;
  calibration.image_width_px = top.integer("image_width");
  calibration.image_height_px = top.integer("image_height");
  const cv::FileNode zooms = top.member("zooms");
  if (!zooms.isSeq()) top.fail("zooms must be a sequence");
  for (std::size_t k = 0; k < zooms.size(); ++k)
    calibration.zooms.push_back(
        read_zoom(Reader(zooms[static_cast<int>(k)], fmt::format("{}: zooms[{}]", path, k))));
  return calibration;
}

cv::Mat row(const cv::Mat& values) {
  return values.reshape(1, 1);
}

}  // namespace

StereoCalibration read_stereo_calibration(const std::string& path) {
  std::error_code error;
  const auto size = std::filesystem::file_size(path, error);
  if (error) throw InputError(path + ": cannot be read: " + error.message());
  if (size > kSizeMaxBytes)
    throw InputError(fmt::format("{}: is {} bytes, must be at most {}", path, size, kSizeMaxBytes));
  StereoCalibration calibration;
  require_one_document(path);
  try {
    const cv::FileStorage storage(path, cv::FileStorage::READ);
    if (!storage.isOpened()) throw InputError(path + ": is not an OpenCV FileStorage file");
    calibration = parse(storage, path);
  } catch (const cv::Exception& e) {
    throw InputError(path + ": is not an OpenCV FileStorage file: " + e.err);
  } catch (const std::length_error&) {  // OpenCV's own, of a broken text
    throw InputError(path + ": is not an OpenCV FileStorage file");
  }
  if (const auto what = invalid_calibration(calibration)) throw InputError(path + ": " + *what);
  return calibration;
}

std::string stereo_calibration_text(const StereoCalibration& calibration) {
  cv::FileStorage out("stereo.yaml", cv::FileStorage::WRITE | cv::FileStorage::MEMORY |
                                         cv::FileStorage::FORMAT_YAML);
  out << "image_width" << calibration.image_width_px;
  out << "image_height" << calibration.image_height_px;
  out << "zooms"
      << "[";
  for (const ZoomCalibration& zoom : calibration.zooms) {
    out << "{"
        << "zoom" << zoom.zoom << "focus_mm" << zoom.focus_mm;
    out << "camera_matrix_left" << cv::Mat(zoom.camera_matrix_left);
    out << "distortion_left" << row(zoom.distortion_left);
    out << "camera_matrix_right" << cv::Mat(zoom.camera_matrix_right);
    out << "distortion_right" << row(zoom.distortion_right);
    out << "R" << cv::Mat(zoom.R) << "T" << cv::Mat(zoom.T);
    out << "rms_px" << zoom.rms_px << "pairs_used" << zoom.pairs_used;
    if (zoom.parameter_covariance.size() > 0) {
      cv::Mat covariance;
      cv::eigen2cv(zoom.parameter_covariance, covariance);
      out << "parameter_covariance" << covariance;
    }
    out << "}";
  }
  out << "]";
  return out.releaseAndGetString();
}

Eigen::VectorXd parameter_vector(const ZoomCalibration& zoom) {
  const int n = static_cast<int>(zoom.distortion_left.total());
  Eigen::VectorXd parameters(2 * (4 + n) + 6);
  Eigen::Index at = 0;
  const auto append = [&](const cv::Matx33d& K, const cv::Mat& distortion) {
    for (const double value : {K(0, 0), K(1, 1), K(0, 2), K(1, 2)}) parameters[at++] = value;
    for (int i = 0; i < n; ++i) parameters[at++] = distortion.at<double>(i);
  };
  append(zoom.camera_matrix_left, zoom.distortion_left);
  append(zoom.camera_matrix_right, zoom.distortion_right);
  cv::Vec3d rotation;
  cv::Rodrigues(zoom.R, rotation);
  for (int i = 0; i < 3; ++i) parameters[at++] = rotation[i];
  for (int i = 0; i < 3; ++i) parameters[at++] = zoom.T[i];
  return parameters;
}

ZoomCalibration with_parameters(const ZoomCalibration& like, const Eigen::VectorXd& parameters) {
  const int n = static_cast<int>(like.distortion_left.total());
  ZoomCalibration zoom = like;
  Eigen::Index at = 0;
  const auto take = [&](cv::Matx33d& K, cv::Mat& distortion) {
    K = cv::Matx33d::eye();
    K(0, 0) = parameters[at++];
    K(1, 1) = parameters[at++];
    K(0, 2) = parameters[at++];
    K(1, 2) = parameters[at++];
    distortion = cv::Mat(1, n, CV_64F);
    for (int i = 0; i < n; ++i) distortion.at<double>(i) = parameters[at++];
  };
  take(zoom.camera_matrix_left, zoom.distortion_left);
  take(zoom.camera_matrix_right, zoom.distortion_right);
  cv::Rodrigues(cv::Vec3d(parameters[at], parameters[at + 1], parameters[at + 2]), zoom.R);
  zoom.T = {parameters[at + 3], parameters[at + 4], parameters[at + 5]};
  return zoom;
}

}  // namespace holdfast::registration
