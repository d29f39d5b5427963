// SPDX-License-Identifier: Apache-2.0
// Two cameras on one trigger line as a source of simultaneous pairs. What is handed over as a pair
// was exposed together, by both cameras' own stamps; a frame without its partner, or with one
// exposed at another time, is reported and never paired. Takes no decision beyond that.
//
// How frames find each other: each camera delivers in order, with mid-exposure on the host's clock
// (camera_source.hpp). The oldest two of either side are a pair when their mid-exposures are no
// further apart than skew_max; further than that, but less than half a trigger period, they are one
// trigger's, skewed; else the older one has no partner. Beside the stamps the frame ids are
// watched: from pair to pair both must advance alike, but for frames that were reported missing.
// Constant delays of a camera (readout_delay) that are not configured show as skew.
//
// No program of ours reads from it yet: `calibrate` and `reconstruct` take image files, and the
// daemon has one camera.
#pragma once

#include <memory>

#include "bridge/camera_source.hpp"

namespace holdfast::bridge {

struct StereoParameters {
  /// Both need the same frame_rate_hz, the highest rate of triggers, and a trigger_source.
  CameraParameters left, right;
  std::chrono::microseconds skew_max{2000};        ///< below half a trigger period
  std::chrono::milliseconds partner_timeout{200};  ///< waited for the other side's frame
  int pairs = 3;  ///< frames each side may have waiting for their partner, 1..16
};

enum class StereoEvent : std::uint8_t {
  pair,
  left_missing,   ///< a right frame whose left one did not come in time; `right` is that frame
  right_missing,  ///< the reverse
  skewed,         ///< one trigger's two frames, `skew` apart
  slipped,        ///< simultaneous by their stamps, but one side's ids have advanced further
  left_event,     ///< `left` is the camera's own report: fault, connected, disconnected
  right_event
};

struct StereoReport {
  StereoEvent event{};
  std::chrono::nanoseconds skew{};  ///< left mid-exposure - right; pair, skewed, slipped
  /// pair: both with their images, in our pool, valid during the call only. Otherwise what there
  /// is, without images.
  CameraReport left, right;
};

struct StereoCounters {
  std::uint64_t pairs = 0, left_missing = 0, right_missing = 0, skewed = 0, slipped = 0;
};

/// Opens both cameras and delivers reports, one at a time, from its own threads until destroyed.
/// Nothing is allocated per pair.
class StereoSource {
 public:
  using Callback = std::function<void(const StereoReport&)>;  ///< must not block
  /// Throws InputError when the two are not told apart by id or serial, are not alike in size,
  /// format and rate, lack a trigger, or are swapped (each has the other's serial number); and what
  /// CameraSource throws, naming the side.
  StereoSource(const StereoParameters& parameters, Callback callback);
  ~StereoSource();
  StereoSource(const StereoSource&) = delete;
  StereoSource& operator=(const StereoSource&) = delete;

  [[nodiscard]] StereoCounters counters() const noexcept;
  [[nodiscard]] CameraCounters left_counters() const noexcept;
  [[nodiscard]] CameraCounters right_counters() const noexcept;

 private:
  struct Impl;
  std::unique_ptr<Impl> impl_;
};

}  // namespace holdfast::bridge
