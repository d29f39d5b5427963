// SPDX-License-Identifier: Apache-2.0
#include "bridge/stereo_source.hpp"

#include <array>
#include <atomic>
#include <cmath>
#include <condition_variable>
#include <mutex>
#include <thread>
#include <utility>
#include <vector>

#include <fmt/core.h>

#include "bridge/frame_pairing.hpp"
#include "rt/core/clock.hpp"

namespace holdfast::bridge {
namespace {

using std::chrono::nanoseconds;

constexpr std::array kSideNames{"left", "right"};

int image_type(PixelFormat format) noexcept {
  if (format == PixelFormat::mono8) return CV_8UC1;
  return format == PixelFormat::mono12 ? CV_16UC1 : CV_8UC3;
}

nanoseconds half_period(const CameraParameters& camera) noexcept {
  return nanoseconds(std::llround(0.5e9 / camera.frame_rate_hz));
}

StereoParameters validated(const StereoParameters& parameters) {
  const CameraParameters &left = parameters.left, &right = parameters.right;
  const auto require = [](bool is_valid, const std::string& what) {
    if (!is_valid) throw InputError(fmt::format("stereo: {}", what));
  };
  const bool is_named =
      !(left.id.empty() && left.serial.empty()) && !(right.id.empty() && right.serial.empty());
  require(is_named, "left and right each need an id or a serial number");
  require(left.id != right.id || left.id.empty(),
          fmt::format("left and right have the same id {}", left.id));
  require(left.serial != right.serial || left.serial.empty(),
          fmt::format("left and right have the same serial number {}", left.serial));
  require(left.width_px == right.width_px && left.height_px == right.height_px &&
              left.pixel_format == right.pixel_format,
          fmt::format("left ({}x{} px) and right ({}x{} px) differ in size or format",
                      left.width_px, left.height_px, right.width_px, right.height_px));
  require(!left.trigger_source.empty() && !right.trigger_source.empty(),
          "both cameras need a trigger_source: without a trigger no two frames are simultaneous");
  require(left.frame_rate_hz == right.frame_rate_hz && left.frame_rate_hz > 0,
          fmt::format("left ({:g} Hz) and right ({:g} Hz) differ in the rate of triggers",
                      left.frame_rate_hz, right.frame_rate_hz));
  require(parameters.skew_max.count() >= 0 && parameters.skew_max < half_period(left),
          fmt::format("skew_max is {} us, must be below half a trigger period, {} us",
                      parameters.skew_max.count(), half_period(left).count() / 1000));
  require(parameters.partner_timeout.count() > 0, "partner_timeout must be positive (ms)");
  require(parameters.pairs >= 1 && parameters.pairs <= 16,
          fmt::format("pairs is {}, must be 1..16", parameters.pairs));
  return parameters;
}

std::unique_ptr<CameraSource> open(const StereoParameters& stereo, Side side,
                                   CameraSource::Callback callback) {
  const bool is_left = side == Side::left;
  const CameraParameters& own = is_left ? stereo.left : stereo.right;
  const CameraParameters& partner = is_left ? stereo.right : stereo.left;
  const char* name = kSideNames[static_cast<std::size_t>(side)];
  try {
    return std::make_unique<CameraSource>(own, std::move(callback));
  } catch (const WrongCameraError& e) {
    if (!partner.serial.empty() && e.found_serial == partner.serial)
      throw InputError(fmt::format("stereo: left and right are swapped: {}: {}", name, e.what()));
    throw InputError(fmt::format("stereo: {}: {}", name, e.what()));
  } catch (const InputError& e) {
    throw InputError(fmt::format("stereo: {}: {}", name, e.what()));
  } catch (const UnavailableError& e) {
    throw UnavailableError(fmt::format("stereo: {}: {}", name, e.what()));
  }
}

}  // namespace

struct StereoSource::Impl {
  Impl(const StereoParameters& given, Callback report_to);
  ~Impl();
  Impl(const Impl&) = delete;
  Impl& operator=(const Impl&) = delete;

  void take(Side side, const CameraReport& report);
  void keep(Side side, const CameraReport& report);
  void tell_all(nanoseconds now);
  void tell(const Matched& matched);
  void forward(Side side, const CameraReport& report);
  void watch();

  struct Kept {
    CameraReport report;  // its image, if any, is `pixels`
    cv::Mat pixels;
  };
  [[nodiscard]] std::vector<Kept>& pool(Side side) { return pools[static_cast<std::size_t>(side)]; }

  const StereoParameters parameters;
  const Callback callback;

  // Both cameras' threads and the watch take turns; the callback runs with it held.
  std::mutex mutex;
  FramePairing pairing;
  std::array<std::vector<Kept>, 2> pools;  // a slot of the pairing each
  std::condition_variable changed;
  bool stop = false;

  std::array<std::atomic<std::uint64_t>, 5> counts{};  // by Match
  std::unique_ptr<CameraSource> left, right;
  std::thread thread;
};

StereoSource::Impl::Impl(const StereoParameters& given, Callback report_to)
    : parameters(validated(given)),
      callback(std::move(report_to)),
      pairing({.skew_max = parameters.skew_max,
               .same_trigger_max = half_period(parameters.left),
               .partner_timeout = parameters.partner_timeout,
               .capacity = parameters.pairs}) {
  const CameraParameters& camera = parameters.left;
  for (auto& side : pools) {
    side.resize(static_cast<std::size_t>(pairing.slots()));
    for (Kept& kept : side)
      kept.pixels = cv::Mat::zeros(camera.height_px, camera.width_px,
                                   image_type(camera.pixel_format));  // prefaulted
  }
  left = open(parameters, Side::left, [this](const auto& report) { take(Side::left, report); });
  right = open(parameters, Side::right, [this](const auto& report) { take(Side::right, report); });
  thread = std::thread([this] { watch(); });
}

StereoSource::Impl::~Impl() {
  left.reset();  // their threads end first: nobody adds any more
  right.reset();
  {
    const std::lock_guard lock(mutex);
    stop = true;
  }
  changed.notify_all();
  if (thread.joinable()) thread.join();
}

void StereoSource::Impl::take(Side side, const CameraReport& report) {
  const std::lock_guard lock(mutex);
  if (report.event == CameraEvent::frame)
    keep(side, report);
  else
    forward(side, report);
  tell_all(report.t_received);
  changed.notify_all();
}

void StereoSource::Impl::keep(Side side, const CameraReport& report) {
  const int slot = pairing.free_slot(side);
  Kept& kept = pool(side)[static_cast<std::size_t>(slot)];
  report.image.copyTo(kept.pixels);  // of the size and type that it has: nothing is allocated
  kept.report = report;
  kept.report.image.release();
  pairing.add(side, {report.t_exposure, report.t_received, report.ids_advanced, slot});
}

void StereoSource::Impl::tell_all(nanoseconds now) {
  while (const auto matched = pairing.next(now)) tell(*matched);
}

void StereoSource::Impl::tell(const Matched& matched) {
  static constexpr std::array kEvents{StereoEvent::pair, StereoEvent::skewed, StereoEvent::slipped,
                                      StereoEvent::left_missing, StereoEvent::right_missing};
  const auto index = static_cast<std::size_t>(matched.match);
  counts[index].fetch_add(1, std::memory_order_relaxed);
  StereoReport report;
  report.event = kEvents[index];
  const auto fill = [&](Side side, const std::optional<WaitingFrame>& frame, CameraReport& out) {
    if (!frame) return;
    const Kept& kept = pool(side)[static_cast<std::size_t>(frame->slot)];
    out = kept.report;
    if (matched.match == Match::pair) out.image = kept.pixels;
  };
  fill(Side::left, matched.left, report.left);
  fill(Side::right, matched.right, report.right);
  if (matched.left && matched.right)
    report.skew = matched.left->t_exposure - matched.right->t_exposure;
  callback(report);
}

void StereoSource::Impl::forward(Side side, const CameraReport& camera_report) {
  StereoReport report;
  report.event = side == Side::left ? StereoEvent::left_event : StereoEvent::right_event;
  (side == Side::left ? report.left : report.right) = camera_report;
  callback(report);
}

// A frame whose partner never comes is reported although no further frame comes either.
void StereoSource::Impl::watch() {
  std::unique_lock lock(mutex);
  while (!stop) {
    tell_all(rt::monotonic_now());
    if (const auto deadline = pairing.deadline())
      changed.wait_for(lock, *deadline - rt::monotonic_now());
    else
      changed.wait(lock);
  }
}

StereoSource::StereoSource(const StereoParameters& parameters, Callback callback)
    : impl_(std::make_unique<Impl>(parameters, std::move(callback))) {}
StereoSource::~StereoSource() = default;

StereoCounters StereoSource::counters() const noexcept {
  const auto of = [this](Match match) {
    return impl_->counts[static_cast<std::size_t>(match)].load(std::memory_order_relaxed);
  };
  return {of(Match::pair), of(Match::left_missing), of(Match::right_missing), of(Match::skewed),
          of(Match::slipped)};
}
CameraCounters StereoSource::left_counters() const noexcept {
  return impl_->left->counters();
}
CameraCounters StereoSource::right_counters() const noexcept {
  return impl_->right->counters();
}

}  // namespace holdfast::bridge
