// SPDX-License-Identifier: Apache-2.0
#include "bridge/atomic_file.hpp"

#include <cerrno>
#include <cstdlib>
#include <filesystem>
#include <system_error>
#include <utility>

#include <fcntl.h>
#include <sys/stat.h>
#include <unistd.h>

#include "rt/core/error.hpp"

namespace holdfast::bridge {

AtomicFile::AtomicFile(std::string path) : path_(std::move(path)) {
  std::error_code error;
  if (std::filesystem::is_directory(path_, error)) fail("is a directory", 0);
  temporary_ = path_ + ".XXXXXX";
  descriptor_ = mkostemp(temporary_.data(), O_CLOEXEC);
  if (descriptor_ < 0) {
    const int cause = errno;
    temporary_.clear();
    fail("cannot be written", cause);
  }
  // mkstemp makes it private; give it the permissions any new file of this user has.
  const mode_t mask = umask(0);
  umask(mask);
  if (fchmod(descriptor_, 0666 & ~mask) != 0) {
    const int cause = errno;
    close(descriptor_);
    unlink(temporary_.c_str());
    fail("cannot be written", cause);
  }
}

AtomicFile::~AtomicFile() {
  if (descriptor_ >= 0) close(descriptor_);
  if (!temporary_.empty()) unlink(temporary_.c_str());
}

void AtomicFile::fail(const char* what, int error) const {
  std::string line = path_ + ": " + what;
  if (error != 0) line += ": " + std::generic_category().message(error);
  throw InputError(line);
}

void AtomicFile::write(std::string_view bytes) {
  while (!bytes.empty()) {
    const ssize_t written = ::write(descriptor_, bytes.data(), bytes.size());
    if (written < 0 && errno == EINTR) continue;
    if (written < 0) fail("cannot be written", errno);
    bytes.remove_prefix(static_cast<std::size_t>(written));
  }
}

void AtomicFile::commit() {
  if (fsync(descriptor_) != 0) fail("cannot be flushed to the disk", errno);
  const int closed = close(std::exchange(descriptor_, -1));
  if (closed != 0) fail("cannot be flushed to the disk", errno);
  if (rename(temporary_.c_str(), path_.c_str()) != 0) fail("cannot be put in place", errno);
  temporary_.clear();
  // The rename itself is safe only when the folder is on the disk. Some file systems refuse to
  // flush a folder; the file is in place all the same.
  const std::filesystem::path folder = std::filesystem::path(path_).parent_path();
  const int parent =
      open(folder.empty() ? "." : folder.c_str(), O_RDONLY | O_DIRECTORY | O_CLOEXEC);
  if (parent < 0) return;
  fsync(parent);
  close(parent);
}

void write_file_atomically(const std::string& path, std::string_view bytes) {
  AtomicFile file(path);
  file.write(bytes);
  file.commit();
}

}  // namespace holdfast::bridge
