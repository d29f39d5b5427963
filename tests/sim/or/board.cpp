// SPDX-License-Identifier: Apache-2.0
#include "tests/sim/or/board.hpp"

#include <cmath>
#include <numbers>

#include <fmt/format.h>

#include "rt/core/error.hpp"
#include "tests/sim/or/seeded_random.hpp"

namespace holdfast::sim {
namespace {

using Eigen::Vector2d;
using Eigen::Vector3d;

cv::Mat_<float> chessboard(const Board& board) {
  constexpr double kTexelMm = 0.02;
  const int square = static_cast<int>(std::lround(board.square_mm / kTexelMm));
  const int margin = static_cast<int>(std::lround(board.margin_mm / kTexelMm));
  const int columns = board.corners_x + 1, rows = board.corners_y + 1;
  cv::Mat_<float> print(rows * square + 2 * margin, columns * square + 2 * margin, 1.F);
  constexpr float kInk = 0.07F;
  for (int j = 0; j < rows; ++j)
    for (int i = 0; i < columns; ++i)
      if ((i + j) % 2 == 0)
        print(cv::Rect(margin + i * square, margin + j * square, square, square)) = kInk;
  return print;
}

bool is_in_view(const OpticalChannel& channel, const Vector3d& p_camera, double border) {
  const Vector2d pixel = channel.project(p_camera);
  return pixel.x() >= border && pixel.y() >= border && pixel.x() <= kSensorWidthPx - 1 - border &&
         pixel.y() <= kSensorHeightPx - 1 - border;
}

bool is_in_view(const Board& board, const StereoOptics& optics,
                const Eigen::Isometry3d& T_head_board, double border) {
  const double s = board.square_mm, m = board.margin_mm;
  for (const double x : {-s - m, board.corners_x * s + m})
    for (const double y : {-s - m, board.corners_y * s + m}) {
      const Vector3d p = T_head_board * Vector3d(x, y, 0);
      if (!is_in_view(optics.left, optics.T_head_left.inverse() * p, border) ||
          !is_in_view(optics.right, optics.T_head_right.inverse() * p, border))
        return false;
    }
  return true;
}

}  // namespace

double Board::height_mm(double x, double y) const {
  SeededRandom random{seed, 0xb0a2dU};
  const double width = (corners_x - 1) * square_mm, height = (corners_y - 1) * square_mm;
  const double u = 2 * x / width - 1, v = 2 * y / height - 1;
  const double a = random.between(-1, 1), b = random.between(-1, 1), c = random.between(-1, 1);
  return bow_mm / 3 * (a * (1 - u * u) + b * (1 - v * v) + c * u * v);
}

std::vector<Vector3d> Board::corners() const {
  std::vector<Vector3d> points;
  for (int j = 0; j < corners_y; ++j)
    for (int i = 0; i < corners_x; ++i) {
      const double x = i * square_mm, y = j * square_mm;
      points.emplace_back(x, y, -height_mm(x, y));
    }
  return points;
}

LitSurface Board::surface() const {
  LitSurface s;
  s.look.albedo_visible = s.look.albedo_nir = 0.75F;
  s.look.specular = 0.03F;
  s.look.roughness = 0.5F;
  s.look.print = chessboard(*this);
  const double x0 = -square_mm - margin_mm, width = (corners_x + 1) * square_mm + 2 * margin_mm;
  const double y0 = -square_mm - margin_mm, height = (corners_y + 1) * square_mm + 2 * margin_mm;
  constexpr int kCells = 24;
  for (int j = 0; j <= kCells; ++j)
    for (int i = 0; i <= kCells; ++i) {
      const double u = static_cast<double>(i) / kCells, v = static_cast<double>(j) / kCells;
      const double x = x0 + u * width, y = y0 + v * height, h = 1e-3;
      s.vertices_mm.push_back(Vector3d(x, y, -height_mm(x, y)).cast<float>());
      s.normals.push_back(Vector3d(-(height_mm(x + h, y) - height_mm(x - h, y)) / (2 * h),
                                   -(height_mm(x, y + h) - height_mm(x, y - h)) / (2 * h), -1)
                              .normalized()
                              .cast<float>());
      s.uv.emplace_back(static_cast<float>(u), static_cast<float>(v));
    }
  for (std::uint32_t j = 0; j < kCells; ++j)
    for (std::uint32_t i = 0; i < kCells; ++i) {
      const std::uint32_t a = j * (kCells + 1) + i, b = a + 1, c = a + kCells + 1, d = c + 1;
      s.triangles.push_back({a, b, c});
      s.triangles.push_back({b, d, c});
    }
  return s;
}

std::vector<Eigen::Isometry3d> board_poses(const Board& board, const StereoOptics& optics,
                                           const BoardPoses& poses) {
  SeededRandom random{poses.seed, static_cast<std::uint32_t>(std::lround(1000 * optics.zoom))};
  const double half_width = 0.5 * kSensorWidthPx / optics.left.focal_px() * optics.focus_mm;
  const double half_height = 0.5 * kSensorHeightPx / optics.left.focal_px() * optics.focus_mm;
  const Vector3d centre(0.5 * (board.corners_x - 1) * board.square_mm,
                        0.5 * (board.corners_y - 1) * board.square_mm, 0);
  // The field in cells, so that no corner of it stays without a view.
  const int columns = static_cast<int>(std::ceil(std::sqrt(poses.count * 1.2)));
  const int rows = (poses.count + columns - 1) / columns;
  std::vector<Eigen::Isometry3d> result;
  for (int i = 0; i < poses.count; ++i) {
    bool is_placed = false;
    for (int attempt = 0; attempt < 2000 && !is_placed; ++attempt) {
      const double reach = 1 - 0.0004 * attempt;  // towards the middle when it will not fit
      const double x =
          half_width * reach * (2 * (i % columns + random.between(0, 1)) / columns - 1);
      const double y = half_height * reach * (2 * (i / columns + random.between(0, 1)) / rows - 1);
      const double z = optics.focus_mm + random.between(-1, 1) * poses.depth_range_mm;
      const double share = (i * 7 % poses.count + random.between(0, 1)) / poses.count;
      const double towards = random.between(-std::numbers::pi, std::numbers::pi);
      Eigen::Isometry3d T_head_board = Eigen::Isometry3d::Identity();
      T_head_board.translate(Vector3d(x, y, z));
      T_head_board.rotate(Eigen::AngleAxisd(poses.tilt_max_rad * share,
                                            Vector3d(std::cos(towards), std::sin(towards), 0)));
      T_head_board.rotate(Eigen::AngleAxisd(random.between(-0.5, 0.5), Vector3d::UnitZ()));
      T_head_board.translate(-centre);
      is_placed = is_in_view(board, optics, T_head_board, poses.border_px);
      if (is_placed) result.push_back(T_head_board);
    }
    if (!is_placed)
      throw InputError(fmt::format("a board of {}x{} squares of {} mm does not fit the field",
                                   board.corners_x + 1, board.corners_y + 1, board.square_mm));
  }
  return result;
}

}  // namespace holdfast::sim
