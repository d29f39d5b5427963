// SPDX-License-Identifier: Apache-2.0
#include "registration/chessboard.hpp"

#include <algorithm>
#include <cmath>

#include <Eigen/Cholesky>
#include <opencv2/calib3d.hpp>
#include <opencv2/imgproc.hpp>

namespace holdfast::registration {
namespace {

constexpr int kCoarseWidthPx = 1000;

/// Two blurred edges crossing: I = mean + gx·x + gy·y + contrast·E(d1)·E(d2), E = tanh(d/width).
/// d1 and d2: distances from lines through the corner. tanh is within 1.5 % of an edge under a
/// Gaussian blur; what is left is symmetrical about the corner and moves it not.
struct Crossing {
  // x, y, angle 1, angle 2, width, mean, contrast, gradient x, gradient y
  Eigen::Matrix<double, 9, 1> p;
};

/// Angles of the two edges from the intensity on a circle: where its sign changes.
bool edge_angles(const cv::Mat& grey, const cv::Point2d& corner, double radius, double& first,
                 double& second, double& contrast) {
  constexpr int kSteps = 72;
  double value[kSteps], mean = 0;
  for (int i = 0; i < kSteps; ++i) {
    const double a = 2 * CV_PI * i / kSteps;
    const auto x = static_cast<int>(std::lround(corner.x + radius * std::cos(a)));
    const auto y = static_cast<int>(std::lround(corner.y + radius * std::sin(a)));
    if (x < 0 || y < 0 || x >= grey.cols || y >= grey.rows) return false;
    value[i] = grey.at<std::uint8_t>(y, x);
    mean += value[i] / kSteps;
  }
  // Point symmetric up to light fall-off: the average of opposite places.
  double half[kSteps / 2];
  for (int i = 0; i < kSteps / 2; ++i) half[i] = 0.5 * (value[i] + value[i + kSteps / 2]) - mean;
  std::vector<double> changes;
  bool first_rises = false;
  for (int i = 0; i < kSteps / 2; ++i) {
    const double a = half[i], b = half[(i + 1) % (kSteps / 2)];
    if ((a > 0) == (b > 0)) continue;
    if (changes.empty()) first_rises = b > 0;
    changes.push_back(2 * CV_PI * (i + a / (a - b)) / kSteps);
  }
  if (changes.size() != 2) return false;
  first = changes[0];
  second = changes[1];
  contrast = 0;
  for (const double h : half) contrast += std::abs(h) / (kSteps / 2.0);
  // Between the two angles: d1 > 0 and d2 < 0, so the product is negative there.
  if (first_rises) contrast = -contrast;
  return std::abs(contrast) > 2;
}

bool fit_crossing(const cv::Mat& grey, int reach, cv::Point2d& corner) {
  Crossing c;
  double angle1 = 0, angle2 = 0, contrast = 0;
  if (!edge_angles(grey, corner, 0.7 * reach, angle1, angle2, contrast)) return false;
  const cv::Point middle(static_cast<int>(std::lround(corner.x)),
                         static_cast<int>(std::lround(corner.y)));
  if (middle.x - reach < 0 || middle.y - reach < 0 || middle.x + reach >= grey.cols ||
      middle.y + reach >= grey.rows)
    return false;
  const double level =
      cv::mean(grey(cv::Rect(middle.x - reach, middle.y - reach, 2 * reach + 1, 2 * reach + 1)))[0];
  c.p << corner.x - middle.x, corner.y - middle.y, angle1, angle2, 2, level, contrast, 0, 0;
  double step = 1;
  for (int iteration = 0; iteration < 20 && step > 1e-3; ++iteration) {
    Eigen::Matrix<double, 9, 9> normal = Eigen::Matrix<double, 9, 9>::Zero();
    Eigen::Matrix<double, 9, 1> gradient = Eigen::Matrix<double, 9, 1>::Zero();
    const double c1 = std::cos(c.p[2]), s1 = std::sin(c.p[2]), c2 = std::cos(c.p[3]),
                 s2 = std::sin(c.p[3]), w = c.p[4];
    for (int y = -reach; y <= reach; ++y) {
      const auto* row = grey.ptr<std::uint8_t>(middle.y + y) + middle.x;
      for (int x = -reach; x <= reach; ++x) {
        const double dx = x - c.p[0], dy = y - c.p[1];
        if (dx * dx + dy * dy > (reach + 0.5) * (reach + 0.5)) continue;
        const double e1 = std::tanh((c1 * dy - s1 * dx) / w);
        const double e2 = std::tanh((c2 * dy - s2 * dx) / w);
        const double d1 = (1 - e1 * e1) / w, d2 = (1 - e2 * e2) / w, k = c.p[6];
        Eigen::Matrix<double, 9, 1> j;
        j << k * (d1 * s1 * e2 + e1 * d2 * s2), -k * (d1 * c1 * e2 + e1 * d2 * c2),
            k * d1 * e2 * (-s1 * dy - c1 * dx), k * e1 * d2 * (-s2 * dy - c2 * dx),
            -k * (d1 * e2 * (c1 * dy - s1 * dx) + e1 * d2 * (c2 * dy - s2 * dx)) / w, 1, e1 * e2,
            dx, dy;
        const double r = row[x] - (c.p[5] + c.p[7] * dx + c.p[8] * dy + k * e1 * e2);
        normal.selfadjointView<Eigen::Lower>().rankUpdate(j);
        gradient += r * j;
      }
    }
    normal = Eigen::Matrix<double, 9, 9>(normal.selfadjointView<Eigen::Lower>());
    normal.diagonal() *= 1 + 1e-6;
    Eigen::Matrix<double, 9, 1> change = normal.ldlt().solve(gradient);
    if (!change.allFinite()) return false;
    const double furthest = std::max(std::abs(change[0]), std::abs(change[1]));
    if (furthest > 1.5) change *= 1.5 / furthest;
    c.p += change;
    c.p[4] = std::clamp(c.p[4], 0.4, 0.8 * reach);
    step = change.head<2>().norm();
    if (c.p.head<2>().norm() > 0.6 * reach) return false;
  }
  if (step > 0.02 || std::abs(c.p[6]) < 2 || std::abs(std::sin(c.p[2] - c.p[3])) < 0.2)
    return false;
  corner = {middle.x + c.p[0], middle.y + c.p[1]};
  return true;
}

/// Half side of the window: a little less than half the distance to the nearest neighbour.
int reach_of(const std::vector<cv::Point2d>& corners, const BoardPattern& board) {
  double nearest = 1e9;
  for (int r = 0; r < board.rows; ++r)
    for (int c = 0; c < board.columns; ++c) {
      const int index = r * board.columns + c;
      const auto i = static_cast<std::size_t>(index);
      if (c > 0) nearest = std::min(nearest, cv::norm(corners[i] - corners[i - 1]));
      if (r > 0)
        nearest = std::min(
            nearest, cv::norm(corners[i] - corners[i - static_cast<std::size_t>(board.columns)]));
    }
  return std::clamp(static_cast<int>(0.4 * nearest), 3, 16);
}

std::vector<cv::Point2d> coarse_corners(const cv::Mat& image, const BoardPattern& board,
                                        double scale) {
  const cv::Size size(board.columns, board.rows);
  std::vector<cv::Point2f> found;
  // Not CALIB_CB_NORMALIZE_IMAGE at first: with it OpenCV misses evenly lit boards.
  if (!cv::findChessboardCornersSB(image, size, found, 0) &&
      !cv::findChessboardCornersSB(image, size, found,
                                   cv::CALIB_CB_EXHAUSTIVE | cv::CALIB_CB_NORMALIZE_IMAGE))
    return {};
  std::vector<cv::Point2d> corners;
  for (const cv::Point2f& p : found)  // pixel centres: (p + 1/2) / scale - 1/2
    corners.emplace_back((static_cast<double>(p.x) + 0.5) / scale - 0.5,
                         (static_cast<double>(p.y) + 0.5) / scale - 0.5);
  return corners;
}

/// Row by row as the front of the board shows it: x cross y points away from the camera.
void make_right_handed(const BoardPattern& board, std::vector<cv::Point2d>& corners) {
  const auto columns = static_cast<std::ptrdiff_t>(board.columns);
  const cv::Point2d x = corners[static_cast<std::size_t>(columns) - 1] - corners[0];
  const cv::Point2d y = corners[corners.size() - static_cast<std::size_t>(columns)] - corners[0];
  if (x.cross(y) > 0) return;
  for (auto row = corners.begin(); row != corners.end(); row += columns)
    std::reverse(row, row + columns);
}

/// What part of a board is there: the largest grid that grows from 3x3 corners.
cv::Size seen_grid(const cv::Mat& image) {
  std::vector<cv::Point2f> found;
  cv::Mat grid;
  if (!cv::findChessboardCornersSB(image, cv::Size(3, 3), found, cv::CALIB_CB_LARGER, grid))
    return {0, 0};
  return grid.size();
}

}  // namespace

bool refine_corners(const cv::Mat& grey, int reach_px, std::vector<cv::Point2d>& corners) {
  return std::all_of(corners.begin(), corners.end(),
                     [&](cv::Point2d& corner) { return fit_crossing(grey, reach_px, corner); });
}

ChessboardView find_chessboard(const cv::Mat& grey, const BoardPattern& board) {
  ChessboardView view;
  const double scale = std::min(1.0, static_cast<double>(kCoarseWidthPx) / grey.cols);
  cv::Mat reduced = grey;
  if (scale < 1) cv::resize(grey, reduced, {}, scale, scale, cv::INTER_AREA);
  // cv::resize rounds the size: the true scale is that of the result.
  const double true_scale = static_cast<double>(reduced.cols) / grey.cols;
  std::vector<cv::Point2d> corners = coarse_corners(reduced, board, true_scale);
  if (corners.empty() && scale < 1) corners = coarse_corners(grey, board, 1);
  if (corners.empty()) {
    view.seen = seen_grid(reduced);
    return view;
  }
  make_right_handed(board, corners);
  if (refine_corners(grey, reach_of(corners, board), corners)) view.corners = corners;
  return view;
}

void match_corner_order(const BoardPattern& board, const std::vector<cv::Point2d>& left,
                        std::vector<cv::Point2d>& right) {
  const auto along = [&](const std::vector<cv::Point2d>& corners) {
    const auto last = static_cast<std::size_t>(board.columns) - 1;
    return corners[last] - corners[0];
  };
  if (along(left).dot(along(right)) < 0) std::reverse(right.begin(), right.end());
}

}  // namespace holdfast::registration
