// SPDX-License-Identifier: Apache-2.0
// The one exception base of start-up code and tools, with the exit code a script sees. Caught once,
// in main. Never thrown on the real-time path, nor by perception/ and safety/, which return status.
#pragma once

#include <stdexcept>
#include <string>

namespace holdfast {

/// Exit codes of every program, as docs/interfaces.md lists them.
enum class ExitCode : int {
  done = 0,          ///< done and acceptable
  refused = 1,       ///< ran, but the result is refused
  bad_input = 2,     ///< bad usage or bad input
  unavailable = 3,   ///< a device, bus or peer is not there
  interrupted = 130  ///< SIGINT or SIGTERM before the work was done
};

class Error : public std::runtime_error {
 public:
  [[nodiscard]] ExitCode exit_code() const noexcept { return exit_code_; }

 protected:
  Error(ExitCode exit_code, const std::string& what)
      : std::runtime_error(what), exit_code_(exit_code) {}

 private:
  ExitCode exit_code_;
};

/// The work was done but its result must not be used; the message is the reason, one line.
class RefusedError : public Error {
 public:
  explicit RefusedError(const std::string& what) : Error(ExitCode::refused, what) {}
};

/// Usage, configuration or an input file is wrong; the message names file, key, value, limit, unit.
class InputError : public Error {
 public:
  explicit InputError(const std::string& what) : Error(ExitCode::bad_input, what) {}
};

/// A device, bus, peer or system facility is missing or denied.
class UnavailableError : public Error {
 public:
  explicit UnavailableError(const std::string& what) : Error(ExitCode::unavailable, what) {}
};

/// The user asked the program to end before its work was done.
class InterruptedError : public Error {
 public:
  explicit InterruptedError(const std::string& what) : Error(ExitCode::interrupted, what) {}
};

}  // namespace holdfast
