// SPDX-License-Identifier: Apache-2.0
#include "rt/outlets/outlets.hpp"

#include <ctime>
#include <optional>

#include <fmt/format.h>

#include "bridge/command_line.hpp"
#include "bridge/config_file.hpp"
#include "bridge/live_view/live_file.hpp"
#include "rt/core/error.hpp"

namespace holdfast::outlets {
namespace {

constexpr nanoseconds kLookPeriod = std::chrono::milliseconds(5);
constexpr std::size_t kPicturesWaitingMax = 2;  // of the largest, for one slow client

Ros2Settings read_ros2(const bridge::ConfigSection& s) {
  Ros2Settings result;
  result.is_on = s.boolean("on", result.is_on);
  result.domain = s.integer("domain", result.domain, {0, 230});
  if (s.has("network")) result.network = "file://" + s.path("network").string();
  result.robot_frame = s.text("robot_frame", result.robot_frame);
  result.rate_hz = s.number("rate_hz", result.rate_hz, {1, 200});
  return result;
}

IgtlSettings read_openigtlink(const bridge::ConfigSection& s) {
  IgtlSettings result;
  result.is_on = s.boolean("on", result.is_on);
  result.server.address = s.text("address", result.server.address);
  result.server.port =
      static_cast<std::uint16_t>(s.integer("port", result.server.port, {0, 65535}));
  result.server.allow_network = s.boolean("allow_network", result.server.allow_network);
  result.server.clients_max = static_cast<std::size_t>(s.integer("clients_max", 4, {1, 64}));
  result.rate_hz = s.number("rate_hz", result.rate_hz, {1, 200});
  return result;
}

/// Where everything goes, before anything does.
void say(const OutletsConfig& config) {
  fmt::print(stderr, "outlets: hears domain {}, {}\n", config.observer.domain,
             config.observer.security.folder.empty() ? "UNSECURED" : "secured, as observer");
  if (config.ros2.is_on)
    fmt::print(stderr,
               "outlets: ROS 2 on domain {}, UNSECURED, network of {}: tf, tf_static, "
               "holdfast/target_pose, diagnostics{}\n",
               config.ros2.domain,
               config.ros2.network.empty() ? "CYCLONEDDS_URI" : config.ros2.network,
               config.live_view.empty() ? "" : ", holdfast/image");
}

void wait(nanoseconds duration) {
  const timespec time{0, duration.count()};
  (void)clock_nanosleep(CLOCK_MONOTONIC, 0, &time, nullptr);  // a signal ends it early
}

}  // namespace

OutletsConfig load_outlets_config(const std::filesystem::path& path) {
  const bridge::ConfigFile file(path);
  const auto root = file.root();
  OutletsConfig config;
  config.observer = observer::read_observer(root);
  config.ros2 = read_ros2(root.section("ros2"));
  config.openigtlink = read_openigtlink(root.section("openigtlink"));
  if (const auto live = root.section("live_view"); live.has("file"))
    config.live_view = live.path("file");
  file.refuse_unknown_keys();
  return config;
}

void check_outlets(const OutletsConfig& config) {
  if (!config.ros2.is_on && !config.openigtlink.is_on)
    throw InputError("outlets: none is on: set [ros2] on or [openigtlink] on to true");
  if (config.ros2.is_on && config.ros2.domain == config.observer.domain)
    throw InputError(fmt::format(
        "outlets: [ros2] domain {} is the daemon's: ROS nodes do not belong where robots take "
        "their permission from",
        config.ros2.domain));
  if (config.ros2.is_on && config.ros2.robot_frame.empty())
    throw InputError("outlets: [ros2] robot_frame is empty");
  if (config.openigtlink.is_on) bridge::openigtlink::check_server(config.openigtlink.server);
}

void run_outlets(const OutletsConfig& config) {
  check_outlets(config);
  say(config);
  observer::Observer observer(config.observer);
  std::optional<Ros2Outlet> ros2;
  std::optional<IgtlOutlet> openigtlink;
  std::optional<bridge::LiveReader> live;
  if (!config.live_view.empty()) live.emplace(config.live_view);
  if (config.ros2.is_on) {
    Ros2Settings settings = config.ros2;
    settings.has_images = live.has_value();
    ros2.emplace(settings);
  }
  if (config.openigtlink.is_on) {
    IgtlSettings settings = config.openigtlink;
    if (live) settings.server.backlog_max += kPicturesWaitingMax * bridge::kLiveBytesMax;
    openigtlink.emplace(settings);
    fmt::print(stderr, "outlets: OpenIGTLink on {}:{}, UNENCRYPTED{}\n",
               config.openigtlink.server.address, openigtlink->server().port(),
               config.openigtlink.server.allow_network ? ", for all who reach it" : "");
  }
  fmt::print(stderr, "outlets: ready\n");
  while (!bridge::is_interrupted()) {
    observer.look();
    const bridge::dds::Clocks now = bridge::dds::read_clocks();
    const bridge::LivePicture* picture = live ? live->look(now) : nullptr;
    if (ros2) ros2->tell(observer.state(), now);
    if (ros2) ros2->tell_picture(picture);
    if (openigtlink) {
      openigtlink->tell(observer.state(), now);
      openigtlink->tell_picture(picture, now);
      openigtlink->server().serve(kLookPeriod);
    } else {
      wait(kLookPeriod);
    }
  }
}

}  // namespace holdfast::outlets
