// SPDX-License-Identifier: Apache-2.0
// Collects what a source reports from its own threads, and waits for what a test expects.
#pragma once

#include <chrono>
#include <condition_variable>
#include <functional>
#include <mutex>
#include <optional>
#include <vector>

#include "tests/sim/private_network.hpp"
#include "tests/sim/virtual_camera.hpp"

namespace holdfast::bridge::test {

// Long enough for a starved machine; reached only when the test fails.
inline constexpr std::chrono::seconds kPatience{60};

/// Report: copied by `keep` while the source's call lasts.
template <typename Report>
class Collected {
 public:
  using Predicate = std::function<bool(const Report&)>;

  void add(Report kept) {
    const std::lock_guard lock(mutex_);
    all_.push_back(std::move(kept));
    changed_.notify_all();
  }
  /// The nth report from `begin` on that is so; empty when it does not come.
  std::optional<Report> await(const Predicate& is_so, std::size_t begin = 0, int nth = 1) {
    std::unique_lock lock(mutex_);
    std::optional<Report> found;
    changed_.wait_for(lock, kPatience, [&] {
      int seen = 0;
      for (std::size_t i = begin; i < all_.size(); ++i)
        if (is_so(all_[i]) && ++seen == nth) {
          found = all_[i];
          return true;
        }
      return false;
    });
    return found;
  }
  std::size_t size() {
    const std::lock_guard lock(mutex_);
    return all_.size();
  }
  std::vector<Report> all() {
    const std::lock_guard lock(mutex_);
    return all_;
  }

 private:
  std::mutex mutex_;
  std::condition_variable changed_;
  std::vector<Report> all_;
};

/// What a device says it sent.
class Sent {
 public:
  sim::VirtualCamera::OnFrame callback() {
    return [this](const sim::SentFrame& frame) {
      const std::lock_guard lock(mutex_);
      all_.push_back(frame);
    };
  }
  std::optional<sim::SentFrame> with_id(std::uint64_t id) {
    const std::lock_guard lock(mutex_);
    for (const sim::SentFrame& frame : all_)
      if (frame.frame_id == id) return frame;
    return std::nullopt;
  }

 private:
  std::mutex mutex_;
  std::vector<sim::SentFrame> all_;
};

}  // namespace holdfast::bridge::test
