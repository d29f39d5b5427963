// SPDX-License-Identifier: Apache-2.0
// The simulator's own account of what really happened: the true pose of the site, and every event.
#pragma once

#include <chrono>
#include <cstdio>
#include <memory>
#include <mutex>
#include <string>
#include <vector>

#include "tests/sim/moving_site.hpp"
#include "tests/sim/virtual_camera.hpp"

namespace holdfast::sim {

/// A CSV file that appears whole: written beside its name, moved there by finish().
class CsvFile {
 public:
  /// Throws InputError when it cannot be written. An empty path: write() does nothing.
  CsvFile(std::string path, const std::string& header);
  ~CsvFile();
  CsvFile(const CsvFile&) = delete;
  CsvFile& operator=(const CsvFile&) = delete;
  void write(const std::string& row);
  /// Throws InputError when the disk was full.
  void finish();
  [[nodiscard]] bool is_wanted() const noexcept { return file_ != nullptr; }

 private:
  std::string path_, partial_;
  std::FILE* file_ = nullptr;
};

/// t_monotonic_ns,tx_mm,ty_mm,tz_mm,qx,qy,qz,qw: T_camera_site once a millisecond.
class TruthLog {
 public:
  TruthLog(std::string path, const MovingSite& site, std::chrono::nanoseconds t_start);
  /// Writes all rows up to `t`.
  void advance(std::chrono::nanoseconds t);
  void finish() { file_.finish(); }

 private:
  CsvFile file_;
  const MovingSite& site_;
  std::chrono::nanoseconds t_next_;
};

/// t_monotonic_ns,event,detail. Any thread adds; rows are written in order of time.
class EventLog {
 public:
  explicit EventLog(std::string path);
  void add(std::chrono::nanoseconds t, const std::string& event, const std::string& detail);
  void add(const SentFrame& frame);
  void finish();

 private:
  struct Row {
    std::chrono::nanoseconds t;
    std::string text;
  };
  CsvFile file_;
  std::mutex mutex_;
  std::vector<Row> rows_;
};

}  // namespace holdfast::sim
