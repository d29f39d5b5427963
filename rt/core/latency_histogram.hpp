// SPDX-License-Identifier: Apache-2.0
// Latencies in fixed log-linear bins (32 per factor of two: at most 3.2 % wide), 0 ns to 68 s. One
// thread records, wait-free; another takes snapshots while it does.
#pragma once

#include <algorithm>
#include <array>
#include <atomic>
#include <bit>
#include <chrono>
#include <cmath>
#include <cstddef>
#include <cstdint>

namespace holdfast::rt {

namespace detail {
inline constexpr unsigned kSubBits = 5;  // 2^5 bins per octave
inline constexpr unsigned kMaxBits = 36;
inline constexpr std::size_t kBinCount = std::size_t{kMaxBits - kSubBits + 1} << kSubBits;

/// Values below 2^kSubBits have their own bin; above, the leading bits select it.
[[nodiscard]] constexpr std::size_t bin_of(std::uint64_t value_ns) noexcept {
  const std::uint64_t clamped = std::min(value_ns, (std::uint64_t{1} << kMaxBits) - 1);
  const auto width = static_cast<unsigned>(std::bit_width(clamped));
  const unsigned shift = width > kSubBits ? width - kSubBits - 1 : 0;
  return (std::size_t{shift} << kSubBits) + static_cast<std::size_t>(clamped >> shift);
}
/// Largest value that falls into the bin.
[[nodiscard]] constexpr std::uint64_t upper_edge_ns(std::size_t bin) noexcept {
  const auto octave = static_cast<unsigned>(bin >> kSubBits);
  const unsigned shift = octave > 0 ? octave - 1 : 0;
  const std::uint64_t leading = bin - (std::size_t{shift} << kSubBits);
  return ((leading + 1) << shift) - 1;
}
}  // namespace detail

/// Counts as they were at one moment. A plain value; one thread.
class LatencySnapshot {
 public:
  [[nodiscard]] std::uint64_t count() const noexcept { return count_; }
  [[nodiscard]] std::chrono::nanoseconds max() const noexcept { return max_; }

  /// The latency that `fraction` (0..1) of the records do not exceed, rounded up to its bin's upper
  /// edge but not beyond max(); zero when nothing was recorded.
  [[nodiscard]] std::chrono::nanoseconds percentile(double fraction) const noexcept {
    if (count_ == 0) return {};
    const double wanted = std::ceil(std::clamp(fraction, 0.0, 1.0) * static_cast<double>(count_));
    const auto rank = std::max<std::uint64_t>(1, static_cast<std::uint64_t>(wanted));
    std::uint64_t seen = 0;
    for (std::size_t bin = 0; bin < bins_.size(); ++bin) {
      seen += bins_[bin];
      if (seen >= rank && bin + 1 < bins_.size()) {
        const auto edge = static_cast<std::int64_t>(detail::upper_edge_ns(bin));
        return std::min(std::chrono::nanoseconds(edge), max_);
      }
    }
    return max_;  // in the last bin, which is open above
  }

  /// Adds the records of another histogram.
  void merge(const LatencySnapshot& other) noexcept {
    for (std::size_t bin = 0; bin < bins_.size(); ++bin) bins_[bin] += other.bins_[bin];
    count_ += other.count_;
    max_ = std::max(max_, other.max_);
  }

 private:
  friend class LatencyHistogram;
  std::array<std::uint64_t, detail::kBinCount> bins_{};
  std::uint64_t count_ = 0;
  std::chrono::nanoseconds max_{};
};

class LatencyHistogram {
 public:
  LatencyHistogram() = default;
  LatencyHistogram(const LatencyHistogram&) = delete;
  LatencyHistogram& operator=(const LatencyHistogram&) = delete;

  /// Recording thread only; wait-free, no allocation. Negative counts as zero; beyond the range
  /// counts in the last bin, and max() is exact.
  void record(std::chrono::nanoseconds latency) noexcept {
    const std::int64_t value = std::max<std::int64_t>(latency.count(), 0);
    // Plain loads and stores, relaxed: this thread alone writes.
    if (value > max_.load(std::memory_order_relaxed)) {
      max_.store(value, std::memory_order_relaxed);
    }
    auto& bin = bins_[detail::bin_of(static_cast<std::uint64_t>(value))];
    // Release: a snapshot that counts this record also sees a max not below it.
    bin.store(bin.load(std::memory_order_relaxed) + 1, std::memory_order_release);
  }

  /// Any one thread, also while another records. Each record is in it wholly or not at all; records
  /// made during the copy may or may not be.
  [[nodiscard]] LatencySnapshot snapshot() const noexcept {
    LatencySnapshot copy;
    for (std::size_t bin = 0; bin < bins_.size(); ++bin) {
      copy.bins_[bin] = bins_[bin].load(std::memory_order_acquire);
      copy.count_ += copy.bins_[bin];
    }
    copy.max_ = std::chrono::nanoseconds(max_.load(std::memory_order_relaxed));
    return copy;
  }

 private:
  std::array<std::atomic<std::uint64_t>, detail::kBinCount> bins_{};
  std::atomic<std::int64_t> max_{0};
  static_assert(std::atomic<std::int64_t>::is_always_lock_free);
};

}  // namespace holdfast::rt
