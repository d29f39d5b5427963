// SPDX-License-Identifier: Apache-2.0
// `holdfast-bench-dds`: a compensated pose from its stamping in one process to the permission it
// gives in another, against a bare UDP datagram of the same size on the same loopback, measured in
// alternating windows of one run; and what one write asks of the heap, against a write without a
// registered instance.
#include <algorithm>
#include <csignal>
#include <cstdio>
#include <ctime>
#include <string>
#include <vector>

#include <CLI/CLI.hpp>
#include <dds/dds.h>
#include <netinet/in.h>
#include <nlohmann/json.hpp>
#include <poll.h>
#include <sys/socket.h>
#include <sys/wait.h>
#include <unistd.h>

#include "bridge/atomic_file.hpp"
#include "bridge/client/client.hpp"
#include "bridge/command_line.hpp"
#include "rt/core/error.hpp"
#include "tests/bridge/dds_domain.hpp"
#include "tests/bridge/dds_peer.hpp"
#include "tests/bridge/heap_counter.hpp"
#include "tests/bridge/scripted_daemon.hpp"

namespace holdfast::bridge::dds {
namespace {

using std::chrono::milliseconds;
using std::chrono::nanoseconds;

struct Options {
  std::string json;
  double seconds = 10;
  bool is_quick = false;
};

std::int64_t now_ns() {
  return read_clocks().monotonic.count();
}

double quantile_us(std::vector<std::int64_t>& ns, double q) {
  const auto n = static_cast<std::size_t>(q * static_cast<double>(ns.size() - 1));
  std::nth_element(ns.begin(), ns.begin() + static_cast<std::ptrdiff_t>(n), ns.end());
  return static_cast<double>(ns[n]) / 1000;
}

// A process that sends one stamped datagram of a pose's size a millisecond.
class UdpPeer {
 public:
  UdpPeer() : socket_(socket(AF_INET, SOCK_DGRAM | SOCK_CLOEXEC, 0)) {
    sockaddr_in address{};
    address.sin_family = AF_INET;
    address.sin_addr.s_addr = htonl(INADDR_LOOPBACK);
    socklen_t size = sizeof address;
    auto* const generic = reinterpret_cast<sockaddr*>(&address);
    if (bind(socket_, generic, size) != 0 || getsockname(socket_, generic, &size) != 0)
      throw UnavailableError("no loopback UDP socket");
    pid_ = fork();
    if (pid_ == 0) send_for_ever(address);
  }
  ~UdpPeer() {
    ::kill(pid_, SIGKILL);
    waitpid(pid_, nullptr, 0);
    close(socket_);
  }
  UdpPeer(const UdpPeer&) = delete;
  UdpPeer& operator=(const UdpPeer&) = delete;

  void receive(std::vector<std::int64_t>& latencies_ns) {
    pollfd waiting{.fd = socket_, .events = POLLIN, .revents = 0};
    (void)poll(&waiting, 1, 100);
    msg::CompensatedPose pose{};
    if (recv(socket_, &pose, sizeof pose, MSG_DONTWAIT) == sizeof pose)
      latencies_ns.push_back(now_ns() - pose.t_pose_ns);
  }
  void discard() {
    msg::CompensatedPose pose{};
    while (recv(socket_, &pose, sizeof pose, MSG_DONTWAIT) > 0) {
    }
  }

 private:
  [[noreturn]] void send_for_ever(const sockaddr_in& to) const {
    for (;;) {
      msg::CompensatedPose pose{};
      pose.t_pose_ns = now_ns();
      (void)sendto(socket_, &pose, sizeof pose, MSG_DONTWAIT,
                   reinterpret_cast<const sockaddr*>(&to), sizeof to);
      const timespec pause{0, 1'000'000};
      nanosleep(&pause, nullptr);
    }
  }
  int socket_;
  pid_t pid_ = -1;
};

void receive_pose(client::Client& robot, std::uint32_t& counter, std::vector<std::int64_t>& ns) {
  robot.wait(milliseconds(100));
  const auto permission = robot.poll();
  const std::int64_t now = now_ns();
  if (!permission.pose || permission.pose->counter == counter) return;
  counter = permission.pose->counter;
  ns.push_back(now - permission.pose->t_pose_ns);
}

nlohmann::json measure_latency(UdpPeer& udp, double seconds) {
  client::Parameters parameters;
  parameters.domain = test_domain();
  client::Client robot(parameters);
  const Peer daemon("publish", test_domain());
  if (!eventually([&] {
        robot.wait(milliseconds(10));
        return robot.poll().is_permitted();
      }))
    throw UnavailableError("no permission from the publishing peer");

  std::vector<std::int64_t> dds_ns, udp_ns;
  std::uint32_t counter = 0;
  constexpr double kWindow = 0.5;
  for (double t = 0; t < seconds; t += 2 * kWindow) {
    const auto window_end = [] { return now_ns() + static_cast<std::int64_t>(kWindow * 1e9); };
    (void)robot.poll();
    for (const auto end = window_end(); now_ns() < end;) receive_pose(robot, counter, dds_ns);
    udp.discard();
    for (const auto end = window_end(); now_ns() < end;) udp.receive(udp_ns);
  }
  if (dds_ns.empty() || udp_ns.empty()) throw UnavailableError("nothing was received");
  const double median = quantile_us(dds_ns, 0.5), udp_median = quantile_us(udp_ns, 0.5);
  return {{"name", "dds: pose stamped -> permission in another process"},
          {"median", median},
          {"p99", quantile_us(dds_ns, 0.99)},
          {"unit", "us"},
          {"baseline", udp_median},
          {"baseline_p99", quantile_us(udp_ns, 0.99)},
          {"baseline_is", "bare UDP datagram of the same size"},
          {"ratio", median / udp_median},
          {"samples", dds_ns.size()}};
}

template <class M>
nlohmann::json measure_heap(const char* name) {
  constexpr int kWrites = 1000;
  const Participant participant({.domain = test_domain(), .configuration = {}});
  const Writer<M> writer = [&] {
    if constexpr (std::is_same_v<M, msg::CompensatedPose>)
      return Writer<M>(participant, PoseForger::key());
    else
      return Writer<M>(participant);
  }();
  const Entity topic(
      dds_create_topic(participant.handle(), &Topic<M>::descriptor(), "bench", nullptr, nullptr),
      "create a topic");
  const Entity plain(dds_create_writer(participant.handle(), topic.handle(), nullptr, nullptr),
                     "create a writer");
  const M message{};
  const auto per_write = [&](auto&& write) {
    const auto many = [&] {
      for (int i = 0; i < kWrites; ++i) write();
    };
    many();
    return static_cast<double>(heap_requests_in(many)) / kWrites;
  };
  const double ours = per_write([&] { (void)writer.write(message); });
  const double baseline = per_write([&] { (void)dds_write(plain.handle(), &message); });
  return {{"name", std::string("dds: heap requests per write, ") + name},
          {"median", ours},
          {"p99", ours},
          {"unit", "requests"},
          {"baseline", baseline},
          {"baseline_is", "writer without a registered instance"},
          {"ratio", baseline > 0 ? ours / baseline : 1.0}};
}

void run(const Options& options) {
  UdpPeer udp;  // forks: before DDS has threads
  (void)test_domain();
  const nlohmann::json results{measure_latency(udp, options.is_quick ? 2 : options.seconds),
                               measure_heap<msg::CompensatedPose>("compensated_pose"),
                               measure_heap<msg::MotionStop>("motion_stop")};
  for (const auto& r : results)
    std::printf("%-52s median %8.2f  p99 %8.2f %s  (%s: %.2f)\n",
                r["name"].get<std::string>().c_str(), r["median"].get<double>(),
                r["p99"].get<double>(), r["unit"].get<std::string>().c_str(),
                r["baseline_is"].get<std::string>().c_str(), r["baseline"].get<double>());
  if (options.json.empty()) return;
  bridge::write_file_atomically(options.json, results.dump(2) + "\n");
}

}  // namespace
}  // namespace holdfast::bridge::dds

int main(int argc, char** argv) {
  CLI::App app{"What DDS costs.\nExample: holdfast-bench-dds --json dds.json",
               "holdfast-bench-dds"};
  holdfast::bridge::dds::Options options;
  app.add_option("--json", options.json, "results as a JSON list");
  app.add_option("--seconds", options.seconds, "s of measuring latency")
      ->check(CLI::Range(1.0, 600.0))
      ->capture_default_str();
  app.add_flag("--quick", options.is_quick, "2 s of measuring latency");
  app.callback([&options] { holdfast::bridge::dds::run(options); });
  return holdfast::bridge::run_command_line(app, argc, argv);
}
