// SPDX-License-Identifier: Apache-2.0
// What every program does with its command line: parse it, run the chosen command, and turn every
// outcome into the exit code and the one line that scripts rely on.
#pragma once

#include <CLI/CLI.hpp>

namespace holdfast::bridge {

/// Parses and runs the callback of the chosen (sub)command. Returns the process's exit code
/// (ExitCode); prints exactly one line on stderr when it is not 0. Never lets an exception out.
[[nodiscard]] int run_command_line(CLI::App& app, int argc, char** argv) noexcept;

/// From the first call on, SIGINT and SIGTERM no longer end the process but set a flag.
/// is_interrupted() may be polled from any thread; long commands throw InterruptedError on it.
void catch_interrupts();
[[nodiscard]] bool is_interrupted() noexcept;
/// Sets the flag as a signal would (tests, and programs that end themselves).
void request_interrupt() noexcept;

}  // namespace holdfast::bridge
