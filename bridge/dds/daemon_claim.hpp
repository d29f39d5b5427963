// SPDX-License-Identifier: Apache-2.0
// One daemon per domain. On one host a lock that dies with its holder makes it certain; across
// hosts DDS discovery is asked, at start and then again and again.
#pragma once

#include <chrono>
#include <cstdint>

#include "bridge/dds/publication_watch.hpp"

namespace holdfast::bridge::dds {

/// Holds an abstract Unix socket (one network namespace: the scope in which two daemons could meet
/// on a domain without a network). Released when the process ends, however it ends.
class DomainLock {
 public:
  /// Throws InputError "domain N already has a Holdfast daemon (pid P)".
  explicit DomainLock(std::uint32_t domain);
  ~DomainLock();
  DomainLock(const DomainLock&) = delete;
  DomainLock& operator=(const DomainLock&) = delete;

 private:
  int socket_ = -1;
};

class DaemonClaim {
 public:
  /// Construct it before any writer. Throws InputError "domain N already has a Holdfast daemon ..."
  /// when the lock is taken, or a writer of holdfast/compensated_pose shows up within `look`.
  explicit DaemonClaim(const Participant& participant,
                       std::chrono::nanoseconds look = std::chrono::milliseconds(500));

  /// Another participant writes poses now. Poll it, also at run time; does not wait. One thread.
  [[nodiscard]] bool second_publisher() noexcept { return watch_.has_other_writer(); }

 private:
  DomainLock lock_;
  PublicationWatch watch_;
};

}  // namespace holdfast::bridge::dds
