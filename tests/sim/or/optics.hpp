// SPDX-License-Identifier: Apache-2.0
// The true optics of the virtual stereo microscope: what its cameras see exactly, not what a
// calibration says. A common main objective with two channels that converge on the focal plane; a
// lens whose distortion changes smoothly with zoom and holds a part that OpenCV's five coefficients
// cannot: higher radial order, thin prism, a figure error of the glass, and a pupil that moves with
// the field (rays that share no centre). Everything is drawn from a seed.
//
// Frames: `head`: origin between the entrance pupils, x from left to right, y down, z towards the
// site. A channel's `camera` frame: origin in its pupil on the axis, x right, y down, z forward.
// Pixels as OpenCV has them: (0,0) is the centre of the first one.
#pragma once

#include <array>
#include <cstdint>

#include <Eigen/Core>
#include <Eigen/Geometry>

namespace holdfast::sim {

constexpr int kSensorWidthPx = 2456;
constexpr int kSensorHeightPx = 2054;

struct OpticsParameters {
  std::uint32_t seed = 1;
  double irregularity = 1;          ///< scales what the five-coefficient model does not contain
  double seating_px = 0.15;         ///< standard deviation of the principal point between visits
  double seating_focal = 3e-5;      ///< likewise of the focal length, relative, common to both
  double aperture_mm = 2.5;         ///< diameter of an entrance pupil: sets the defocus
  double blur_px = 0.6;             ///< standard deviation of the point spread in focus
  double exposure_mismatch = 0.04;  ///< half the relative difference of the two exposures, at most
};

/// A line of sight in a camera's frame; `direction` has z = 1.
struct SightLine {
  Eigen::Vector3d origin_mm;
  Eigen::Vector3d direction;
};

/// One camera at one zoom. Immutable; any thread.
class OpticalChannel {
 public:
  /// The pixel that sees `p_camera` (mm; z > 0, else NaN).
  [[nodiscard]] Eigen::Vector2d project(const Eigen::Vector3d& p_camera_mm) const;
  /// The line that `pixel` sees; exact to 1e-9 px within half a sensor around it, NaN where the
  /// distortion has no inverse.
  [[nodiscard]] SightLine sight_line(const Eigen::Vector2d& pixel) const;

  [[nodiscard]] double focal_px() const noexcept { return fx_; }
  [[nodiscard]] double gain() const noexcept { return gain_; }

 private:
  friend class Microscope;
  [[nodiscard]] Eigen::Vector2d distort(const Eigen::Vector2d& m) const;
  struct Ripple {
    Eigen::Vector2d amplitude, wave;
    double phase = 0;
  };
  double fx_ = 1, fy_ = 1, cx_ = 0, cy_ = 0;
  double k1_ = 0, k2_ = 0, k3_ = 0, p1_ = 0, p2_ = 0;  // OpenCV's five
  double k4_ = 0, s1_ = 0, s2_ = 0;                    // r^8; thin prism
  std::array<Ripple, 3> ripples_;
  double pupil_shift_mm_ = 0;  // the pupil moves by this times r^2 along the axis
  double gain_ = 1;
};

/// Both channels at one zoom.
struct StereoOptics {
  double zoom = 0, focus_mm = 0;
  OpticalChannel left, right;
  Eigen::Isometry3d T_head_left = Eigen::Isometry3d::Identity();
  Eigen::Isometry3d T_head_right = Eigen::Isometry3d::Identity();
  double aperture_mm = 0, blur_px = 0;
  [[nodiscard]] Eigen::Isometry3d T_right_left() const {
    return T_head_right.inverse() * T_head_left;
  }
};

class Microscope {
 public:
  static constexpr double kZoomMin = 1.1, kZoomMax = 1.5;

  explicit Microscope(const OpticsParameters& parameters = {});

  /// The optics at `zoom` (kZoomMin..kZoomMax, any value; InputError else). Each `visit` to a zoom
  /// seats a little differently; visit 0 is the mean of all. Pure; any thread.
  [[nodiscard]] StereoOptics at(double zoom, std::uint32_t visit = 0) const;

  [[nodiscard]] double focus_mm() const noexcept { return focus_mm_; }
  [[nodiscard]] const OpticsParameters& parameters() const noexcept { return parameters_; }

 private:
  /// Coefficients of 1, t, t^2, t^3 with t = (zoom - 1.3) / 0.2.
  using Curve = std::array<double, 4>;
  struct ChannelDesign {
    Curve f, aspect, cx, cy, k1, k2, k3, k4, p1, p2, s1, s2, pupil_shift;
    std::array<OpticalChannel::Ripple, 3> ripples;  // amplitude in px
    Curve yaw, pitch, roll, x, y, z;                // of the camera in `head`; rad, mm
    double gain = 1;
  };
  template <typename Random>
  void draw(ChannelDesign& design, double side, Random& random) const;
  [[nodiscard]] OpticalChannel channel(const ChannelDesign& design, double t, double zoom,
                                       const Eigen::Vector3d& seating) const;

  OpticsParameters parameters_;
  double focus_mm_ = 200;
  double base_mm_ = 24;
  ChannelDesign left_, right_;
};

}  // namespace holdfast::sim
