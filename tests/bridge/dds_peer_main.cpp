// SPDX-License-Identifier: Apache-2.0
// The other process of the DDS tests: dds_peer ROLE DOMAIN [KEYS], until a signal ends it.
//   publish  one good pose and one permitting stop message a millisecond
//   claim    the domain's daemon, as the real one claims it
//   flood    as publish, whoever listens or does not
//   rogue    a writer of poses that asks nobody, as from another host
#include <csignal>
#include <cstdio>
#include <cstdlib>
#include <ctime>
#include <exception>
#include <optional>
#include <string>

#include "bridge/dds/daemon_claim.hpp"
#include "tests/bridge/scripted_daemon.hpp"

namespace {

using holdfast::bridge::dds::DaemonClaim;
using holdfast::bridge::dds::Participant;
using holdfast::bridge::dds::ScriptedDaemon;

volatile std::sig_atomic_t is_ended = 0;

void run(const std::string& role, unsigned domain, const std::string& keys) {
  const Participant participant({.domain = domain, .configuration = {}, .security = keys});
  std::optional<DaemonClaim> claim;
  if (role == "claim") claim.emplace(participant);
  ScriptedDaemon daemon(participant, keys.empty());
  std::printf("ready\n");
  std::fflush(stdout);
  timespec t{};
  clock_gettime(CLOCK_MONOTONIC, &t);
  while (is_ended == 0) {
    if (role == "flood" || (role == "publish" && daemon.has_robot())) daemon.permit();
    t.tv_nsec += 1'000'000;
    if (t.tv_nsec >= 1'000'000'000) {
      t.tv_nsec -= 1'000'000'000;
      ++t.tv_sec;
    }
    clock_nanosleep(CLOCK_MONOTONIC, TIMER_ABSTIME, &t, nullptr);
  }
}

}  // namespace

int main(int argc, char** argv) {
  if (argc != 3 && argc != 4) return 2;
  std::signal(SIGTERM, [](int) { is_ended = 1; });
  try {
    run(argv[1], static_cast<unsigned>(std::atoi(argv[2])), argc == 4 ? argv[3] : "");
  } catch (const std::exception& e) {
    std::printf("%s\n", e.what());
    return 1;
  }
}
