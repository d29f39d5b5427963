// SPDX-License-Identifier: Apache-2.0
#include "tests/sim/virtual_camera.hpp"

#include <atomic>
#include <cmath>
#include <cstring>
#include <ctime>
#include <mutex>
#include <optional>

#include <arv.h>
#include <fmt/core.h>

#include "rt/core/error.hpp"
#include "tests/sim/gige_device.hpp"
#include "tests/sim/render_ahead.hpp"

namespace holdfast::sim {
namespace {

using std::chrono::nanoseconds;

constexpr std::uint64_t kFrameIds = 65535;    // 1..65535, GigE Vision 1.x
constexpr nanoseconds kGridSlack{3'000'000};  // woken later than this: not on the grid
// While it waits for a trigger the device's thread answers no control packet: not for long.
constexpr std::chrono::milliseconds kTriggerWait{10};
// A trigger that came while the device was busy is still taken when it is no older than this.
constexpr std::chrono::milliseconds kTriggerLatched{50};
constexpr std::chrono::microseconds kSpin{100};  // a sleeper may oversleep by about this

nanoseconds now_on(clockid_t clock) noexcept {
  timespec t{};
  clock_gettime(clock, &t);
  return std::chrono::seconds(t.tv_sec) + nanoseconds(t.tv_nsec);
}

// Sleeps until shortly before `t`, then looks at the clock until it is there.
void wait_until(nanoseconds t) noexcept {
  const std::int64_t wake_ns = (t - kSpin).count();
  const timespec wake{wake_ns / 1'000'000'000, wake_ns % 1'000'000'000};
  clock_nanosleep(CLOCK_MONOTONIC, TIMER_ABSTIME, &wake, nullptr);
  while (now_on(CLOCK_MONOTONIC) < t) {
  }
}

void validate(const VirtualCameraParameters& parameters) {
  if (parameters.serial.empty() || parameters.serial.size() > 15)
    throw InputError(
        fmt::format("virtual camera: serial \"{}\" must have 1..15 characters", parameters.serial));
  const auto require_within = [](const char* what, double value, double lowest, double highest,
                                 const char* unit) {
    if (!(value >= lowest && value <= highest))
      throw InputError(fmt::format("virtual camera: {} {:g} {} is outside {:g}..{:g}", what, value,
                                   unit, lowest, highest));
  };
  require_within("frame rate", parameters.frame_rate_hz, 1, 200, "Hz");
  require_within("exposure", parameters.exposure_us, 10, 100'000, "us");
  require_within("read-out", static_cast<double>(parameters.readout.count()), 0, 50'000, "us");
  require_within("packet size", parameters.packet_size_bytes, 576, 16'000, "bytes");
}

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
    validate(parameters);
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
    return gige_ != nullptr;
  }

  const VirtualCameraParameters parameters;
  std::atomic<std::uint64_t> frames{0};

 private:
  static void on_fill(ArvBuffer* buffer, void* self, guint32 exposure_us, guint32 /*gain*/,
                      guint32 pixel_format) {
    static_cast<Device*>(self)->expose(buffer, std::chrono::microseconds(exposure_us),
                                       pixel_format);
  }
  void expose(ArvBuffer* buffer, nanoseconds exposure, guint32 pixel_format);
  [[nodiscard]] Faults faults_of_this_exposure();
  /// Runs `use` on the device, unless it is being powered down.
  template <typename Use>
  void with_device(Use use) {
    const std::lock_guard lock(device_mutex_);
    if (gige_) use(*gige_);
  }
  void read_registers();
  /// When the exposure that is now due began to be read out; empty when none is due.
  [[nodiscard]] std::optional<nanoseconds> exposure_end(nanoseconds exposure);
  [[nodiscard]] nanoseconds grid_instant() const;
  [[nodiscard]] nanoseconds camera_clock(nanoseconds t) const;
  void count_discarded(nanoseconds t_mid);

  const cv::Size sensor_;
  const OnFrame on_frame_;
  RenderAhead ahead_;

  std::mutex faults_mutex_;
  Faults faults_;

  // The device's thread's own, while powered.
  std::uint64_t frame_id_ = 0, last_pulse_ = 0;
  nanoseconds t_power_up_{}, t_last_mid_{}, period_{};
  TriggerState trigger_ = TriggerState::free_running;
  bool has_software_trigger_ = false;
  const std::vector<std::uint8_t>* last_image_ = nullptr;  // ahead_'s own

  std::mutex power_mutex_;           // one power_up() or power_down() at a time
  mutable std::mutex device_mutex_;  // guards the pointer
  std::unique_ptr<GigeDevice> gige_;
};

void VirtualCamera::Device::power_up() {
  const std::lock_guard power(power_mutex_);
  if (is_up()) return;
  auto gige = std::make_unique<GigeDevice>(
      parameters.interface, parameters.serial,
      DeviceDefaults{sensor_, parameters.format, parameters.frame_rate_hz, parameters.exposure_us,
                     parameters.packet_size_bytes});
  t_power_up_ = now_on(CLOCK_MONOTONIC);
  t_last_mid_ = {};
  last_image_ = nullptr;
  period_ = nanoseconds(std::llround(1e9 / parameters.frame_rate_hz));
  const std::lock_guard lock(device_mutex_);
  gige_ = std::move(gige);
  gige_->set_fill(&Device::on_fill, this);
}

void VirtualCamera::Device::power_down() {
  const std::lock_guard power(power_mutex_);
  std::unique_ptr<GigeDevice> gige;
  {
    const std::lock_guard lock(device_mutex_);
    std::swap(gige, gige_);
  }
  gige.reset();  // joins the device's thread, which may be waiting for the pointer's mutex
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

// What a client may have written since the last frame.
void VirtualCamera::Device::read_registers() {
  with_device([this](GigeDevice& device) {
    const TriggerState before = std::exchange(trigger_, device.trigger());
    if (const auto period = device.period()) period_ = *period;
    has_software_trigger_ = device.take_software_trigger();
    const bool is_armed_now = trigger_ == TriggerState::line1 && before != trigger_;
    if (is_armed_now && parameters.line1 != nullptr)
      last_pulse_ = parameters.line1->number_at(now_on(CLOCK_MONOTONIC));
  });
}

nanoseconds VirtualCamera::Device::camera_clock(nanoseconds t) const {
  const auto since = static_cast<double>((t - t_power_up_).count());
  return nanoseconds(std::llround(1e9 + since * (1 + parameters.clock_drift_ppm * 1e-6)));
}

// The device's thread is woken when CLOCK_REALTIME passes a multiple of the period: that instant,
// not the waking, is the end of exposure.
nanoseconds VirtualCamera::Device::grid_instant() const {
  const nanoseconds now = now_on(CLOCK_MONOTONIC);
  const nanoseconds late =
      now_on(CLOCK_REALTIME) % std::chrono::duration_cast<std::chrono::microseconds>(period_);
  return late < kGridSlack ? now - late : now;
}

std::optional<nanoseconds> VirtualCamera::Device::exposure_end(nanoseconds exposure) {
  if (trigger_ == TriggerState::free_running) return grid_instant();
  if (trigger_ == TriggerState::software) {
    if (has_software_trigger_) return now_on(CLOCK_MONOTONIC) + exposure;
    wait_until(now_on(CLOCK_MONOTONIC) + kTriggerWait);
    return std::nullopt;
  }
  if (parameters.line1 == nullptr) {  // nothing is wired to it
    wait_until(now_on(CLOCK_MONOTONIC) + kTriggerWait);
    return std::nullopt;
  }
  const auto pulse = parameters.line1->wait_after(last_pulse_, kTriggerWait);
  if (!pulse) return std::nullopt;
  last_pulse_ = pulse->number;
  if (now_on(CLOCK_MONOTONIC) - pulse->t > kTriggerLatched) return std::nullopt;
  return pulse->t + exposure;
}

// Frames that a shorter delay discards keep their ids.
void VirtualCamera::Device::count_discarded(nanoseconds t_mid) {
  const double periods =
      static_cast<double>((t_mid - t_last_mid_).count()) / static_cast<double>(period_.count());
  frame_id_ += static_cast<std::uint64_t>(std::max<std::int64_t>(0, std::lround(periods) - 1));
}

void VirtualCamera::Device::expose(ArvBuffer* buffer, nanoseconds exposure, guint32 pixel_format) {
  read_registers();
  const auto lose = [this](double share) {
    with_device([share](GigeDevice& device) { device.set_lost_share(share); });
  };
  const auto t_end = exposure_end(exposure);
  if (!t_end) {
    lose(1);
    return;
  }
  const Faults faults = faults_of_this_exposure();
  const bool is_free_running = trigger_ == TriggerState::free_running;
  const auto format = pixel_format_of(pixel_format);
  Shot shot;
  gint x = 0, y = 0, width = 0, height = 0;
  arv_buffer_get_image_region(buffer, &x, &y, &width, &height);
  shot.region = {x, y, width, height};
  shot.t_mid_exposure = *t_end - (is_free_running ? faults.delay : nanoseconds(0)) - exposure / 2;
  shot.view = {faults.occlude, faults.black, true};
  shot.source_version = faults.source_version;
  const bool is_possible =
      format && (shot.region & cv::Rect({0, 0}, sensor_)) == shot.region && !shot.region.empty();
  const bool is_due = !is_free_running || shot.t_mid_exposure > t_last_mid_ + period_ / 2;
  if (!is_possible || !is_due) {  // a region off the sensor, or the first of a longer delay
    lose(1);
    return;
  }
  shot.format = *format;
  if (faults.is_queue_discarded && is_free_running) count_discarded(shot.t_mid_exposure);
  frame_id_ = frame_id_ % kFrameIds + 1;

  SentFrame sent;
  sent.is_frozen = faults.freeze && last_image_ != nullptr && last_image_->size() == shot.bytes();
  if (!sent.is_frozen) last_image_ = &ahead_.take(shot);
  std::size_t unused = 0;
  void* pixels = const_cast<void*>(arv_buffer_get_data(buffer, &unused));  // NOLINT: ours to fill
  std::memcpy(pixels, last_image_->data(), last_image_->size());
  t_last_mid_ = shot.t_mid_exposure;
  if (is_free_running) {
    Shot next = shot;
    next.t_mid_exposure += period_;
    ahead_.prepare(next);
  }

  sent.frame_id = frame_id_;
  sent.t_mid_exposure = shot.t_mid_exposure;
  sent.t_stamp = camera_clock(shot.t_mid_exposure - exposure / 2);
  sent.trigger = trigger_ == TriggerState::line1 ? last_pulse_ : 0;
  sent.view = shot.view;
  sent.is_dropped = faults.drop || faults.drop_next > 0;
  sent.is_corrupt = !sent.is_dropped && faults.corrupt_next > 0;
  arv_buffer_set_frame_id(buffer, sent.frame_id);
  arv_buffer_set_timestamp(buffer, static_cast<guint64>(sent.t_stamp.count()));
  lose(sent.is_dropped ? 1.0 : (sent.is_corrupt ? 0.5 : 0.0));
  frames.fetch_add(1, std::memory_order_relaxed);
  wait_until(*t_end + parameters.readout + (is_free_running ? nanoseconds(0) : faults.delay));
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
