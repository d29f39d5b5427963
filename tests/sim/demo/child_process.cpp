// SPDX-License-Identifier: Apache-2.0
#include "tests/sim/demo/child_process.hpp"

#include <cerrno>
#include <cstring>
#include <utility>

#include <fcntl.h>
#include <fmt/format.h>
#include <poll.h>
#include <signal.h>
#include <sys/prctl.h>
#include <sys/syscall.h>
#include <sys/wait.h>
#include <unistd.h>

#include "rt/core/error.hpp"

namespace holdfast::sim {
namespace {

int exit_code_of(int status) {
  return WIFSIGNALED(status) ? 128 + WTERMSIG(status) : WEXITSTATUS(status);
}

/// In the child, between fork and exec: async-signal-safe calls only.
[[noreturn]] void become(const char* program, char* const* arguments, int log, pid_t parent) {
  prctl(PR_SET_PDEATHSIG, SIGKILL);
  if (getppid() != parent) _exit(127);  // the parent died before prctl
  dup2(log, STDOUT_FILENO);
  dup2(log, STDERR_FILENO);
  execv(program, arguments);
  _exit(127);
}

}  // namespace

std::filesystem::path program_folder() {
  return std::filesystem::read_symlink("/proc/self/exe").parent_path();
}

ChildProcess::ChildProcess(const std::filesystem::path& program,
                           const std::vector<std::string>& arguments,
                           const std::filesystem::path& log)
    : name_(program.filename().string()) {
  if (access(program.c_str(), X_OK) != 0)
    throw UnavailableError(fmt::format("{}: {}", program.string(), std::strerror(errno)));
  const int output = open(log.c_str(), O_WRONLY | O_CREAT | O_APPEND | O_CLOEXEC, 0644);
  if (output < 0) throw UnavailableError(fmt::format("{}: {}", log.string(), std::strerror(errno)));
  std::vector<std::string> words{program.string()};
  words.insert(words.end(), arguments.begin(), arguments.end());
  std::vector<char*> argv;
  for (std::string& word : words) argv.push_back(word.data());
  argv.push_back(nullptr);
  const pid_t parent = getpid();
  pid_ = fork();
  if (pid_ == 0) become(program.c_str(), argv.data(), output, parent);
  close(output);
  if (pid_ < 0) throw UnavailableError(fmt::format("fork: {}", std::strerror(errno)));
}

ChildProcess::ChildProcess(ChildProcess&& other) noexcept
    : name_(std::move(other.name_)),
      pid_(std::exchange(other.pid_, -1)),
      exit_code_(other.exit_code_) {}

ChildProcess::~ChildProcess() {
  kill_now();
}

int ChildProcess::wait(std::chrono::milliseconds patience) {
  if (pid_ < 0) return exit_code_;
  const int handle = static_cast<int>(syscall(SYS_pidfd_open, pid_, 0));
  if (handle >= 0) {
    pollfd ended{handle, POLLIN, 0};
    (void)poll(&ended, 1, static_cast<int>(patience.count()));
    close(handle);
  }
  int status = 0;
  if (waitpid(pid_, &status, WNOHANG) != pid_) return -1;
  pid_ = -1;
  exit_code_ = exit_code_of(status);
  return exit_code_;
}

bool ChildProcess::is_running() {
  (void)wait(std::chrono::milliseconds{0});
  return pid_ >= 0;
}

int ChildProcess::end(std::chrono::milliseconds patience) {
  if (pid_ < 0) return exit_code_;
  kill(pid_, SIGTERM);
  const int code = wait(patience);
  if (pid_ >= 0) kill_now();
  return code >= 0 ? code : exit_code_;
}

void ChildProcess::kill_now() {
  if (pid_ < 0) return;
  kill(pid_, SIGKILL);
  int status = 0;
  waitpid(pid_, &status, 0);
  pid_ = -1;
  exit_code_ = exit_code_of(status);
}

}  // namespace holdfast::sim
