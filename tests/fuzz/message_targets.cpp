// SPDX-License-Identifier: Apache-2.0
// What comes over CAN, DDS and HTTP.
#include <algorithm>
#include <cmath>
#include <cstring>
#include <stdexcept>

#include "bridge/can/microscope_watch.hpp"
#include "bridge/client/permission.hpp"
#include "bridge/dds/message_protection.hpp"
#include "bridge/http/http_access.hpp"
#include "rt/guard/guard_core.hpp"
#include "tests/fuzz/targets.hpp"

namespace holdfast::fuzz {
namespace {

using bridge::dds::Clocks;
using std::chrono::milliseconds;
using std::chrono::nanoseconds;
namespace can = bridge::can;

constexpr nanoseconds kNow = std::chrono::seconds(1000);
constexpr Clocks kClocks{kNow, kNow + std::chrono::hours(400'000)};

/// On the fuzzer's wire a frame is its identifier (2), flags (1), size (1) and 64 bytes of data.
constexpr std::size_t kFrameBytes = 68;

Bytes bytes_of(const can::Frame& frame) {
  Bytes bytes(kFrameBytes);
  bytes[0] = static_cast<std::uint8_t>(frame.id & 0xffU);
  bytes[1] = static_cast<std::uint8_t>(frame.id >> 8U);
  bytes[2] = static_cast<std::uint8_t>((frame.is_fd ? 1 : 0) | (frame.is_error ? 2 : 0));
  bytes[3] = frame.size;
  std::memcpy(&bytes[4], frame.data.data(), frame.data.size());
  return bytes;
}

can::Frame frame_of(std::span<const std::uint8_t> bytes) {
  can::Frame frame;
  frame.id = static_cast<std::uint32_t>(bytes[0]) | static_cast<std::uint32_t>(bytes[1]) << 8U;
  frame.is_fd = (bytes[2] & 1U) != 0;
  frame.is_error = (bytes[2] & 2U) != 0;
  frame.size = static_cast<std::uint8_t>(bytes[3] % 65);
  std::memcpy(frame.data.data(), &bytes[4], frame.data.size());
  return frame;
}

std::vector<Bytes> can_seeds() {
  Bytes day;
  for (std::uint8_t i = 0; i < 4; ++i) {
    const can::Frame frames[] = {
        encode(can::HeartbeatMessage{can::NodeState::operational, i}, 1, false),
        encode(can::StateMessage{{1.25, 200, 50}, false, i}, i % 2 == 0),
        encode(can::ConfirmMessage{i, can::Quantity::zoom, can::ConfirmResult::reached, 1.25},
               false)};
    for (const can::Frame& frame : frames) {
      const Bytes bytes = bytes_of(frame);
      day.insert(day.end(), bytes.begin(), bytes.end());
    }
  }
  return {day};
}

void take_can(std::span<const std::uint8_t> bytes) {
  can::MicroscopeWatch watch({}, kNow);
  nanoseconds now = kNow;
  for (; bytes.size() >= kFrameBytes; bytes = bytes.subspan(kFrameBytes)) {
    const can::Frame frame = frame_of(bytes);
    now += milliseconds(10);
    if (const auto state = decode_state(frame)) {
      const can::Frame again = encode(*state, frame.is_fd);
      require(std::ranges::equal(again.payload(), frame.payload()),
              "a state that was not what it says");
    }
    (void)decode_confirm(frame);
    (void)decode_command(frame);
    watch.take(frame, now);
    watch.supervise(now, true, 0);
    const can::MicroscopeReport& report = watch.report();
    const bool is_in_range = !report.optics || (report.optics->zoom <= 6.5535 + 1e-9 &&
                                                report.optics->focus_mm <= 16777.215 + 1e-9);
    require(is_in_range, "optics out of range");
  }
}

template <class M>
Bytes bytes_of(const M& message) {
  Bytes bytes(sizeof(M));
  std::memcpy(bytes.data(), &message, sizeof(M));
  return bytes;
}

/// A message with this content. Booleans are made of their lowest bit, as the middleware's check of
/// them leaves no other value.
template <class M>
M message_of(std::span<const std::uint8_t> bytes) {
  Bytes whole(bytes.begin(), bytes.end());
  whole.resize(sizeof(M));
  M message;
  std::memcpy(&message, whole.data(), sizeof(M));
  msg::for_each_field(message, [](auto& field) {
    if constexpr (std::is_same_v<std::remove_cvref_t<decltype(field)>, bool>) {
      std::uint8_t byte = 0;
      std::memcpy(&byte, &field, 1);
      field = (byte & 1U) != 0;
    }
  });
  return message;
}

template <class M>
std::vector<Bytes> message_seeds() {
  M message{};
  bridge::dds::protect(message, 7, 1, milliseconds(15), kClocks);
  return {bytes_of(message)};
}

/// A permitted robot, then this message, once as it is and once with a right CRC.
template <class M>
void take_by_client(std::span<const std::uint8_t> bytes) {
  for (const bool is_resealed : {false, true}) {
    client::Parameters parameters;
    parameters.guard = client::Guard::absent;
    client::PermissionCore core(parameters);
    M message = message_of<M>(bytes);
    if (is_resealed) bridge::dds::protect(message, 7, 1, milliseconds(15), kClocks);
    core.take(message, kClocks);
    const client::Permission permission = core.decide(kNow);
    require(!permission.pose, "a single message permits");
  }
}

void take_pose_when_permitted(std::span<const std::uint8_t> bytes) {
  client::Parameters parameters;
  parameters.guard = client::Guard::absent;
  client::PermissionCore core(parameters);
  for (std::uint32_t i = 1; i < 20; ++i) {
    const Clocks clocks{kNow + i * milliseconds(1), kClocks.utc + i * milliseconds(1)};
    msg::MotionStop stop{};
    stop.mode = 3;
    stop.is_permitted = true;
    bridge::dds::protect(stop, 7, i, milliseconds(15), clocks);
    core.take(stop, clocks);
    auto pose = message_of<msg::CompensatedPose>(bytes);
    bridge::dds::protect(pose, 7, i, milliseconds(15), clocks);
    core.take(pose, clocks);
    const client::Permission permission = core.decide(clocks.monotonic);
    if (!permission.pose) continue;
    double norm = 0;
    for (const double q : permission.pose->rotation_xyzw) norm += q * q;
    for (const double t : permission.pose->translation_mm)
      require(std::isfinite(t), "a pose that is no number");
    require(std::abs(norm - 1) < 1e-2, "a pose that is no rotation");
  }
}

std::vector<Bytes> pose_seeds() {
  msg::CompensatedPose pose{};
  pose.t_pose_ns = (kNow + milliseconds(10)).count();
  pose.t_exposure_ns = (kNow - milliseconds(10)).count();
  pose.rotation_xyzw[3] = 1;
  for (int i = 0; i < 6; ++i) pose.covariance[7 * i] = 0.01;
  bridge::dds::protect(pose, 7, 1, milliseconds(15), kClocks);
  return {bytes_of(pose)};
}

/// The guard's messages one after the other, a millisecond apart, right CRCs on every second.
template <class M>
void tell(guard::GuardCore& core, std::span<const std::uint8_t> bytes, std::uint32_t counter,
          const Clocks& clocks) {
  M message = message_of<M>(bytes);
  if (counter % 2 == 0) bridge::dds::protect(message, 7, counter, milliseconds(15), clocks);
  core.take(message, clocks);
}

void take_by_guard(std::span<const std::uint8_t> bytes) {
  constexpr std::size_t kPieceMax = 1024;
  guard::GuardCore core(guard::GuardLimits{}, Eigen::Isometry3d::Identity());
  for (std::uint32_t counter = 1; bytes.size() > 1; ++counter) {
    const Clocks clocks{kNow + counter * milliseconds(1), kClocks.utc + counter * milliseconds(1)};
    const unsigned kind = bytes[0] % 5U;
    const auto piece = bytes.subspan(1, std::min(bytes.size() - 1, kPieceMax));
    if (kind == 0) tell<msg::MotionStop>(core, piece, counter, clocks);
    if (kind == 1) tell<msg::CompensatedPose>(core, piece, counter, clocks);
    if (kind == 2) tell<msg::TrackingHealth>(core, piece, counter, clocks);
    if (kind == 3) tell<msg::RegistrationInfo>(core, piece, counter, clocks);
    if (kind == 4) tell<msg::RobotStatus>(core, piece, counter, clocks);
    const guard::GuardAnswer& answer = core.decide(clocks.monotonic);
    require(answer.is_permitted == (answer.cause == guard::GuardCause::none),
            "an answer that is not its cause");
    bytes = bytes.subspan(1 + piece.size());
  }
}

std::vector<Bytes> guard_seeds() {
  return {Bytes(3000, 1), Bytes(3000, 3)};
}

constexpr std::string_view kToken = "0123456789abcdef0123456789abcdef";

std::vector<Bytes> http_seeds() {
  return {bytes_of_text("/?token=" + std::string(kToken) + "\n127.0.0.1:8080\n\n"),
          bytes_of_text("/page.js\nlocalhost\nholdfast=" + std::string(kToken) + "\n"),
          bytes_of_text("/\nlocalhost\n\nBearer " + std::string(kToken))};
}

/// Target, host, cookie, authorization, a line each.
void take_http(std::span<const std::uint8_t> bytes) {
  const std::string_view text(reinterpret_cast<const char*>(bytes.data()), bytes.size());
  std::string_view rest = text;
  const auto line = [&] {
    const std::string_view head = rest.substr(0, rest.find('\n'));
    rest.remove_prefix(std::min(rest.size(), head.size() + 1));
    return head;
  };
  bridge::HttpAsking asking;
  asking.target = line();
  asking.host = line();
  asking.cookie = line();
  asking.authorization = line();
  const bridge::HttpAnswer answer = bridge::access(asking, kToken);
  const bool is_let_in =
      answer == bridge::HttpAnswer::serve || answer == bridge::HttpAnswer::set_cookie;
  require(!is_let_in || text.find(kToken) != std::string_view::npos, "let in without the token");
  (void)bridge::path_of(asking.target);
}

}  // namespace

std::span<const Target> message_targets() {
  static const Target targets[] = {
      {"can_frames", can_seeds, take_can},
      {"motion_stop", message_seeds<msg::MotionStop>, take_by_client<msg::MotionStop>},
      {"compensated_pose", pose_seeds, take_by_client<msg::CompensatedPose>},
      {"pose_when_permitted", pose_seeds, take_pose_when_permitted},
      {"guard_permission", message_seeds<msg::GuardPermission>,
       take_by_client<msg::GuardPermission>},
      {"guard", guard_seeds, take_by_guard},
      {"http_access", http_seeds, take_http}};
  return targets;
}

}  // namespace holdfast::fuzz
