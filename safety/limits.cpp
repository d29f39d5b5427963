// SPDX-License-Identifier: Apache-2.0
#include "safety/limits.hpp"

#include <array>
#include <numbers>
#include <sstream>
#include <string_view>

namespace holdfast::safety {
namespace {

struct Range {
  std::string_view name;
  std::string_view unit;
  double value;
  double lowest;
  double highest;
};

double milliseconds(Duration duration) {
  return std::chrono::duration<double, std::milli>(duration).count();
}

std::array<Range, 23> ranges(const Limits& limits) {
  return {{
      {"frame_period", "ms", milliseconds(limits.frame_period), 1, 1000},
      {"frame_lateness", "ms", milliseconds(limits.frame_lateness), 0.1, 500},
      {"estimate_age_max", "ms", milliseconds(limits.estimate_age_max), 1, 2000},
      {"pose_validity", "ms", milliseconds(limits.pose_validity), 1, 20},
      {"pose_lead", "ms", milliseconds(limits.pose_lead), 0, 10},
      {"robot_silence_max", "ms", milliseconds(limits.robot_silence_max), 1, 1000},
      {"loop_lateness_max", "ms", milliseconds(limits.loop_lateness_max), 0.01, 20},
      {"clock_step_max", "ms", milliseconds(limits.clock_step_max), 0.001, 100},
      {"frame_future_max", "ms", milliseconds(limits.frame_future_max), 0, 20},
      {"hold_max", "ms", milliseconds(limits.hold_max), 1, 5000},
      {"hold_recovery", "ms", milliseconds(limits.hold_recovery), 1, 5000},
      {"confirm_min", "ms", milliseconds(limits.confirm_min), 50, 10'000},
      {"confirm_max", "ms", milliseconds(limits.confirm_max), 100, 60'000},
      {"drift_max_mm", "mm", limits.drift_max_mm, 0.001, 5},
      {"displacement_max_mm", "mm", limits.displacement_max_mm, 0.01, 100},
      {"rotation_max_rad", "rad", limits.rotation_max_rad, 0.001, std::numbers::pi / 2},
      {"speed_max_mm_per_s", "mm/s", limits.speed_max_mm_per_s, 0.1, 500},
      {"sigma_target_max_mm", "mm", limits.sigma_target_max_mm, 0.001, 5},
      {"inlier_spread_min", "of 1", limits.inlier_spread_min, 0.01, 1},
      {"zoom_tolerance", "of zoom", limits.zoom_tolerance, 0.0001, 0.1},
      {"focus_tolerance_mm", "mm", limits.focus_tolerance_mm, 0.001, 10},
      {"scale_mismatch_max", "of 1", limits.scale_mismatch_max, 0.001, 0.2},
      {"optics_age_max", "ms", milliseconds(limits.optics_age_max), 1, 500},
  }};
}

std::optional<std::string> outside(const Range& range) {
  if (range.value >= range.lowest && range.value <= range.highest) return std::nullopt;  // NaN: no
  std::ostringstream text;
  text << range.name << " = " << range.value << ' ' << range.unit << ": must lie within "
       << range.lowest << " and " << range.highest << ' ' << range.unit;
  return text.str();
}

/// Two limits of which the first must not exceed the second, and why.
struct Order {
  std::string_view smaller_name;
  double smaller;
  std::string_view larger_name;
  double larger;
  std::string_view unit;
  std::string_view why;
};

std::array<Order, 9> orders(const Limits& limits) {
  const double period = milliseconds(limits.frame_period);
  const double deadline = milliseconds(limits.frame_period + limits.frame_lateness);
  const double estimate_age = milliseconds(limits.estimate_age_max);
  const double recovery = milliseconds(limits.hold_recovery);
  const double validity = milliseconds(limits.pose_validity);
  return {{
      {"frame_lateness", milliseconds(limits.frame_lateness), "frame_period", period, "ms",
       "a whole missing frame must be noticed before the one after it is due"},
      {"frame_future_max", milliseconds(limits.frame_future_max), "frame_period", period, "ms",
       "a stamp a frame ahead must be noticed"},
      {"frame_period + frame_lateness", deadline, "estimate_age_max", estimate_age, "ms",
       "each estimate must last until the next frame's deadline"},
      {"loop_lateness_max", milliseconds(limits.loop_lateness_max), "pose_validity", validity, "ms",
       "a pose must outlive the lateness that is tolerated"},
      {"estimate_age_max", estimate_age, "hold_recovery", recovery, "ms",
       "a hold must not end on an image exposed before its cause was gone"},
      {"hold_recovery", recovery, "hold_max", milliseconds(limits.hold_max), "ms",
       "a hold could never end by recovery"},
      {"confirm_min", milliseconds(limits.confirm_min), "confirm_max",
       milliseconds(limits.confirm_max), "ms", "a stop could never be confirmed"},
      {"drift_max_mm", limits.drift_max_mm, "displacement_max_mm", limits.displacement_max_mm, "mm",
       "the error of a motion must be limited below the motion itself"},
      {"sigma_target_max_mm", limits.sigma_target_max_mm, "displacement_max_mm",
       limits.displacement_max_mm, "mm",
       "the uncertainty of a motion must be limited below the motion itself"},
  }};
}

std::optional<std::string> contradicts(const Order& order) {
  if (order.smaller <= order.larger) return std::nullopt;
  std::ostringstream text;
  text << order.smaller_name << " = " << order.smaller << ' ' << order.unit << ": must not exceed "
       << order.larger_name << " = " << order.larger << ' ' << order.unit << " (" << order.why
       << ')';
  return text.str();
}

}  // namespace

std::optional<std::string> invalid_limit(const Limits& limits) {
  for (const Range& range : ranges(limits)) {
    if (auto message = outside(range)) return message;
  }
  const Range inliers{"inliers_min", "inliers", static_cast<double>(limits.inliers_min), 6,
                      100'000};
  if (auto message = outside(inliers)) return message;
  for (const Order& order : orders(limits)) {
    if (auto message = contradicts(order)) return message;
  }
  return std::nullopt;
}

}  // namespace holdfast::safety
