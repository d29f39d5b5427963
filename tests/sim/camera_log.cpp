// SPDX-License-Identifier: Apache-2.0
#include "tests/sim/camera_log.hpp"

#include <algorithm>
#include <cerrno>
#include <cstring>

#include <fmt/core.h>

#include "rt/core/error.hpp"

namespace holdfast::sim {
namespace {

constexpr std::chrono::nanoseconds kTruthStep{1'000'000};

}  // namespace

CsvFile::CsvFile(std::string path, const std::string& header)
    : path_(std::move(path)), partial_(path_ + ".part") {
  if (path_.empty()) return;
  file_ = std::fopen(partial_.c_str(), "w");
  if (file_ == nullptr)
    throw InputError(fmt::format("{}: cannot be written: {}", path_, std::strerror(errno)));
  write(header);
}

CsvFile::~CsvFile() {
  if (file_ == nullptr) return;
  std::fclose(file_);
  std::remove(partial_.c_str());
}

void CsvFile::write(const std::string& row) {
  if (file_ == nullptr) return;
  std::fputs(row.c_str(), file_);
  std::fputc('\n', file_);
}

void CsvFile::finish() {
  if (file_ == nullptr) return;
  const bool has_failed = std::ferror(file_) != 0;
  const bool is_closed = std::fclose(file_) == 0;
  file_ = nullptr;
  if (has_failed || !is_closed || std::rename(partial_.c_str(), path_.c_str()) != 0) {
    const std::string reason = std::strerror(errno);
    std::remove(partial_.c_str());
    throw InputError(fmt::format("{}: cannot be written: {}", path_, reason));
  }
}

TruthLog::TruthLog(std::string path, const MovingSite& site, std::chrono::nanoseconds t_start)
    : file_(std::move(path), "t_monotonic_ns,tx_mm,ty_mm,tz_mm,qx,qy,qz,qw"),
      site_(site),
      t_next_(t_start) {}

void TruthLog::advance(std::chrono::nanoseconds t) {
  if (!file_.is_wanted()) return;
  for (; t_next_ <= t; t_next_ += kTruthStep) {
    const SitePose pose = site_.pose_at(t_next_);
    file_.write(fmt::format("{},{:.9f},{:.9f},{:.9f},{:.12f},{:.12f},{:.12f},{:.12f}",
                            t_next_.count(), pose.t_mm.x(), pose.t_mm.y(), pose.t_mm.z(),
                            pose.q.x(), pose.q.y(), pose.q.z(), pose.q.w()));
  }
}

EventLog::EventLog(std::string path) : file_(std::move(path), "t_monotonic_ns,event,detail") {}

void EventLog::add(std::chrono::nanoseconds t, const std::string& event,
                   const std::string& detail) {
  const std::lock_guard lock(mutex_);
  if (!file_.is_wanted()) return;
  const bool has_comma = detail.find(',') != std::string::npos;
  rows_.push_back({t, fmt::format("{},{},{}{}{}", t.count(), event, has_comma ? "\"" : "", detail,
                                  has_comma ? "\"" : "")});
}

void EventLog::add(const SentFrame& frame) {
  std::string detail = fmt::format("id={} mid_exposure_ns={} stamp_ns={}", frame.frame_id,
                                   frame.t_mid_exposure.count(), frame.t_stamp.count());
  if (frame.is_frozen) detail += " frozen";
  if (frame.is_dropped) detail += " dropped";
  if (frame.is_corrupt) detail += " corrupt";
  if (frame.view.is_dark) detail += " black";
  if (frame.view.is_occluded) detail += " occluded";
  add(frame.t_sent, "frame", detail);
}

void EventLog::finish() {
  const std::lock_guard lock(mutex_);
  std::stable_sort(rows_.begin(), rows_.end(),
                   [](const Row& a, const Row& b) { return a.t < b.t; });
  for (const Row& row : rows_) file_.write(row.text);
  file_.finish();
}

}  // namespace holdfast::sim
