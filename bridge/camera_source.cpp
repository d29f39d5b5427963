// SPDX-License-Identifier: Apache-2.0
#include "bridge/camera_source.hpp"

#include <algorithm>
#include <atomic>
#include <condition_variable>
#include <ctime>
#include <mutex>
#include <thread>

#include <fmt/core.h>

#include "bridge/aravis_camera.hpp"
#include "bridge/camera_clock.hpp"
#include "bridge/frame_ids.hpp"
#include "bridge/pixel_conversion.hpp"
#include "rt/core/error.hpp"

namespace holdfast::bridge {
namespace {

using std::chrono::nanoseconds;

// How often the thread looks up from waiting: bounds the reaction to a lost camera and to the end.
constexpr std::chrono::milliseconds kWaitSlice{20};

nanoseconds now_on(clockid_t clock) noexcept {
  timespec t{};
  clock_gettime(clock, &t);
  return std::chrono::seconds(t.tv_sec) + nanoseconds(t.tv_nsec);
}

CameraParameters validated(const CameraParameters& parameters) {
  const auto require = [](bool is_valid, const char* what) {
    if (!is_valid) throw InputError(fmt::format("camera: {}", what));
  };
  require(parameters.width_px > 0 && parameters.height_px > 0, "width and height must be positive");
  require(parameters.frame_rate_hz > 0, "frame rate must be positive (Hz)");
  require(parameters.exposure_us > 0, "exposure must be positive (us)");
  require(parameters.buffers >= 2 && parameters.buffers <= 256, "buffers must be 2..256");
  require(parameters.socket_buffer_bytes > 0, "socket buffer must be positive (bytes)");
  require(parameters.frame_timeout.count() > 0, "frame timeout must be positive (ms)");
  require(parameters.disconnect_timeout >= parameters.frame_timeout,
          "disconnect timeout must not be below the frame timeout (ms)");
  require(
      parameters.reconnect_min.count() > 0 && parameters.reconnect_max >= parameters.reconnect_min,
      "reconnect backoff must be positive and its maximum not below its minimum (ms)");
  return parameters;
}

// The leader packet's arrival on CLOCK_MONOTONIC: Aravis stamps it with CLOCK_REALTIME.
nanoseconds first_packet_time(ArvBuffer* buffer, nanoseconds t_received) noexcept {
  const nanoseconds leader(static_cast<std::int64_t>(arv_buffer_get_system_timestamp(buffer)));
  const nanoseconds age = now_on(CLOCK_REALTIME) - leader;
  const bool is_plausible = age >= nanoseconds(0) && age < std::chrono::seconds(1);
  return is_plausible ? t_received - age : t_received;
}

}  // namespace

struct CameraSource::Impl {
  Impl(const CameraParameters& given, Callback report_to)
      : parameters(validated(given)),
        callback(std::move(report_to)),
        convert(parameters.pixel_format, parameters.width_px, parameters.height_px),
        camera(std::make_unique<AravisCamera>(parameters)) {
    describe();
    thread = std::thread([this] { run(); });
  }
  ~Impl() {
    {
      const std::lock_guard lock(stop_mutex);
      stop = true;
    }
    stop_changed.notify_all();
    thread.join();
  }
  Impl(const Impl&) = delete;
  Impl& operator=(const Impl&) = delete;

  void run();
  void begin_stream();
  void receive();
  void take(ArvBuffer* buffer, nanoseconds t_received);
  void take_complete(ArvBuffer* buffer, CameraReport& report);
  void report_gap(const CameraReport& frame);
  void watch_silence();
  void lose();
  void reconnect();
  void describe();
  void report_event(CameraEvent event);
  bool sleep_unless_stopped(std::chrono::milliseconds duration);

  const CameraParameters parameters;
  const Callback callback;
  PixelConversion convert;
  std::unique_ptr<AravisCamera> camera;  // null while disconnected; the camera thread's own

  // State of the stream, the camera thread's own.
  CameraClock clock;
  std::uint64_t last_id = 0, incomplete_since_last_id = 0;
  nanoseconds t_last_stamp{}, t_last_buffer{}, t_silence_reported{};
  std::chrono::milliseconds backoff{};

  std::atomic<std::uint64_t> frames{0}, incomplete{0}, missing{0}, disconnects{0}, reconnects{0};
  mutable std::mutex description_mutex;
  std::string shown_description;
  std::mutex stop_mutex;
  std::condition_variable stop_changed;
  bool stop = false;  // guarded by stop_mutex
  std::thread thread;
};

void CameraSource::Impl::run() {
  begin_stream();
  while (!sleep_unless_stopped(std::chrono::milliseconds(0))) {
    if (camera == nullptr) {
      reconnect();
      continue;
    }
    receive();
    watch_silence();
  }
  camera.reset();
}

void CameraSource::Impl::begin_stream() {
  CameraClockParameters clock_parameters;
  clock_parameters.known_delay =
      parameters.readout_delay +
      (parameters.stamp_is_exposure_start ? camera->exposure() : nanoseconds(0));
  clock = CameraClock(clock_parameters);
  last_id = incomplete_since_last_id = 0;
  t_last_stamp = {};
  t_last_buffer = t_silence_reported = now_on(CLOCK_MONOTONIC);
  backoff = parameters.reconnect_min;
  report_event(CameraEvent::connected);
}

void CameraSource::Impl::receive() {
  ArvBuffer* buffer = camera->wait(kWaitSlice);
  if (buffer == nullptr) return;
  const nanoseconds t_received = now_on(CLOCK_MONOTONIC);
  t_last_buffer = t_silence_reported = t_received;
  take(buffer, t_received);
  camera->give_back(buffer);
}

void CameraSource::Impl::take(ArvBuffer* buffer, nanoseconds t_received) {
  CameraReport report;
  report.t_received = t_received;
  report.frame_id = arv_buffer_get_frame_id(buffer);
  report.t_camera = nanoseconds(static_cast<std::int64_t>(arv_buffer_get_timestamp(buffer)));
  report.buffer_status = static_cast<int>(arv_buffer_get_status(buffer));
  std::size_t size = 0;
  if (report.buffer_status == ARV_BUFFER_STATUS_SUCCESS) arv_buffer_get_image_data(buffer, &size);
  report.received_bytes = size;
  const std::size_t expected = row_bytes(parameters.pixel_format, parameters.width_px) *
                               static_cast<std::size_t>(parameters.height_px);
  if (report.buffer_status == ARV_BUFFER_STATUS_SUCCESS && size == expected) {
    take_complete(buffer, report);
    return;
  }
  if (report.buffer_status == ARV_BUFFER_STATUS_ABORTED ||
      report.buffer_status == ARV_BUFFER_STATUS_CLEARED)
    return;  // the stream is being taken down, which is reported as such
  report.event = CameraEvent::incomplete;
  incomplete.fetch_add(1, std::memory_order_relaxed);
  ++incomplete_since_last_id;
  callback(report);
}

void CameraSource::Impl::take_complete(ArvBuffer* buffer, CameraReport& report) {
  if (last_id != 0) {
    const auto between = frames_between(last_id, report.frame_id, camera->frame_id_width());
    report.ids_advanced = between ? *between + 1 : 0;
  }
  report_gap(report);
  last_id = report.frame_id;
  incomplete_since_last_id = 0;

  const bool is_known_clock =
      clock.add(report.t_camera, first_packet_time(buffer, report.t_received));
  report.clock_offset_sigma = clock.sigma();
  const nanoseconds half = camera->exposure() / 2;
  report.t_exposure =
      clock.to_host(report.t_camera) + (parameters.stamp_is_exposure_start ? half : -half);
  if (!is_known_clock) {
    report.event = CameraEvent::time_invalid;
    callback(report);
    return;
  }
  std::size_t size = 0;
  // const only because Aravis hands out a view; the memory is our pool's.
  auto* pixels = static_cast<std::uint8_t*>(
      const_cast<void*>(arv_buffer_get_image_data(buffer, &size)));  // NOLINT
  report.event = CameraEvent::frame;
  report.image = convert(pixels);
  frames.fetch_add(1, std::memory_order_relaxed);
  callback(report);
}

void CameraSource::Impl::report_gap(const CameraReport& frame) {
  if (last_id == 0) return;
  const bool is_known = frame.ids_advanced > 0;
  if (is_known && frame.ids_advanced - 1 <= incomplete_since_last_id) return;
  CameraReport report;
  report.event = CameraEvent::gap;
  report.frame_id = frame.frame_id;
  report.t_received = frame.t_received;
  report.t_camera = frame.t_camera;
  report.frames_missing = is_known ? frame.ids_advanced - 1 - incomplete_since_last_id : 0;
  missing.fetch_add(report.frames_missing, std::memory_order_relaxed);
  callback(report);
}

void CameraSource::Impl::watch_silence() {
  const nanoseconds now = now_on(CLOCK_MONOTONIC);
  if (camera->is_control_lost()) {
    lose();
    return;
  }
  if (!parameters.trigger_source.empty()) return;  // silent until triggered
  if (now - t_last_buffer >= parameters.disconnect_timeout) {
    lose();
  } else if (now - t_silence_reported >= parameters.frame_timeout) {
    t_silence_reported = now;
    report_event(CameraEvent::silent);
  }
}

void CameraSource::Impl::lose() {
  disconnects.fetch_add(1, std::memory_order_relaxed);
  report_event(CameraEvent::disconnected);
  camera.reset();
}

void CameraSource::Impl::reconnect() {
  if (sleep_unless_stopped(backoff)) return;
  try {
    camera = std::make_unique<AravisCamera>(parameters);
  } catch (const Error&) {  // still away, or not yet ours again: the event said so, keep trying
    backoff = std::min(2 * backoff, parameters.reconnect_max);
    return;
  }
  reconnects.fetch_add(1, std::memory_order_relaxed);
  describe();
  begin_stream();
}

void CameraSource::Impl::describe() {
  const std::lock_guard lock(description_mutex);
  shown_description = camera->description();
}

void CameraSource::Impl::report_event(CameraEvent event) {
  CameraReport report;
  report.event = event;
  report.t_received = now_on(CLOCK_MONOTONIC);
  callback(report);
}

bool CameraSource::Impl::sleep_unless_stopped(std::chrono::milliseconds duration) {
  std::unique_lock lock(stop_mutex);
  return stop_changed.wait_for(lock, duration, [this] { return stop; });
}

CameraSource::CameraSource(const CameraParameters& parameters, Callback callback)
    : impl_(std::make_unique<Impl>(parameters, std::move(callback))) {}
CameraSource::~CameraSource() = default;

CameraCounters CameraSource::counters() const noexcept {
  const auto load = [](const std::atomic<std::uint64_t>& counter) {
    return counter.load(std::memory_order_relaxed);  // each is a statistic of its own
  };
  return {load(impl_->frames), load(impl_->incomplete), load(impl_->missing),
          load(impl_->disconnects), load(impl_->reconnects)};
}

std::string CameraSource::description() const {
  const std::lock_guard lock(impl_->description_mutex);
  return impl_->shown_description;
}

}  // namespace holdfast::bridge
