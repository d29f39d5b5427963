// SPDX-License-Identifier: Apache-2.0
// What writer and reader share of the MCAP container, version 0 (mcap.dev/spec): magic, record
// kinds, little-endian fields. Only what our recordings use; chunks are never compressed.
#pragma once

#include <concepts>
#include <cstdint>
#include <cstring>
#include <string>
#include <string_view>

namespace holdfast::bridge::mcap {

inline constexpr std::string_view kMagic{"\x89MCAP0\r\n", 8};
inline constexpr std::size_t kRecordHeaderBytes = 9;  ///< kind, then 64-bit length of the content
/// Longest record that we write or accept; bounds the reader's memory.
inline constexpr std::uint64_t kRecordBytesMax = std::uint64_t{16} << 20U;

enum class Kind : std::uint8_t {
  header = 0x01,
  footer = 0x02,
  schema = 0x03,
  channel = 0x04,
  message = 0x05,
  chunk = 0x06,
  message_index = 0x07,
  chunk_index = 0x08,
  attachment = 0x09,
  attachment_index = 0x0A,
  statistics = 0x0B,
  metadata = 0x0C,
  metadata_index = 0x0D,
  summary_offset = 0x0E,
  data_end = 0x0F
};

/// Appends fields to a byte string.
class FieldWriter {
 public:
  explicit FieldWriter(std::string& out) : out_(out) {}
  template <std::unsigned_integral T>
  FieldWriter& number(T value) {
    char bytes[sizeof(T)];
    std::memcpy(bytes, &value, sizeof(T));  // little-endian, as every machine we build for
    out_.append(bytes, sizeof(T));
    return *this;
  }
  /// 32-bit length, then the bytes.
  FieldWriter& text(std::string_view bytes) {
    number(static_cast<std::uint32_t>(bytes.size()));
    out_.append(bytes);
    return *this;
  }

 private:
  std::string& out_;
};

/// Takes fields off a byte string. When the bytes end early every later field is zero or empty and
/// is_valid() false: checked once, at the end.
class FieldReader {
 public:
  explicit FieldReader(std::string_view bytes) : rest_(bytes) {}
  template <std::unsigned_integral T>
  [[nodiscard]] T number() {
    T value{};
    const std::string_view bytes = take(sizeof(T));
    if (bytes.size() == sizeof(T)) std::memcpy(&value, bytes.data(), sizeof(T));
    return value;
  }
  [[nodiscard]] std::string_view text() { return take(number<std::uint32_t>()); }
  [[nodiscard]] std::string_view take(std::uint64_t bytes) {
    if (bytes > rest_.size()) {
      is_valid_ = false;
      rest_ = {};
      return {};
    }
    const std::string_view taken = rest_.substr(0, bytes);
    rest_.remove_prefix(bytes);
    return taken;
  }
  [[nodiscard]] std::string_view rest() const { return rest_; }
  [[nodiscard]] bool is_valid() const { return is_valid_; }

 private:
  std::string_view rest_;
  bool is_valid_ = true;
};

}  // namespace holdfast::bridge::mcap
