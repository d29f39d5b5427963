// SPDX-License-Identifier: Apache-2.0
#include "rt/study/rig.hpp"

#include <array>
#include <cerrno>
#include <csignal>
#include <cstring>

#include <fcntl.h>
#include <fmt/format.h>
#include <nlohmann/json.hpp>
#include <poll.h>
#include <sys/prctl.h>
#include <sys/socket.h>
#include <sys/syscall.h>
#include <sys/wait.h>
#include <unistd.h>

#include "bridge/command_line.hpp"
#include "rt/core/error.hpp"

namespace holdfast::rt {
namespace {

using nlohmann::json;

constexpr int kPollMs = 200;
constexpr int kPatienceMs = 1000;

/// In the child, between fork and exec: async-signal-safe calls only.
[[noreturn]] void become(const char* program, char* const* arguments, int in, int out,
                         pid_t parent) {
  prctl(PR_SET_PDEATHSIG, SIGKILL);
  if (getppid() != parent) _exit(127);  // the parent died before prctl
  dup2(in, STDIN_FILENO);
  dup2(out, STDOUT_FILENO);
  // Its failures are answers; what it says beside them would be a second line of ours.
  dup2(open("/dev/null", O_WRONLY | O_CLOEXEC), STDERR_FILENO);
  execv(program, arguments);
  _exit(127);
}

}  // namespace

std::filesystem::path default_rig() {
  return std::filesystem::read_symlink("/proc/self/exe").parent_path() / "holdfast-sim";
}

Rig::Rig(const std::filesystem::path& program) : name_(program.string()) {
  if (access(program.c_str(), X_OK) != 0)
    throw UnavailableError(fmt::format("{}: {}", name_, std::strerror(errno)));
  // A socket for the requests: a rig that has ended must not end us by SIGPIPE.
  std::array<int, 2> asked{}, answered{};
  if (socketpair(AF_UNIX, SOCK_STREAM | SOCK_CLOEXEC, 0, asked.data()) != 0 ||
      pipe2(answered.data(), O_CLOEXEC) != 0)
    throw UnavailableError(fmt::format("{}: no pipe: {}", name_, std::strerror(errno)));
  std::string word = "serve";
  std::array<char*, 3> arguments{name_.data(), word.data(), nullptr};
  const pid_t parent = getpid();
  pid_ = fork();
  if (pid_ == 0) become(name_.c_str(), arguments.data(), asked[1], answered[1], parent);
  const int error = errno;
  close(asked[1]);
  close(answered[1]);
  to_rig_ = asked[0];
  from_rig_ = answered[0];
  if (pid_ < 0) throw UnavailableError(fmt::format("{}: fork: {}", name_, std::strerror(error)));
}

Rig::~Rig() {
  close(to_rig_);
  close(from_rig_);
  if (pid_ < 0) return;
  const int handle = static_cast<int>(syscall(SYS_pidfd_open, pid_, 0));
  pollfd ended{handle, POLLIN, 0};
  if (handle < 0 || poll(&ended, 1, kPatienceMs) != 1) kill(pid_, SIGKILL);
  if (handle >= 0) close(handle);
  waitpid(pid_, nullptr, 0);
}

std::string Rig::read_line() {
  for (;;) {
    if (const std::size_t end = unread_.find('\n'); end != std::string::npos) {
      std::string line = unread_.substr(0, end);
      unread_.erase(0, end + 1);
      return line;
    }
    if (bridge::is_interrupted()) throw InterruptedError("interrupted");
    pollfd readable{from_rig_, POLLIN, 0};
    if (poll(&readable, 1, kPollMs) <= 0) continue;
    std::array<char, 4096> bytes{};
    const ssize_t count = read(from_rig_, bytes.data(), bytes.size());
    if (count < 0 && errno == EINTR) continue;
    if (count <= 0) {
      if (bridge::is_interrupted()) throw InterruptedError("interrupted");
      throw UnavailableError(fmt::format("{}: the rig has ended", name_));
    }
    unread_.append(bytes.data(), static_cast<std::size_t>(count));
  }
}

json Rig::request(const json& what) {
  const std::string line = what.dump() + "\n";
  for (std::size_t sent = 0; sent < line.size();) {
    const ssize_t count = send(to_rig_, line.data() + sent, line.size() - sent, MSG_NOSIGNAL);
    if (count < 0 && errno == EINTR) continue;
    if (count <= 0) throw UnavailableError(fmt::format("{}: the rig has ended", name_));
    sent += static_cast<std::size_t>(count);
  }
  const std::string text = read_line();
  json answer = json::parse(text, nullptr, false);
  if (answer.is_discarded() || !answer.is_object())
    throw UnavailableError(fmt::format("{}: answered no JSON object: {}", name_, text));
  if (answer.contains("error"))
    throw RefusedError(fmt::format("rig: {}", answer.at("error").get<std::string>()));
  return answer;
}

}  // namespace holdfast::rt
