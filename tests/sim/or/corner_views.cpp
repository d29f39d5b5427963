// SPDX-License-Identifier: Apache-2.0
#include "tests/sim/or/corner_views.hpp"

#include <random>

#include <fmt/format.h>

#include "tests/sim/or/board.hpp"
#include "tests/sim/or/optics.hpp"

namespace holdfast::sim {
namespace {

registration::BoardPair seen_pair(const Board& board, const Eigen::Isometry3d& T_head_board,
                                  const StereoOptics& optics, std::mt19937& random,
                                  double noise_px) {
  registration::BoardPair pair;
  std::normal_distribution<double> noise(0, noise_px);
  const auto see = [&](const OpticalChannel& channel, const Eigen::Isometry3d& T_head_camera) {
    std::vector<cv::Point2d> pixels;
    for (const Eigen::Vector3d& corner : board.corners()) {
      const Eigen::Vector2d p = channel.project(T_head_camera.inverse() * T_head_board * corner);
      const double dx = noise(random), dy = noise(random);
      pixels.emplace_back(p.x() + dx, p.y() + dy);
    }
    return pixels;
  };
  pair.left = see(optics.left, optics.T_head_left);
  pair.right = see(optics.right, optics.T_head_right);
  return pair;
}

}  // namespace

std::vector<registration::ZoomViews> corner_views(const RoomConfig& config, double noise_px) {
  const Microscope microscope(config.optics);
  std::mt19937 random(config.seed);
  std::vector<registration::ZoomViews> views;
  for (const double zoom : config.calibration_zooms) {
    const StereoOptics optics = microscope.at(zoom, board_visit(0, views.size()));
    registration::ZoomViews& of_zoom = views.emplace_back();
    of_zoom.zoom = zoom;
    for (const Eigen::Isometry3d& pose : board_poses(config.board, optics, config.board_poses)) {
      of_zoom.pairs.push_back(seen_pair(config.board, pose, optics, random, noise_px));
      of_zoom.pairs.back().name = fmt::format("zoom {} view {}", zoom, of_zoom.pairs.size() - 1);
    }
  }
  return views;
}

registration::CalibrationOutcome calibrated_by_corners(const RoomConfig& config, double noise_px,
                                                       registration::CalibrationOptions options) {
  options.board = {config.board.corners_x, config.board.corners_y, config.board.square_mm};
  return registration::calibrate_stereo(corner_views(config, noise_px), kSensorWidthPx,
                                        kSensorHeightPx, options, nullptr);
}

}  // namespace holdfast::sim
