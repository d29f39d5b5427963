// SPDX-License-Identifier: Apache-2.0
// Part of stereo_bundle: the bent board and where both cameras see its corners.
#pragma once

#include <vector>

#include <Eigen/Core>
#include <ceres/problem.h>

#include "registration/bundle_unknowns.hpp"
#include "registration/calibration_views.hpp"

namespace holdfast::registration::bundle {

/// A corner's place on the flat board: mm, and the same in -1..1 over the board.
struct Place {
  double x_mm, y_mm, u, v;
};

struct Corner {
  Place place;
  double left_px[2], right_px[2];
};

/// One pair of images.
struct Sighting {
  std::size_t zoom = 0;  ///< index
  const BoardPair* pair = nullptr;
  std::vector<Corner> corners;
};

/// Zoom by zoom, as Unknowns::poses. Points into `views`.
[[nodiscard]] std::vector<Sighting> sightings_of(const std::vector<ZoomViews>& views,
                                                 const BoardPattern& board);

/// Two residuals a corner, in units of `sigma_px`, under Huber's loss from `outlier_sigma` on.
void add_corners(ceres::Problem& problem, Unknowns& unknowns,
                 const std::vector<Sighting>& sightings, double sigma_px, double outlier_sigma);

/// Noise of one coordinate: Huber-weighted residual of the corners, per degree of freedom.
[[nodiscard]] double estimated_sigma_px(const Unknowns& unknowns,
                                        const std::vector<Sighting>& sightings, double huber_px);

/// The corners' places on the bent board, mm.
[[nodiscard]] std::vector<Eigen::Vector3d> bent_board_mm(const BoardPattern& board,
                                                         const Bend& bend);

}  // namespace holdfast::registration::bundle
