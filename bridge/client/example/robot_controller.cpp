// SPDX-License-Identifier: Apache-2.0
// A robot controller's cycle around holdfast::client: 1 kHz, moves only on a permitted pose.
//   robot_controller DOMAIN SECONDS
#include <cstdint>
#include <cstdio>
#include <cstdlib>
#include <exception>

#include <holdfast/client.hpp>
#include <time.h>

namespace {

// Stands for the drives of a real robot.
struct Drives {
  std::uint64_t cycles_moved = 0, cycles_stopped = 0;
  bool is_moving = false;
  void move_to(const holdfast::client::Pose& /*T_robot_ct*/) {
    ++cycles_moved;
    is_moving = true;
  }
  void stop() {
    ++cycles_stopped;
    is_moving = false;
  }
};

void next_cycle(timespec& t) {
  t.tv_nsec += 1'000'000;
  if (t.tv_nsec >= 1'000'000'000) {
    t.tv_nsec -= 1'000'000'000;
    ++t.tv_sec;
  }
  clock_nanosleep(CLOCK_MONOTONIC, TIMER_ABSTIME, &t, nullptr);
}

void run(std::uint32_t domain, int seconds) {
  holdfast::client::Parameters parameters;
  parameters.domain = domain;
  holdfast::client::Client holdfast(parameters);
  Drives drives;
  timespec t{};
  clock_gettime(CLOCK_MONOTONIC, &t);

  for (int cycle = 0; cycle < seconds * 1000; ++cycle) {
    next_cycle(t);
    const auto permission = holdfast.poll();  // in each cycle, right before acting
    const bool was_moving = drives.is_moving;
    if (permission.pose)
      drives.move_to(*permission.pose);
    else
      drives.stop();  // whatever the reason
    if (drives.is_moving != was_moving || cycle % 20 == 0)
      holdfast.report({.is_enabled = drives.is_moving, .has_fault = false, .fault_code = 0});
    if (drives.is_moving != was_moving)
      std::printf("%s: %s\n", drives.is_moving ? "moving" : "stopped",
                  holdfast::client::name(permission.refusal).data());
  }
  std::printf("cycles moved %llu, stopped %llu\n",
              static_cast<unsigned long long>(drives.cycles_moved),
              static_cast<unsigned long long>(drives.cycles_stopped));
}

}  // namespace

int main(int argc, char** argv) {
  if (argc != 3) {
    std::fprintf(stderr, "usage: robot_controller DOMAIN SECONDS\n");
    return 2;
  }
  try {
    run(static_cast<std::uint32_t>(std::atoi(argv[1])), std::atoi(argv[2]));
  } catch (const std::exception& e) {
    std::fprintf(stderr, "robot_controller: %s\n", e.what());
    return 3;
  }
}
