// SPDX-License-Identifier: Apache-2.0
// Any GigE Vision or USB3 Vision camera through Aravis: frames from a fixed pool, each with camera
// and host time stamps, and every fault reported as such. Nothing is allocated per frame; a faulty
// frame is reported, never repaired.
#pragma once

#include <chrono>
#include <cstddef>
#include <cstdint>
#include <functional>
#include <memory>
#include <optional>
#include <string>

#include <opencv2/core.hpp>

#include "rt/core/error.hpp"

namespace holdfast::bridge {

enum class PixelFormat : std::uint8_t {
  mono8,
  mono12,
  bayer_rg8,
  bayer_gb8,
  bayer_gr8,
  bayer_bg8,
  rgb8,
  bgr8
};

struct CameraParameters {
  std::string id;  ///< Aravis id, IP address or empty
  /// Without an id the camera is searched by it; with one, the camera there must have it. Both
  /// empty: the first camera found.
  std::string serial;
  PixelFormat pixel_format = PixelFormat::mono8;
  int width_px = 1920, height_px = 1080, offset_x_px = 0, offset_y_px = 0;
  double frame_rate_hz = 30;  ///< with a trigger: the highest rate of triggers to expect
  /// TriggerSource of FrameStart, as the camera names it, e.g. "Line1". Empty: free running, and
  /// any trigger that the camera was left with is switched off. With a trigger silence is no fault:
  /// no `silent` is reported, and `disconnected` only when the control channel is lost.
  std::string trigger_source;
  double exposure_us = 5000;
  std::optional<double> gain_db;         ///< absent: left as the camera has it
  std::optional<int> packet_size_bytes;  ///< GigE only; absent: negotiated
  int buffers = 8;
  int socket_buffer_bytes = 16 * 1024 * 1024;
  bool stamp_is_exposure_start = true;  ///< the camera stamps the start of exposure; false: its end
  /// From the end of exposure to the first packet's departure, by the camera's data sheet: one-way
  /// arrivals cannot tell it from a clock offset, so what is not given here shifts t_exposure.
  std::chrono::microseconds readout_delay{0};
  std::chrono::milliseconds frame_timeout{200};        ///< no buffer for this long: silent
  std::chrono::milliseconds disconnect_timeout{1000};  ///< silent for this long: disconnected
  std::chrono::milliseconds reconnect_min{100};        ///< backoff, doubled up to reconnect_max
  std::chrono::milliseconds reconnect_max{2000};
};

enum class CameraEvent : std::uint8_t {
  connected,
  frame,       ///< a complete frame
  incomplete,  ///< packets missing, or a size that is not the expected one
  gap,         ///< frame ids were skipped; `frames_missing` says how many
  silent,      ///< no buffer within frame_timeout; repeated every frame_timeout
  disconnected,
  time_invalid  ///< the camera's stamp repeats, goes back, or lies ahead of its own arrival; the
                ///< frame is withheld and the clock is learnt anew
};

struct CameraReport {
  CameraEvent event{};
  std::uint64_t frame_id = 0;  ///< 0: unknown (an incomplete frame may have lost it)
  /// gap: ids skipped and not reported as incomplete; 0 when the ids went back (the camera
  /// restarted), so that the number is not known.
  std::uint64_t frames_missing = 0;
  /// frame: by how many its id is ahead of the previous complete frame's; 0: unknown (the first
  /// since connecting, or the ids went back).
  std::uint64_t ids_advanced = 0;
  int buffer_status = 0;                  ///< incomplete: Aravis' ArvBufferStatus
  std::size_t received_bytes = 0;         ///< frame, incomplete of a wrong size: bytes of the image
  std::chrono::nanoseconds t_received{};  ///< host CLOCK_MONOTONIC, when the last packet was in
  std::chrono::nanoseconds t_camera{};    ///< the camera's own stamp
  std::chrono::nanoseconds t_exposure{};  ///< mid-exposure on host CLOCK_MONOTONIC, from t_camera
  std::chrono::nanoseconds clock_offset_sigma{};  ///< uncertainty of that conversion
  cv::Mat image;  ///< CV_8UC1, CV_16UC1 (mono12: 0..4095, unscaled) or CV_8UC3 BGR; in the pool,
                  ///< valid during the call only; empty unless event is frame
};

/// The camera that answers is not the one that was asked for.
class WrongCameraError : public InputError {
 public:
  WrongCameraError(const std::string& line, std::string serial)
      : InputError(line), found_serial(std::move(serial)) {}
  std::string found_serial;
};

struct CameraCounters {
  std::uint64_t frames = 0, incomplete = 0, missing = 0, disconnects = 0, reconnects = 0;
};

/// Opens the camera and delivers reports from its own thread until destroyed.
class CameraSource {
 public:
  using Callback =
      std::function<void(const CameraReport&)>;  ///< called on the camera thread; must not block
  /// Throws UnavailableError when the camera is not there, WrongCameraError when another is in its
  /// place, InputError when it refuses a parameter (naming the feature, the value, and the range
  /// the camera offers).
  CameraSource(const CameraParameters& parameters, Callback callback);
  ~CameraSource();
  CameraSource(const CameraSource&) = delete;
  CameraSource& operator=(const CameraSource&) = delete;
  [[nodiscard]] CameraCounters counters() const noexcept;
  [[nodiscard]] std::string description() const;  ///< vendor, model, serial, address

 private:
  struct Impl;
  std::unique_ptr<Impl> impl_;
};

/// How many GigE Vision and USB3 Vision cameras answer on this machine's interfaces. Takes up to a
/// second or two. Any thread, but not beside a CameraSource that is being constructed.
[[nodiscard]] std::size_t count_cameras();

}  // namespace holdfast::bridge
