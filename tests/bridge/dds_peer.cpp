// SPDX-License-Identifier: Apache-2.0
#include "tests/bridge/dds_peer.hpp"

#include <array>
#include <csignal>
#include <stdexcept>

#include <spawn.h>
#include <sys/wait.h>
#include <unistd.h>

extern char** environ;

namespace holdfast::bridge::dds {

Peer::Peer(const std::string& role, unsigned domain, const std::string& keys) {
  std::array<int, 2> out{};
  if (pipe(out.data()) != 0) throw std::runtime_error("pipe");
  posix_spawn_file_actions_t actions;
  posix_spawn_file_actions_init(&actions);
  posix_spawn_file_actions_adddup2(&actions, out[1], STDOUT_FILENO);
  posix_spawn_file_actions_addclose(&actions, out[0]);
  std::vector<std::string> words{HOLDFAST_DDS_PEER, role, std::to_string(domain), keys};
  std::array<char*, 5> argv{words[0].data(), words[1].data(), words[2].data(),
                            keys.empty() ? nullptr : words[3].data(), nullptr};
  const int error = posix_spawn(&pid_, argv[0], &actions, nullptr, argv.data(), environ);
  posix_spawn_file_actions_destroy(&actions);
  close(out[1]);
  if (error != 0) {
    close(out[0]);
    throw std::runtime_error("cannot start " + words[0]);
  }
  char c = 0;
  while (read(out[0], &c, 1) == 1 && c != '\n') first_line_ += c;
  close(out[0]);
}

Peer::~Peer() {
  end(SIGKILL);
}

void Peer::kill() {
  end(SIGKILL);
}

void Peer::terminate() {
  end(SIGTERM);
}

void Peer::end(int signal) {
  if (pid_ <= 0) return;
  ::kill(pid_, signal);
  waitpid(pid_, nullptr, 0);
  pid_ = -1;
}

}  // namespace holdfast::bridge::dds
