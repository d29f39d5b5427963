// SPDX-License-Identifier: Apache-2.0
// Writes the bytes of one MCAP file: schemas and channels, messages in chunks with a CRC, an index
// at the end. Formats only: whoever owns it puts pending() on the disk. What has been written up to
// the end of any chunk is a readable file; finish() adds what makes it quick to open.
#pragma once

#include <chrono>
#include <cstdint>
#include <map>
#include <string>
#include <string_view>
#include <utility>
#include <vector>

namespace holdfast::bridge::mcap {

class Writer {
 public:
  /// Magic and header are pending at once. `library` names the writing program.
  explicit Writer(std::string_view library);

  /// Before the first message. Ids count from 1.
  [[nodiscard]] std::uint16_t add_schema(std::string_view name, std::string_view encoding,
                                         std::string_view text);
  [[nodiscard]] std::uint16_t add_channel(std::uint16_t schema, std::string_view topic,
                                          std::string_view encoding);

  /// Into the chunk that is being filled. `t_log`: since the Unix epoch.
  void message(std::uint16_t channel, std::uint32_t sequence, std::chrono::nanoseconds t_log,
               std::string_view data);
  [[nodiscard]] std::size_t chunk_bytes() const { return chunk_.size(); }

  /// The chunk becomes pending. Nothing without messages.
  void end_chunk();
  /// end_chunk(), then data end, summary, footer. Nothing may follow.
  void finish();

  /// Bytes not fetched yet, in file order.
  [[nodiscard]] const std::string& pending() const { return pending_; }
  void clear_pending() { pending_.clear(); }

 private:
  using Index = std::vector<std::pair<std::uint64_t, std::uint64_t>>;  // time, offset in the chunk
  void emit(std::string_view record);
  void add_summary();

  std::string pending_, chunk_;
  std::string schemas_, channels_, chunk_indexes_;  // again in the summary
  std::map<std::uint16_t, Index> index_;            // of the chunk that is being filled
  std::map<std::uint16_t, std::uint64_t> message_counts_;
  std::uint64_t offset_ = 0;  // bytes emitted
  std::uint32_t data_crc_ = 0;
  std::uint64_t chunk_start_ = 0, chunk_end_ = 0, file_start_ = 0, file_end_ = 0;
  std::uint64_t messages_ = 0;
  std::uint32_t chunks_ = 0;
  std::uint16_t schema_count_ = 0;
};

/// CRC-32 (zlib's) of `bytes`, continued from `crc`.
[[nodiscard]] std::uint32_t crc32(std::string_view bytes, std::uint32_t crc = 0);

}  // namespace holdfast::bridge::mcap
