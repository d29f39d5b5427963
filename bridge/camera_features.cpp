// SPDX-License-Identifier: Apache-2.0
#include "bridge/camera_features.hpp"

#include <cmath>
#include <memory>

#include <fmt/core.h>

#include "bridge/pixel_conversion.hpp"
#include "rt/core/error.hpp"

namespace holdfast::bridge {
namespace {

// What the camera makes of a frame rate may differ from what was asked by this much.
constexpr double kFrameRateTolerance = 0.01;

struct GFree {
  void operator()(gpointer memory) const noexcept { g_free(memory); }
};

class ErrorSlot {
 public:
  ErrorSlot() = default;
  ErrorSlot(const ErrorSlot&) = delete;
  ErrorSlot& operator=(const ErrorSlot&) = delete;
  ~ErrorSlot() { g_clear_error(&error_); }
  GError** out() noexcept { return &error_; }
  void check(const std::string& what) { throw_if(std::exchange(error_, nullptr), what); }

 private:
  GError* error_ = nullptr;
};

void write_pixel_format(ArvCamera* camera, PixelFormat format) {
  ErrorSlot error;
  const std::string wanted(genicam_name(format));
  guint n = 0;
  const std::unique_ptr<const char*, GFree> offered(
      arv_camera_dup_available_pixel_formats_as_strings(camera, &n, error.out()));
  error.check("PixelFormat");
  std::string list;
  bool is_offered = false;
  for (guint i = 0; i < n; ++i) {
    const std::string name = offered.get()[i];
    is_offered = is_offered || name == wanted;
    list += (list.empty() ? "" : ", ") + name;
  }
  if (!is_offered)
    throw InputError(fmt::format("camera feature PixelFormat: {} is not one of those offered: {}",
                                 wanted, list));
  arv_camera_set_pixel_format_from_string(camera, wanted.c_str(), error.out());
  error.check(fmt::format("camera feature PixelFormat: {}", wanted));
}

void write_integer(ArvCamera* camera, const char* feature, gint64 value) {
  ErrorSlot error;
  gint64 lowest = 0, highest = 0;
  arv_camera_get_integer_bounds(camera, feature, &lowest, &highest, error.out());
  error.check(fmt::format("camera feature {}", feature));
  const gint64 step =
      std::max<gint64>(1, arv_camera_get_integer_increment(camera, feature, nullptr));
  if (value < lowest || value > highest || (value - lowest) % step != 0)
    throw InputError(fmt::format("camera feature {}: {} is outside {}..{} in steps of {}", feature,
                                 value, lowest, highest, step));
  arv_camera_set_integer(camera, feature, value, error.out());
  error.check(fmt::format("camera feature {}: {} refused; offered {}..{}", feature, value, lowest,
                          highest));
}

void write_region(ArvCamera* camera, const CameraParameters& parameters) {
  const bool has_offset = arv_camera_is_region_offset_available(camera, nullptr) != FALSE;
  if (has_offset) {  // the offset bounds the size: full freedom for the size first
    write_integer(camera, "OffsetX", 0);
    write_integer(camera, "OffsetY", 0);
  } else if (parameters.offset_x_px != 0 || parameters.offset_y_px != 0) {
    throw InputError(fmt::format("camera feature OffsetX, OffsetY: {}, {}: not offered",
                                 parameters.offset_x_px, parameters.offset_y_px));
  }
  write_integer(camera, "Width", parameters.width_px);
  write_integer(camera, "Height", parameters.height_px);
  if (has_offset) {
    write_integer(camera, "OffsetX", parameters.offset_x_px);
    write_integer(camera, "OffsetY", parameters.offset_y_px);
  }
}

void require_within(const char* feature, double value, double lowest, double highest,
                    const char* unit) {
  if (!(value >= lowest && value <= highest))
    throw InputError(fmt::format("camera feature {}: {:g} {} is outside {:g}..{:g} {}", feature,
                                 value, unit, lowest, highest, unit));
}

std::chrono::nanoseconds write_exposure(ArvCamera* camera, double exposure_us) {
  ErrorSlot error;
  if (arv_camera_is_exposure_auto_available(camera, nullptr))
    arv_camera_set_exposure_time_auto(camera, ARV_AUTO_OFF, nullptr);
  double lowest = 0, highest = 0;
  arv_camera_get_exposure_time_bounds(camera, &lowest, &highest, error.out());
  error.check("camera feature ExposureTime");
  require_within("ExposureTime", exposure_us, lowest, highest, "us");
  arv_camera_set_exposure_time(camera, exposure_us, error.out());
  error.check(fmt::format("camera feature ExposureTime: {:g} us refused", exposure_us));
  const double taken_us = arv_camera_get_exposure_time(camera, error.out());
  error.check("camera feature ExposureTime");
  return std::chrono::nanoseconds(std::llround(taken_us * 1e3));
}

void write_gain(ArvCamera* camera, double gain_db) {
  ErrorSlot error;
  if (arv_camera_is_gain_auto_available(camera, nullptr))
    arv_camera_set_gain_auto(camera, ARV_AUTO_OFF, nullptr);
  double lowest = 0, highest = 0;
  arv_camera_get_gain_bounds(camera, &lowest, &highest, error.out());
  error.check("camera feature Gain");
  require_within("Gain", gain_db, lowest, highest, "dB");
  arv_camera_set_gain(camera, gain_db, error.out());
  error.check(fmt::format("camera feature Gain: {:g} dB refused", gain_db));
}

void write_frame_rate(ArvCamera* camera, double frame_rate_hz) {
  ErrorSlot error;
  double lowest = 0, highest = 0;
  arv_camera_get_frame_rate_bounds(camera, &lowest, &highest, error.out());
  error.check("camera feature AcquisitionFrameRate");
  require_within("AcquisitionFrameRate", frame_rate_hz, lowest, highest, "Hz");
  arv_camera_set_frame_rate(camera, frame_rate_hz, error.out());
  error.check(fmt::format("camera feature AcquisitionFrameRate: {:g} Hz refused", frame_rate_hz));
  const double taken_hz = arv_camera_get_frame_rate(camera, error.out());
  error.check("camera feature AcquisitionFrameRate");
  if (!(std::abs(taken_hz - frame_rate_hz) <= kFrameRateTolerance * frame_rate_hz))
    throw InputError(fmt::format(
        "camera feature AcquisitionFrameRate: {:g} Hz was asked, the camera gives {:g} Hz",
        frame_rate_hz, taken_hz));
}

void write_trigger(ArvCamera* camera, const std::string& source) {
  ErrorSlot error;
  if (!source.empty()) {
    arv_camera_set_trigger(camera, source.c_str(), error.out());
    error.check(fmt::format("camera feature TriggerSource: {}", source));
  } else if (arv_camera_is_feature_available(camera, "TriggerMode", nullptr)) {
    arv_camera_clear_triggers(camera, error.out());
    error.check("camera feature TriggerMode: Off");
  }
}

}  // namespace

void throw_if(GError* error, const std::string& what) {
  if (error == nullptr) return;
  const std::string line = what + ": " + error->message;
  const bool is_silent =
      error->domain == ARV_DEVICE_ERROR &&
      (error->code == ARV_DEVICE_ERROR_TIMEOUT || error->code == ARV_DEVICE_ERROR_NOT_CONNECTED ||
       error->code == ARV_DEVICE_ERROR_NOT_FOUND ||
       error->code == ARV_DEVICE_ERROR_NOT_CONTROLLER ||
       error->code == ARV_DEVICE_ERROR_PROTOCOL_ERROR_ACCESS_DENIED ||
       error->code == ARV_DEVICE_ERROR_PROTOCOL_ERROR_BUSY);
  g_error_free(error);
  if (is_silent) throw UnavailableError(line);
  throw InputError(line);
}

std::chrono::nanoseconds write_features(ArvCamera* camera, const CameraParameters& parameters) {
  write_pixel_format(camera, parameters.pixel_format);
  write_region(camera, parameters);
  const auto exposure = write_exposure(camera, parameters.exposure_us);
  if (parameters.gain_db) write_gain(camera, *parameters.gain_db);
  write_trigger(camera, parameters.trigger_source);
  if (parameters.trigger_source.empty()) write_frame_rate(camera, parameters.frame_rate_hz);
  return exposure;
}

}  // namespace holdfast::bridge
