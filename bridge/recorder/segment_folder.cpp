// SPDX-License-Identifier: Apache-2.0
#include "bridge/recorder/segment_folder.hpp"

#include <algorithm>
#include <cerrno>
#include <cstring>
#include <system_error>

#include <fcntl.h>
#include <fmt/format.h>
#include <sys/file.h>
#include <unistd.h>

#include "rt/core/error.hpp"

namespace holdfast::bridge {
namespace {

constexpr std::string_view kPrefix = "holdfast-";
constexpr std::string_view kSuffix = ".mcap";

bool is_ours(const std::filesystem::directory_entry& entry) {
  const std::string name = entry.path().filename().string();
  std::error_code ignored;
  return name.starts_with(kPrefix) && name.ends_with(kSuffix) && entry.is_regular_file(ignored);
}

bool is_full(int error) {
  return error == ENOSPC || error == EDQUOT;
}

}  // namespace

std::vector<std::filesystem::path> recordings_in(const std::filesystem::path& folder) {
  std::vector<std::filesystem::path> files;
  std::error_code error;
  for (const auto& entry : std::filesystem::directory_iterator(folder, error))
    if (is_ours(entry)) files.push_back(entry.path());
  std::sort(files.begin(), files.end());
  return files;
}

std::optional<std::string> invalid_recording_folder(const std::filesystem::path& folder) {
  namespace fs = std::filesystem;
  std::error_code error;
  fs::path nearest = fs::absolute(folder, error);
  while (!fs::exists(nearest, error) && nearest.has_parent_path() &&
         nearest != nearest.parent_path())
    nearest = nearest.parent_path();
  if (!fs::is_directory(nearest, error)) return nearest.string() + " is not a folder";
  if (::access(nearest.c_str(), W_OK) != 0) return nearest.string() + " cannot be written";
  return std::nullopt;
}

SegmentFolder::SegmentFolder(const std::filesystem::path& folder, std::uint64_t size_max_bytes,
                             Write write)
    : folder_(folder),
      size_max_bytes_(size_max_bytes),
      write_(write != nullptr ? write : &::write) {
  std::error_code error;
  std::filesystem::create_directories(folder, error);
  if (error)
    throw InputError(fmt::format("{}: cannot be made: {}", folder.string(), error.message()));
  lock_ = ::open(folder.c_str(), O_RDONLY | O_DIRECTORY | O_CLOEXEC);
  if (lock_ < 0 || ::access(folder.c_str(), W_OK) != 0) {
    const int reason = errno;
    if (lock_ >= 0) ::close(lock_);
    throw InputError(
        fmt::format("{}: cannot be written: {}", folder.string(), std::strerror(reason)));
  }
  if (::flock(lock_, LOCK_EX | LOCK_NB) != 0) {
    ::close(lock_);
    throw InputError(fmt::format("{}: another recorder writes here", folder.string()));
  }
  for (const std::filesystem::path& file : recordings_in(folder)) {
    const std::uint64_t bytes = std::filesystem::file_size(file, error);
    if (error) continue;
    closed_.push_back({file, bytes});
    closed_bytes_ += bytes;
  }
}

SegmentFolder::~SegmentFolder() {
  close();
  ::close(lock_);
}

bool SegmentFolder::open(const std::string& name) {
  close();
  file_ = folder_ / (std::string(kPrefix) + name + std::string(kSuffix));
  do {
    descriptor_ = ::open(file_.c_str(), O_WRONLY | O_CREAT | O_EXCL | O_APPEND | O_CLOEXEC, 0640);
    error_ = descriptor_ < 0 ? errno : 0;
  } while (is_full(error_) && remove_oldest());
  if (descriptor_ < 0) return false;
  (void)::fsync(
      lock_);  // the name is on the disk too; a file system that cannot is no reason to end
  return true;
}

void SegmentFolder::close() {
  if (descriptor_ < 0) return;
  ::close(descriptor_);
  descriptor_ = -1;
  closed_.push_back({file_, open_bytes_});
  closed_bytes_ += open_bytes_;
  open_bytes_ = 0;
}

void SegmentFolder::discard() {
  if (descriptor_ < 0) return;
  ::close(descriptor_);
  descriptor_ = -1;
  open_bytes_ = 0;
  (void)::unlink(file_.c_str());
}

bool SegmentFolder::append(std::string_view bytes) {
  while (total_bytes() + bytes.size() > size_max_bytes_)
    if (!remove_oldest()) break;
  if (total_bytes() + bytes.size() > size_max_bytes_) {
    error_ = EFBIG;
    return false;
  }
  while (!try_append(bytes))
    if (!is_full(error_) || !remove_oldest()) return false;
  return true;
}

bool SegmentFolder::try_append(std::string_view bytes) {
  std::size_t done = 0;
  while (done < bytes.size()) {
    const ssize_t count = write_(descriptor_, bytes.data() + done, bytes.size() - done);
    if (count < 0 && errno == EINTR) continue;
    if (count <= 0) {
      error_ = count < 0 ? errno : ENOSPC;
      // Back to the last whole record. Should even that fail, a reader sees a file that was cut
      // off.
      if (::ftruncate(descriptor_, static_cast<off_t>(open_bytes_)) != 0) open_bytes_ += done;
      return false;
    }
    done += static_cast<std::size_t>(count);
  }
  open_bytes_ += bytes.size();
  return true;
}

bool SegmentFolder::sync() {
  if (::fdatasync(descriptor_) == 0) return true;
  error_ = errno;
  return false;
}

bool SegmentFolder::remove_oldest() {
  if (closed_.empty()) return false;
  const Segment oldest = closed_.front();
  if (::unlink(oldest.file.c_str()) != 0 && errno != ENOENT) return false;
  closed_.pop_front();
  closed_bytes_ -= oldest.bytes;
  return true;
}

}  // namespace holdfast::bridge
