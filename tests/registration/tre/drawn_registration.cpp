// SPDX-License-Identifier: Apache-2.0
#include "tests/registration/tre/drawn_registration.hpp"

#include <array>
#include <cmath>
#include <random>

#include <fmt/format.h>

#include "registration/calibration_run.hpp"
#include "tests/sim/or/board.hpp"
#include "tests/sim/or/calibration_error.hpp"
#include "tests/sim/or/marker_holder.hpp"
#include "tests/sim/or/room.hpp"

namespace holdfast::registration::test {
namespace {

using Eigen::Isometry3d;
using Eigen::Vector2d;
using Eigen::Vector3d;

constexpr std::uint32_t kBoardVisit = 1000, kMarkerVisit = 1;  // as the room counts them

class Noise {
 public:
  explicit Noise(std::uint32_t seed) : random_(seed * 7919ULL + 17) {}
  double operator()(double sigma) { return sigma * normal_(random_); }
  Vector3d point(double sigma) { return {(*this)(sigma), (*this)(sigma), (*this)(sigma)}; }

 private:
  std::mt19937_64 random_;
  std::normal_distribution<double> normal_;
};

struct Eye {
  const sim::OpticalChannel& channel;
  Isometry3d T_camera_head;
  [[nodiscard]] Vector2d see(const Vector3d& p_head) const {
    return channel.project(T_camera_head * p_head);
  }
};
std::array<Eye, 2> eyes(const sim::StereoOptics& optics) {
  return {
      {{optics.left, optics.T_head_left.inverse()}, {optics.right, optics.T_head_right.inverse()}}};
}

ZoomViews board_views(const DrawnRig& rig, const sim::Microscope& microscope, Noise& noise) {
  sim::Board board;
  board.seed = rig.seed;
  sim::BoardPoses poses;
  poses.count = rig.pairs;
  poses.seed = rig.seed;
  const sim::StereoOptics optics = microscope.at(rig.zoom, kBoardVisit);
  ZoomViews views{rig.zoom, {}};
  for (const Isometry3d& T_head_board : sim::board_poses(board, optics, poses)) {
    BoardPair pair;
    pair.name = fmt::format("view {}", views.pairs.size());
    for (const Eye& eye : eyes(optics))
      for (const Vector3d& corner : board.corners()) {
        const Vector2d p = eye.see(T_head_board * corner);
        (&eye.channel == &optics.left ? pair.left : pair.right)
            .emplace_back(p.x() + noise(rig.noise.board_corner_px),
                          p.y() + noise(rig.noise.board_corner_px));
      }
    views.pairs.push_back(pair);
  }
  return views;
}

/// A side of a marker in the image: through `point` (its middle) along `direction`.
struct Side {
  Vector2d point, direction;
  double length_px;
};

Eigen::Matrix<double, 8, 1> corners_of(const std::array<Side, 4>& sides) {
  Eigen::Matrix<double, 8, 1> corners;
  for (std::size_t i = 0; i < 4; ++i) {
    const Side &a = sides.at((i + 3) % 4), &b = sides[i];
    const Vector2d d = b.point - a.point;
    const double cross = a.direction.x() * b.direction.y() - a.direction.y() * b.direction.x();
    corners.segment<2>(static_cast<Eigen::Index>(2 * i)) =
        a.point + a.direction * ((d.x() * b.direction.y() - d.y() * b.direction.x()) / cross);
  }
  return corners;
}

/// Across by `offset_px`, its ends against one another by what a line fit of that exactness leaves.
Side moved(Side side, double offset_px, double turn_px) {
  const Vector2d normal(-side.direction.y(), side.direction.x());
  side.point += offset_px * normal;
  side.direction = (side.direction + turn_px / side.length_px * normal).normalized();
  return side;
}

/// As detect_markers() finds and states it: lines along 0.8 of each side.
DetectedMarker sighted(const sim::TrueMarker& marker, const Isometry3d& T_head_ct, const Eye& eye,
                       double side_px, Noise& noise) {
  const double turn = std::sqrt(12.0) / 0.8;  // of the line's ends for its offset
  const double h = 0.5 * marker.side_mm;
  std::array<Vector2d, 4> corner;
  const std::array<Vector3d, 4> square{{{-h, h, 0}, {h, h, 0}, {h, -h, 0}, {-h, -h, 0}}};
  for (std::size_t i = 0; i < 4; ++i)
    corner.at(i) = eye.see(T_head_ct * (marker.T_ct_marker * square.at(i)));
  std::array<Side, 4> sides;
  for (std::size_t i = 0; i < 4; ++i) {
    const Vector2d along = corner.at((i + 1) % 4) - corner.at(i);
    sides.at(i) = {corner.at(i) + 0.5 * along, along.normalized(), along.norm()};
  }
  const Eigen::Matrix<double, 8, 1> here = corners_of(sides);
  DetectedMarker found;
  found.id = marker.aruco_id;
  found.covariance_px2.setZero();
  std::array<Side, 4> drawn = sides;
  for (std::size_t i = 0; i < 4; ++i) {
    drawn.at(i) = moved(sides.at(i), noise(side_px), turn * noise(side_px));
    for (const bool is_offset : {true, false}) {
      std::array<Side, 4> one = sides;
      one.at(i) = moved(one.at(i), is_offset ? side_px : 0, is_offset ? 0 : turn * side_px);
      const Eigen::Matrix<double, 8, 1> change = corners_of(one) - here;
      found.covariance_px2 += change * change.transpose();
    }
  }
  const Eigen::Matrix<double, 8, 1> at = corners_of(drawn);
  for (Eigen::Index i = 0; i < 4; ++i)
    found.corners.at(static_cast<std::size_t>(i)) = {at[2 * i], at[2 * i + 1]};
  return found;
}

}  // namespace

MarkerOptions bead_options() {
  MarkerOptions options;
  options.offset_mm = sim::kBeadDepthMm;
  options.marker_mm = sim::kMarkerSideMm;
  return options;
}

DrawnMeasurement draw_measurement(const DrawnRig& rig, const sim::Phantom& phantom) {
  Noise noise(rig.seed);
  sim::OpticsParameters parameters;
  parameters.seed = rig.seed;
  const sim::Microscope microscope(parameters);
  const CalibrationOutcome calibrated = calibrate_stereo(
      {board_views(rig, microscope, noise)}, sim::kSensorWidthPx, sim::kSensorHeightPx, {}, {});

  sim::RoomConfig room;
  room.seed = rig.seed;
  room.poses = 2;  // the first is always straight above
  DrawnMeasurement drawn;
  drawn.calibration = calibrated.calibration.zooms.front();
  drawn.T_ct_head = sim::head_poses(room, phantom, microscope.focus_mm()).back();
  drawn.optics = microscope.at(rig.zoom, kMarkerVisit);
  const Isometry3d T_head_ct = drawn.T_ct_head.inverse();
  for (const sim::TrueMarker& marker : phantom.markers) {
    // The holder is made anew for each rig, as the phantom makes them.
    const Vector3d made_off{noise(0.01), noise(0.01), noise(0.02)};
    const Vector3d bead = marker.T_ct_marker * (Vector3d(0, 0, -sim::kBeadDepthMm) + made_off);
    drawn.beads.points.push_back({fmt::format("bead-{}", marker.aruco_id),
                                  bead + noise.point(rig.noise.bead_mm),
                                  std::pow(rig.noise.bead_mm, 2) * Eigen::Matrix3d::Identity(),
                                  {}});
    const auto both = eyes(drawn.optics);
    drawn.left.push_back(sighted(marker, T_head_ct, both[0], rig.noise.marker_side_px, noise));
    drawn.right.push_back(sighted(marker, T_head_ct, both[1], rig.noise.marker_side_px, noise));
  }
  drawn.markers = locate_markers(drawn.left, drawn.right, drawn.calibration, bead_options());
  drawn.T_camera_ct = sim::frame_of(drawn.calibration, microscope.at(rig.zoom)) * T_head_ct;
  return drawn;
}

}  // namespace holdfast::registration::test
