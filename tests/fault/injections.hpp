// SPDX-License-Identifier: Apache-2.0
// Attacks on the end-to-end protection, as many as wanted: good streams of every message, of which
// each next message is once received as sent and once spoilt. No spoilt one may be accepted.
#pragma once

#include <array>
#include <cstddef>
#include <cstdint>

namespace holdfast::fault {

enum class Injection : std::uint8_t {
  bits,           ///< one to eight bits anywhere
  burst,          ///< up to 32 bits in a row
  truncation,     ///< zeros from some byte on
  random_bytes,   ///< everything but the protection
  repetition,     ///< the newest accepted one again
  old_message,    ///< one accepted earlier, again
  loss,           ///< one to 1,000 messages are missing before it
  reordering,     ///< its successor first; neither counts
  delay,          ///< received after its validity
  future,         ///< stamped ahead of our clock, well protected
  time_reversal,  ///< stamped before its predecessor, well protected
  utc_step,       ///< the clocks of two hosts have parted
  masquerade,     ///< another sender, well protected
  other_topic,    ///< another topic's, well protected
  other_version,  ///< well protected
  no_source       ///< sender 0, well protected
};
inline constexpr std::size_t kInjectionCount = 16;
[[nodiscard]] const char* name(Injection injection) noexcept;  ///< as spelled above

/// Ways to wire or set up the protection so that it lets something through: what the injections
/// must find before their zero means anything.
enum class Weakness : std::uint8_t {
  none,
  crc_believed,       ///< the receiver takes the CRC in the message for the one it should compute
  loss_tolerated,     ///< counters may skip
  age_not_limited,    ///< whatever the sender claims, and it claims an hour
  future_tolerated,   ///< stamps may lie a second ahead
  sources_take_turns  ///< a new source may take over at once
};
inline constexpr int kWeaknessCount = 5;
[[nodiscard]] const char* name(Weakness weakness) noexcept;

struct InjectionResult {
  std::array<std::uint64_t, kInjectionCount> injected{}, accepted{};
  std::uint64_t good = 0, good_refused = 0;
};

/// `count` injections, spread evenly over messages and kinds. Same seed, same result.
[[nodiscard]] InjectionResult inject(std::uint64_t count, std::uint64_t seed,
                                     Weakness weakness = Weakness::none);

}  // namespace holdfast::fault
