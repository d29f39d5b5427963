// SPDX-License-Identifier: Apache-2.0
#include "tests/sim/virtual_camera.hpp"

#include <atomic>
#include <cmath>
#include <cstring>
#include <ctime>
#include <mutex>
#include <optional>

#include <arpa/inet.h>
#include <arv.h>
#include <fmt/core.h>
#include <ifaddrs.h>
#include <netinet/in.h>
#include <sys/mman.h>
#include <sys/socket.h>
#include <unistd.h>

#include "bridge/pixel_conversion.hpp"
#include "rt/core/error.hpp"
#include "tests/sim/device_waker.hpp"
#include "tests/sim/genicam/genicam_xml.hpp"
#include "tests/sim/render_ahead.hpp"

namespace holdfast::sim {
namespace {

using bridge::PixelFormat;
using std::chrono::nanoseconds;

constexpr std::uint16_t kGvcpPort = 3956;
constexpr guint32 kPacketSizeRegister = 0x0d04;  // GigE Vision bootstrap: stream channel 0
constexpr guint32 kVendorRegister = 0x48, kModelRegister = 0x68;
constexpr std::uint64_t kFrameIds = 65535;    // 1..65535, GigE Vision 1.x
constexpr nanoseconds kGridSlack{3'000'000};  // woken later than this: not on the grid

struct Code {
  PixelFormat format;
  guint32 code;
};
constexpr Code kCodes[] = {
    {PixelFormat::mono8, ARV_PIXEL_FORMAT_MONO_8},
    {PixelFormat::mono12, ARV_PIXEL_FORMAT_MONO_12},
    {PixelFormat::bayer_rg8, ARV_PIXEL_FORMAT_BAYER_RG_8},
    {PixelFormat::bayer_gb8, ARV_PIXEL_FORMAT_BAYER_GB_8},
    {PixelFormat::bayer_gr8, ARV_PIXEL_FORMAT_BAYER_GR_8},
    {PixelFormat::bayer_bg8, ARV_PIXEL_FORMAT_BAYER_BG_8},
    {PixelFormat::rgb8, ARV_PIXEL_FORMAT_RGB_8_PACKED},
    {PixelFormat::bgr8, ARV_PIXEL_FORMAT_BGR_8_PACKED},
};

guint32 code_of(PixelFormat format) {
  for (const Code& entry : kCodes)
    if (entry.format == format) return entry.code;
  return ARV_PIXEL_FORMAT_MONO_8;
}

std::optional<PixelFormat> format_of(guint32 code) {
  for (const Code& entry : kCodes)
    if (entry.code == code) return entry.format;
  return std::nullopt;
}

nanoseconds now_on(clockid_t clock) noexcept {
  timespec t{};
  clock_gettime(clock, &t);
  return std::chrono::seconds(t.tv_sec) + nanoseconds(t.tv_nsec);
}

in_addr address_of(const std::string& interface) {
  in_addr found{};
  if (inet_pton(AF_INET, interface.c_str(), &found) == 1) return found;
  ifaddrs* list = nullptr;
  if (getifaddrs(&list) == 0) {
    const std::unique_ptr<ifaddrs, decltype(&freeifaddrs)> guard(list, freeifaddrs);
    for (const ifaddrs* i = list; i != nullptr; i = i->ifa_next)
      if (i->ifa_addr != nullptr && i->ifa_addr->sa_family == AF_INET && interface == i->ifa_name) {
        sockaddr_in address{};
        std::memcpy(&address, i->ifa_addr, sizeof address);
        return address.sin_addr;
      }
  }
  throw UnavailableError(fmt::format("virtual camera: no network interface {}", interface));
}

// Aravis only warns when its control port is taken: ask first.
void require_free_port(const std::string& interface) {
  sockaddr_in address{};
  address.sin_family = AF_INET;
  address.sin_addr = address_of(interface);
  address.sin_port = htons(kGvcpPort);
  const int probe = socket(AF_INET, SOCK_DGRAM | SOCK_CLOEXEC, 0);
  sockaddr generic{};
  std::memcpy(&generic, &address, sizeof generic);
  const bool is_free = probe >= 0 && bind(probe, &generic, sizeof address) == 0;
  const std::string reason = is_free ? "" : std::strerror(errno);
  if (probe >= 0) close(probe);
  if (!is_free)
    throw UnavailableError(fmt::format("virtual camera: UDP port {} of {} cannot be used: {}",
                                       kGvcpPort, interface, reason));
}

// Aravis reads the description from a file: give it one that exists only in memory.
class DescriptionFile {
 public:
  DescriptionFile() : descriptor_(memfd_create("genicam.xml", MFD_CLOEXEC)) {
    const std::string_view xml = virtual_camera_genicam_xml();
    if (descriptor_ < 0 ||
        write(descriptor_, xml.data(), xml.size()) != static_cast<ssize_t>(xml.size()))
      throw UnavailableError("virtual camera: cannot hold the GenICam description in memory");
  }
  ~DescriptionFile() { close(descriptor_); }
  DescriptionFile(const DescriptionFile&) = delete;
  DescriptionFile& operator=(const DescriptionFile&) = delete;
  [[nodiscard]] std::string path() const { return fmt::format("/proc/self/fd/{}", descriptor_); }

 private:
  int descriptor_;
};

struct Faults {
  bool freeze = false, black = false, occlude = false, drop = false;
  int drop_next = 0, corrupt_next = 0;
  nanoseconds delay{};
  bool is_queue_discarded = false;
  std::uint64_t source_version = 0;
};

}  // namespace

class VirtualCamera::Device {
 public:
  Device(const VirtualCameraParameters& given, FrameSource& source, OnFrame report)
      : parameters(given),
        sensor_(source.sensor_px()),
        on_frame_(std::move(report)),
        ahead_(source) {
    if (parameters.serial.empty() || parameters.serial.size() > 15)
      throw InputError(fmt::format("virtual camera: serial \"{}\" must have 1..15 characters",
                                   parameters.serial));
    if (!(parameters.frame_rate_hz >= 1 && parameters.frame_rate_hz <= 200))
      throw InputError(fmt::format("virtual camera: frame rate {:g} Hz is outside 1..200",
                                   parameters.frame_rate_hz));
    if (!(parameters.exposure_us >= 10 && parameters.exposure_us <= 100'000))
      throw InputError(fmt::format("virtual camera: exposure {:g} us is outside 10..100000",
                                   parameters.exposure_us));
    if (parameters.packet_size_bytes < 576 || parameters.packet_size_bytes > 16000)
      throw InputError(fmt::format("virtual camera: packet size {} is outside 576..16000 bytes",
                                   parameters.packet_size_bytes));
    frame_id_ = parameters.first_frame_id == 0 ? kFrameIds : parameters.first_frame_id - 1U;
    power_up();
  }
  ~Device() { power_down(); }
  Device(const Device&) = delete;
  Device& operator=(const Device&) = delete;

  template <typename Change>
  nanoseconds apply(Change change) {
    const std::lock_guard lock(faults_mutex_);
    change(faults_);
    return now_on(CLOCK_MONOTONIC);
  }
  void power_up();
  void power_down();
  [[nodiscard]] bool is_up() const {
    const std::lock_guard lock(device_mutex_);
    return camera_ != nullptr;
  }

  const VirtualCameraParameters parameters;
  std::atomic<std::uint64_t> frames{0};

 private:
  static void on_fill(ArvBuffer* buffer, void* self, guint32 exposure_us, guint32 /*gain*/,
                      guint32 pixel_format) {
    static_cast<Device*>(self)->expose(buffer, std::chrono::microseconds(exposure_us),
                                       pixel_format);
  }
  void write_defaults(ArvFakeCamera* camera) const;
  void expose(ArvBuffer* buffer, nanoseconds exposure, guint32 pixel_format);
  [[nodiscard]] Faults faults_of_this_exposure();
  void set_lost_share(double share);
  void read_period();
  [[nodiscard]] nanoseconds camera_clock(nanoseconds t) const;
  [[nodiscard]] nanoseconds exposure_end() const;

  const cv::Size sensor_;
  const OnFrame on_frame_;
  RenderAhead ahead_;

  std::mutex faults_mutex_;
  Faults faults_;

  // The device's thread's own, while powered.
  std::uint64_t frame_id_ = 0;
  nanoseconds t_power_up_{}, t_last_mid_{}, period_{};
  std::vector<std::uint8_t> last_image_;

  std::mutex power_mutex_;           // one power_up() or power_down() at a time
  mutable std::mutex device_mutex_;  // guards the pointer
  ArvGvFakeCamera* camera_ = nullptr;
  std::unique_ptr<DeviceWaker> waker_;  // the device's thread reaches it while powered
};

void VirtualCamera::Device::power_up() {
  const std::lock_guard power(power_mutex_);
  if (is_up()) return;
  require_free_port(parameters.interface);
  const DescriptionFile description;
  t_power_up_ = now_on(CLOCK_MONOTONIC);
  t_last_mid_ = {};
  last_image_.clear();
  ArvGvFakeCamera* camera = arv_gv_fake_camera_new_full(
      parameters.interface.c_str(), parameters.serial.c_str(), description.path().c_str());
  if (arv_gv_fake_camera_is_running(camera) == FALSE) {
    g_object_unref(camera);
    throw UnavailableError(
        fmt::format("virtual camera: no network interface {}", parameters.interface));
  }
  ArvFakeCamera* registers = arv_gv_fake_camera_get_fake_camera(camera);
  write_defaults(registers);
  period_ = nanoseconds(std::llround(1e9 / parameters.frame_rate_hz));
  {
    const std::lock_guard lock(device_mutex_);
    camera_ = camera;
  }
  waker_ = std::make_unique<DeviceWaker>(address_of(parameters.interface));
  arv_fake_camera_set_fill_pattern(registers, &Device::on_fill, this);
}

void VirtualCamera::Device::power_down() {
  const std::lock_guard power(power_mutex_);
  ArvGvFakeCamera* camera = nullptr;
  {
    const std::lock_guard lock(device_mutex_);
    std::swap(camera, camera_);
  }
  if (camera != nullptr) g_object_unref(camera);  // joins the device's thread
  waker_.reset();
}

void VirtualCamera::Device::write_defaults(ArvFakeCamera* camera) const {
  const auto write_text = [camera](guint32 address, std::string_view value) {
    char field[32] = {};
    value.copy(field, sizeof field - 1);
    arv_fake_camera_write_memory(camera, address, sizeof field, field);
  };
  const auto write = [camera](guint32 address, double value) {
    arv_fake_camera_write_register(camera, address, static_cast<guint32>(std::lround(value)));
  };
  write_text(kVendorRegister, "Holdfast");
  write_text(kModelRegister, "VirtualCamera");
  write(ARV_FAKE_CAMERA_REGISTER_SENSOR_WIDTH, sensor_.width);
  write(ARV_FAKE_CAMERA_REGISTER_SENSOR_HEIGHT, sensor_.height);
  write(ARV_FAKE_CAMERA_REGISTER_WIDTH, sensor_.width);
  write(ARV_FAKE_CAMERA_REGISTER_HEIGHT, sensor_.height);
  write(ARV_FAKE_CAMERA_REGISTER_PIXEL_FORMAT, code_of(parameters.format));
  write(ARV_FAKE_CAMERA_REGISTER_ACQUISITION_FRAME_PERIOD_US, 1e6 / parameters.frame_rate_hz);
  write(ARV_FAKE_CAMERA_REGISTER_EXPOSURE_TIME_US, parameters.exposure_us);
  write(kPacketSizeRegister, parameters.packet_size_bytes);
}

Faults VirtualCamera::Device::faults_of_this_exposure() {
  const std::lock_guard lock(faults_mutex_);
  const Faults now = faults_;
  faults_.is_queue_discarded = false;
  if (faults_.drop_next > 0)
    --faults_.drop_next;
  else if (faults_.corrupt_next > 0)
    --faults_.corrupt_next;
  return now;
}

void VirtualCamera::Device::set_lost_share(double share) {
  const std::lock_guard lock(device_mutex_);
  if (camera_ != nullptr) g_object_set(camera_, "gvsp-lost-ratio", share, nullptr);
}

// A client may have written another frame rate.
void VirtualCamera::Device::read_period() {
  const std::lock_guard lock(device_mutex_);
  guint32 period_us = 0;
  if (camera_ != nullptr &&
      arv_fake_camera_read_register(arv_gv_fake_camera_get_fake_camera(camera_),
                                    ARV_FAKE_CAMERA_REGISTER_ACQUISITION_FRAME_PERIOD_US,
                                    &period_us) != FALSE &&
      period_us > 0) {
    period_ = std::chrono::microseconds(period_us);
    waker_->set_period(std::chrono::microseconds(period_us));
  }
}

nanoseconds VirtualCamera::Device::camera_clock(nanoseconds t) const {
  const auto since = static_cast<double>((t - t_power_up_).count());
  return nanoseconds(std::llround(1e9 + since * (1 + parameters.clock_drift_ppm * 1e-6)));
}

// The device's thread is woken when CLOCK_REALTIME passes a multiple of the period: that instant,
// not the waking, is the end of exposure.
nanoseconds VirtualCamera::Device::exposure_end() const {
  const nanoseconds now = now_on(CLOCK_MONOTONIC);
  const nanoseconds late =
      now_on(CLOCK_REALTIME) % std::chrono::duration_cast<std::chrono::microseconds>(period_);
  return late < kGridSlack ? now - late : now;
}

void VirtualCamera::Device::expose(ArvBuffer* buffer, nanoseconds exposure, guint32 pixel_format) {
  const Faults faults = faults_of_this_exposure();
  read_period();
  const auto format = format_of(pixel_format);
  gint x = 0, y = 0, width = 0, height = 0;
  arv_buffer_get_image_region(buffer, &x, &y, &width, &height);
  const cv::Rect region(x, y, width, height);
  std::size_t unused = 0;
  auto* pixels = static_cast<std::uint8_t*>(
      const_cast<void*>(arv_buffer_get_data(buffer, &unused)));  // NOLINT: ours to fill
  Shot shot;
  shot.t_mid_exposure = exposure_end() - faults.delay - exposure / 2;
  shot.view = {faults.occlude, faults.black, true};
  shot.region = region;
  shot.source_version = faults.source_version;
  const bool is_possible =
      format && (region & cv::Rect({0, 0}, sensor_)) == region && !region.empty();
  const bool is_due = shot.t_mid_exposure > t_last_mid_ + period_ / 2;
  if (!is_possible || !is_due) {  // a region off the sensor, or the first of a longer delay
    set_lost_share(1);
    return;
  }
  shot.format = *format;
  if (faults.is_queue_discarded)
    frame_id_ += static_cast<std::uint64_t>(std::max<std::int64_t>(
        0, std::lround(static_cast<double>((shot.t_mid_exposure - t_last_mid_).count()) /
                       static_cast<double>(period_.count())) -
               1));
  frame_id_ = frame_id_ % kFrameIds + 1;

  SentFrame sent;
  sent.is_frozen = faults.freeze && last_image_.size() == shot.bytes();
  if (!sent.is_frozen) last_image_ = ahead_.take(shot);
  std::memcpy(pixels, last_image_.data(), last_image_.size());
  t_last_mid_ = shot.t_mid_exposure;
  Shot next = shot;
  next.t_mid_exposure += period_;
  ahead_.prepare(next);

  sent.frame_id = frame_id_;
  sent.t_mid_exposure = shot.t_mid_exposure;
  sent.t_stamp = camera_clock(shot.t_mid_exposure - exposure / 2);
  sent.view = shot.view;
  sent.is_dropped = faults.drop || faults.drop_next > 0;
  sent.is_corrupt = !sent.is_dropped && faults.corrupt_next > 0;
  arv_buffer_set_frame_id(buffer, sent.frame_id);
  arv_buffer_set_timestamp(buffer, static_cast<guint64>(sent.t_stamp.count()));
  set_lost_share(sent.is_dropped ? 1.0 : (sent.is_corrupt ? 0.5 : 0.0));
  frames.fetch_add(1, std::memory_order_relaxed);
  sent.t_sent = now_on(CLOCK_MONOTONIC);
  if (on_frame_) on_frame_(sent);
}

VirtualCamera::VirtualCamera(const VirtualCameraParameters& parameters, FrameSource& source,
                             OnFrame on_frame)
    : device_(std::make_unique<Device>(parameters, source, std::move(on_frame))) {}
VirtualCamera::~VirtualCamera() = default;

nanoseconds VirtualCamera::freeze(bool on) {
  return device_->apply([on](Faults& faults) { faults.freeze = on; });
}
nanoseconds VirtualCamera::black(bool on) {
  return device_->apply([on](Faults& faults) { faults.black = on; });
}
nanoseconds VirtualCamera::occlude(bool on) {
  return device_->apply([on](Faults& faults) { faults.occlude = on; });
}
nanoseconds VirtualCamera::drop(bool on) {
  return device_->apply([on](Faults& faults) {
    faults.drop = on;
    faults.drop_next = 0;
  });
}
nanoseconds VirtualCamera::drop_next(int frames) {
  return device_->apply([frames](Faults& faults) { faults.drop_next = frames; });
}
nanoseconds VirtualCamera::corrupt_next(int frames) {
  return device_->apply([frames](Faults& faults) { faults.corrupt_next = frames; });
}
nanoseconds VirtualCamera::delay(std::chrono::milliseconds by) {
  return device_->apply([by](Faults& faults) {
    faults.is_queue_discarded = by < faults.delay;
    faults.delay = by;
  });
}
nanoseconds VirtualCamera::source_changed() {
  return device_->apply([](Faults& faults) { ++faults.source_version; });
}
nanoseconds VirtualCamera::disconnect() {
  device_->power_down();
  return now_on(CLOCK_MONOTONIC);
}
nanoseconds VirtualCamera::reconnect() {
  device_->power_up();
  return now_on(CLOCK_MONOTONIC);
}

std::uint64_t VirtualCamera::frames() const noexcept {
  return device_->frames.load(std::memory_order_relaxed);
}
bool VirtualCamera::is_connected() const {
  return device_->is_up();
}

}  // namespace holdfast::sim
