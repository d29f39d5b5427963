// SPDX-License-Identifier: Apache-2.0
#include "registration/calibration_start.hpp"

#include <algorithm>

#include <opencv2/calib3d.hpp>

namespace holdfast::registration {
namespace {

std::vector<cv::Point3d> object_points(const BoardPattern& board) {
  std::vector<cv::Point3d> points;
  for (const auto& p : board.points_mm()) points.emplace_back(p.x(), p.y(), p.z());
  return points;
}

std::vector<cv::Point2f> single(const std::vector<cv::Point2d>& corners) {
  return {corners.begin(), corners.end()};
}

struct Observations {
  std::vector<std::vector<cv::Point3f>> object;
  std::vector<std::vector<cv::Point2f>> left, right;
};

Observations observations(const ZoomViews& views, const BoardPattern& board) {
  const auto points = object_points(board);
  Observations all;
  for (const BoardPair& pair : views.pairs) {
    all.object.emplace_back(points.begin(), points.end());
    all.left.push_back(single(pair.left));
    all.right.push_back(single(pair.right));
  }
  return all;
}

struct RelativePose {
  cv::Vec3d rotation, T;
};

RelativePose relative_pose(const BoardPair& pair, const BoardPattern& board,
                           const ZoomCalibration& zoom) {
  const auto points = object_points(board);
  cv::Vec3d r_left, t_left, r_right, t_right;
  cv::solvePnP(points, pair.left, zoom.camera_matrix_left, zoom.distortion_left, r_left, t_left);
  cv::solvePnP(points, pair.right, zoom.camera_matrix_right, zoom.distortion_right, r_right,
               t_right);
  cv::Matx33d R_left, R_right;
  cv::Rodrigues(r_left, R_left);
  cv::Rodrigues(r_right, R_right);
  RelativePose relative;
  const cv::Matx33d R = R_right * R_left.t();
  cv::Rodrigues(R, relative.rotation);
  relative.T = t_right - R * t_left;
  return relative;
}

double median(std::vector<double> values) {
  const auto middle = values.begin() + static_cast<std::ptrdiff_t>(values.size() / 2);
  std::nth_element(values.begin(), middle, values.end());
  return *middle;
}

}  // namespace

cv::Vec3d right_camera_mm(const BoardPair& pair, const BoardPattern& board,
                          const ZoomCalibration& zoom) {
  const RelativePose relative = relative_pose(pair, board, zoom);
  cv::Matx33d R;
  cv::Rodrigues(relative.rotation, R);
  return -(R.t() * relative.T);
}

ZoomCalibration start_of_zoom(const ZoomViews& views, const BoardPattern& board, int image_width_px,
                              int image_height_px) {
  const cv::Size size(image_width_px, image_height_px);
  const Observations all = observations(views, board);
  const int flags = cv::CALIB_FIX_ASPECT_RATIO | cv::CALIB_FIX_PRINCIPAL_POINT |
                    cv::CALIB_ZERO_TANGENT_DIST | cv::CALIB_FIX_K2 | cv::CALIB_FIX_K3;
  ZoomCalibration zoom;
  zoom.zoom = views.zoom;
  for (const bool is_left : {true, false}) {
    // The aspect ratio is held at that of the matrix given, whatever else is in it.
    cv::Mat K = cv::Mat::eye(3, 3, CV_64F), distortion;
    std::vector<cv::Mat> rotations, translations;
    cv::calibrateCamera(
        all.object, is_left ? all.left : all.right, size, K, distortion, rotations, translations,
        flags, cv::TermCriteria(cv::TermCriteria::COUNT | cv::TermCriteria::EPS, 50, 1e-9));
    (is_left ? zoom.camera_matrix_left : zoom.camera_matrix_right) = cv::Matx33d(K);
    (is_left ? zoom.distortion_left : zoom.distortion_right) = distortion.reshape(1, 1).clone();
  }
  std::vector<RelativePose> poses;
  for (const BoardPair& pair : views.pairs) poses.push_back(relative_pose(pair, board, zoom));
  cv::Vec3d rotation;
  for (int i = 0; i < 3; ++i) {
    std::vector<double> r, t;
    for (const RelativePose& pose : poses) {
      r.push_back(pose.rotation[i]);
      t.push_back(pose.T[i]);
    }
    rotation[i] = median(r);
    zoom.T[i] = median(t);
  }
  cv::Rodrigues(rotation, zoom.R);
  zoom.pairs_used = static_cast<int>(views.pairs.size());
  return zoom;
}

ZoomCalibration plain_calibration(const ZoomViews& views, const BoardPattern& board,
                                  int image_width_px, int image_height_px) {
  const cv::Size size(image_width_px, image_height_px);
  const Observations all = observations(views, board);
  cv::Mat K[2], distortion[2];
  std::vector<cv::Mat> rotations, translations;
  for (const int side : {0, 1})
    cv::calibrateCamera(all.object, side == 0 ? all.left : all.right, size, K[side],
                        distortion[side], rotations, translations);
  cv::Mat R, T, E, F;
  ZoomCalibration zoom;
  zoom.rms_px = cv::stereoCalibrate(all.object, all.left, all.right, K[0], distortion[0], K[1],
                                    distortion[1], size, R, T, E, F, cv::CALIB_FIX_INTRINSIC);
  zoom.zoom = views.zoom;
  zoom.camera_matrix_left = cv::Matx33d(K[0]);
  zoom.camera_matrix_right = cv::Matx33d(K[1]);
  zoom.distortion_left = distortion[0].reshape(1, 1).clone();
  zoom.distortion_right = distortion[1].reshape(1, 1).clone();
  zoom.R = cv::Matx33d(R);
  zoom.T = cv::Vec3d(T.reshape(1, 3));
  zoom.pairs_used = static_cast<int>(views.pairs.size());
  return zoom;
}

}  // namespace holdfast::registration
