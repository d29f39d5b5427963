// SPDX-License-Identifier: Apache-2.0
// Reads an MCAP file from front to back, one chunk in memory at a time, and trusts nothing in it:
// every CRC is checked, every length bounded. A file whose writer was killed ends early: its whole
// part is read, and what is cut off is reported. Only uncompressed chunks, as our writer makes
// them.
#pragma once

#include <cstdint>
#include <filesystem>
#include <map>
#include <string>
#include <string_view>

namespace holdfast::bridge::mcap {

struct Schema {
  std::string name, encoding, text;
};

struct Channel {
  std::string topic, encoding;
  Schema schema;
};

struct Message {
  const Channel* channel = nullptr;  ///< valid as long as the reader
  std::uint32_t sequence = 0;
  std::uint64_t t_log_ns = 0;  ///< since the Unix epoch
  std::string_view data;       ///< valid until the next call
};

class Reader {
 public:
  /// Throws InputError when the file cannot be read or is no MCAP file. One that holds no more than
  /// a part of the magic counts as cut off at byte 0.
  explicit Reader(const std::filesystem::path& file);
  ~Reader();
  Reader(const Reader&) = delete;
  Reader& operator=(const Reader&) = delete;

  /// False at the end. Throws InputError, naming the byte, on a part that is damaged: a CRC that
  /// does not match, a length or kind that cannot be, a file that was closed and is not whole.
  [[nodiscard]] bool next(Message& message);

  /// After the end: the writer closed the file, and nothing is missing.
  [[nodiscard]] bool is_closed() const { return is_closed_; }
  /// After the end: bytes of a last record that is not whole; 0 where it was cut between records.
  [[nodiscard]] std::uint64_t bytes_cut_off() const { return bytes_cut_off_; }
  [[nodiscard]] std::uint64_t file_bytes() const { return file_bytes_; }

 private:
  [[noreturn]] void fail(std::uint64_t at, const std::string& what) const;
  [[nodiscard]] bool read_record();
  [[nodiscard]] bool cut_off();
  void read_bytes(std::string& out, std::uint64_t bytes);
  [[nodiscard]] bool is_rest_zero();
  void take_schema(std::string_view content);
  void take_channel(std::string_view content);
  void take_chunk();
  void take_message(std::string_view content, Message& message) const;
  void take_data_end(std::string_view content);
  void take_summary();

  std::filesystem::path file_;
  int descriptor_ = -1;
  std::uint64_t file_bytes_ = 0;
  std::uint64_t offset_ = 0;         // bytes read
  std::uint64_t record_offset_ = 0;  // of the record in record_
  std::uint32_t data_crc_ = 0;       // up to and without record_
  std::string record_;               // head and content
  std::string_view chunk_rest_;
  std::map<std::uint16_t, Schema> schemas_;
  std::map<std::uint16_t, Channel> channels_;
  bool has_magic_at_end_ = false, is_at_end_ = false, is_closed_ = false;
  std::uint64_t bytes_cut_off_ = 0;
};

}  // namespace holdfast::bridge::mcap
