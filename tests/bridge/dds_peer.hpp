// SPDX-License-Identifier: Apache-2.0
// Another process on the test's domain: starts tests/bridge/dds_peer.cpp and holds it by its
// process id.
#pragma once

#include <string>
#include <vector>

#include <sys/types.h>

namespace holdfast::bridge::dds {

class Peer {
 public:
  /// Starts `dds_peer ROLE DOMAIN [KEYS]` and waits for its first line of output.
  Peer(const std::string& role, unsigned domain, const std::string& keys = {});
  ~Peer();  ///< kills it
  Peer(const Peer&) = delete;
  Peer& operator=(const Peer&) = delete;

  [[nodiscard]] pid_t pid() const noexcept { return pid_; }
  [[nodiscard]] const std::string& first_line() const noexcept { return first_line_; }
  void kill();       ///< SIGKILL; returns when it is dead
  void terminate();  ///< SIGTERM: it takes leave of the domain; returns when it has ended

 private:
  void end(int signal);
  pid_t pid_ = -1;
  std::string first_line_;
};

}  // namespace holdfast::bridge::dds
