// SPDX-License-Identifier: Apache-2.0
// A GigE Vision camera on the real network stack: Aravis' fake camera with our own GenICam
// description, pixels and clock, and with faults that can be switched while it streams.
// It exposes on a grid of its frame period or, with TriggerMode On, at each edge of the line that
// is wired to Line1 (or at TriggerSoftware), stamps the start of exposure on its own drifting
// clock, and renders each frame, ahead of time, for the middle of the exposure that its stamp
// tells.
#pragma once

#include <chrono>
#include <cstdint>
#include <functional>
#include <memory>
#include <string>

#include "tests/sim/frame_source.hpp"
#include "tests/sim/trigger_line.hpp"

namespace holdfast::sim {

struct VirtualCameraParameters {
  std::string interface = "127.0.0.1";  ///< name or address; one camera per address (UDP port 3956)
  std::string serial = "HOLDFAST-SIM";  ///< at most 15 characters
  bridge::PixelFormat format = bridge::PixelFormat::mono8;  ///< until a client sets another
  double frame_rate_hz = 30, exposure_us = 5000;            ///< likewise
  int packet_size_bytes = 8192;                             ///< likewise
  /// From the end of exposure to the first packet, as a data sheet would state it; longer only when
  /// the machine is slower.
  std::chrono::microseconds readout{2000};
  TriggerLine* line1 = nullptr;  ///< wired to Line1; must outlive the camera
  double clock_drift_ppm = 20;   ///< how much faster than the host's the camera's clock runs
  std::uint16_t first_frame_id = 65400;  ///< wraps soon, as Aravis' own fake camera does
};

/// What became of one exposure.
struct SentFrame {
  std::uint64_t frame_id = 0;
  std::chrono::nanoseconds t_mid_exposure{};  ///< CLOCK_MONOTONIC, the truth
  std::chrono::nanoseconds t_stamp{};         ///< the camera's own clock, start of exposure
  std::chrono::nanoseconds t_sent{};          ///< CLOCK_MONOTONIC, before the first packet
  std::uint64_t trigger = 0;                  ///< number of the pulse that began it; 0: none
  bool is_frozen = false, is_dropped = false, is_corrupt = false;
  View view;
};

class VirtualCamera {
 public:
  using OnFrame = std::function<void(const SentFrame&)>;  ///< on the device's thread

  /// Powers up. `source` must outlive the camera. Throws UnavailableError when the interface does
  /// not exist or has a camera already, InputError on a bad parameter.
  VirtualCamera(const VirtualCameraParameters& parameters, FrameSource& source,
                OnFrame on_frame = {});
  ~VirtualCamera();
  VirtualCamera(const VirtualCamera&) = delete;
  VirtualCamera& operator=(const VirtualCamera&) = delete;

  // Faults. Any thread. Each returns the CLOCK_MONOTONIC time from which on no exposure leaves
  // without it (the frame whose packets are already under way is untouched).
  std::chrono::nanoseconds freeze(bool on);   ///< the last image again, with new ids and stamps
  std::chrono::nanoseconds black(bool on);    ///< no light
  std::chrono::nanoseconds occlude(bool on);  ///< a hand over most of the view
  std::chrono::nanoseconds drop(bool on);     ///< no packet of a frame gets through; ids go on
  std::chrono::nanoseconds drop_next(int frames);
  std::chrono::nanoseconds corrupt_next(int frames);  ///< half of their packets are lost
  /// Frames leave this much later than exposed. Less delay than before discards what is queued.
  std::chrono::nanoseconds delay(std::chrono::milliseconds by);
  std::chrono::nanoseconds disconnect();  ///< the device vanishes from the network
  std::chrono::nanoseconds reconnect();   ///< and returns as after power-up: new clock, defaults
  /// A change of the source shows in the next exposure, even if that is already rendered.
  std::chrono::nanoseconds source_changed();

  [[nodiscard]] std::uint64_t frames() const noexcept;  ///< exposures since construction
  [[nodiscard]] bool is_connected() const;

 private:
  class Device;
  std::unique_ptr<Device> device_;
};

}  // namespace holdfast::sim
