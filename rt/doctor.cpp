// SPDX-License-Identifier: Apache-2.0
#include "rt/doctor.hpp"

#include <algorithm>
#include <cerrno>
#include <charconv>
#include <cstring>
#include <fstream>

#include <arpa/inet.h>
#include <linux/can.h>
#include <netinet/in.h>
#include <poll.h>
#include <sys/mman.h>
#include <sys/resource.h>
#include <sys/socket.h>
#include <unistd.h>

#include "rt/core/cyclic_thread.hpp"
#include "rt/core/error.hpp"

namespace holdfast::rt {
namespace {

using State = DoctorState;
using std::filesystem::path;

/// The file's first line; nothing when it cannot be read.
std::optional<std::string> first_line(const path& file) {
  std::ifstream stream(file);
  std::string line;
  if (!std::getline(stream, line)) return std::nullopt;
  return line;
}

std::optional<long> number_in(const path& file) {
  const auto line = first_line(file);
  long number = 0;
  if (!line ||
      std::from_chars(line->data(), line->data() + line->size(), number).ec != std::errc()) {
    return std::nullopt;
  }
  return number;
}

DoctorFinding unreadable(const std::string& check, const path& file) {
  return {check, State::warning, file.string() + " cannot be read",
          "check it on the machine that runs holdfastd; virtual machines often hide it"};
}

class Socket {
 public:
  Socket(int family, int type, int protocol) : fd_(socket(family, type, protocol)) {}
  ~Socket() {
    if (fd_ >= 0) close(fd_);
  }
  Socket(const Socket&) = delete;
  Socket& operator=(const Socket&) = delete;
  [[nodiscard]] int fd() const noexcept { return fd_; }

 private:
  int fd_;
};

DoctorFinding check_kernel(const path& root) {
  const std::string version =
      first_line(root / "proc/sys/kernel/version").value_or("unknown version");
  const bool is_rt = version.find("PREEMPT_RT") != std::string::npos ||
                     number_in(root / "sys/kernel/realtime") == 1;  // missing on some RT kernels
  if (is_rt) return {"kernel", State::ok, version, ""};
  return {"kernel", State::warning, version + ": not PREEMPT_RT",
          "install linux-image-rt-amd64 and boot it; other kernels delay the loop by milliseconds"};
}

DoctorFinding check_fifo(int priority) {
  CyclicThreadParameters parameters;
  parameters.name = "doctor";
  parameters.fifo_priority = priority;
  const std::string what = "SCHED_FIFO priority " + std::to_string(priority);
  try {
    const CyclicThread thread(parameters, [](const CycleInfo&) {});
    return {"scheduling", State::ok, what + " granted", ""};
  } catch (const Error& error) {
    return {"scheduling", State::failed, error.what(),
            "set 'rtprio 99' in /etc/security/limits.conf (LimitRTPRIO=99 in a systemd unit) or "
            "grant CAP_SYS_NICE"};
  }
}

DoctorFinding check_throttling(const path& root) {
  const path file = root / "proc/sys/kernel/sched_rt_runtime_us";
  const auto runtime_us = number_in(file);
  if (!runtime_us) return unreadable("rt throttling", file);
  if (*runtime_us < 0) return {"rt throttling", State::ok, "off", ""};
  return {"rt throttling", State::warning,
          "real-time threads get " + std::to_string(*runtime_us) + " us of each period",
          "sysctl -w kernel.sched_rt_runtime_us=-1, or a busy loop is paused for tens of ms"};
}

DoctorFinding check_memory_lock(std::size_t bytes) {
  rlimit limit{};
  getrlimit(RLIMIT_MEMLOCK, &limit);
  const std::string allowed =
      "RLIMIT_MEMLOCK " + (limit.rlim_cur == RLIM_INFINITY
                               ? std::string("unlimited")
                               : std::to_string(limit.rlim_cur / 1024) + " KiB");
  void* memory = mmap(nullptr, bytes, PROT_READ | PROT_WRITE, MAP_PRIVATE | MAP_ANONYMOUS, -1, 0);
  const int error = memory == MAP_FAILED || mlock(memory, bytes) != 0 ? errno : 0;
  if (memory != MAP_FAILED) munmap(memory, bytes);
  const std::string what = std::to_string(bytes / 1024 / 1024) + " MiB ";
  if (error == 0) return {"memory lock", State::ok, what + "locked; " + allowed, ""};
  return {
      "memory lock", State::failed, what + "refused: " + std::strerror(error) + "; " + allowed,
      "set 'memlock unlimited' in /etc/security/limits.conf (LimitMEMLOCK=infinity in a systemd "
      "unit) or grant CAP_IPC_LOCK"};
}

DoctorFinding check_cpus() {
  const long count = sysconf(_SC_NPROCESSORS_ONLN);
  const std::string what = std::to_string(count) + " online";
  if (count >= 4) return {"cpus", State::ok, what, ""};
  return {"cpus", State::warning, what,
          "use 4 or more: one for the loop, one for the publisher, the rest for the tracker"};
}

DoctorFinding check_isolation(const path& root) {
  const path file = root / "sys/devices/system/cpu/isolated";
  if (!std::filesystem::exists(file)) return unreadable("isolated cpus", file);
  const std::string list = first_line(file).value_or("");
  if (!list.empty()) return {"isolated cpus", State::ok, list, ""};
  return {"isolated cpus", State::warning, "none",
          "boot with isolcpus=N nohz_full=N rcu_nocbs=N and bind the loop to cpu N"};
}

DoctorFinding check_governor(const path& root) {
  const path file = root / "sys/devices/system/cpu/cpu0/cpufreq/scaling_governor";
  const auto governor = first_line(file);
  if (!governor) return unreadable("cpu frequency", file);
  if (*governor == "performance") return {"cpu frequency", State::ok, *governor, ""};
  return {"cpu frequency", State::warning, "governor " + *governor,
          "cpupower frequency-set -g performance"};
}

DoctorFinding check_idle_states(const path& root) {
  constexpr long kLatencyMaxUs = 20;
  const path folder = root / "sys/devices/system/cpu/cpu0/cpuidle";
  if (!std::filesystem::is_directory(folder)) return unreadable("idle states", folder);
  long deepest_us = 0;
  for (const auto& entry : std::filesystem::directory_iterator(folder)) {
    if (number_in(entry.path() / "disable").value_or(0) != 0) continue;
    deepest_us = std::max(deepest_us, number_in(entry.path() / "latency").value_or(0));
  }
  const std::string what = "deepest enabled state wakes in " + std::to_string(deepest_us) + " us";
  if (deepest_us <= kLatencyMaxUs) return {"idle states", State::ok, what, ""};
  return {"idle states", State::warning, what,
          "cpupower idle-set -D " + std::to_string(kLatencyMaxUs) +
              ", or hold /dev/cpu_dma_latency at 0"};
}

DoctorFinding check_clock_source(const path& root) {
  const path file = root / "sys/devices/system/clocksource/clocksource0/current_clocksource";
  const auto source = first_line(file);
  if (!source) return unreadable("clock source", file);
  if (*source == "tsc" || *source == "kvm-clock" || *source == "arch_sys_counter") {
    return {"clock source", State::ok, *source, ""};
  }
  return {"clock source", State::warning, *source,
          "boot with tsc=reliable if the processor's counter is: reading " + *source +
              " costs a system call"};
}

DoctorFinding check_socket_buffer(const path& root, std::size_t wanted_bytes) {
  const path file = root / "proc/sys/net/core/rmem_max";
  const auto bytes = number_in(file);
  if (!bytes) return unreadable("socket buffer", file);
  const std::string what = "net.core.rmem_max " + std::to_string(*bytes) + " bytes";
  if (*bytes >= static_cast<long>(wanted_bytes)) return {"socket buffer", State::ok, what, ""};
  return {"socket buffer", State::warning,
          what + ", a GigE camera wants " + std::to_string(wanted_bytes),
          "sysctl -w net.core.rmem_max=" + std::to_string(wanted_bytes)};
}

DoctorFinding check_can() {
  const Socket can(AF_CAN, SOCK_RAW, CAN_RAW);
  if (can.fd() >= 0) return {"can", State::ok, "SocketCAN is there", ""};
  return {"can", State::warning, std::string("no CAN socket: ") + std::strerror(errno),
          "load can_raw and the adapter's driver; needed only with a CAN microscope"};
}

/// One datagram to a multicast group over the loopback interface, as DDS discovery does; the reason
/// why it did not come back, or nothing.
std::optional<std::string> multicast_failure() {
  const Socket receiver(AF_INET, SOCK_DGRAM, 0);
  const Socket sender(AF_INET, SOCK_DGRAM, 0);
  const auto failed = [](const char* call) {
    return std::string(call) + ": " + std::strerror(errno);
  };
  if (receiver.fd() < 0 || sender.fd() < 0) return failed("socket");
  sockaddr_in address{};
  address.sin_family = AF_INET;
  auto* generic = reinterpret_cast<sockaddr*>(&address);
  socklen_t size = sizeof(address);
  if (bind(receiver.fd(), generic, size) != 0) return failed("bind");
  if (getsockname(receiver.fd(), generic, &size) != 0) return failed("getsockname");
  ip_mreq group{};
  group.imr_multiaddr.s_addr = inet_addr("239.255.0.1");  // the default group of DDS discovery
  group.imr_interface.s_addr = htonl(INADDR_LOOPBACK);
  if (setsockopt(receiver.fd(), IPPROTO_IP, IP_ADD_MEMBERSHIP, &group, sizeof(group)) != 0) {
    return failed("IP_ADD_MEMBERSHIP");
  }
  if (setsockopt(sender.fd(), IPPROTO_IP, IP_MULTICAST_IF, &group.imr_interface,
                 sizeof(group.imr_interface)) != 0) {
    return failed("IP_MULTICAST_IF");
  }
  address.sin_addr = group.imr_multiaddr;
  if (sendto(sender.fd(), "?", 1, 0, generic, sizeof(address)) != 1) return failed("sendto");
  pollfd wait{receiver.fd(), POLLIN, 0};
  if (poll(&wait, 1, 500) != 1) return "sent, but not received within 500 ms";
  return std::nullopt;
}

DoctorFinding check_multicast() {
  const auto failure = multicast_failure();
  if (!failure)
    return {"multicast", State::ok, "a datagram to 239.255.0.1 over loopback came back", ""};
  return {"multicast", State::warning, *failure,
          "ip link set lo multicast on, and let no firewall drop 239.255.0.1; or name the peers in "
          "CYCLONEDDS_URI"};
}

DoctorFinding check_cameras(int found) {
  const std::string what = std::to_string(found) + " found";
  if (found > 0) return {"cameras", State::ok, what, ""};
  return {"cameras", State::warning, what,
          "check cable, power and address range; arv-tool-0.8 lists what the network shows"};
}

}  // namespace

std::vector<DoctorFinding> run_doctor(const DoctorParameters& parameters) {
  const path& root = parameters.root;
  std::vector<DoctorFinding> findings{
      check_kernel(root),
      check_fifo(parameters.fifo_priority),
      check_throttling(root),
      check_memory_lock(parameters.lock_bytes),
      check_cpus(),
      check_isolation(root),
      check_governor(root),
      check_idle_states(root),
      check_clock_source(root),
      check_socket_buffer(root, parameters.socket_buffer_bytes),
      check_can(),
      check_multicast(),
  };
  if (parameters.cameras_found) findings.push_back(check_cameras(*parameters.cameras_found));
  return findings;
}

}  // namespace holdfast::rt
