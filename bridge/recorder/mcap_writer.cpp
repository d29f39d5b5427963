// SPDX-License-Identifier: Apache-2.0
#include "bridge/recorder/mcap_writer.hpp"

#include <algorithm>

#include <zlib.h>

#include "bridge/recorder/mcap_format.hpp"

namespace holdfast::bridge::mcap {
namespace {

std::string record(Kind kind, std::string_view content) {
  std::string bytes;
  bytes.reserve(kRecordHeaderBytes + content.size());
  FieldWriter(bytes)
      .number(static_cast<std::uint8_t>(kind))
      .number(static_cast<std::uint64_t>(content.size()));
  bytes.append(content);
  return bytes;
}

}  // namespace

std::uint32_t crc32(std::string_view bytes, std::uint32_t crc) {
  return static_cast<std::uint32_t>(
      ::crc32_z(crc, reinterpret_cast<const Bytef*>(bytes.data()), bytes.size()));
}

Writer::Writer(std::string_view library) {
  emit(kMagic);
  std::string header;
  FieldWriter(header).text("").text(library);  // no profile
  emit(record(Kind::header, header));
}

void Writer::emit(std::string_view bytes) {
  data_crc_ = crc32(bytes, data_crc_);
  offset_ += bytes.size();
  pending_.append(bytes);
}

std::uint16_t Writer::add_schema(std::string_view name, std::string_view encoding,
                                 std::string_view text) {
  const std::uint16_t id = ++schema_count_;
  std::string content;
  FieldWriter(content).number(id).text(name).text(encoding).text(text);
  const std::string bytes = record(Kind::schema, content);
  schemas_ += bytes;
  emit(bytes);
  return id;
}

std::uint16_t Writer::add_channel(std::uint16_t schema, std::string_view topic,
                                  std::string_view encoding) {
  const auto id = static_cast<std::uint16_t>(message_counts_.size() + 1);
  message_counts_[id] = 0;
  std::string content;
  FieldWriter(content).number(id).number(schema).text(topic).text(encoding).text("");
  const std::string bytes = record(Kind::channel, content);
  channels_ += bytes;
  emit(bytes);
  return id;
}

void Writer::message(std::uint16_t channel, std::uint32_t sequence, std::chrono::nanoseconds t_log,
                     std::string_view data) {
  const auto t = static_cast<std::uint64_t>(t_log.count());
  chunk_start_ = chunk_.empty() ? t : std::min(chunk_start_, t);
  chunk_end_ = chunk_.empty() ? t : std::max(chunk_end_, t);
  file_start_ = messages_ == 0 ? t : std::min(file_start_, t);
  file_end_ = messages_ == 0 ? t : std::max(file_end_, t);
  index_[channel].emplace_back(t, chunk_.size());
  constexpr std::size_t kFixedBytes = 2 + 4 + 8 + 8;
  FieldWriter(chunk_)
      .number(static_cast<std::uint8_t>(Kind::message))
      .number(static_cast<std::uint64_t>(kFixedBytes + data.size()))
      .number(channel)
      .number(sequence)
      .number(t)
      .number(t);
  chunk_.append(data);
  ++messages_;
  ++message_counts_[channel];
}

void Writer::end_chunk() {
  if (chunk_.empty()) return;
  const std::uint64_t chunk_offset = offset_;
  std::string content;
  content.reserve(chunk_.size() + 64);
  FieldWriter(content)
      .number(chunk_start_)
      .number(chunk_end_)
      .number(static_cast<std::uint64_t>(chunk_.size()))
      .number(crc32(chunk_))
      .text("")
      .number(static_cast<std::uint64_t>(chunk_.size()));
  content.append(chunk_);
  emit(record(Kind::chunk, content));
  const std::uint64_t chunk_length = offset_ - chunk_offset;

  const std::uint64_t indexes_offset = offset_;
  std::string index_offsets;
  for (const auto& [channel, entries] : index_) {
    FieldWriter(index_offsets).number(channel).number(offset_);
    std::string pairs;
    for (const auto& [t, offset] : entries) FieldWriter(pairs).number(t).number(offset);
    std::string index;
    FieldWriter(index).number(channel).text(pairs);
    emit(record(Kind::message_index, index));
  }
  std::string chunk_index;
  FieldWriter(chunk_index)
      .number(chunk_start_)
      .number(chunk_end_)
      .number(chunk_offset)
      .number(chunk_length)
      .text(index_offsets)
      .number(offset_ - indexes_offset)
      .text("")
      .number(static_cast<std::uint64_t>(chunk_.size()))
      .number(static_cast<std::uint64_t>(chunk_.size()));
  chunk_indexes_ += record(Kind::chunk_index, chunk_index);
  ++chunks_;
  chunk_.clear();
  index_.clear();
}

void Writer::finish() {
  end_chunk();
  std::string data_end;
  FieldWriter(data_end).number(data_crc_);
  emit(record(Kind::data_end, data_end));
  add_summary();
  emit(kMagic);
}

/// Schemas, channels, statistics and chunk indexes, where each group stands, and the footer.
void Writer::add_summary() {
  const std::uint64_t summary_start = offset_;
  std::string counts;
  for (const auto& [channel, count] : message_counts_)
    FieldWriter(counts).number(channel).number(count);
  std::string statistics;
  FieldWriter(statistics)
      .number(messages_)
      .number(schema_count_)
      .number(static_cast<std::uint32_t>(message_counts_.size()))
      .number(std::uint32_t{0})
      .number(std::uint32_t{0})
      .number(chunks_)
      .number(file_start_)
      .number(file_end_)
      .text(counts);
  std::string summary;
  std::string offsets;
  const auto add_group = [&](Kind kind, const std::string& group) {
    if (group.empty()) return;
    std::string content;
    FieldWriter(content)
        .number(static_cast<std::uint8_t>(kind))
        .number(summary_start + summary.size())
        .number(static_cast<std::uint64_t>(group.size()));
    offsets += record(Kind::summary_offset, content);
    summary += group;
  };
  add_group(Kind::schema, schemas_);
  add_group(Kind::channel, channels_);
  add_group(Kind::statistics, record(Kind::statistics, statistics));
  add_group(Kind::chunk_index, chunk_indexes_);
  std::string footer;
  FieldWriter(footer).number(summary_start).number(summary_start + summary.size());
  // The CRC reaches over the footer's own first fields.
  std::string head;
  constexpr std::uint64_t kFooterBytes = 20;
  FieldWriter(head).number(static_cast<std::uint8_t>(Kind::footer)).number(kFooterBytes);
  const std::uint32_t crc = crc32(head + footer, crc32(offsets, crc32(summary)));
  FieldWriter(footer).number(crc);
  emit(summary);
  emit(offsets);
  emit(record(Kind::footer, footer));
}

}  // namespace holdfast::bridge::mcap
