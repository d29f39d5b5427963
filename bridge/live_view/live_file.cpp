// SPDX-License-Identifier: Apache-2.0
#include "bridge/live_view/live_file.hpp"

#include <algorithm>
#include <array>
#include <atomic>
#include <cerrno>
#include <cstring>
#include <span>
#include <system_error>
#include <utility>

#include <fcntl.h>
#include <fmt/format.h>
#include <sys/stat.h>
#include <unistd.h>

#include "rt/core/error.hpp"

namespace holdfast::bridge {
namespace {

namespace fs = std::filesystem;
using std::chrono::nanoseconds;

constexpr mode_t kMode = 0640;

std::string text(int error) {
  return std::generic_category().message(error);
}

/// Closes what it holds.
class Descriptor {
 public:
  explicit Descriptor(int descriptor) noexcept : descriptor_(descriptor) {}
  ~Descriptor() {
    if (descriptor_ >= 0) close(descriptor_);
  }
  Descriptor(const Descriptor&) = delete;
  Descriptor& operator=(const Descriptor&) = delete;
  [[nodiscard]] int get() const noexcept { return descriptor_; }

 private:
  int descriptor_;
};

/// A FIFO or a device in its place neither holds us up nor is followed.
int open_to_read(const fs::path& file) noexcept {
  return ::open(file.c_str(), O_RDONLY | O_NOFOLLOW | O_NONBLOCK | O_CLOEXEC);
}

/// As many bytes as there are, at most `bytes`.
std::size_t read_at(int descriptor, std::span<std::uint8_t> bytes, std::size_t at) noexcept {
  std::size_t done = 0;
  while (done < bytes.size()) {
    const ssize_t n =
        pread(descriptor, bytes.data() + done, bytes.size() - done, static_cast<off_t>(at + done));
    if (n < 0 && errno == EINTR) continue;
    if (n <= 0) break;
    done += static_cast<std::size_t>(n);
  }
  return done;
}

/// 0, or errno.
int write_at(int descriptor, std::span<const std::uint8_t> bytes, std::size_t at) noexcept {
  std::size_t done = 0;
  while (done < bytes.size()) {
    const ssize_t n =
        pwrite(descriptor, bytes.data() + done, bytes.size() - done, static_cast<off_t>(at + done));
    if (n < 0 && errno == EINTR) continue;
    if (n <= 0) return n < 0 ? errno : EIO;
    done += static_cast<std::size_t>(n);
  }
  return 0;
}

std::array<std::uint8_t, sizeof(std::uint64_t)> bytes_of(std::uint64_t number) noexcept {
  std::array<std::uint8_t, sizeof number> bytes{};
  std::memcpy(bytes.data(), &number, sizeof number);
  return bytes;
}

}  // namespace

std::optional<std::string> invalid_live_file(const fs::path& file) {
  std::error_code error;
  if (!fs::is_directory(file.has_parent_path() ? file.parent_path() : ".", error))
    return fmt::format("{}: its folder is not there", file.string());
  const auto status = fs::symlink_status(file, error);
  if (!fs::exists(status)) return std::nullopt;
  if (!fs::is_regular_file(status)) return fmt::format("{} is no file", file.string());
  const Descriptor old(open_to_read(file));
  if (old.get() < 0) return fmt::format("{}: {}", file.string(), text(errno));
  std::array<std::uint8_t, kLiveMagic.size()> head{};
  const std::size_t n = read_at(old.get(), head, 0);
  if (n == 0 || (n == head.size() && std::memcmp(head.data(), kLiveMagic.data(), n) == 0))
    return std::nullopt;
  return fmt::format("{} is there, and is no live view: nothing else is overwritten",
                     file.string());
}

LiveWriter::LiveWriter(fs::path file) : file_(std::move(file)) {
  if (const auto what = invalid_live_file(file_))
    throw InputError(fmt::format("live view: {}", *what));
  const auto fail = [this](int error) {
    throw UnavailableError(fmt::format("live view: {}: {}", file_.string(), text(error)));
  };
  if (unlink(file_.c_str()) != 0 && errno != ENOENT) fail(errno);
  descriptor_ = ::open(file_.c_str(), O_RDWR | O_CREAT | O_EXCL | O_NOFOLLOW | O_CLOEXEC, kMode);
  if (descriptor_ < 0) fail(errno);
  if (fchmod(descriptor_, kMode) == 0) return;  // whatever the umask took away
  const int error = errno;
  close(descriptor_);
  fail(error);
}

LiveWriter::~LiveWriter() {
  struct stat own {
  }, there{};
  const bool is_ours = fstat(descriptor_, &own) == 0 && lstat(file_.c_str(), &there) == 0 &&
                       own.st_dev == there.st_dev && own.st_ino == there.st_ino;
  if (is_ours) (void)unlink(file_.c_str());
  close(descriptor_);
}

int LiveWriter::write(const LivePicture& picture) {
  const std::uint64_t writing = sequence_ + 1;
  if (!pack_live(picture, writing, bytes_)) return EINVAL;
  // The fences keep the three writes in their order for a reader on another CPU.
  if (const int error = write_at(descriptor_, bytes_of(writing), kLiveSequenceAt)) return error;
  std::atomic_thread_fence(std::memory_order_seq_cst);
  if (const int error = write_at(descriptor_, bytes_, 0)) return error;
  std::atomic_thread_fence(std::memory_order_seq_cst);
  sequence_ = writing + 1;
  return write_at(descriptor_, bytes_of(sequence_), kLiveSequenceAt);
}

std::string_view sentence(NoPicture why) noexcept {
  switch (why) {
    case NoPicture::none:
      return "there is one";
    case NoPicture::no_file:
      return "the daemon writes none";
    case NoPicture::not_readable:
      return "its file may not be read, or others may write it";
    case NoPicture::not_ours:
      return "its file is no live view";
    case NoPicture::other_version:
      return "the daemon is of another version";
    case NoPicture::damaged:
      return "its file is damaged";
    case NoPicture::old:
      return "no new frame comes";
  }
  return "";
}

bool is_live(const LivePicture& picture, dds::Clocks now) noexcept {
  constexpr nanoseconds kAheadMax = std::chrono::milliseconds(5);  // of the camera's clock
  constexpr nanoseconds kApartMax = std::chrono::milliseconds(100);
  // The stamps may be anything: compared in a way that does not overflow.
  const auto age = [](nanoseconds t, nanoseconds t_now) {
    return static_cast<double>(t_now.count()) - static_cast<double>(t.count());
  };
  const double by_monotonic = age(picture.t_exposure, now.monotonic);
  const double by_utc = age(picture.t_utc, now.utc);
  const double apart = by_monotonic - by_utc;
  return by_monotonic >= -static_cast<double>(kAheadMax.count()) &&
         by_monotonic <= static_cast<double>(kLiveAgeMax.count()) &&
         apart >= -static_cast<double>(kApartMax.count()) &&
         apart <= static_cast<double>(kApartMax.count());
}

NoPicture LiveReader::read_from(int descriptor) {
  struct stat status {};
  if (fstat(descriptor, &status) != 0 || !S_ISREG(status.st_mode) ||
      (status.st_mode & (S_IWGRP | S_IWOTH)) != 0)
    return NoPicture::not_readable;
  std::vector<std::uint8_t> head(kLiveHeaderBytes);
  head.resize(read_at(descriptor, head, 0));
  if (has_picture_ && head == head_) return NoPicture::none;  // it has that one
  const auto size = static_cast<std::uint64_t>(std::max<off_t>(status.st_size, 0));
  std::atomic_thread_fence(std::memory_order_seq_cst);
  bytes_.resize(static_cast<std::size_t>(std::min<std::uint64_t>(size, kLiveBytesMax)));
  bytes_.resize(read_at(descriptor, bytes_, 0));
  std::atomic_thread_fence(std::memory_order_seq_cst);
  std::vector<std::uint8_t> head_after(kLiveHeaderBytes);
  head_after.resize(read_at(descriptor, head_after, 0));
  if (head_after != head) return NoPicture::old;  // written meanwhile: the next look
  switch (unpack_live(bytes_, incoming_)) {
    case LiveBytes::picture:
      break;
    case LiveBytes::unfinished:
      return NoPicture::old;
    case LiveBytes::not_ours:
      return NoPicture::not_ours;
    case LiveBytes::other_version:
      return NoPicture::other_version;
    case LiveBytes::damaged:
      return NoPicture::damaged;
  }
  std::swap(picture_, incoming_);
  head_ = std::move(head);
  return NoPicture::none;
}

NoPicture LiveReader::read() {
  const Descriptor descriptor(open_to_read(file_));
  if (descriptor.get() < 0) return errno == ENOENT ? NoPicture::no_file : NoPicture::not_readable;
  return read_from(descriptor.get());
}

const LivePicture* LiveReader::look(dds::Clocks now) {
  why_ = read();
  if (why_ == NoPicture::none)
    has_picture_ = true;
  else if (why_ != NoPicture::old)  // a picture between two writes is still what it was
    has_picture_ = false;
  if (has_picture_) why_ = is_live(picture_, now) ? NoPicture::none : NoPicture::old;
  if (why_ != NoPicture::none) return nullptr;
  t_seen_ = now.monotonic;
  return &picture_;
}

}  // namespace holdfast::bridge
