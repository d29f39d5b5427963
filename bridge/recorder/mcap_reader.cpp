// SPDX-License-Identifier: Apache-2.0
#include "bridge/recorder/mcap_reader.hpp"

#include <algorithm>
#include <array>
#include <cerrno>
#include <cstring>

#include <fcntl.h>
#include <fmt/format.h>
#include <sys/stat.h>
#include <unistd.h>

#include "bridge/recorder/mcap_format.hpp"
#include "bridge/recorder/mcap_writer.hpp"
#include "rt/core/error.hpp"

namespace holdfast::bridge::mcap {
namespace {

constexpr std::size_t kFooterBytes = 20;

Kind kind_of(std::string_view record) {
  return static_cast<Kind>(static_cast<std::uint8_t>(record[0]));
}

}  // namespace

Reader::Reader(const std::filesystem::path& file) : file_(file) {
  descriptor_ = ::open(file.c_str(), O_RDONLY | O_CLOEXEC);
  struct stat status {};
  if (descriptor_ < 0 || ::fstat(descriptor_, &status) != 0 || !S_ISREG(status.st_mode)) {
    const int error = S_ISDIR(status.st_mode) ? EISDIR : errno;
    if (descriptor_ >= 0) ::close(descriptor_);
    throw InputError(fmt::format("{}: cannot be read: {}", file.string(), std::strerror(error)));
  }
  file_bytes_ = static_cast<std::uint64_t>(status.st_size);
  std::array<char, kMagic.size()> end{};
  has_magic_at_end_ =
      file_bytes_ > 2 * kMagic.size() &&
      ::pread(descriptor_, end.data(), end.size(), static_cast<off_t>(file_bytes_ - end.size())) ==
          static_cast<ssize_t>(end.size()) &&
      std::string_view(end.data(), end.size()) == kMagic;
  std::string start;
  try {
    read_bytes(start, std::min<std::uint64_t>(kMagic.size(), file_bytes_));
    if (start != kMagic.substr(0, start.size()))
      throw InputError(fmt::format("{}: not an MCAP file", file.string()));
  } catch (...) {
    ::close(descriptor_);
    throw;
  }
  data_crc_ = crc32(start);
  if (start.size() < kMagic.size()) {
    is_at_end_ = true;
    bytes_cut_off_ = file_bytes_;
  }
}

Reader::~Reader() {
  ::close(descriptor_);
}

void Reader::fail(std::uint64_t at, const std::string& what) const {
  throw InputError(fmt::format("{}: byte {}: {}", file_.string(), at, what));
}

/// Exactly so many, which the caller knows to be there.
void Reader::read_bytes(std::string& out, std::uint64_t bytes) {
  const std::size_t before = out.size();
  out.resize(before + bytes);
  std::size_t done = 0;
  while (done < bytes) {
    const ssize_t count = ::read(descriptor_, out.data() + before + done, bytes - done);
    if (count < 0 && errno == EINTR) continue;
    if (count < 0) fail(offset_ + done, std::string("cannot be read: ") + std::strerror(errno));
    if (count == 0) fail(offset_ + done, "the file became shorter while it was read");
    done += static_cast<std::size_t>(count);
  }
  offset_ += bytes;
}

/// The file ends within a record, or the disk never got the rest. False, as what it ends.
bool Reader::cut_off() {
  if (has_magic_at_end_) fail(record_offset_, "a record that goes beyond the end: damaged");
  bytes_cut_off_ = file_bytes_ - record_offset_;
  is_at_end_ = true;
  return false;
}

/// After a loss of power the file may be longer than what was written to it.
bool Reader::is_rest_zero() {
  if (file_bytes_ - record_offset_ > kRecordBytesMax) return false;
  std::string rest = record_;
  read_bytes(rest, file_bytes_ - offset_);
  return rest.find_first_not_of('\0') == std::string::npos;
}

/// The next record of the file into record_; false at the end.
bool Reader::read_record() {
  data_crc_ = crc32(record_, data_crc_);
  record_.clear();
  record_offset_ = offset_;
  if (offset_ == file_bytes_) {
    if (has_magic_at_end_) fail(offset_, "no end of data in a file that was closed: damaged");
    is_at_end_ = true;
    return false;
  }
  if (file_bytes_ - offset_ < kRecordHeaderBytes) return cut_off();
  read_bytes(record_, kRecordHeaderBytes);
  FieldReader head(std::string_view(record_).substr(1));
  const auto length = head.number<std::uint64_t>();
  if (record_[0] == 0 && is_rest_zero()) return cut_off();
  if (length > kRecordBytesMax)
    fail(record_offset_,
         fmt::format("a record of {} bytes, at most {}: damaged", length, kRecordBytesMax));
  if (length > file_bytes_ - offset_) return cut_off();
  read_bytes(record_, length);
  return true;
}

bool Reader::next(Message& message) {
  while (true) {
    if (!chunk_rest_.empty()) {
      FieldReader reader(chunk_rest_);
      const auto kind = static_cast<Kind>(reader.number<std::uint8_t>());
      const std::string_view content = reader.take(reader.number<std::uint64_t>());
      if (!reader.is_valid()) fail(record_offset_, "a chunk whose records do not fit it: damaged");
      chunk_rest_ = reader.rest();
      if (kind != Kind::message) continue;
      take_message(content, message);
      return true;
    }
    if (is_at_end_ || !read_record()) return false;
    const std::string_view content = std::string_view(record_).substr(kRecordHeaderBytes);
    switch (kind_of(record_)) {
      case Kind::schema:
        take_schema(content);
        break;
      case Kind::channel:
        take_channel(content);
        break;
      case Kind::chunk:
        take_chunk();
        break;
      case Kind::message:
        take_message(content, message);
        return true;
      case Kind::data_end:
        take_data_end(content);
        return false;
      case Kind::header:
      case Kind::message_index:
      case Kind::attachment:
      case Kind::metadata:
        break;
      default:
        fail(record_offset_, fmt::format("a record of kind {} among the data: damaged",
                                         static_cast<unsigned>(kind_of(record_))));
    }
  }
}

void Reader::take_schema(std::string_view content) {
  FieldReader reader(content);
  const auto id = reader.number<std::uint16_t>();
  Schema schema;
  schema.name = reader.text();
  schema.encoding = reader.text();
  schema.text = reader.text();
  if (!reader.is_valid()) fail(record_offset_, "a schema that is too short: damaged");
  schemas_.try_emplace(id, std::move(schema));
}

void Reader::take_channel(std::string_view content) {
  FieldReader reader(content);
  const auto id = reader.number<std::uint16_t>();
  const auto schema = schemas_.find(reader.number<std::uint16_t>());
  Channel channel;
  channel.topic = reader.text();
  channel.encoding = reader.text();
  if (!reader.is_valid() || schema == schemas_.end())
    fail(record_offset_, "a channel that is too short or has no schema: damaged");
  channel.schema = schema->second;
  channels_.try_emplace(id, std::move(channel));
}

void Reader::take_chunk() {
  FieldReader reader(std::string_view(record_).substr(kRecordHeaderBytes));
  (void)reader.take(16);  // first and last time
  const auto size = reader.number<std::uint64_t>();
  const auto crc = reader.number<std::uint32_t>();
  const std::string_view compression = reader.text();
  const std::string_view records = reader.take(reader.number<std::uint64_t>());
  if (!reader.is_valid() || !reader.rest().empty())
    fail(record_offset_, "a chunk whose lengths contradict: damaged");
  if (!compression.empty())
    fail(record_offset_, fmt::format("a chunk compressed with {}: not a recording of ours",
                                     std::string(compression.substr(0, 16))));
  if (records.size() != size || crc32(records) != crc)
    fail(record_offset_, "a chunk whose CRC does not match: damaged");
  chunk_rest_ = records;
}

void Reader::take_message(std::string_view content, Message& message) const {
  FieldReader reader(content);
  const auto channel = channels_.find(reader.number<std::uint16_t>());
  message.sequence = reader.number<std::uint32_t>();
  message.t_log_ns = reader.number<std::uint64_t>();
  (void)reader.number<std::uint64_t>();
  if (!reader.is_valid() || channel == channels_.end())
    fail(record_offset_, "a message that is too short or has no channel: damaged");
  message.channel = &channel->second;
  message.data = reader.rest();
}

void Reader::take_data_end(std::string_view content) {
  FieldReader reader(content);
  const auto crc = reader.number<std::uint32_t>();
  if (!reader.is_valid() || crc != data_crc_)
    fail(record_offset_, "the CRC of all data does not match: damaged");
  is_at_end_ = true;
  take_summary();
}

/// Nothing in it is needed; its CRC and the magic at the end say that the file is whole.
void Reader::take_summary() {
  record_offset_ = offset_;
  const std::uint64_t size = file_bytes_ - offset_;
  if (size > kRecordBytesMax) fail(offset_, "a summary that is too long: damaged");
  std::string summary;
  read_bytes(summary, size);
  FieldReader reader(summary);
  while (true) {
    const std::size_t at = summary.size() - reader.rest().size();
    const auto kind = static_cast<Kind>(reader.number<std::uint8_t>());
    const std::string_view content = reader.take(reader.number<std::uint64_t>());
    if (!reader.is_valid()) {
      (void)cut_off();
      return;
    }
    if (kind != Kind::footer) continue;
    const std::size_t crc_at = at + kRecordHeaderBytes + kFooterBytes - sizeof(std::uint32_t);
    if (content.size() != kFooterBytes) fail(record_offset_ + at, "a footer of a wrong length");
    const auto crc = FieldReader(content.substr(kFooterBytes - 4)).number<std::uint32_t>();
    if (crc32(std::string_view(summary).substr(0, crc_at)) != crc)
      fail(record_offset_ + at, "the CRC of the summary does not match: damaged");
    break;
  }
  if (reader.rest() == kMagic) {
    is_closed_ = true;
    return;
  }
  if (reader.rest() != kMagic.substr(0, reader.rest().size()))
    fail(file_bytes_ - reader.rest().size(), "something else than the magic at the end: damaged");
  (void)cut_off();
}

}  // namespace holdfast::bridge::mcap
