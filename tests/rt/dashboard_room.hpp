// SPDX-License-Identifier: Apache-2.0
// A healthy daemon, guard and robot on the wire until they are told otherwise, the dashboard as a
// process before them, and a browser's side of HTTP by bare sockets.
#pragma once

#include <atomic>
#include <cmath>
#include <filesystem>
#include <fstream>
#include <sstream>
#include <string>
#include <thread>
#include <vector>

#include <arpa/inet.h>
#include <netinet/in.h>
#include <nlohmann/json.hpp>
#include <sys/socket.h>
#include <unistd.h>

#include "bridge/dds/endpoint.hpp"
#include "bridge/live_view/live_file.hpp"
#include "safety/gate.hpp"
#include "tests/bridge/dds_domain.hpp"
#include "tests/bridge/scripted_daemon.hpp"
#include "tests/sim/demo/child_process.hpp"

namespace holdfast::dashboard::testing {

namespace dds = bridge::dds;
namespace fs = std::filesystem;
using std::chrono::milliseconds;

/// What the processes of a set-up say, at their rates.
class PlayedRoom {
 public:
  explicit PlayedRoom(const dds::Participant& participant)
      : poses_(participant, source_, dds::PoseForger::key()),
        stops_(participant, source_),
        health_(participant, source_),
        registrations_(participant, source_),
        guard_(participant, guard_source_),
        robot_(participant, guard_source_) {
    thread_ = std::thread([this] { run(); });
  }
  ~PlayedRoom() {
    is_ending_ = true;
    thread_.join();
  }
  PlayedRoom(const PlayedRoom&) = delete;
  PlayedRoom& operator=(const PlayedRoom&) = delete;

  std::atomic<bool> is_silent{false};  ///< the daemon
  std::atomic<bool> is_guard_silent{false};
  std::atomic<safety::Reason> cause{safety::Reason::none};

 private:
  void run() {
    msg::RegistrationInfo registration{};
    registration.is_loaded = true;
    registration.registration_id = 9;
    registration.rotation_xyzw[3] = 1;
    registration.zoom = 1.3;
    registration.focus_mm = 200;
    registration.translation_mm[0] = 5;
    registration.translation_mm[1] = 6;
    registration.translation_mm[2] = 250;
    for (std::size_t i = 0; i < 3; ++i) registration.covariance[7 * i] = 0.01;
    (void)registrations_.publish(registration);
    for (std::uint64_t cycle = 0; !is_ending_; ++cycle) {
      if (!is_silent) daemon(cycle);
      if (!is_guard_silent && cycle % 2 == 0) guard();
      if (cycle % 50 == 0) {
        msg::RobotStatus status{};
        status.is_enabled = true;
        (void)robot_.publish(status);
      }
      std::this_thread::sleep_for(milliseconds(1));  // the loop's pace
    }
  }
  void daemon(std::uint64_t cycle) {
    const safety::Reason why = cause;
    const std::int64_t now_ns = dds::read_clocks().monotonic.count();
    if (cycle % 33 == 0) {
      msg::TrackingHealth health{};
      health.frame = frame_ = cycle / 33 + 1;
      health.registration_id = 9;
      health.inliers = 150;
      health.matches = 180;
      health.dx_um = 400 * std::sin(static_cast<double>(cycle) / 500);
      health.dy_um = 300 * std::cos(static_cast<double>(cycle) / 700);
      health.site_translation_mm[0] = 1;
      health.site_translation_mm[1] = 2;
      health.site_translation_mm[2] = 3;
      health.site_rotation_xyzw[3] = 1;
      health.has_drift = true;
      health.drift_um = 8;
      health.sigma_target_mm = 0.07;
      health.scale = 1;
      health.tracker_us = 2100;
      health.cycles = cycle;
      health.t_exposure_ns = t_exposure_ns_ = now_ns - 12'000'000;
      (void)health_.publish(health);
    }
    if (cycle % 5 == 0 || why != told_) {
      msg::MotionStop stop{};
      stop.is_permitted = why == safety::Reason::none;
      const bool is_stop = safety::severity(why) == safety::Severity::stop;
      stop.mode = static_cast<std::uint8_t>(stop.is_permitted ? safety::Mode::permitted
                                            : is_stop         ? safety::Mode::stop_latched
                                                              : safety::Mode::hold);
      stop.cause = static_cast<std::uint8_t>(why);
      stop.reasons = stop.is_permitted ? 0 : std::uint64_t{1} << stop.cause;
      stop.is_latched = is_stop;
      if (is_stop && why != told_) ++stop_id_;
      stop.stop_id = is_stop ? stop_id_ : 0;
      stop.t_changed_ns = now_ns;
      (void)stops_.publish(stop);
      told_ = why;
    }
    if (why != safety::Reason::none) return;
    msg::CompensatedPose pose = this->pose();
    pose.frame = frame_;
    pose.t_pose_ns = now_ns;
    pose.t_exposure_ns = t_exposure_ns_;
    (void)poses_.publish(pose);
  }
  /// A quarter turn about z: the patient's anterior, left, superior lie on the robot's x, y, z.
  static msg::CompensatedPose pose() {
    msg::CompensatedPose pose{};
    const double t[] = {100, -20, 300}, target[] = {110, -15, 320};
    for (std::size_t i = 0; i < 3; ++i) {
      pose.translation_mm[i] = t[i];
      pose.target_robot_mm[i] = target[i];
    }
    pose.rotation_xyzw[2] = pose.rotation_xyzw[3] = std::sqrt(0.5);
    for (std::size_t row = 0; row < 6; ++row)
      for (std::size_t column = 0; column < 6; ++column)
        pose.covariance[6 * row + column] =
            row == column ? 0.04 : 0.001 * static_cast<double>(row + column);
    return pose;
  }
  void guard() {
    msg::GuardPermission m{};
    m.is_permitted = cause == safety::Reason::none && !is_silent;
    m.cause = m.is_permitted ? 0 : is_silent ? 5 : 13;
    m.daemon_source = source_;
    (void)guard_.publish(m);
  }

  std::uint32_t source_ = dds::random_source(), guard_source_ = dds::random_source();
  dds::ProtectedWriter<msg::CompensatedPose> poses_;
  dds::ProtectedWriter<msg::MotionStop> stops_;
  dds::ProtectedWriter<msg::TrackingHealth> health_;
  dds::ProtectedWriter<msg::RegistrationInfo> registrations_;
  dds::ProtectedWriter<msg::GuardPermission> guard_;
  dds::ProtectedWriter<msg::RobotStatus> robot_;
  std::uint64_t frame_ = 0;
  std::int64_t t_exposure_ns_ = 0;
  safety::Reason told_ = safety::Reason::none;
  std::uint32_t stop_id_ = 0;
  std::atomic<bool> is_ending_{false};
  std::thread thread_;
};

constexpr std::uint8_t kLiveDark = 40, kLiveLight = 200;

/// 320x180, dark on the left, light on the right, masked at the top left, an inlier at 240,90, and
/// motion from 160,90 to 160,130.
inline bridge::LivePicture played_picture() {
  bridge::LivePicture p;
  p.width_px = 320;
  p.height_px = 180;
  p.camera_width_px = 321;
  p.camera_height_px = 181;
  p.fx_px = p.fy_px = 3000;
  p.cx_px = 160;
  p.cy_px = 90;
  p.status = perception::TrackingStatus::tracking;
  p.reason = perception::TrackingReason::none;
  p.inliers = 150;
  p.visible = 180;
  p.plane_depth_mm = 200;
  p.points = {{240, 90}};
  p.has_motion = true;
  p.from = {160, 90};
  p.to = {160, 130};
  p.mask.resize(80 * 45);
  for (std::size_t row = 0; row < 10; ++row)
    std::fill_n(p.mask.begin() + static_cast<std::ptrdiff_t>(80 * row), 10, 255);
  p.pixels.resize(320 * 180);
  for (std::size_t i = 0; i < p.pixels.size(); ++i)
    p.pixels[i] = i % 320 < 160 ? kLiveDark : kLiveLight;
  return p;
}

/// A daemon's live view: the same picture as a new frame, 15 a second.
class PlayedCamera {
 public:
  explicit PlayedCamera(const fs::path& file, bridge::LivePicture picture = played_picture())
      : picture_(std::move(picture)), writer_(file), thread_([this] { run(); }) {}
  ~PlayedCamera() {
    is_ending_ = true;
    thread_.join();
  }
  PlayedCamera(const PlayedCamera&) = delete;
  PlayedCamera& operator=(const PlayedCamera&) = delete;

  std::atomic<bool> is_stuck{false};  ///< no new frame comes, the file stays

 private:
  void run() {
    while (!is_ending_) {
      if (!is_stuck) {
        const dds::Clocks now = dds::read_clocks();
        ++picture_.frame;
        picture_.t_exposure = now.monotonic - milliseconds(20);
        picture_.t_utc = now.utc - milliseconds(20);
        if (writer_.write(picture_) != 0) return;
      }
      std::this_thread::sleep_for(milliseconds(66));  // the live view's pace
    }
  }
  bridge::LivePicture picture_;
  bridge::LiveWriter writer_;
  std::atomic<bool> is_ending_{false};
  std::thread thread_;
};

inline std::string text_of(const fs::path& file) {
  std::ostringstream text;
  text << std::ifstream(file).rdbuf();
  return text.str();
}

/// A connection to the dashboard; closed at the end. Reads wait 10 s at most.
class Connection {
 public:
  explicit Connection(std::uint16_t port)
      : socket_(socket(AF_INET, SOCK_STREAM | SOCK_CLOEXEC, 0)) {
    sockaddr_in address{};
    address.sin_family = AF_INET;
    address.sin_port = htons(port);
    address.sin_addr.s_addr = htonl(INADDR_LOOPBACK);
    const timeval patience{10, 0};
    (void)setsockopt(socket_, SOL_SOCKET, SO_RCVTIMEO, &patience, sizeof patience);
    // NOLINTNEXTLINE(cppcoreguidelines-pro-type-reinterpret-cast): the socket API's own convention
    is_open_ = connect(socket_, reinterpret_cast<const sockaddr*>(&address), sizeof address) == 0;
  }
  ~Connection() { close(socket_); }
  Connection(const Connection&) = delete;
  Connection& operator=(const Connection&) = delete;

  [[nodiscard]] bool is_open() const { return is_open_; }
  bool send(std::string_view bytes) const {
    return ::send(socket_, bytes.data(), bytes.size(), MSG_NOSIGNAL) ==
           static_cast<ssize_t>(bytes.size());
  }
  /// One answer on a connection that stays open; false when none comes.
  [[nodiscard]] bool receive_one() const {
    std::string all;
    char buffer[4096];
    for (;;) {
      const ssize_t n = recv(socket_, buffer, sizeof buffer, 0);
      if (n <= 0) return false;
      all.append(buffer, static_cast<std::size_t>(n));
      const auto head = all.find("\r\n\r\n"), length = all.find("Content-Length: ");
      if (head == std::string::npos) continue;
      if (length > head) return false;
      if (all.size() >= head + 4 + std::stoul(all.substr(length + 16))) return true;
    }
  }
  /// Until the other side closes.
  [[nodiscard]] std::string receive() const {
    std::string all;
    char buffer[4096];
    ssize_t n = 0;
    while ((n = recv(socket_, buffer, sizeof buffer, 0)) > 0)
      all.append(buffer, static_cast<std::size_t>(n));
    return all;
  }

 private:
  int socket_;
  bool is_open_ = false;
};

/// One request, as given, and everything that comes back.
inline std::string talk(std::uint16_t port, const std::string& request) {
  const Connection connection(port);
  return connection.send(request) ? connection.receive() : std::string();
}
inline std::string get(std::uint16_t port, const std::string& path, const std::string& headers = "",
                       const std::string& host = "127.0.0.1") {
  return talk(port, "GET " + path + " HTTP/1.1\r\nHost: " + host + "\r\nConnection: close\r\n" +
                        headers + "\r\n");
}
inline int status_of(const std::string& answer) {
  return answer.starts_with("HTTP/1.1 ") ? std::stoi(answer.substr(9, 3)) : 0;
}
inline std::string body_of(const std::string& answer) {
  const auto at = answer.find("\r\n\r\n");
  return at == std::string::npos ? std::string() : answer.substr(at + 4);
}

/// holdfast-dashboard on a port of its own; `more` is appended to its configuration.
class Dashboard {
 public:
  Dashboard(const fs::path& folder, const std::string& more = "",
            const std::vector<std::string>& options = {},
            const std::string& security = "allow_unsecured = true")
      : log_(folder / "dashboard.log") {
    fs::remove(log_);
    const fs::path config = folder / "dashboard.toml";
    std::ofstream(config) << "domain = " << dds::test_domain() << "\n"
                          << more << "\n[dds]\n"
                          << security << "\n";
    std::vector<std::string> arguments{"--config", config, "--port", "0"};
    arguments.insert(arguments.end(), options.begin(), options.end());
    process_.emplace(HOLDFAST_DASHBOARD, arguments, log_);
    (void)dds::eventually([this] {
      const std::string text = log();
      const auto at = text.find("http://");
      if (at != std::string::npos && text.find('\n', at) != std::string::npos)
        port_ = static_cast<std::uint16_t>(std::stoi(text.substr(text.find(':', at + 7) + 1)));
      return port_ != 0 || !process_->is_running();
    });
  }
  [[nodiscard]] std::uint16_t port() const { return port_; }
  [[nodiscard]] std::string url() const {
    return "http://127.0.0.1:" + std::to_string(port_) + "/";
  }
  [[nodiscard]] std::string log() const { return text_of(log_); }
  sim::ChildProcess& process() { return *process_; }
  [[nodiscard]] nlohmann::json ask(const std::string& path) const {
    return nlohmann::json::parse(body_of(get(port_, path)), nullptr, false);
  }
  /// "permitted", "no_data" …; empty when there is no answer.
  [[nodiscard]] std::string level() const {
    const auto state = ask("/state");
    return state.is_object() ? state["shown"]["level"].get<std::string>() : std::string();
  }
  [[nodiscard]] bool becomes(const std::string& wanted) const {
    return dds::eventually([&] { return level() == wanted; });
  }

 private:
  fs::path log_;
  std::optional<sim::ChildProcess> process_;
  std::uint16_t port_ = 0;
};

}  // namespace holdfast::dashboard::testing
