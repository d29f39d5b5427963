// SPDX-License-Identifier: Apache-2.0
#include "rt/core/cyclic_thread.hpp"

#include <algorithm>
#include <atomic>
#include <cerrno>
#include <cstring>
#include <ctime>
#include <utility>

#include <pthread.h>
#include <sched.h>
#include <sys/prctl.h>

#include "rt/core/clock.hpp"
#include "rt/core/error.hpp"
#include "rt/core/memory_lock.hpp"

namespace holdfast::rt {

namespace {

using std::chrono::nanoseconds;

void check(const CyclicThreadParameters& p) {
  const std::string who = "cyclic thread '" + p.name + "': ";
  if (p.period <= nanoseconds::zero()) {
    throw InputError(who + "period " + std::to_string(p.period.count()) + " ns must be above 0 ns");
  }
  if (p.phase < nanoseconds::zero() || p.phase >= p.period) {
    throw InputError(who + "phase " + std::to_string(p.phase.count()) + " ns must be in [0, " +
                     std::to_string(p.period.count()) + ") ns, the period");
  }
  if (p.fifo_priority && (*p.fifo_priority < 1 || *p.fifo_priority > 99)) {
    throw InputError(who + "SCHED_FIFO priority " + std::to_string(*p.fifo_priority) +
                     " must be in [1, 99]");
  }
  if (p.cpu && (*p.cpu < 0 || *p.cpu >= CPU_SETSIZE)) {
    throw InputError(who + "cpu " + std::to_string(*p.cpu) + " must be in [0, " +
                     std::to_string(CPU_SETSIZE - 1) + "]");
  }
  if (p.stack_prefault_bytes > p.stack_bytes / 2) {
    throw InputError(who + "stack_prefault_bytes " + std::to_string(p.stack_prefault_bytes) +
                     " must be at most half of stack_bytes " + std::to_string(p.stack_bytes));
  }
}

std::string denied(const CyclicThreadParameters& p, const std::string& what, int error,
                   const std::string& cure) {
  return "cyclic thread '" + p.name + "': " + what + " denied: " + std::strerror(error) + "; " +
         cure;
}

void sleep_until(nanoseconds deadline) noexcept {
  const auto seconds = std::chrono::duration_cast<std::chrono::seconds>(deadline);
  timespec time{};
  time.tv_sec = seconds.count();
  time.tv_nsec = (deadline - seconds).count();
  // A signal ends the sleep early (it returns EINTR; errno is not set): the deadline is absolute.
  while (clock_nanosleep(CLOCK_MONOTONIC, TIMER_ABSTIME, &time, nullptr) == EINTR) {
  }
}

/// The first grid point after `now`.
nanoseconds first_slot(const CyclicThreadParameters& p, nanoseconds now) noexcept {
  const nanoseconds origin = p.epoch + p.phase;
  if (now < origin) return origin;
  return origin + ((now - origin) / p.period + 1) * p.period;
}

std::string usable_cpus() {
  cpu_set_t set;
  CPU_ZERO(&set);
  sched_getaffinity(0, sizeof(set), &set);
  std::string list;
  for (std::size_t cpu = 0; cpu < CPU_SETSIZE; ++cpu) {
    if (!CPU_ISSET(cpu, &set)) continue;
    if (!list.empty()) list += ',';
    list += std::to_string(cpu);
  }
  return list;
}

/// What the system denies the thread, one line each. Pthread calls return their error code.
std::vector<std::string> make_real_time(pthread_t thread, const CyclicThreadParameters& p) {
  std::vector<std::string> refusals;
  if (p.cpu) {
    cpu_set_t set;
    CPU_ZERO(&set);
    CPU_SET(static_cast<std::size_t>(*p.cpu), &set);
    const int error = pthread_setaffinity_np(thread, sizeof(set), &set);
    if (error != 0) {
      refusals.push_back(denied(p, "affinity to cpu " + std::to_string(*p.cpu), error,
                                "choose one of this process' cpus: " + usable_cpus()));
    }
  }
  if (p.fifo_priority) {
    sched_param priority{};
    priority.sched_priority = *p.fifo_priority;
    const int error = pthread_setschedparam(thread, SCHED_FIFO, &priority);
    if (error != 0) {
      refusals.push_back(denied(p, "SCHED_FIFO priority " + std::to_string(*p.fifo_priority), error,
                                "set 'rtprio 99' in /etc/security/limits.conf (LimitRTPRIO=99 in a "
                                "systemd unit) or grant "
                                "CAP_SYS_NICE"));
    }
  }
  return refusals;
}

pthread_t start_thread(const CyclicThreadParameters& p, void* (*entry)(void*), void* argument) {
  pthread_attr_t attributes;
  pthread_attr_init(&attributes);
  pthread_t thread{};
  int error = pthread_attr_setstacksize(&attributes, p.stack_bytes);
  if (error == 0) error = pthread_create(&thread, &attributes, entry, argument);
  pthread_attr_destroy(&attributes);
  if (error != 0) {
    throw UnavailableError(denied(p, "thread with " + std::to_string(p.stack_bytes) + " byte stack",
                                  error, "use a stack size the system can give"));
  }
  pthread_setname_np(thread, p.name.substr(0, 15).c_str());  // a name is a convenience
  return thread;
}

}  // namespace

struct CyclicThread::Shared {
  enum class Order : int { wait, run, stop };
  CyclicThreadParameters parameters;
  Callback callback;
  std::atomic<Order> order{Order::wait};
  pthread_t thread{};
  bool is_joinable = false;

  void cycle() noexcept {
    prctl(PR_SET_TIMERSLACK, 1UL);  // ns; matters only when not SCHED_FIFO
    prefault_stack(parameters.stack_prefault_bytes);
    order.wait(Order::wait);
    CycleInfo info;
    info.t_scheduled = first_slot(parameters, monotonic_now());
    while (order.load() == Order::run) {
      sleep_until(info.t_scheduled);
      if (order.load() != Order::run) return;
      info.t_woken = monotonic_now();
      info.lateness = std::max(info.t_woken - info.t_scheduled, nanoseconds::zero());
      // Slots that have passed are skipped, never made up for: this cycle serves the newest one.
      const std::int64_t passed = info.lateness / parameters.period;
      info.missed += static_cast<std::uint64_t>(passed);
      callback(info);
      ++info.index;
      info.t_scheduled += (passed + 1) * parameters.period;
    }
  }
  static void* entry(void* shared) noexcept {
    static_cast<Shared*>(shared)->cycle();
    return nullptr;
  }
};

CyclicThread::CyclicThread(const CyclicThreadParameters& parameters, Callback callback)
    : shared_(std::make_unique<Shared>()) {
  check(parameters);
  shared_->parameters = parameters;
  shared_->callback = std::move(callback);
  shared_->thread = start_thread(parameters, &Shared::entry, shared_.get());
  shared_->is_joinable = true;
  warnings_ = make_real_time(shared_->thread, parameters);
  if (!warnings_.empty() && !parameters.allow_non_rt) {
    stop();
    throw UnavailableError(warnings_.front());
  }
  // Not over a stop: a callback cannot have asked for one yet, for it has not run.
  shared_->order.store(Shared::Order::run);
  shared_->order.notify_one();
}

CyclicThread::~CyclicThread() {
  stop();
}

void CyclicThread::request_stop() noexcept {
  shared_->order.store(Shared::Order::stop);
  shared_->order.notify_one();
}

void CyclicThread::stop() noexcept {
  request_stop();
  if (!shared_->is_joinable) return;
  pthread_join(shared_->thread, nullptr);
  shared_->is_joinable = false;
}

}  // namespace holdfast::rt
