// SPDX-License-Identifier: Apache-2.0
// How the site moves: a program of segments, each known analytically at every instant. Each begins
// and ends at rest in the identity pose; where a path of paper B ends elsewhere (the spiral), the
// way home at its own speed is part of the segment.
#pragma once

#include <chrono>
#include <memory>
#include <string>
#include <string_view>
#include <vector>

#include <Eigen/Core>
#include <Eigen/Geometry>

namespace holdfast::sim {

/// T_camera_site of a segment, in mm and as a unit quaternion.
struct SitePose {
  Eigen::Vector3d t_mm = Eigen::Vector3d::Zero();
  Eigen::Quaterniond q = Eigen::Quaterniond::Identity();
};

class Segment {
 public:
  Segment(std::string name, double duration_s) : name_(std::move(name)), duration_s_(duration_s) {}
  virtual ~Segment() = default;
  Segment(const Segment&) = delete;
  Segment& operator=(const Segment&) = delete;
  [[nodiscard]] const std::string& name() const noexcept { return name_; }
  [[nodiscard]] double duration_s() const noexcept { return duration_s_; }
  /// `t_s` in 0..duration_s.
  [[nodiscard]] virtual SitePose at(double t_s) const = 0;

 private:
  std::string name_;
  double duration_s_;
};

class Trajectory {
 public:
  /// Reads a program such as "still:2,linear,still:1,spiral:0.5,bump:1.5". One number each:
  ///   still:S        S seconds at rest (default 1)
  ///   linear:F       paper B's cross (Eq. 4), amplitude times F (default 1: +-10 mm), 2 mm/s
  ///   spiral:F       paper B's spiral (Eq. 5), amplitude times F (default 1: 5 mm), 2 mm/s
  ///   bump:A         a knock of A mm (default 1.5) to the right, 6.5 Hz, gone after 1.5 s
  ///   breathing:S    S seconds (default 8; whole cycles of 4 s) of 0.5 mm down and 0.15 mm closer
  ///   roll:D         turns D degrees (default 5) about the optical axis and back, 5 deg/s at most
  ///   tilt:D         turns D degrees (default 2) about the camera's x axis and back
  ///   lift:A         moves A mm (default 1) away along the optical axis and back
  ///   away:S        within .4 s 5 mm to the right and 5 degrees about the optical axis, S seconds
  ///                 (default 1) there, and back within .4 s
  /// roll, tilt and away turn about the point of the axis at `depth_mm`. `scale` multiplies every
  /// amplitude. `loop`: begins again at its end; otherwise the site stays at rest there.
  /// Throws InputError naming the segment.
  Trajectory(std::string_view program, double scale, bool loop, double depth_mm);

  /// The pose at `t` since the start; identity before it. Any thread.
  [[nodiscard]] SitePose at(std::chrono::nanoseconds t) const;

  struct Start {
    std::chrono::nanoseconds t;  ///< since the program's start
    std::string name;
  };
  /// The segments that begin in [from, to).
  [[nodiscard]] std::vector<Start> starts(std::chrono::nanoseconds from,
                                          std::chrono::nanoseconds to) const;
  /// Of one pass.
  [[nodiscard]] std::chrono::nanoseconds duration() const noexcept;

 private:
  std::vector<std::unique_ptr<Segment>> segments_;
  double duration_s_ = 0;
  bool loop_;
};

}  // namespace holdfast::sim
