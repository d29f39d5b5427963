// SPDX-License-Identifier: Apache-2.0
// Our MCAP files against our own reader: whole, cut off at every byte, with every byte changed, and
// with random bytes. The official reader reads them in tests/bridge/mcap_reader.
#include <filesystem>
#include <random>
#include <string>
#include <vector>

#include <gtest/gtest.h>
#include <sys/mman.h>
#include <unistd.h>

#include "bridge/recorder/mcap_format.hpp"
#include "bridge/recorder/mcap_reader.hpp"
#include "bridge/recorder/mcap_writer.hpp"
#include "rt/core/error.hpp"

namespace holdfast::bridge::mcap {
namespace {

namespace fs = std::filesystem;
using namespace std::chrono_literals;

/// Two topics, three chunks; `ends` gets the file's size after each.
std::string small_file(std::vector<std::size_t>* ends = nullptr) {
  Writer writer("test");
  const std::uint16_t schema = writer.add_schema("a/msg/B", "ros2msg", "uint8 x\n");
  const std::uint16_t first = writer.add_channel(schema, "/first", "cdr");
  const std::uint16_t second = writer.add_channel(schema, "/second", "cdr");
  std::string bytes = writer.pending();
  writer.clear_pending();
  for (std::uint32_t chunk = 0; chunk < 3; ++chunk) {
    for (std::uint32_t i = 0; i < 4; ++i)
      writer.message(i % 2 == 0 ? first : second, i, 1s * chunk + 1ms * i,
                     "chunk " + std::to_string(chunk) + " message " + std::to_string(i));
    writer.end_chunk();
    bytes += writer.pending();
    writer.clear_pending();
    if (ends != nullptr) ends->push_back(bytes.size());
  }
  writer.finish();
  return bytes + writer.pending();
}

struct Content {
  std::vector<std::string> messages;
  bool is_closed = false;
  std::uint64_t cut_off = 0;
  friend bool operator==(const Content&, const Content&) = default;
};

class McapTest : public ::testing::Test {
 protected:
  void SetUp() override { ASSERT_GE(memory_, 0); }
  void TearDown() override { ::close(memory_); }
  [[nodiscard]] Content read(const std::string& bytes) const {
    EXPECT_EQ(::ftruncate(memory_, 0), 0);
    EXPECT_EQ(::pwrite(memory_, bytes.data(), bytes.size(), 0), static_cast<ssize_t>(bytes.size()));
    Reader reader(file_);
    Content content;
    Message message;
    while (reader.next(message))
      content.messages.push_back(message.channel->topic + " " + std::string(message.data));
    content.is_closed = reader.is_closed();
    content.cut_off = reader.bytes_cut_off();
    return content;
  }
  /// Whether the reader says that something is wrong.
  [[nodiscard]] bool is_refused(const std::string& bytes) const {
    try {
      (void)read(bytes);
      return false;
    } catch (const InputError&) {
      return true;
    }
  }
  int memory_ = ::memfd_create("mcap-test", MFD_CLOEXEC);  // thousands of files: none on a disk
  fs::path file_ = "/proc/self/fd/" + std::to_string(memory_);
};

TEST_F(McapTest, ReadsBackWhatWasWritten) {
  const Content content = read(small_file());
  ASSERT_EQ(content.messages.size(), 12U);
  EXPECT_EQ(content.messages.front(), "/first chunk 0 message 0");
  EXPECT_EQ(content.messages.back(), "/second chunk 2 message 3");
  EXPECT_TRUE(content.is_closed);
  EXPECT_EQ(content.cut_off, 0U);
}

TEST_F(McapTest, CutOffAnywhereTheWholeChunksAreReadAndTheRestIsReported) {
  std::vector<std::size_t> ends;
  const std::string bytes = small_file(&ends);
  for (std::size_t size = 0; size < bytes.size(); ++size) {
    const Content content = read(bytes.substr(0, size));
    EXPECT_FALSE(content.is_closed) << size;
    std::size_t whole = 0;
    for (const std::size_t end : ends) whole += end <= size ? 4 : 0;
    EXPECT_GE(content.messages.size(), whole) << size;
    EXPECT_LE(content.cut_off, size) << size;
  }
}

TEST_F(McapTest, OneChangedByteAnywhereInAClosedFileIsRefused) {
  const std::string bytes = small_file();
  for (std::size_t at = 0; at < bytes.size(); ++at)
    for (const int bit : {0, 3, 7}) {
      std::string changed = bytes;
      changed[at] = static_cast<char>(changed[at] ^ (1 << bit));
      EXPECT_TRUE(is_refused(changed)) << "byte " << at << " bit " << bit;
    }
}

TEST_F(McapTest, AChangedByteOfTheDataInACutOffFileIsRefusedOrReported) {
  std::vector<std::size_t> ends;
  const std::string whole = small_file(&ends);
  const std::string bytes = whole.substr(0, ends.back());
  const Content truth = read(bytes);
  for (std::size_t at = 0; at < bytes.size(); ++at) {
    std::string changed = bytes;
    changed[at] = static_cast<char>(changed[at] ^ 0x10);
    if (is_refused(changed)) continue;
    const Content content = read(changed);
    // What is read is true: names aside, which only a closed file protects.
    for (std::size_t i = 0; i < content.messages.size(); ++i) {
      const std::string& message = content.messages[i];
      EXPECT_EQ(message.substr(message.find(' ')),
                truth.messages[i].substr(truth.messages[i].find(' ')))
          << at;
    }
    if (content.messages.size() < truth.messages.size()) {
      EXPECT_GT(content.cut_off, 0U) << at;
    }
  }
}

TEST_F(McapTest, UnwrittenBytesAfterALossOfPowerAreACutOffEnd) {
  std::vector<std::size_t> ends;
  const std::string bytes = small_file(&ends).substr(0, ends[1]) + std::string(5000, '\0');
  const Content content = read(bytes);
  EXPECT_EQ(content.messages.size(), 8U);
  EXPECT_EQ(content.cut_off, 5000U);
}

TEST_F(McapTest, RefusesWhatIsNoMcapFileOrNotThere) {
  EXPECT_TRUE(is_refused("not an MCAP file, but long enough to be one"));
  EXPECT_TRUE(is_refused(std::string(100, '\0')));
  EXPECT_THROW(Reader("/nowhere/at/all.mcap"), InputError);
  EXPECT_THROW(Reader("/tmp"), InputError);
}

TEST_F(McapTest, RefusesALengthThatWouldFillTheMemory) {
  std::string bytes = small_file();
  const std::size_t length_at = kMagic.size() + 1;
  const std::uint64_t length = kRecordBytesMax + 1;
  std::memcpy(bytes.data() + length_at, &length, sizeof(length));
  EXPECT_TRUE(is_refused(bytes));
  EXPECT_TRUE(is_refused(bytes.substr(0, bytes.size() - 1)));
}

TEST_F(McapTest, NoBytesWhateverMakeTheReaderFailOtherwise) {
  std::mt19937 random(1);
  const std::string bytes = small_file();
  for (int run = 0; run < 3000; ++run) {
    std::string changed = bytes.substr(0, random() % (bytes.size() + 1));
    if (run % 3 == 0) {  // magic, then noise
      for (std::size_t i = kMagic.size(); i < changed.size(); ++i)
        changed[i] = static_cast<char>(random());
    } else {
      for (unsigned edits = random() % 8; edits > 0 && changed.size() > kMagic.size(); --edits) {
        const std::size_t at = kMagic.size() + random() % (changed.size() - kMagic.size());
        if (random() % 2 == 0)
          changed[at] = static_cast<char>(random());
        else
          changed.insert(at, changed.substr(random() % changed.size(), random() % 64));
      }
    }
    (void)is_refused(changed);  // returns, with or without: no crash, no other exception
  }
}

}  // namespace
}  // namespace holdfast::bridge::mcap
