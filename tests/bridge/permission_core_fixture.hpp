// SPDX-License-Identifier: Apache-2.0
// A scripted daemon before the client's decision, without DDS; time is passed in.
#pragma once

#include <gtest/gtest.h>

#include "bridge/client/permission.hpp"

namespace holdfast::client {

using bridge::dds::canonical_crc;
using bridge::dds::protect;
using std::chrono::nanoseconds;
using namespace std::chrono_literals;

inline constexpr nanoseconds kUtcOffset = 1'700'000'000s;
inline constexpr std::uint32_t kSource = 7;

inline Clocks at(nanoseconds monotonic) {
  return {.monotonic = monotonic, .utc = monotonic + kUtcOffset};
}

// The daemon's side of both streams.
struct Daemon {
  std::uint32_t source = kSource;
  std::uint32_t pose_counter = 0, stop_counter = 0;
  nanoseconds t_permitted{};

  msg::CompensatedPose pose(nanoseconds t) {
    msg::CompensatedPose m{};
    m.t_pose_ns = t.count();
    m.t_exposure_ns = (t - 20ms).count();
    m.t_frame_received_ns = (t - 15ms).count();
    m.frame = 5;
    m.registration_id = 9;
    m.translation_mm[2] = 200;
    m.rotation_xyzw[3] = 1;
    for (std::size_t i = 0; i < 6; ++i) m.covariance[7 * i] = 0.01;
    protect(m, source, ++pose_counter, 15ms, at(t));
    return m;
  }
  msg::MotionStop permitted(nanoseconds t) {
    msg::MotionStop m{};
    m.mode = 3;
    m.is_permitted = true;
    m.t_changed_ns = t_permitted.count();
    protect(m, source, ++stop_counter, 20ms, at(t));
    return m;
  }
  msg::MotionStop stopped(nanoseconds t) {
    msg::MotionStop m{};
    m.mode = 5;
    m.cause = 9;
    m.is_latched = true;
    m.stop_id = 3;
    m.t_changed_ns = t.count();
    protect(m, source, ++stop_counter, 20ms, at(t));
    return m;
  }
};

template <class M>
M resealed(M message) {
  message.protection.crc32c = canonical_crc(message);
  return message;
}

class PermissionCoreTest : public testing::Test {
 public:
  // Two good messages on each stream, the last ones sent and received at `t`.
  void permit(nanoseconds t) {
    for (const nanoseconds sent : {t - 1ms, t}) {
      core.take(daemon.permitted(sent), at(sent));
      core.take(daemon.pose(sent), at(sent));
    }
    ASSERT_EQ(core.decide(t).refusal, Refusal::none);
  }
  // Good messages on both streams at t, t + 1 ms, ... until permission is back; how many it took.
  int messages_to_recover(nanoseconds t) {
    for (int n = 1; n <= 10; ++n, t += 1ms) {
      core.take(daemon.permitted(t), at(t));
      core.take(daemon.pose(t), at(t));
      if (core.decide(t).is_permitted()) return n;
    }
    return -1;
  }

  // The guard's part has its own tests: client_guard_test.cpp.
  static Parameters without_guard() {
    Parameters result;
    result.guard = Guard::absent;
    return result;
  }
  Parameters parameters = without_guard();
  PermissionCore core{parameters};
  Daemon daemon;
  static constexpr nanoseconds kT0 = 100s;
};

}  // namespace holdfast::client
