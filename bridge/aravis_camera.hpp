// SPDX-License-Identifier: Apache-2.0
// One connection to one camera through Aravis: found, configured, streaming into a fixed pool of
// buffers. Private to CameraSource, which adds the thread, the reports and the reconnecting.
#pragma once

#include <atomic>
#include <chrono>
#include <cstdint>
#include <memory>
#include <string>
#include <vector>

#include <arv.h>

#include "bridge/camera_source.hpp"
#include "bridge/frame_ids.hpp"

namespace holdfast::bridge {

struct GObjectUnref {
  void operator()(gpointer object) const noexcept {
    if (object != nullptr) g_object_unref(object);
  }
};
template <typename Object>
using GObjectPtr = std::unique_ptr<Object, GObjectUnref>;

class AravisCamera {
 public:
  /// Finds, configures and starts the camera. Throws UnavailableError when it is not there, is
  /// someone else's, or does not answer; InputError when it refuses a parameter.
  explicit AravisCamera(const CameraParameters& parameters);
  /// May take seconds when the camera no longer answers.
  ~AravisCamera();
  AravisCamera(const AravisCamera&) = delete;
  AravisCamera& operator=(const AravisCamera&) = delete;

  /// The next buffer, complete or not; null when none came in time. One thread.
  [[nodiscard]] ArvBuffer* wait(std::chrono::microseconds timeout) noexcept;
  /// Every buffer that wait() gave must come back.
  void give_back(ArvBuffer* buffer) noexcept;

  /// The camera said, or its silence on the control channel said, that it is no longer ours.
  [[nodiscard]] bool is_control_lost() const noexcept {
    return control_lost_.load(std::memory_order_relaxed);  // a lone flag, orders nothing
  }
  [[nodiscard]] std::chrono::nanoseconds exposure() const noexcept { return exposure_; }
  [[nodiscard]] FrameIdWidth frame_id_width() const noexcept { return frame_id_width_; }
  [[nodiscard]] const std::string& description() const noexcept { return description_; }

 private:
  void open(const CameraParameters& parameters);
  void describe();
  void make_stream(const CameraParameters& parameters);

  GObjectPtr<ArvCamera> camera_;
  std::vector<std::uint8_t> memory_;  // the buffers' pixels: outlives the stream below
  GObjectPtr<ArvStream> stream_;
  std::atomic<bool> control_lost_{false};
  std::chrono::nanoseconds exposure_{};
  FrameIdWidth frame_id_width_ = FrameIdWidth::bits16;
  std::string description_;
};

}  // namespace holdfast::bridge
