// SPDX-License-Identifier: Apache-2.0
#include "tests/sim/gige_device.hpp"

#include <cerrno>
#include <cmath>
#include <cstring>
#include <memory>

#include <arpa/inet.h>
#include <fmt/core.h>
#include <ifaddrs.h>
#include <netinet/in.h>
#include <sys/mman.h>
#include <sys/socket.h>
#include <unistd.h>

#include "rt/core/error.hpp"
#include "tests/sim/genicam/genicam_xml.hpp"

namespace holdfast::sim {
namespace {

using bridge::PixelFormat;

constexpr std::uint16_t kGvcpPort = 3956;
constexpr guint32 kPacketSizeRegister = 0x0d04;  // GigE Vision bootstrap: stream channel 0
constexpr guint32 kVendorRegister = 0x48, kModelRegister = 0x68;

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
in_addr free_address(const std::string& interface) {
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
  return address.sin_addr;
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

// Of our own description, beside Aravis' trigger registers: with those it would not call fill at
// all while Line1 is chosen.
constexpr guint32 kTriggerModeRegister = 0x310, kTriggerSourceRegister = 0x314;
constexpr guint32 kTriggerSoftwareRegister = 0x31c;
constexpr guint32 kPeriodRegister = ARV_FAKE_CAMERA_REGISTER_ACQUISITION_FRAME_PERIOD_US;
constexpr guint32 kSourceSoftware = 1, kSourceLine1 = 2;

}  // namespace

std::optional<PixelFormat> pixel_format_of(guint32 code) noexcept {
  for (const Code& entry : kCodes)
    if (entry.code == code) return entry.format;
  return std::nullopt;
}

GigeDevice::GigeDevice(const std::string& interface, const std::string& serial,
                       const DeviceDefaults& defaults)
    : waker_(free_address(interface)) {
  const DescriptionFile description;
  camera_ =
      arv_gv_fake_camera_new_full(interface.c_str(), serial.c_str(), description.path().c_str());
  if (arv_gv_fake_camera_is_running(camera_) == FALSE) {
    g_object_unref(camera_);
    throw UnavailableError(
        fmt::format("virtual camera: no network interface lists {0}; for a second camera on this "
                    "machine: ip address add {0}/8 dev lo",
                    interface));
  }
  registers_ = arv_gv_fake_camera_get_fake_camera(camera_);
  write_defaults(defaults);
}

void GigeDevice::set_fill(ArvFakeCameraFillPattern fill, void* self) noexcept {
  arv_fake_camera_set_fill_pattern(registers_, fill, self);
}

GigeDevice::~GigeDevice() {
  g_object_unref(camera_);  // joins the device's thread
}

void GigeDevice::write_defaults(const DeviceDefaults& defaults) noexcept {
  const auto write_text = [this](guint32 address, std::string_view value) {
    char field[32] = {};
    value.copy(field, sizeof field - 1);
    arv_fake_camera_write_memory(registers_, address, sizeof field, field);
  };
  const auto write = [this](guint32 address, double value) {
    arv_fake_camera_write_register(registers_, address, static_cast<guint32>(std::lround(value)));
  };
  write_text(kVendorRegister, "Holdfast");
  write_text(kModelRegister, "VirtualCamera");
  write(ARV_FAKE_CAMERA_REGISTER_SENSOR_WIDTH, defaults.sensor_px.width);
  write(ARV_FAKE_CAMERA_REGISTER_SENSOR_HEIGHT, defaults.sensor_px.height);
  write(ARV_FAKE_CAMERA_REGISTER_WIDTH, defaults.sensor_px.width);
  write(ARV_FAKE_CAMERA_REGISTER_HEIGHT, defaults.sensor_px.height);
  write(ARV_FAKE_CAMERA_REGISTER_PIXEL_FORMAT, code_of(defaults.format));
  write(ARV_FAKE_CAMERA_REGISTER_ACQUISITION_FRAME_PERIOD_US, 1e6 / defaults.frame_rate_hz);
  write(ARV_FAKE_CAMERA_REGISTER_EXPOSURE_TIME_US, defaults.exposure_us);
  write(kTriggerSourceRegister, kSourceSoftware);
  write(kPacketSizeRegister, defaults.packet_size_bytes);
}

guint32 GigeDevice::read(guint32 address) const noexcept {
  guint32 value = 0;
  return arv_fake_camera_read_register(registers_, address, &value) != FALSE ? value : 0;
}

void GigeDevice::set_lost_share(double share) noexcept {
  g_object_set(camera_, "gvsp-lost-ratio", share, nullptr);
}

std::optional<std::chrono::microseconds> GigeDevice::period() noexcept {
  const guint32 period_us = read(kPeriodRegister);
  if (period_us == 0) return std::nullopt;
  return std::chrono::microseconds(period_us);
}

TriggerState GigeDevice::trigger() noexcept {
  const bool is_triggered = read(kTriggerModeRegister) != 0;
  const auto grid_us = static_cast<guint32>(kTriggerGrid.count());
  if (is_triggered && !free_period_us_) {
    free_period_us_ = read(kPeriodRegister);
    arv_fake_camera_write_register(registers_, kPeriodRegister, grid_us);
  } else if (!is_triggered && free_period_us_) {
    if (read(kPeriodRegister) == grid_us)  // else the client has set another already
      arv_fake_camera_write_register(registers_, kPeriodRegister, *free_period_us_);
    free_period_us_.reset();
  }
  waker_.set_period(period().value_or(kTriggerGrid));
  if (!is_triggered) return TriggerState::free_running;
  return read(kTriggerSourceRegister) == kSourceLine1 ? TriggerState::line1
                                                      : TriggerState::software;
}

bool GigeDevice::take_software_trigger() noexcept {
  if (read(kTriggerSoftwareRegister) == 0) return false;
  arv_fake_camera_write_register(registers_, kTriggerSoftwareRegister, 0);
  return true;
}

}  // namespace holdfast::sim
