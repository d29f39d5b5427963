// SPDX-License-Identifier: Apache-2.0
// Puts end-to-end protection on a message before it is written and checks it after it was read
// (safety/end_to_end.hpp decides; this computes the CRC of the canonical bytes). Canonical bytes:
// every field in the order of the IDL, Protection first, without its CRC; little-endian, no
// padding; a boolean is one byte, a string its length (4 bytes) and its characters. All functions
// but random_source are noexcept and allocation-free.
#pragma once

#include <array>
#include <bit>
#include <chrono>
#include <cstddef>
#include <cstdint>
#include <cstring>
#include <span>

#include "bridge/dds/message_fields.hpp"
#include "bridge/dds/topics.hpp"
#include "safety/crc32c.hpp"
#include "safety/end_to_end.hpp"

namespace holdfast::bridge::dds {

/// Both clocks of this host at one instant.
struct Clocks {
  std::chrono::nanoseconds monotonic{};  ///< CLOCK_MONOTONIC
  std::chrono::nanoseconds utc{};        ///< CLOCK_REALTIME
};
[[nodiscard]] Clocks read_clocks() noexcept;

/// A sender's identity: random, never 0; one per process start. Throws UnavailableError when the
/// kernel has no randomness to give.
[[nodiscard]] std::uint32_t random_source();

/// The canonical bytes of one message, in place.
template <msg::Message M>
class CanonicalBytes {
 public:
  explicit CanonicalBytes(const M& message) noexcept {
    msg::for_each_field(message, [this](const auto& field) { this->append(field); });
  }
  [[nodiscard]] std::span<const std::byte> bytes() const noexcept {
    return std::span(bytes_).first(size_);
  }

 private:
  void append(const bool& value) noexcept {  // its byte as received, even if neither 0 nor 1
    std::memcpy(&bytes_[size_++], &value, 1);
  }
  void append(const double& value) noexcept { append(std::bit_cast<std::uint64_t>(value)); }
  template <std::integral T>
  void append(const T& value) noexcept {
    static_assert(std::endian::native == std::endian::little,
                  "the canonical bytes are the value's");
    std::memcpy(&bytes_[size_], &value, sizeof value);
    size_ += sizeof value;
  }
  template <std::size_t N>
  void append(const char (&text)[N]) noexcept {
    const std::size_t length = strnlen(text, N);
    append(static_cast<std::uint32_t>(length));
    std::memcpy(&bytes_[size_], text, length);
    size_ += length;
  }

  // Every scalar takes no more than in the struct; a string up to its length's 4 bytes more.
  std::array<std::byte, sizeof(M) + 16> bytes_;
  std::size_t size_ = 0;
};

template <msg::Message M>
[[nodiscard]] std::uint32_t canonical_crc(const M& message) noexcept {
  return safety::crc32c(CanonicalBytes<M>(message).bytes());
}

/// A message's protection before its CRC is known.
[[nodiscard]] msg::Protection make_protection(safety::DataId data_id, std::uint32_t source,
                                              std::uint32_t counter,
                                              std::chrono::nanoseconds validity,
                                              Clocks now) noexcept;
/// The same as safety/ knows it.
[[nodiscard]] safety::Protection received(const msg::Protection& protection) noexcept;

/// Fills in `message.protection`, CRC last: the message must not change any more.
template <msg::Message M>
void protect(M& message, std::uint32_t source, std::uint32_t counter,
             std::chrono::nanoseconds validity, Clocks now) noexcept {
  message.protection = make_protection(Topic<M>::policy().data_id, source, counter, validity, now);
  message.protection.crc32c = canonical_crc(message);
}

/// Checks a received message against the receiver's memory.
template <msg::Message M>
[[nodiscard]] safety::Verdict check(const M& message, safety::Receiver& receiver,
                                    Clocks now) noexcept {
  return receiver.check(received(message.protection), canonical_crc(message), now.monotonic,
                        now.utc);
}

}  // namespace holdfast::bridge::dds
