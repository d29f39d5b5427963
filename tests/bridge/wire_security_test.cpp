// SPDX-License-Identifier: Apache-2.0
// What somebody who listens on the wire sees, and what comes of sending it again. Each has its
// control without DDS Security, in which the same search finds, and the same sending arrives.
#include <algorithm>
#include <cstring>
#include <map>
#include <optional>
#include <string>
#include <vector>

#include <gtest/gtest.h>

#include "bridge/client/client.hpp"
#include "bridge/dds/endpoint.hpp"
#include "tests/bridge/dds_domain.hpp"
#include "tests/bridge/dds_peer.hpp"
#include "tests/bridge/key_folder.hpp"
#include "tests/bridge/packet_capture.hpp"
#include "tests/sim/private_network.hpp"

namespace holdfast::bridge {
namespace {

using dds::eventually;
using dds::Peer;
using dds::test_domain;
using test::Datagram;
using test::PacketCapture;
using Bytes = std::vector<std::uint8_t>;

constexpr std::size_t kEnough = 50;  // poses and motion-stop messages, each

/// As they lie in CDR, one behind the other (x86 and CDR both little-endian here).
template <class... T>
Bytes bytes_of(const T&... values) {
  Bytes bytes;
  const auto append = [&bytes](const auto& value) {
    const auto* begin = reinterpret_cast<const std::uint8_t*>(&value);
    bytes.insert(bytes.end(), begin, begin + sizeof value);
  };
  (append(values), ...);
  return bytes;
}

Bytes bytes_of_text(std::string_view text) {
  return {text.begin(), text.end()};
}

class WireSecurity : public KeyFolderTest {
 protected:
  static void SetUpTestSuite() { sim::enter_private_network(); }
};

/// A robot's two readers, and whatever they were given.
class Robot {
 public:
  explicit Robot(const std::string& keys)
      : participant_({.domain = test_domain(), .configuration = {}, .security = keys}),
        poses_(participant_),
        stops_(participant_) {}

  void take() {
    for (const auto& m : poses_.take()) poses.push_back(m);
    for (const auto& m : stops_.take()) stops.push_back(m);
  }
  /// Until it has `count` more of each.
  [[nodiscard]] bool hears_more(std::size_t count) {
    const std::size_t more_poses = poses.size() + count, more_stops = stops.size() + count;
    return eventually([&] {
      take();
      return poses.size() >= more_poses && stops.size() >= more_stops;
    });
  }
  /// Until both have come that were sent after `t`: whatever was on the wire before has been
  /// looked at, for a socket gives its datagrams in order.
  [[nodiscard]] bool hears_newer_than(std::chrono::nanoseconds t) {
    return eventually([&] {
      take();
      return !poses.empty() && !stops.empty() &&
             poses.back().protection.t_monotonic_ns > t.count() &&
             stops.back().protection.t_monotonic_ns > t.count();
    });
  }
  template <class M>
  static void expect_each_once(const std::vector<M>& messages) {
    std::map<std::uint32_t, std::uint32_t> newest;  // counter of each source
    for (const M& m : messages) {
      const auto [at, is_first] = newest.emplace(m.protection.source, m.protection.counter);
      if (is_first) continue;
      EXPECT_GT(m.protection.counter, at->second);
      at->second = m.protection.counter;
    }
  }

  std::vector<msg::CompensatedPose> poses;
  std::vector<msg::MotionStop> stops;

 private:
  dds::Participant participant_;
  dds::Reader<msg::CompensatedPose> poses_;
  dds::Reader<msg::MotionStop> stops_;
};

/// How many of the things that ought to be secret stand on the wire.
/// Topic names are not among it: the permissions that participants show each other, signed but
/// readable, hold them.
struct Seen {
  std::size_t poses = 0, pose_times = 0, stop_times = 0, types = 0;
};
Seen seen_on(const std::vector<Datagram>& wire, const Robot& robot) {
  const auto stands = [&wire](const Bytes& part) {
    return std::any_of(wire.begin(), wire.end(),
                       [&part](const Datagram& d) { return test::contains(d.payload, part); });
  };
  Seen seen;
  for (const auto& m : robot.poses) {
    seen.poses += stands(bytes_of(m.translation_mm, m.rotation_xyzw)) ? 1U : 0U;
    seen.pose_times +=
        stands(bytes_of(m.t_pose_ns, m.t_exposure_ns, m.t_frame_received_ns)) ? 1U : 0U;
  }
  for (const auto& m : robot.stops)
    seen.stop_times +=
        stands(bytes_of(m.protection.t_monotonic_ns, m.protection.t_utc_ns)) ? 1U : 0U;
  for (const char* name : {"CompensatedPose", "MotionStop"})
    seen.types += stands(bytes_of_text(name)) ? 1U : 0U;
  return seen;
}

TEST_F(WireSecurity, WithoutItTheWireShowsPosesPermissionsAndTypes) {
  PacketCapture capture;
  Robot robot("");
  const Peer daemon("flood", test_domain());
  ASSERT_EQ(daemon.first_line(), "ready");
  ASSERT_TRUE(robot.hears_more(kEnough));
  const Seen seen = seen_on(capture.take(), robot);
  EXPECT_EQ(seen.poses, robot.poses.size());
  EXPECT_EQ(seen.pose_times, robot.poses.size());
  EXPECT_EQ(seen.stop_times, robot.stops.size());
  EXPECT_EQ(seen.types, 2U);
}

TEST_F(WireSecurity, NothingOfAPoseOrAPermissionIsReadableOnTheWire) {
  RecordProperty("requirement", "SR-143");
  PacketCapture capture;
  Robot robot(keys_of("robot", "robot"));
  const Peer daemon("flood", test_domain(), keys_of("daemon", "daemon"));
  ASSERT_EQ(daemon.first_line(), "ready");
  ASSERT_TRUE(robot.hears_more(kEnough));
  const std::vector<Datagram> wire = capture.take();
  EXPECT_GT(wire.size(), 2 * kEnough);  // it did go over this wire
  const Seen seen = seen_on(wire, robot);
  EXPECT_EQ(seen.poses, 0U);
  EXPECT_EQ(seen.pose_times, 0U);
  EXPECT_EQ(seen.stop_times, 0U);
  EXPECT_EQ(seen.types, 0U);
}

/// The datagram as it would be, had its sample been written a thousand samples later. RTPS 2.1:
/// header of 20 bytes; then each submessage: id, flags, length (2); in DATA (0x15) after 16 more
/// bytes the lower half of the sequence number. None when no DATA holds `part`.
std::optional<Datagram> as_if_written_later(Datagram datagram, const Bytes& part) {
  Bytes& b = datagram.payload;
  for (std::size_t at = 20; at + 24 <= b.size();) {
    std::uint16_t length = 0;
    std::memcpy(&length, &b[at + 2], sizeof length);
    const std::size_t end = length == 0 ? b.size() : std::min(b.size(), at + 4 + length);
    if (b[at] == 0x15 && test::contains({&b[at], end - at}, part)) {
      std::uint32_t number = 0;
      std::memcpy(&number, &b[at + 20], sizeof number);
      number += 1000;
      std::memcpy(&b[at + 20], &number, sizeof number);
      return datagram;
    }
    at = end;
  }
  return std::nullopt;
}

TEST_F(WireSecurity, WhatWasHeardOnTheWireIsNotTakenAgain) {
  RecordProperty("requirement", "SR-143");
  PacketCapture capture;
  Robot robot(keys_of("robot", "robot"));
  const Peer daemon("flood", test_domain(), keys_of("daemon", "daemon"));
  ASSERT_EQ(daemon.first_line(), "ready");
  ASSERT_TRUE(robot.hears_more(kEnough));
  const std::vector<Datagram> wire = capture.take();
  const Bytes pose =
      bytes_of(robot.poses.front().translation_mm, robot.poses.front().rotation_xyzw);
  for (const Datagram& datagram : wire) {
    capture.send_again(datagram);
    Datagram spoilt = datagram;  // and with a bit turned, so that it is not known already
    spoilt.payload[spoilt.payload.size() / 2] ^= 4;
    capture.send_again(spoilt);
    if (const auto later = as_if_written_later(datagram, pose)) capture.send_again(*later);
    robot.take();  // the readers keep 64
  }
  const std::size_t poses = robot.poses.size(), stops = robot.stops.size();
  ASSERT_TRUE(robot.hears_newer_than(dds::read_clocks().monotonic));
  EXPECT_GT(robot.poses.size(), poses);
  EXPECT_GT(robot.stops.size(), stops);
  Robot::expect_each_once(robot.poses);
  Robot::expect_each_once(robot.stops);
}

TEST_F(WireSecurity, WithoutItAPoseSentAgainArrivesAndTheClientRefusesAndCountsIt) {
  RecordProperty("requirement", "SR-52");
  PacketCapture capture;
  client::Parameters parameters;
  parameters.domain = test_domain();
  parameters.guard = client::Guard::absent;
  client::Client robot(parameters);
  const Peer daemon("flood", test_domain());
  ASSERT_EQ(daemon.first_line(), "ready");
  client::Permission permission;
  ASSERT_TRUE(eventually([&] { return (permission = robot.poll()).is_permitted(); }));
  const auto again = [&robot] {
    return robot.counts().refused_messages[static_cast<std::size_t>(client::Refusal::repeated)];
  };
  EXPECT_EQ(again(), 0U);
  const Bytes part = bytes_of(permission.pose->t_pose_ns, permission.pose->t_exposure_ns,
                              permission.pose->t_frame_received_ns);
  bool is_sent = false;
  for (const Datagram& datagram : capture.take())
    if (const auto later = as_if_written_later(datagram, part)) {
      capture.send_again(*later);
      is_sent = true;
    }
  ASSERT_TRUE(is_sent);
  EXPECT_TRUE(eventually([&] {
    (void)robot.poll();
    return again() > 0;
  }));
}

}  // namespace
}  // namespace holdfast::bridge
