// SPDX-License-Identifier: Apache-2.0
#include "safety/end_to_end.hpp"

#include <algorithm>

namespace holdfast::safety {
namespace {

using std::chrono::nanoseconds;

/// A counter step in the upper half of the range is a step back.
constexpr std::uint32_t kHalfRange = 0x8000'0000U;

}  // namespace

std::string_view name(Verdict verdict) noexcept {
  switch (verdict) {
    case Verdict::accepted:
      return "accepted";
    case Verdict::bad_version:
      return "bad_version";
    case Verdict::bad_data_id:
      return "bad_data_id";
    case Verdict::bad_source:
      return "bad_source";
    case Verdict::bad_crc:
      return "bad_crc";
    case Verdict::repeated:
      return "repeated";
    case Verdict::skipped:
      return "skipped";
    case Verdict::expired:
      return "expired";
    case Verdict::from_future:
      return "from_future";
    case Verdict::time_reversed:
      return "time_reversed";
  }
  return "unknown";
}

Verdict Receiver::check(const Protection& protection, std::uint32_t computed_crc,
                        nanoseconds now_monotonic, nanoseconds now_utc) noexcept {
  // The version says how the CRC is formed; nothing else is believed before the CRC holds.
  if (protection.version != kProtectionVersion) return Verdict::bad_version;
  if (protection.crc32c != computed_crc) return Verdict::bad_crc;
  if (protection.data_id != data_id_) return Verdict::bad_data_id;
  if (protection.source == 0) return Verdict::bad_source;

  const bool is_same_source = protection.source == source_;
  const bool is_takeover = source_ != 0 && !is_same_source;
  if (is_takeover && now_monotonic - t_last_heard_ < parameters_.source_timeout) {
    return Verdict::bad_source;
  }

  const std::uint32_t step = protection.counter - counter_;  // modulo 2^32: wraps
  if (is_same_source && (step == 0 || step >= kHalfRange)) return Verdict::repeated;

  const bool is_same_host = parameters_.clock == ClockRelation::same_host;
  const nanoseconds t_sent{is_same_host ? protection.t_monotonic_ns : protection.t_utc_ns};
  const nanoseconds now = is_same_host ? now_monotonic : now_utc;
  // Before a clock's epoch nothing was ever sent; with both at or after it, `age` cannot overflow.
  if (t_sent < nanoseconds::zero() || now < nanoseconds::zero()) return Verdict::expired;
  const nanoseconds age = now - t_sent;
  const nanoseconds validity = std::min<nanoseconds>(
      std::chrono::microseconds(protection.validity_us), parameters_.max_validity);
  if (age > validity) return Verdict::expired;
  if (age < -parameters_.future_tolerance) return Verdict::from_future;
  if (is_same_source && t_sent < t_last_sent_) return Verdict::time_reversed;

  const std::uint32_t previous_step = is_same_source ? step : 1;
  source_ = protection.source;
  counter_ = protection.counter;
  t_last_heard_ = now_monotonic;
  if (previous_step > parameters_.max_counter_step) return Verdict::skipped;

  t_last_sent_ = t_sent;
  // A stamp slightly ahead of us (clock synchronisation error) earns no longer validity.
  valid_until_ = now_monotonic + validity - std::max(age, nanoseconds::zero());
  return Verdict::accepted;
}

}  // namespace holdfast::safety
