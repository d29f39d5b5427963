// SPDX-License-Identifier: Apache-2.0
// A file that appears whole or not at all: written beside its final place, flushed to the disk,
// then renamed over it. Whatever ends the program before that leaves the old file, or none.
#pragma once

#include <string>
#include <string_view>

namespace holdfast::bridge {

class AtomicFile {
 public:
  /// Creates the temporary file beside `path`. Throws InputError when that is not possible.
  explicit AtomicFile(std::string path);
  ~AtomicFile();  ///< removes the temporary file unless commit() succeeded
  AtomicFile(const AtomicFile&) = delete;
  AtomicFile& operator=(const AtomicFile&) = delete;

  /// Appends. Throws InputError when the disk refuses (full, for instance).
  void write(std::string_view bytes);
  /// Flushes to the disk and puts the file in its place. Throws InputError; then nothing appears.
  void commit();

 private:
  [[noreturn]] void fail(const char* what, int error) const;
  std::string path_, temporary_;
  int descriptor_ = -1;
};

/// Writes `bytes` as the whole content of `path`, or throws InputError and leaves `path` as it was.
void write_file_atomically(const std::string& path, std::string_view bytes);

}  // namespace holdfast::bridge
