// SPDX-License-Identifier: Apache-2.0
// Counts the system calls of one thread, all but those of a cyclic thread that sleeps and ends:
// clock_nanosleep, getrusage (the probe's own), and what the C library does at a thread's end. A
// seccomp filter traps each of the others; the handler counts it and then makes it after all, so
// that the program runs on as it would have.
#pragma once

#include <cstdint>

namespace holdfast::rtvm {

/// Traps the calling thread's system calls from now on, for good. Once a process; x86-64. Throws
/// UnavailableError.
void count_system_calls();

/// Made since by that thread. Any thread.
[[nodiscard]] std::uint64_t system_calls() noexcept;
/// The number (as in asm/unistd.h) of the newest of them; -1: none.
[[nodiscard]] int newest_system_call() noexcept;

}  // namespace holdfast::rtvm
