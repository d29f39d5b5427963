// SPDX-License-Identifier: Apache-2.0
// A program started beside this one, and never left behind.
#pragma once

#include <chrono>
#include <filesystem>
#include <string>
#include <vector>

#include <sys/types.h>

namespace holdfast::sim {

/// The folder of the running program: its siblings are started from there.
[[nodiscard]] std::filesystem::path program_folder();

class ChildProcess {
 public:
  /// Starts `program` with `arguments`; its stdout and stderr are appended to `log`. The kernel
  /// kills it when this process ends. Throws UnavailableError.
  ChildProcess(const std::filesystem::path& program, const std::vector<std::string>& arguments,
               const std::filesystem::path& log);
  /// kill_now() when it still runs.
  ~ChildProcess();
  ChildProcess(ChildProcess&& other) noexcept;
  ChildProcess& operator=(ChildProcess&&) = delete;
  ChildProcess(const ChildProcess&) = delete;
  ChildProcess& operator=(const ChildProcess&) = delete;

  [[nodiscard]] bool is_running();
  /// SIGTERM, then waits; SIGKILL when `patience` is over. The exit code, or 128 + signal.
  int end(std::chrono::milliseconds patience);
  /// Waits for it to end by itself; -1 when it still runs after `patience`.
  int wait(std::chrono::milliseconds patience);
  /// SIGKILL.
  void kill_now();
  [[nodiscard]] pid_t pid() const noexcept { return pid_; }

 private:
  std::string name_;
  pid_t pid_ = -1;
  int exit_code_ = -1;
};

}  // namespace holdfast::sim
