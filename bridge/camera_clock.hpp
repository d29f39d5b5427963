// SPDX-License-Identifier: Apache-2.0
// The camera's clock on the host's: offset and drift from the lower envelope of the arrival delays.
// A packet can be late but never early, so the line that touches the arrivals from below is the
// clock; what lies above it is the network's and the scheduler's doing. One-way arrivals cannot
// tell a constant delay from an offset: the constant part must be given.
// Pure: no clock is read, nothing is allocated. One thread at a time.
#pragma once

#include <array>
#include <chrono>
#include <cstdint>

namespace holdfast::bridge {

struct CameraClockParameters {
  std::chrono::nanoseconds known_delay{0};     ///< from the camera's stamp to the earliest arrival
  double drift_max_ppm = 200;                  ///< a steeper envelope is an artefact, not a quartz
  std::chrono::nanoseconds sigma_min{20'000};  ///< never claim better than this
  std::chrono::nanoseconds sigma_start{5'000'000};  ///< after one arrival; shrinks as 1/n
  std::chrono::nanoseconds early_max{
      20'000'000};  ///< an arrival this much too early is a new clock
};

class CameraClock {
 public:
  explicit CameraClock(const CameraClockParameters& parameters = {}) noexcept;

  /// Takes one arrival: the camera's stamp and the host's time, both monotonic and in order.
  /// Returns false when the stamp cannot belong to the clock known so far (it does not increase, or
  /// the frame would have arrived before it was sent): the clock then starts anew from this
  /// arrival.
  bool add(std::chrono::nanoseconds t_camera, std::chrono::nanoseconds t_arrival) noexcept;

  /// Forgets everything.
  void reset() noexcept;

  /// A camera stamp on the host's clock. Before the first arrival: the stamp itself.
  [[nodiscard]] std::chrono::nanoseconds to_host(std::chrono::nanoseconds t_camera) const noexcept;
  /// Standard uncertainty of to_host() for a recent stamp, without that of known_delay.
  [[nodiscard]] std::chrono::nanoseconds sigma() const noexcept { return sigma_; }
  /// How much faster the host's clock runs than the camera's, in parts per million.
  [[nodiscard]] double drift_ppm() const noexcept { return slope_ * 1e6; }
  [[nodiscard]] std::uint64_t arrivals() const noexcept { return arrivals_; }

 private:
  // Per second of camera time the earliest arrival; a window of the newest kBins seconds.
  static constexpr std::int64_t kBins = 64;
  struct Point {
    std::int64_t bin = -1;  ///< second of camera time since the first arrival; -1: empty
    double x_ns = 0;        ///< camera time since the first arrival
    double y_ns = 0;        ///< host minus camera, against the first arrival
  };
  using Points = std::array<Point, static_cast<std::size_t>(kBins)>;

  void keep_earliest(double x_ns, double y_ns) noexcept;
  [[nodiscard]] int collect(Points& points) const noexcept;
  void fit() noexcept;
  [[nodiscard]] double line(double x_ns) const noexcept { return offset_ns_ + slope_ * x_ns; }

  CameraClockParameters parameters_;
  Points points_{};
  std::chrono::nanoseconds camera_origin_{}, host_origin_{}, t_last_{}, sigma_{};
  double offset_ns_ = 0, slope_ = 0;
  std::uint64_t arrivals_ = 0;
};

}  // namespace holdfast::bridge
