// SPDX-License-Identifier: Apache-2.0
#include "bridge/aravis_camera.hpp"

#include <algorithm>
#include <mutex>

#include <fmt/core.h>

#include "bridge/camera_features.hpp"
#include "bridge/pixel_conversion.hpp"
#include "rt/core/error.hpp"

namespace holdfast::bridge {
namespace {

// A resent packet that has not come within this time will not: on a direct link it takes < 1 ms.
constexpr guint kPacketTimeoutUs = 2000;
// An incomplete frame holds back the complete ones behind it: give it up after a frame period.
constexpr double kFrameRetentionPeriods = 1.0;

// Aravis keeps one global device list.
std::mutex device_list_mutex;

std::string text(const char* c_string) {
  return c_string != nullptr ? c_string : "?";
}

std::string id_of_serial(const std::string& serial) {
  const std::lock_guard lock(device_list_mutex);
  arv_update_device_list();
  std::string seen;
  for (unsigned i = 0; i < arv_get_n_devices(); ++i) {
    const std::string found = text(arv_get_device_serial_nbr(i));
    if (found == serial) return arv_get_device_id(i);
    seen += (seen.empty() ? "" : ", ") + found;
  }
  throw UnavailableError(fmt::format("no camera with serial number {}; found: {}", serial,
                                     seen.empty() ? "none" : seen));
}

void on_control_lost(ArvDevice* /*device*/, gpointer flag) {
  static_cast<std::atomic<bool>*>(flag)->store(true, std::memory_order_relaxed);
}

}  // namespace

AravisCamera::AravisCamera(const CameraParameters& parameters) {
  open(parameters);
  exposure_ = write_features(camera_.get(), parameters);
  make_stream(parameters);
  describe();
  GError* error = nullptr;
  arv_camera_set_acquisition_mode(camera_.get(), ARV_ACQUISITION_MODE_CONTINUOUS, &error);
  throw_if(error, "camera feature AcquisitionMode");
  arv_camera_start_acquisition(camera_.get(), &error);
  throw_if(error, "camera: start of acquisition");
}

AravisCamera::~AravisCamera() {
  if (camera_ == nullptr) return;
  g_signal_handlers_disconnect_by_data(arv_camera_get_device(camera_.get()), &control_lost_);
  // A lost camera would only make us wait for its answer.
  if (!is_control_lost()) arv_camera_stop_acquisition(camera_.get(), nullptr);
}

void AravisCamera::open(const CameraParameters& parameters) {
  std::string id = parameters.id;
  if (id.empty() && !parameters.serial.empty()) id = id_of_serial(parameters.serial);
  GError* error = nullptr;
  {
    const std::lock_guard lock(device_list_mutex);
    if (id.empty()) arv_update_device_list();
    camera_.reset(arv_camera_new(id.empty() ? nullptr : id.c_str(), &error));
  }
  if (camera_ == nullptr) {
    const std::string reason = error != nullptr ? error->message : "no answer";
    g_clear_error(&error);
    throw UnavailableError(
        fmt::format("camera {}: {}", id.empty() ? "(the first found)" : id, reason));
  }
  ArvDevice* device = arv_camera_get_device(camera_.get());
  if (ARV_IS_GV_DEVICE(device) && !arv_gv_device_is_controller(ARV_GV_DEVICE(device)))
    throw UnavailableError(fmt::format("camera {}: another program controls it", id));
  const std::string found = text(arv_camera_get_device_serial_number(camera_.get(), nullptr));
  if (!parameters.serial.empty() && found != parameters.serial)
    throw WrongCameraError(
        fmt::format("camera {}: has serial number {}, not {}", id, found, parameters.serial),
        found);
  g_signal_connect(device, "control-lost", G_CALLBACK(on_control_lost), &control_lost_);
}

void AravisCamera::describe() {
  ArvCamera* camera = camera_.get();
  std::string address = "USB";
  ArvDevice* device = arv_camera_get_device(camera);
  if (ARV_IS_GV_DEVICE(device)) {
    GSocketAddress* socket = arv_gv_device_get_device_address(ARV_GV_DEVICE(device));
    GInetAddress* inet = g_inet_socket_address_get_address(G_INET_SOCKET_ADDRESS(socket));
    const std::unique_ptr<char, decltype(&g_free)> shown(g_inet_address_to_string(inet), g_free);
    address = fmt::format("{}, packets of {} bytes", shown.get(),
                          arv_camera_gv_get_packet_size(camera, nullptr));
  }
  description_ =
      fmt::format("{} {}, serial {}, {}", text(arv_camera_get_vendor_name(camera, nullptr)),
                  text(arv_camera_get_model_name(camera, nullptr)),
                  text(arv_camera_get_device_serial_number(camera, nullptr)), address);
}

void AravisCamera::make_stream(const CameraParameters& parameters) {
  GError* error = nullptr;
  ArvCamera* camera = camera_.get();
  const bool is_gige = arv_camera_is_gv_device(camera) != FALSE;
  if (is_gige && parameters.packet_size_bytes) {
    arv_camera_gv_set_packet_size_adjustment(camera, ARV_GV_PACKET_SIZE_ADJUSTMENT_NEVER);
    arv_camera_gv_set_packet_size(camera, *parameters.packet_size_bytes, &error);
    throw_if(error,
             fmt::format("camera feature GevSCPSPacketSize: {}", *parameters.packet_size_bytes));
  }
  // The kernel hands out blocks of its packet ring only when full or after 5 ms: the plain socket
  // delivers the last packet at once, and needs no privilege.
  if (is_gige)
    arv_camera_gv_set_stream_options(camera, ARV_GV_STREAM_OPTION_PACKET_SOCKET_DISABLED);

  const std::size_t payload = arv_camera_get_payload(camera, &error);
  throw_if(error, "camera feature PayloadSize");
  const std::size_t expected = row_bytes(parameters.pixel_format, parameters.width_px) *
                               static_cast<std::size_t>(parameters.height_px);
  if (payload < expected)
    throw InputError(
        fmt::format("camera feature PayloadSize: {} bytes, the image needs {}", payload, expected));

  stream_.reset(arv_camera_create_stream(camera, nullptr, nullptr, &error));
  throw_if(error, "camera: stream");
  if (ARV_IS_GV_STREAM(stream_.get())) {
    const double period_us = 1e6 / parameters.frame_rate_hz;
    g_object_set(stream_.get(), "socket-buffer", ARV_GV_STREAM_SOCKET_BUFFER_FIXED,
                 "socket-buffer-size", parameters.socket_buffer_bytes, "packet-timeout",
                 kPacketTimeoutUs, "frame-retention",
                 static_cast<guint>(kFrameRetentionPeriods * period_us), nullptr);
    const gint64 extended =
        arv_camera_is_feature_available(camera, "GevGVSPExtendedIDMode", nullptr)
            ? arv_camera_get_integer(camera, "GevGVSPExtendedIDMode", nullptr)
            : 0;
    frame_id_width_ = extended != 0 ? FrameIdWidth::bits64 : FrameIdWidth::bits16;
  } else {
    frame_id_width_ = FrameIdWidth::bits64;
  }
  memory_.assign(payload * static_cast<std::size_t>(parameters.buffers), 0);  // also: prefaulted
  for (int i = 0; i < parameters.buffers; ++i)
    arv_stream_push_buffer(
        stream_.get(),
        arv_buffer_new(payload, memory_.data() + payload * static_cast<std::size_t>(i)));
}

ArvBuffer* AravisCamera::wait(std::chrono::microseconds timeout) noexcept {
  return arv_stream_timeout_pop_buffer(stream_.get(), static_cast<guint64>(timeout.count()));
}

void AravisCamera::give_back(ArvBuffer* buffer) noexcept {
  // A frame whose leader is lost keeps what its buffer held before: make that recognisable.
  arv_buffer_set_frame_id(buffer, 0);
  arv_buffer_set_timestamp(buffer, 0);
  arv_stream_push_buffer(stream_.get(), buffer);
}

std::size_t count_cameras() {
  arv_update_device_list();
  return arv_get_n_devices();
}

}  // namespace holdfast::bridge
