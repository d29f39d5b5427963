// SPDX-License-Identifier: Apache-2.0
// Aravis' fake GigE Vision camera, powered: its sockets, its thread, its registers. Private to
// VirtualCamera, which knows what the pixels are.
#pragma once

#include <chrono>
#include <optional>
#include <string>

#include <arv.h>
#include <opencv2/core.hpp>

#include "bridge/camera_source.hpp"
#include "tests/sim/device_waker.hpp"

namespace holdfast::sim {

/// What stands in the registers after power-up, until a client writes others.
struct DeviceDefaults {
  cv::Size sensor_px;
  bridge::PixelFormat format = bridge::PixelFormat::mono8;
  double frame_rate_hz = 30, exposure_us = 5000;
  int packet_size_bytes = 8192;
};

/// What starts an exposure, as the client has set it.
enum class TriggerState : std::uint8_t { free_running, software, line1 };

class GigeDevice {
 public:
  /// How often fill is called while a trigger is awaited.
  static constexpr std::chrono::microseconds kTriggerGrid{5000};

  /// Throws UnavailableError when the interface does not exist or its UDP port 3956 is taken.
  GigeDevice(const std::string& interface, const std::string& serial,
             const DeviceDefaults& defaults);
  ~GigeDevice();
  GigeDevice(const GigeDevice&) = delete;
  GigeDevice& operator=(const GigeDevice&) = delete;

  /// `fill` is called with `self` for each frame, on the device's thread, until the destructor
  /// ends.
  void set_fill(ArvFakeCameraFillPattern fill, void* self) noexcept;

  // From within fill.
  /// The share of packets that are lost, 0..1, from the present frame on.
  void set_lost_share(double share) noexcept;
  /// The frame period that is set; empty when the register holds none.
  [[nodiscard]] std::optional<std::chrono::microseconds> period() noexcept;
  [[nodiscard]] TriggerState trigger() noexcept;
  /// True once for each time a client has executed TriggerSoftware.
  [[nodiscard]] bool take_software_trigger() noexcept;

 private:
  void write_defaults(const DeviceDefaults& defaults) noexcept;
  [[nodiscard]] guint32 read(guint32 address) const noexcept;

  ArvGvFakeCamera* camera_ = nullptr;
  ArvFakeCamera* registers_ = nullptr;     // camera_'s own
  std::optional<guint32> free_period_us_;  // set aside while triggered
  DeviceWaker waker_;
};

[[nodiscard]] std::optional<bridge::PixelFormat> pixel_format_of(guint32 code) noexcept;

}  // namespace holdfast::sim
