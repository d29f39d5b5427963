// SPDX-License-Identifier: Apache-2.0
#include "bridge/camera_clock.hpp"

#include <algorithm>
#include <cmath>

namespace holdfast::bridge {
namespace {

constexpr double kBinNs = 1e9;
// Below this span jitter of a millisecond would read as hundreds of ppm: the drift stays as it was.
constexpr double kDriftSpanNs = 8e9;
// What an unknown quartz may drift, for the uncertainty before the drift is known.
constexpr double kUnknownDrift = 50e-6;

double as_ns(std::chrono::nanoseconds t) {
  return static_cast<double>(t.count());
}

}  // namespace

CameraClock::CameraClock(const CameraClockParameters& parameters) noexcept
    : parameters_(parameters) {
  reset();
}

void CameraClock::reset() noexcept {
  points_.fill(Point{});
  camera_origin_ = host_origin_ = t_last_ = {};
  sigma_ = parameters_.sigma_start;
  offset_ns_ = slope_ = 0;
  arrivals_ = 0;
}

bool CameraClock::add(std::chrono::nanoseconds t_camera,
                      std::chrono::nanoseconds t_arrival) noexcept {
  const auto t_sent = t_arrival - parameters_.known_delay;
  bool is_same_clock = true;
  if (arrivals_ > 0) {
    const double x_ns = as_ns(t_camera - camera_origin_);
    const double y_ns = as_ns(t_sent - host_origin_) - x_ns;
    is_same_clock = t_camera > t_last_ && y_ns - line(x_ns) >= -as_ns(parameters_.early_max);
    if (!is_same_clock) reset();
  }
  if (arrivals_ == 0) {
    camera_origin_ = t_camera;
    host_origin_ = t_sent;
  }
  const double x_ns = as_ns(t_camera - camera_origin_);
  keep_earliest(x_ns, as_ns(t_sent - host_origin_) - x_ns);
  t_last_ = t_camera;
  ++arrivals_;
  fit();
  return is_same_clock;
}

std::chrono::nanoseconds CameraClock::to_host(std::chrono::nanoseconds t_camera) const noexcept {
  if (arrivals_ == 0) return t_camera;
  const auto since_origin = t_camera - camera_origin_;
  return host_origin_ + since_origin +
         std::chrono::nanoseconds(std::llround(line(as_ns(since_origin))));
}

void CameraClock::keep_earliest(double x_ns, double y_ns) noexcept {
  const auto bin = static_cast<std::int64_t>(x_ns / kBinNs);
  Point& point = points_[static_cast<std::size_t>(bin % kBins)];
  if (point.bin != bin || y_ns < point.y_ns) point = {bin, x_ns, y_ns};
}

// The window's points in order of time.
int CameraClock::collect(Points& points) const noexcept {
  const auto newest = static_cast<std::int64_t>(as_ns(t_last_ - camera_origin_) / kBinNs);
  int n = 0;
  for (std::int64_t bin = std::max<std::int64_t>(0, newest - kBins + 1); bin <= newest; ++bin) {
    const Point& point = points_[static_cast<std::size_t>(bin % kBins)];
    if (point.bin == bin) points[static_cast<std::size_t>(n++)] = point;
  }
  return n;
}

namespace {

template <typename Point>
double slope_between(const Point& a, const Point& b) {
  return (b.y_ns - a.y_ns) / (b.x_ns - a.x_ns);
}

// Of all lines below the points the one with the least total distance to them: the edge of the
// lower convex hull under the mean of x. Overwrites the front of `points` with the hull.
template <typename Points>
double envelope_slope(Points& points, std::size_t n) {
  double mean_x = 0;
  for (std::size_t i = 0; i < n; ++i) mean_x += points[i].x_ns / static_cast<double>(n);
  std::size_t hull = 0;
  for (std::size_t i = 0; i < n; ++i) {
    while (hull >= 2 && slope_between(points[hull - 2], points[hull - 1]) >=
                            slope_between(points[hull - 1], points[i]))
      --hull;
    points[hull++] = points[i];
  }
  std::size_t edge = 1;
  while (edge + 1 < hull && points[edge].x_ns < mean_x) ++edge;
  return slope_between(points[edge - 1], points[edge]);
}

}  // namespace

void CameraClock::fit() noexcept {
  Points window;
  const auto n = static_cast<std::size_t>(collect(window));
  const double span_ns = window[n - 1].x_ns - window[0].x_ns;
  const bool is_drift_known = span_ns >= kDriftSpanNs;
  if (is_drift_known) {
    Points scratch = window;
    const double limit = parameters_.drift_max_ppm * 1e-6;
    slope_ = std::clamp(envelope_slope(scratch, n), -limit, limit);
  }
  offset_ns_ = window[0].y_ns - slope_ * window[0].x_ns;
  for (std::size_t i = 1; i < n; ++i)
    offset_ns_ = std::min(offset_ns_, window[i].y_ns - slope_ * window[i].x_ns);

  // Evidence against the line: how far the earliest arrivals stay above it, on average and, in case
  // the delay or the clock has just changed, in the newest two seconds.
  double mean_excess = 0;
  for (std::size_t i = 0; i < n; ++i)
    mean_excess += (window[i].y_ns - line(window[i].x_ns)) / static_cast<double>(n);
  double recent_excess = window[n - 1].y_ns - line(window[n - 1].x_ns);
  if (n > 1) recent_excess = std::min(recent_excess, window[n - 2].y_ns - line(window[n - 2].x_ns));
  const double start = as_ns(parameters_.sigma_start) / static_cast<double>(arrivals_);
  const double drift = is_drift_known ? 0 : kUnknownDrift * span_ns;
  const double floor = as_ns(parameters_.sigma_min);
  sigma_ = std::chrono::nanoseconds(
      std::llround(std::sqrt(floor * floor + mean_excess * mean_excess +
                             recent_excess * recent_excess + start * start + drift * drift)));
}

}  // namespace holdfast::bridge
