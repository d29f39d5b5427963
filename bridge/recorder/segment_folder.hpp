// SPDX-License-Identifier: Apache-2.0
// A folder of recording files with one bound on their sum: when it is reached, or the disk is full,
// the oldest file goes first, whole. Touches no file but `holdfast-*.mcap`; their names are in the
// order of time. Whatever the disk does shows as a return value, never as an exception or a signal.
#pragma once

#include <cstdint>
#include <deque>
#include <filesystem>
#include <optional>
#include <string>
#include <string_view>
#include <vector>

#include <sys/types.h>

namespace holdfast::bridge {

/// The recordings in `folder`, oldest first. Empty when there is no such folder.
[[nodiscard]] std::vector<std::filesystem::path> recordings_in(const std::filesystem::path& folder);

/// Why recordings cannot be written to `folder`, in a few words; empty when they can, also when it
/// is still to be made.
[[nodiscard]] std::optional<std::string> invalid_recording_folder(
    const std::filesystem::path& folder);

class SegmentFolder {
 public:
  using Write = ssize_t (*)(int descriptor, const void* bytes, std::size_t count);

  /// Makes the folder, and keeps every other recorder out of it. Throws InputError when it cannot
  /// be made or written, or is in use. `write` as write(2), for tests.
  SegmentFolder(const std::filesystem::path& folder, std::uint64_t size_max_bytes,
                Write write = nullptr);
  ~SegmentFolder();
  SegmentFolder(const SegmentFolder&) = delete;
  SegmentFolder& operator=(const SegmentFolder&) = delete;

  /// Begins holdfast-NAME.mcap; the one before is closed as it is. False: error() says why.
  [[nodiscard]] bool open(const std::string& name);
  /// Appends to the open file, all or nothing. False: error() says why, and the file ends where it
  /// did before.
  [[nodiscard]] bool append(std::string_view bytes);
  /// What was appended is on the disk. False: error().
  [[nodiscard]] bool sync();
  void close();
  /// The open file is removed.
  void discard();

  [[nodiscard]] const std::filesystem::path& open_file() const { return file_; }
  [[nodiscard]] std::uint64_t open_bytes() const { return open_bytes_; }
  [[nodiscard]] std::uint64_t total_bytes() const { return closed_bytes_ + open_bytes_; }
  [[nodiscard]] int error() const { return error_; }  ///< errno of the newest failure

 private:
  struct Segment {
    std::filesystem::path file;
    std::uint64_t bytes;
  };
  [[nodiscard]] bool remove_oldest();
  [[nodiscard]] bool try_append(std::string_view bytes);

  std::filesystem::path folder_, file_;
  std::uint64_t size_max_bytes_;
  Write write_;
  int lock_ = -1, descriptor_ = -1, error_ = 0;
  std::deque<Segment> closed_;  // oldest first
  std::uint64_t closed_bytes_ = 0, open_bytes_ = 0;
};

}  // namespace holdfast::bridge
