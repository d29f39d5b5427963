// SPDX-License-Identifier: Apache-2.0
#include "tests/sim/trajectory.hpp"

#include <algorithm>
#include <charconv>
#include <cmath>
#include <functional>
#include <numbers>

#include <fmt/core.h>

#include "rt/core/error.hpp"

namespace holdfast::sim {
namespace {

constexpr double kSpeedMmPerS = 2.0;  // paper B, section 2.3
constexpr double kTwoPi = 2 * std::numbers::pi;

class Still : public Segment {
 public:
  explicit Still(double duration_s) : Segment("still", duration_s) {}
  [[nodiscard]] SitePose at(double /*t_s*/) const override { return {}; }
};

// Straight from waypoint to waypoint at constant speed, as paper B's robot interpolates.
class Waypoints : public Segment {
 public:
  Waypoints(std::string name, std::vector<Eigen::Vector2d> points_mm)
      : Segment(std::move(name), length(points_mm) / kSpeedMmPerS),
        points_mm_(std::move(points_mm)) {}
  [[nodiscard]] SitePose at(double t_s) const override {
    double left_mm = t_s * kSpeedMmPerS;
    SitePose pose;
    for (std::size_t i = 1; i < points_mm_.size(); ++i) {
      const Eigen::Vector2d way = points_mm_[i] - points_mm_[i - 1];
      const double reach_mm = way.norm();
      if (left_mm <= reach_mm && reach_mm > 0) {
        pose.t_mm.head<2>() = points_mm_[i - 1] + way * (left_mm / reach_mm);
        return pose;
      }
      left_mm -= reach_mm;
    }
    pose.t_mm.head<2>() = points_mm_.back();
    return pose;
  }

 private:
  static double length(const std::vector<Eigen::Vector2d>& points_mm) {
    double sum = 0;
    for (std::size_t i = 1; i < points_mm.size(); ++i)
      sum += (points_mm[i] - points_mm[i - 1]).norm();
    return sum;
  }
  std::vector<Eigen::Vector2d> points_mm_;
};

std::vector<Eigen::Vector2d> cross(double factor) {  // Eq. (4)
  std::vector<Eigen::Vector2d> points{{0, 0}, {0, 10}, {0, -10}, {10, 0}, {-10, 0}, {0, 0}};
  for (auto& point : points) point *= factor;
  return points;
}

std::vector<Eigen::Vector2d> spiral(double factor) {  // Eq. (5), then home
  std::vector<Eigen::Vector2d> points;
  for (int n = 0; n <= 25; ++n) {
    const double share = n / 50.0;
    const double angle = 4 * kTwoPi * share;
    points.emplace_back(factor * 10 * share * Eigen::Vector2d(std::sin(angle), std::cos(angle)));
  }
  points.emplace_back(0, 0);
  return points;
}

// A knock: decaying oscillation, eased in over 20 ms and out to exactly zero.
class Bump : public Segment {
 public:
  explicit Bump(double amplitude_mm) : Segment("bump", 1.5), amplitude_mm_(amplitude_mm) {}
  [[nodiscard]] SitePose at(double t_s) const override {
    const double ease_in = 1 - std::exp(-t_s / 0.02);
    const double ease_out = std::pow(1 - t_s / duration_s(), 2);
    const double decay = std::exp(-t_s / 0.35);
    const double knock =
        amplitude_mm_ * kPeak * ease_in * ease_out * decay * std::sin(kTwoPi * 6.5 * t_s);
    SitePose pose;
    pose.t_mm = {knock, 0.35 * knock, 0};
    return pose;
  }

 private:
  // 1 / the largest value that the product of the four factors takes.
  static constexpr double kPeak = 1.34;
  double amplitude_mm_;
};

class Breathing : public Segment {
 public:
  Breathing(double duration_s, double scale)
      : Segment("breathing", std::max(1.0, std::round(duration_s / kCycleS)) * kCycleS),
        scale_(scale) {}
  [[nodiscard]] SitePose at(double t_s) const override {
    const double breath = scale_ * 0.5 * (1 - std::cos(kTwoPi * t_s / kCycleS));
    SitePose pose;
    pose.t_mm = {0, 0.5 * breath, -0.15 * breath};
    return pose;
  }

 private:
  static constexpr double kCycleS = 4;
  double scale_;
};

// Out and back along one parameter as a raised cosine, no faster than given.
class OutAndBack : public Segment {
 public:
  using PoseOf = std::function<SitePose(double)>;
  OutAndBack(std::string name, double reach, double speed_max, PoseOf pose_of)
      : Segment(std::move(name), std::max(0.5, std::numbers::pi * std::abs(reach) / speed_max)),
        reach_(reach),
        pose_of_(std::move(pose_of)) {}
  [[nodiscard]] SitePose at(double t_s) const override {
    return pose_of_(reach_ * 0.5 * (1 - std::cos(kTwoPi * t_s / duration_s())));
  }

 private:
  double reach_;
  PoseOf pose_of_;
};

// To another pose, a while there, and back.
class Away : public Segment {
 public:
  Away(double stay_s, std::function<SitePose(double share)> pose_of)
      : Segment("away", stay_s + 2 * kWayS), pose_of_(std::move(pose_of)) {}
  [[nodiscard]] SitePose at(double t_s) const override {
    const double share = std::clamp(std::min(t_s, duration_s() - t_s) / kWayS, 0.0, 1.0);
    return pose_of_(0.5 * (1 - std::cos(std::numbers::pi * share)));
  }

 private:
  static constexpr double kWayS = 0.4;
  std::function<SitePose(double)> pose_of_;
};

SitePose turned_about(const Eigen::Vector3d& axis, double angle_deg, double depth_mm) {
  const Eigen::Quaterniond q(
      Eigen::AngleAxisd(angle_deg * std::numbers::pi / 180, axis.normalized()));
  const Eigen::Vector3d pivot_mm(0, 0, depth_mm);
  return {pivot_mm - q * pivot_mm, q};
}

double number_of(std::string_view text, std::string_view item) {
  double value = 0;
  const auto [end, error] = std::from_chars(text.data(), text.data() + text.size(), value);
  if (error != std::errc{} || end != text.data() + text.size() || !std::isfinite(value))
    throw InputError(fmt::format("motion: \"{}\": \"{}\" is not a number", item, text));
  return value;
}

std::unique_ptr<Segment> segment_of(std::string_view item, double scale, double depth_mm) {
  const std::size_t colon = item.find(':');
  const std::string_view name = item.substr(0, colon);
  const auto number = [&](double otherwise) {
    if (colon == std::string_view::npos) return otherwise;
    return number_of(item.substr(colon + 1), item);
  };
  const auto seconds = [&](double otherwise) {
    const double value = number(otherwise);
    if (!(value > 0 && value <= 86400))
      throw InputError(fmt::format("motion: \"{}\": duration must be in 0..86400 s", item));
    return value;
  };
  if (name == "still") return std::make_unique<Still>(seconds(1));
  if (name == "linear") return std::make_unique<Waypoints>("linear", cross(scale * number(1)));
  if (name == "spiral") return std::make_unique<Waypoints>("spiral", spiral(scale * number(1)));
  if (name == "bump") return std::make_unique<Bump>(scale * number(1.5));
  if (name == "breathing") return std::make_unique<Breathing>(seconds(8), scale);
  if (name == "roll")
    return std::make_unique<OutAndBack>("roll", scale * number(5), 5, [depth_mm](double deg) {
      return turned_about(Eigen::Vector3d::UnitZ(), deg, depth_mm);
    });
  if (name == "tilt")
    return std::make_unique<OutAndBack>("tilt", scale * number(2), 5, [depth_mm](double deg) {
      return turned_about(Eigen::Vector3d::UnitX(), deg, depth_mm);
    });
  if (name == "lift")
    return std::make_unique<OutAndBack>("lift", scale * number(1), 2, [](double mm) {
      return SitePose{{0, 0, mm}, Eigen::Quaterniond::Identity()};
    });
  if (name == "away")
    return std::make_unique<Away>(seconds(1), [scale, depth_mm](double share) {
      SitePose pose = turned_about(Eigen::Vector3d::UnitZ(), scale * 5 * share, depth_mm);
      pose.t_mm.x() += scale * 5 * share;
      return pose;
    });
  throw InputError(
      fmt::format("motion: \"{}\" is not one of still, linear, spiral, bump, breathing, roll, "
                  "tilt, lift, away",
                  name));
}

std::chrono::nanoseconds from_seconds(double seconds) {
  return std::chrono::nanoseconds(std::llround(seconds * 1e9));
}

}  // namespace

Trajectory::Trajectory(std::string_view program, double scale, bool loop, double depth_mm)
    : loop_(loop) {
  if (!(std::isfinite(scale) && scale > 0))
    throw InputError(fmt::format("motion: scale {:g} must be positive", scale));
  for (std::size_t begin = 0; begin <= program.size();) {
    const std::size_t end = std::min(program.find(',', begin), program.size());
    segments_.push_back(segment_of(program.substr(begin, end - begin), scale, depth_mm));
    duration_s_ += segments_.back()->duration_s();
    begin = end + 1;
  }
}

SitePose Trajectory::at(std::chrono::nanoseconds t) const {
  double t_s = std::chrono::duration<double>(t).count();
  if (t_s < 0 || (!loop_ && t_s >= duration_s_)) return {};
  if (loop_) t_s = std::fmod(t_s, duration_s_);
  for (const auto& segment : segments_) {
    if (t_s < segment->duration_s()) return segment->at(t_s);
    t_s -= segment->duration_s();
  }
  return {};
}

std::vector<Trajectory::Start> Trajectory::starts(std::chrono::nanoseconds from,
                                                  std::chrono::nanoseconds to) const {
  std::vector<Start> found;
  const auto pass_of = [&](std::chrono::nanoseconds t) {
    return std::max(0.0, std::floor(std::chrono::duration<double>(t).count() / duration_s_));
  };
  const double last_pass = loop_ ? pass_of(to) : 0;
  for (double pass = loop_ ? pass_of(from) : 0; pass <= last_pass; ++pass) {
    double begin_s = pass * duration_s_;
    for (const auto& segment : segments_) {
      const auto begin = from_seconds(begin_s);
      if (begin >= from && begin < to) found.push_back({begin, segment->name()});
      begin_s += segment->duration_s();
    }
    const auto end = from_seconds(begin_s);
    if (!loop_ && end >= from && end < to) found.push_back({end, "end"});
  }
  return found;
}

std::chrono::nanoseconds Trajectory::duration() const noexcept {
  return from_seconds(duration_s_);
}

}  // namespace holdfast::sim
