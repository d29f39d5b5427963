// SPDX-License-Identifier: Apache-2.0
// What comes over CAN and DDS.
#include <algorithm>
#include <cmath>
#include <cstring>
#include <stdexcept>

#include "bridge/can/microscope_watch.hpp"
#include "bridge/client/permission.hpp"
#include "bridge/dds/message_protection.hpp"
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

}  // namespace

void require(bool holds, const char* what) {
  if (!holds) throw std::logic_error(what);
}

std::span<const Target> message_targets() {
  static const Target targets[] = {
      {"can_frames", can_seeds, take_can},
      {"motion_stop", message_seeds<msg::MotionStop>, take_by_client<msg::MotionStop>},
      {"compensated_pose", pose_seeds, take_by_client<msg::CompensatedPose>},
      {"pose_when_permitted", pose_seeds, take_pose_when_permitted},
      {"guard_permission", message_seeds<msg::GuardPermission>,
       take_by_client<msg::GuardPermission>}};
  return targets;
}

}  // namespace holdfast::fuzz
