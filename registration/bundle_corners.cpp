// SPDX-License-Identifier: Apache-2.0
#include "registration/bundle_corners.hpp"

#include <algorithm>
#include <cmath>

#include <ceres/autodiff_cost_function.h>
#include <ceres/loss_function.h>
#include <ceres/rotation.h>

namespace holdfast::registration::bundle {
namespace {

constexpr double kNearestMm = 1e-3;  // of a corner before a camera

/// OpenCV's projection (calib3d, "Detailed Description").
template <typename T>
void project(const T* camera, const T* p, T* pixel) {
  const T x = p[0] / p[2], y = p[1] / p[2], r2 = x * x + y * y;
  const T radial = 1.0 + r2 * (camera[4] + r2 * (camera[5] + r2 * camera[8]));
  const T& p1 = camera[6];
  const T& p2 = camera[7];
  const T xd =
      x * radial + 2.0 * p1 * x * y + p2 * (r2 + 2.0 * x * x) + r2 * (camera[9] + camera[10] * r2);
  const T yd =
      y * radial + p1 * (r2 + 2.0 * y * y) + 2.0 * p2 * x * y + r2 * (camera[11] + camera[12] * r2);
  pixel[0] = exp(camera[0]) * xd + camera[2];
  pixel[1] = exp(camera[1]) * yd + camera[3];
}

template <typename T>
void to_left_camera(const Place& place, const T* pose, const T* bend, T* p) {
  const T on_board[3] = {T(place.x_mm), T(place.y_mm),
                         bend[0] * (place.u * place.u) + bend[1] * (place.u * place.v) +
                             bend[2] * (place.v * place.v)};
  ceres::AngleAxisRotatePoint(pose, on_board, p);
  for (int i = 0; i < 3; ++i) p[i] += pose[3 + i];
}

struct LeftResidual {
  Corner corner;
  double sigma_px;
  template <typename T>
  bool operator()(const T* camera, const T* pose, const T* bend, T* residual) const {
    T p[3], pixel[2];
    to_left_camera(corner.place, pose, bend, p);
    if (p[2] < kNearestMm) return false;
    project(camera, p, pixel);
    for (int i = 0; i < 2; ++i) residual[i] = (pixel[i] - corner.left_px[i]) / sigma_px;
    return true;
  }
};

struct RightResidual {
  Corner corner;
  double sigma_px;
  template <typename T>
  bool operator()(const T* camera, const T* extrinsics, const T* pose, const T* bend,
                  T* residual) const {
    T p[3], q[3], pixel[2];
    to_left_camera(corner.place, pose, bend, p);
    ceres::AngleAxisRotatePoint(extrinsics, p, q);
    for (int i = 0; i < 3; ++i) q[i] += extrinsics[3 + i];
    if (q[2] < kNearestMm) return false;
    project(camera, q, pixel);
    for (int i = 0; i < 2; ++i) residual[i] = (pixel[i] - corner.right_px[i]) / sigma_px;
    return true;
  }
};

std::vector<Place> places_of(const BoardPattern& board) {
  const double half_x = 0.5 * (board.columns - 1) * board.square_mm;
  const double half_y = 0.5 * (board.rows - 1) * board.square_mm;
  std::vector<Place> places;
  for (const Eigen::Vector3d& p : board.points_mm())
    places.push_back({p.x(), p.y(), p.x() / half_x, p.y() / half_y});
  return places;
}

}  // namespace

std::vector<Sighting> sightings_of(const std::vector<ZoomViews>& views, const BoardPattern& board) {
  const std::vector<Place> places = places_of(board);
  std::vector<Sighting> sightings;
  for (std::size_t z = 0; z < views.size(); ++z)
    for (const BoardPair& pair : views[z].pairs) {
      Sighting& sighting = sightings.emplace_back(Sighting{z, &pair, {}});
      for (std::size_t i = 0; i < places.size(); ++i)
        sighting.corners.push_back(
            {places[i], {pair.left[i].x, pair.left[i].y}, {pair.right[i].x, pair.right[i].y}});
    }
  return sightings;
}

void add_corners(ceres::Problem& problem, Unknowns& unknowns,
                 const std::vector<Sighting>& sightings, double sigma_px, double outlier_sigma) {
  for (std::size_t v = 0; v < sightings.size(); ++v) {
    ZoomUnknowns& zoom = unknowns.zooms[sightings[v].zoom];
    double* pose = unknowns.poses[v].data();
    for (const Corner& corner : sightings[v].corners) {
      problem.AddResidualBlock(
          new ceres::AutoDiffCostFunction<LeftResidual, 2, kIntrinsics, kPose, kBend>(
              new LeftResidual{corner, sigma_px}),
          new ceres::HuberLoss(outlier_sigma), zoom.left.data(), pose, unknowns.bend.data());
      problem.AddResidualBlock(
          new ceres::AutoDiffCostFunction<RightResidual, 2, kIntrinsics, kExtrinsics, kPose, kBend>(
              new RightResidual{corner, sigma_px}),
          new ceres::HuberLoss(outlier_sigma), zoom.right.data(), zoom.extrinsics.data(), pose,
          unknowns.bend.data());
    }
  }
}

double estimated_sigma_px(const Unknowns& unknowns, const std::vector<Sighting>& sightings,
                          double huber_px) {
  double sum = 0, count = 0;
  for (std::size_t v = 0; v < sightings.size(); ++v) {
    const ZoomUnknowns& zoom = unknowns.zooms[sightings[v].zoom];
    const double *pose = unknowns.poses[v].data(), *bend = unknowns.bend.data();
    for (const Corner& corner : sightings[v].corners) {
      double left[2] = {}, right[2] = {};
      LeftResidual{corner, 1}(zoom.left.data(), pose, bend, left);
      RightResidual{corner, 1}(zoom.right.data(), zoom.extrinsics.data(), pose, bend, right);
      for (const double* r : {left, right}) {
        const double norm = std::hypot(r[0], r[1]);
        sum += norm <= huber_px ? norm * norm : norm * huber_px;
        count += 2;
      }
    }
  }
  const double sought = static_cast<double>(unknowns.poses.size() * kPose) +
                        static_cast<double>(unknowns.zooms.size() * kOfZoom);
  return std::max(std::sqrt(sum / std::max(count - sought, 1.0)), 1e-4);
}

std::vector<Eigen::Vector3d> bent_board_mm(const BoardPattern& board, const Bend& bend) {
  std::vector<Eigen::Vector3d> points;
  for (const Place& p : places_of(board))
    points.emplace_back(p.x_mm, p.y_mm,
                        bend[0] * p.u * p.u + bend[1] * p.u * p.v + bend[2] * p.v * p.v);
  return points;
}

}  // namespace holdfast::registration::bundle
