// SPDX-License-Identifier: Apache-2.0
// holdfast-rtvm-can: the microscope on real CAN drivers, in the guest: vcan, or two emulated
// controllers on one bus. The daemon's side and the virtual node run as two threads that see each
// other through the kernel only. One JSON object on stdout; judged by rtvm.py.
#include <algorithm>
#include <atomic>
#include <cmath>
#include <cstdio>
#include <cstdlib>
#include <memory>
#include <string>
#include <thread>
#include <vector>

#include <poll.h>
#include <sched.h>

#include "bridge/can/microscope.hpp"
#include "bridge/can/socket_can.hpp"
#include "rt/core/clock.hpp"
#include "rt/core/error.hpp"
#include "rt/optics_thread.hpp"
#include "tests/sim/microscope_node.hpp"

namespace holdfast::rtvm {
namespace {

using namespace bridge::can;  // NOLINT(google-build-using-namespace): this file is its user
using std::chrono::milliseconds;
using std::chrono::nanoseconds;

void become_real_time() {
  sched_param priority{};
  priority.sched_priority = 60;
  if (sched_setscheduler(0, SCHED_FIFO, &priority) != 0)
    throw UnavailableError("SCHED_FIFO denied");
}

/// The node on its own thread.
class NodeThread {
 public:
  NodeThread(const std::string& interface, bool is_fd, bool is_silent)
      : node_(std::make_unique<SocketCan>(interface), parameters(is_fd)), is_silent_(is_silent) {
    thread_ = std::thread([this] {
      become_real_time();
      while (!is_ending_) {
        node_.is_silent = is_silent_;
        if (const double zoom = zoom_.exchange(0); zoom > 0) node_.turn(Quantity::zoom, zoom);
        node_.poll(rt::monotonic_now());
        pollfd waiting{node_.transport().handle(), POLLIN, 0};
        poll(&waiting, 1, 1);
      }
    });
  }
  ~NodeThread() {
    is_ending_ = true;
    thread_.join();
  }
  void set_silent(bool is_silent) { is_silent_ = is_silent; }
  void turn_zoom(double zoom) { zoom_ = zoom; }

 private:
  static sim::MicroscopeNodeParameters parameters(bool is_fd) {
    sim::MicroscopeNodeParameters result;
    result.is_fd = is_fd;
    return result;
  }
  sim::MicroscopeNode node_;
  std::atomic<bool> is_silent_, is_ending_{false};
  std::atomic<double> zoom_{0};
  std::thread thread_;
};

class Probe {
 public:
  Probe(std::string host, std::string node, bool is_fd)
      : host_(std::move(host)), node_(std::move(node)), is_fd_(is_fd) {
    MicroscopeParameters parameters;
    parameters.is_fd = is_fd;
    const nanoseconds now = rt::monotonic_now();
    microscope_ = std::make_unique<Microscope>(std::make_unique<SocketCan>(host_), parameters, now);
    t_start_ = now;
  }

  void run() {
    std::printf("{\"host\":\"%s\",\"node\":\"%s\",\"fd\":%s", host_.c_str(), node_.c_str(),
                is_fd_ ? "true" : "false");
    print("never_seen_ms", wait_for(Fault::node_missing, t_start_));
    {
      NodeThread node(node_, is_fd_, false);
      wait(milliseconds(100));
      print("optics_known", microscope_->poll(rt::monotonic_now()).optics ? 1 : 0);
      measure_confirmations();
      node.set_silent(true);
      const nanoseconds t_silent = rt::monotonic_now();
      print("fell_silent_ms", wait_for(Fault::node_missing, t_silent));
    }
    optics_thread();
    full_queue();
    overflow();
    if (host_ == node_) injected_errors();
    std::printf("}\n");
  }

 private:
  static void print(const char* key, double value) { std::printf(",\"%s\":%.4f", key, value); }
  static double ms(nanoseconds time) {
    return std::chrono::duration<double, std::milli>(time).count();
  }

  const MicroscopeReport& step() {
    pollfd waiting{microscope_->handle(), POLLIN, 0};
    poll(&waiting, 1, 1);
    return microscope_->poll(rt::monotonic_now());
  }
  void wait(nanoseconds duration) {
    for (const auto end = rt::monotonic_now() + duration; rt::monotonic_now() < end;) (void)step();
  }
  /// Milliseconds from t until the fault is reported; -1 after a second without it.
  double wait_for(Fault fault, nanoseconds t) {
    while (!step().faults.contains(fault)) {
      if (rt::monotonic_now() - t > std::chrono::seconds(1)) return -1;
    }
    return ms(rt::monotonic_now() - t);
  }

  void measure_confirmations() {
    std::vector<double> times_ms;
    for (int i = 0; i < 200; ++i) {
      const nanoseconds t = rt::monotonic_now();
      if (!microscope_->command(Quantity::illumination, i % 2 == 0 ? 40 : 60, t)) break;
      while (!microscope_->confirmed() && rt::monotonic_now() - t < std::chrono::seconds(1))
        (void)step();
      if (!microscope_->confirmed()) break;
      times_ms.push_back(ms(rt::monotonic_now() - t));
      wait(milliseconds(3));
    }
    std::ranges::sort(times_ms);
    print("commands_confirmed", static_cast<double>(times_ms.size()));
    print("confirm_ms_p50", times_ms.empty() ? -1 : times_ms[times_ms.size() / 2]);
    print("confirm_ms_p99", times_ms.empty() ? -1 : times_ms[times_ms.size() * 99 / 100]);
  }

  /// More frames than the driver's queue holds; then one command too many.
  void full_queue() {
    SocketCan other(host_);
    Frame frame = encode(HeartbeatMessage{}, 9, is_fd_);  // a node that we do not watch
    bool is_full = false;
    for (int i = 0; i < 2000 && !is_full; ++i)
      is_full = other.send(frame) == SendResult::queue_full;
    print("queue_filled", is_full ? 1 : 0);
    (void)microscope_->command(Quantity::illumination, 50, rt::monotonic_now());
    const auto& report = microscope_->poll(rt::monotonic_now());
    print("transmit_queue_full", report.faults.contains(Fault::transmit_queue_full) ? 1 : 0);
    wait(milliseconds(400));
    (void)microscope_->recover(rt::monotonic_now());
  }

  /// Nobody reads while more frames come than the socket holds.
  void overflow() {
    SocketCan other(node_);
    const Frame frame = encode(HeartbeatMessage{}, 9, is_fd_);
    for (int i = 0; i < 10'000; ++i) {
      if (other.send(frame) != SendResult::sent) std::this_thread::sleep_for(milliseconds(1));
    }
    bool is_named = false;
    for (int i = 0; i < 100 && !is_named; ++i) {
      (void)other.send(frame);  // the count comes with the next frame that fits
      is_named = step().faults.contains(Fault::receive_overflow);
    }
    print("receive_overflow", is_named ? 1 : 0);
    (void)microscope_->recover(rt::monotonic_now());
  }

  /// The daemon's own reader, on its thread: to its inbox, as the control loop finds it.
  void optics_thread() {
    rt::OpticsInbox inbox;
    rt::CyclicThreadParameters thread;
    thread.name = "optics";
    thread.fifo_priority = 70;
    MicroscopeParameters parameters;
    parameters.is_fd = is_fd_;
    NodeThread node(node_, is_fd_, false);
    const rt::OpticsThread reader(std::make_unique<SocketCan>(host_), parameters, thread, inbox);
    const auto told = [&](const char* key, auto holds) {
      const nanoseconds begin = rt::monotonic_now();
      safety::OpticsInput newest;
      do {
        poll(nullptr, 0, 1);
        (void)inbox.newest.try_take(newest);
      } while (!holds(newest) && rt::monotonic_now() - begin < std::chrono::seconds(1));
      print(key, holds(newest) ? ms(rt::monotonic_now() - begin) : -1);
    };
    told("reader_knows_ms", [](const auto& optics) { return optics.is_known; });
    node.turn_zoom(1.4);
    told("reader_tells_zoom_ms",
         [](const auto& optics) { return optics.is_known && std::abs(optics.zoom - 1.4) < 1e-9; });
    node.set_silent(true);
    told("reader_misses_ms", [](const auto& optics) {
      return !optics.is_known && optics.faults.contains(safety::Reason::microscope_missing);
    });
  }

  /// Error reports as a controller would make them, and an interface that goes down.
  void injected_errors() {
    const auto after = [this](const std::string& command, Fault fault) {
      if (std::system(command.c_str()) != 0) return -1.0;
      return wait_for(fault, rt::monotonic_now()) < 0 ? 0.0 : 1.0;
    };
    print("error_passive",
          after("cansend " + host_ + " 20000004#0010000000000000", Fault::error_passive));
    print("bus_off", after("cansend " + host_ + " 20000040#0000000000000000", Fault::bus_off));
    const bool is_recovered =
        microscope_->recover(rt::monotonic_now());  // this driver cannot restart
    const auto& report = microscope_->poll(rt::monotonic_now());
    print("bus_off_stays", !is_recovered && report.faults.contains(Fault::bus_off) ? 1 : 0);
    print("interface_down", after("ip link set " + host_ + " down", Fault::interface_down));
    (void)std::system(("ip link set " + host_ + " up").c_str());
  }

  std::string host_, node_;
  bool is_fd_;
  std::unique_ptr<Microscope> microscope_;
  nanoseconds t_start_{};
};

}  // namespace
}  // namespace holdfast::rtvm

int main(int argc, char** argv) {
  if (argc != 4) {
    std::fputs("usage: holdfast-rtvm-can HOST_INTERFACE NODE_INTERFACE classic|fd\n", stderr);
    return 2;
  }
  try {
    holdfast::rtvm::become_real_time();
    holdfast::rtvm::Probe(argv[1], argv[2], std::string(argv[3]) == "fd").run();
    return 0;
  } catch (const holdfast::Error& error) {
    std::fprintf(stderr, "holdfast-rtvm-can: %s\n", error.what());
    return static_cast<int>(error.exit_code());
  }
}
