// SPDX-License-Identifier: Apache-2.0
#include "bridge/command_line.hpp"

#include <atomic>
#include <csignal>
#include <cstdio>
#include <exception>
#include <string>

#include "rt/core/error.hpp"

namespace holdfast::bridge {
namespace {

std::atomic<bool> interrupt_requested{false};
static_assert(std::atomic<bool>::is_always_lock_free, "set from a signal handler");

void on_signal(int /*signal*/) {
  interrupt_requested.store(true, std::memory_order_relaxed);
}

int fail(const CLI::App& app, ExitCode code, const std::string& what) {
  std::string line = what;
  for (char& c : line)
    if (c == '\n' || c == '\r') c = ' ';
  std::fprintf(stderr, "%s: %s\n", app.get_name().c_str(), line.c_str());
  return static_cast<int>(code);
}

int parse_and_run(CLI::App& app, int argc, char** argv) {
  try {
    app.parse(argc, argv);
    return static_cast<int>(ExitCode::done);
  } catch (const CLI::ParseError& e) {
    if (e.get_exit_code() == 0) return app.exit(e);  // --help, --version
    return fail(app, ExitCode::bad_input, e.what());
  } catch (const Error& e) {
    return fail(app, e.exit_code(), e.what());
  } catch (const std::exception& e) {
    return fail(app, ExitCode::bad_input, e.what());
  }
}

}  // namespace

int run_command_line(CLI::App& app, int argc, char** argv) noexcept {
  try {
    return parse_and_run(app, argc, argv);
  } catch (...) {
    std::fputs("failed: cannot report the error\n", stderr);
    return static_cast<int>(ExitCode::bad_input);
  }
}

void catch_interrupts() {
  struct sigaction action {};
  action.sa_handler = on_signal;
  sigaction(SIGINT, &action, nullptr);
  sigaction(SIGTERM, &action, nullptr);
}

bool is_interrupted() noexcept {
  return interrupt_requested.load(std::memory_order_relaxed);
}

void request_interrupt() noexcept {
  interrupt_requested.store(true, std::memory_order_relaxed);
}

}  // namespace holdfast::bridge
