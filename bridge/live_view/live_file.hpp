// SPDX-License-Identifier: Apache-2.0
// The live view's file, which holds one picture, the newest: put it on a file system in memory
// (/run, /dev/shm). One process writes, any number read, and none waits: the writer makes the
// header's sequence odd before it changes anything and even when it has; a reader that saw it odd,
// or changing, has seen no picture.
//
// Neither side maps the file: where it is cut short, or its file system is full, a call ends short,
// and not the process.
#pragma once

#include <cstdint>
#include <filesystem>
#include <optional>
#include <string>
#include <string_view>
#include <vector>

#include "bridge/dds/message_protection.hpp"
#include "bridge/live_view/live_layout.hpp"

namespace holdfast::bridge {

/// Why no live view can be written to `file`, in a few words; empty when one can. A file that is
/// there and is no live view is never overwritten.
[[nodiscard]] std::optional<std::string> invalid_live_file(const std::filesystem::path& file);

class LiveWriter {
 public:
  /// A new file of mode 0640 in the place of an old one, so that no reader of the old one sees a
  /// mixture. Throws InputError as invalid_live_file() says, UnavailableError when it cannot be
  /// made.
  explicit LiveWriter(std::filesystem::path file);
  ~LiveWriter();  ///< removes it, unless another took its place
  LiveWriter(const LiveWriter&) = delete;
  LiveWriter& operator=(const LiveWriter&) = delete;

  /// One thread at a time; not for the real-time thread. 0, or the errno of what went wrong
  /// (EINVAL: no picture that could be read); then no reader sees a picture until the next.
  [[nodiscard]] int write(const LivePicture& picture);

 private:
  std::filesystem::path file_;
  int descriptor_ = -1;
  std::uint64_t sequence_ = 0;
  std::vector<std::uint8_t> bytes_;
};

/// Why there is no live picture.
enum class NoPicture : std::uint8_t {
  none,           ///< there is one
  no_file,        ///< the daemon does not run, or writes none, or elsewhere
  not_readable,   ///< not allowed, no file, or one that others may write
  not_ours,       ///< another kind of file
  other_version,  ///< of another version of this program
  damaged,        ///< cut short, or says what cannot be
  old             ///< the newest is no longer the present
};
[[nodiscard]] std::string_view sentence(NoPicture why) noexcept;

/// From exposure on. No picture is shown longer: it would be taken for the present.
inline constexpr std::chrono::nanoseconds kLiveAgeMax = std::chrono::milliseconds(500);

/// True when the picture was exposed within kLiveAgeMax before `now`, by both clocks: each alone
/// could agree by chance with a file of before a restart of the machine.
[[nodiscard]] bool is_live(const LivePicture& picture, dds::Clocks now) noexcept;

class LiveReader {
 public:
  explicit LiveReader(std::filesystem::path file) : file_(std::move(file)) {}

  /// The newest picture if it is live, else null. Takes any bytes; waits for nothing. Valid until
  /// the next call. One thread.
  [[nodiscard]] const LivePicture* look(dds::Clocks now);
  /// Of the newest look.
  [[nodiscard]] NoPicture why() const noexcept { return why_; }
  /// CLOCK_MONOTONIC of the newest look that found one; none before the first.
  [[nodiscard]] std::optional<std::chrono::nanoseconds> t_seen() const noexcept { return t_seen_; }

 private:
  [[nodiscard]] NoPicture read();
  [[nodiscard]] NoPicture read_from(int descriptor);

  std::filesystem::path file_;
  std::vector<std::uint8_t> bytes_, head_;  // the newest file's, and the header it began with
  LivePicture picture_, incoming_;
  bool has_picture_ = false;
  NoPicture why_ = NoPicture::no_file;
  std::optional<std::chrono::nanoseconds> t_seen_;
};

}  // namespace holdfast::bridge
