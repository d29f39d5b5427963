// SPDX-License-Identifier: Apache-2.0
#include "tests/rtvm/syscall_count.hpp"

#include <array>
#include <atomic>
#include <cerrno>
#include <csignal>
#include <cstddef>
#include <cstring>
#include <string>

#include <linux/audit.h>
#include <linux/filter.h>
#include <linux/seccomp.h>
#include <sys/prctl.h>
#include <sys/syscall.h>
#include <ucontext.h>
#include <unistd.h>

#include "rt/core/error.hpp"

// The one place from which the filter lets everything through: the handler's own system call.
// Arguments as syscall(2) takes them: number, then six.
asm(R"(
  .text
  .globl holdfast_rtvm_untrapped
  .globl holdfast_rtvm_untrapped_end
holdfast_rtvm_untrapped:
  mov %rdi, %rax
  mov %rsi, %rdi
  mov %rdx, %rsi
  mov %rcx, %rdx
  mov %r8, %r10
  mov %r9, %r8
  mov 8(%rsp), %r9
  syscall
holdfast_rtvm_untrapped_end:
  ret
)");
extern "C" {
long holdfast_rtvm_untrapped(long, long, long, long, long, long, long);
extern const char holdfast_rtvm_untrapped_end[];
}

namespace holdfast::rtvm {
namespace {

std::atomic<std::uint64_t> count{0};
std::atomic<int> newest{-1};

void on_trap(int /*signal*/, siginfo_t* info, void* context) {
  count.fetch_add(1, std::memory_order_relaxed);
  newest.store(info->si_syscall, std::memory_order_relaxed);
  auto& r = static_cast<ucontext_t*>(context)->uc_mcontext.gregs;
  r[REG_RAX] = holdfast_rtvm_untrapped(info->si_syscall, r[REG_RDI], r[REG_RSI], r[REG_RDX],
                                       r[REG_R10], r[REG_R8], r[REG_R9]);
}

constexpr sock_filter load(std::size_t offset) {
  return BPF_STMT(BPF_LD | BPF_W | BPF_ABS, static_cast<std::uint32_t>(offset));
}
constexpr sock_filter answer(std::uint32_t action) {
  return BPF_STMT(BPF_RET | BPF_K, action);
}
/// Skips `lines` unless the loaded word is `value`.
constexpr sock_filter skip_unless(std::uint64_t value, std::uint8_t lines) {
  return BPF_JUMP(BPF_JMP | BPF_JEQ | BPF_K, static_cast<std::uint32_t>(value), 0, lines);
}

}  // namespace

void count_system_calls() {
  struct sigaction action {};
  action.sa_sigaction = on_trap;
  action.sa_flags = SA_SIGINFO | SA_NODEFER;
  const auto address = reinterpret_cast<std::uintptr_t>(holdfast_rtvm_untrapped_end);
  constexpr std::size_t kNumber = offsetof(seccomp_data, nr);
  constexpr std::size_t kAddress = offsetof(seccomp_data, instruction_pointer);
  std::array filter{
      load(kAddress),
      skip_unless(address & 0xffffffffU, 3),
      load(kAddress + 4),
      skip_unless(address >> 32U, 1),
      answer(SECCOMP_RET_ALLOW),
      load(kNumber),
      skip_unless(SYS_clock_nanosleep, 1),
      answer(SECCOMP_RET_ALLOW),
      skip_unless(SYS_rt_sigreturn, 1),
      answer(SECCOMP_RET_ALLOW),
      skip_unless(SYS_getrusage, 1),
      answer(SECCOMP_RET_ALLOW),
      skip_unless(SYS_rt_sigprocmask, 1),
      answer(SECCOMP_RET_ALLOW),
      skip_unless(SYS_madvise, 1),
      answer(SECCOMP_RET_ALLOW),
      skip_unless(SYS_exit, 1),
      answer(SECCOMP_RET_ALLOW),
      answer(SECCOMP_RET_TRAP),
  };
  const sock_fprog program{static_cast<unsigned short>(filter.size()), filter.data()};
  if (sigaction(SIGSYS, &action, nullptr) != 0 || prctl(PR_SET_NO_NEW_PRIVS, 1, 0, 0, 0) != 0 ||
      syscall(SYS_seccomp, SECCOMP_SET_MODE_FILTER, 0, &program) != 0) {
    throw UnavailableError(std::string("seccomp: denied: ") + std::strerror(errno));
  }
}

std::uint64_t system_calls() noexcept {
  return count.load(std::memory_order_relaxed);
}
int newest_system_call() noexcept {
  return newest.load(std::memory_order_relaxed);
}

}  // namespace holdfast::rtvm
