// SPDX-License-Identifier: Apache-2.0
// Sound messages whose content cannot be: numbers, rotations, covariances, times, contradictions.
#include <functional>
#include <limits>
#include <ostream>
#include <string>
#include <type_traits>

#include <gtest/gtest.h>

#include "tests/bridge/permission_core_fixture.hpp"

namespace holdfast::client {
namespace {

TEST_F(PermissionCoreTest, RefusesEveryNumberThatIsNotFinite) {
  RecordProperty("requirement", "SR-54");
  int fields = 0;
  for (const double bad :
       {std::numeric_limits<double>::quiet_NaN(), std::numeric_limits<double>::infinity(),
        -std::numeric_limits<double>::infinity()}) {
    const auto count_doubles = [] {
      msg::CompensatedPose m{};
      int n = 0;
      msg::for_each_field(m, [&n](auto& f) {
        if constexpr (std::is_same_v<std::remove_reference_t<decltype(f)>, double>) ++n;
      });
      return n;
    };
    for (int chosen = 0; chosen < count_doubles(); ++chosen, ++fields) {
      core = PermissionCore(parameters);
      daemon = Daemon{};
      permit(kT0);
      auto pose = daemon.pose(kT0);
      int n = 0;
      msg::for_each_field(pose, [&](auto& f) {
        if constexpr (std::is_same_v<std::remove_reference_t<decltype(f)>, double>)
          if (n++ == chosen) f = bad;
      });
      core.take(resealed(pose), at(kT0));
      EXPECT_EQ(core.decide(kT0).refusal, Refusal::invalid_number) << chosen;
    }
  }
  EXPECT_EQ(fields, 3 * (3 + 4 + 36 + 3));
}

struct BadContent {
  const char* name;
  Refusal refusal;
  std::function<void(msg::CompensatedPose&)> spoil;
};
void PrintTo(const BadContent& bad, std::ostream* os) {
  *os << bad.name;
}
class BadContentTest : public PermissionCoreTest, public testing::WithParamInterface<BadContent> {};

TEST_P(BadContentTest, IsRefused) {
  RecordProperty("requirement", "SR-54");
  permit(kT0);
  auto pose = daemon.pose(kT0 + 1ms);
  GetParam().spoil(pose);
  core.take(resealed(pose), at(kT0 + 1ms));
  EXPECT_EQ(core.decide(kT0 + 1ms).refusal, GetParam().refusal);
  EXPECT_EQ(core.counts().poses_refused, 1U);
}

INSTANTIATE_TEST_SUITE_P(
    PermissionCore, BadContentTest,
    testing::Values(
        BadContent{"ZeroQuaternion", Refusal::invalid_rotation,
                   [](auto& m) { m.rotation_xyzw[3] = 0; }},
        BadContent{"LongQuaternion", Refusal::invalid_rotation,
                   [](auto& m) { m.rotation_xyzw[3] = 1 + 2e-6; }},
        BadContent{"ShortQuaternion", Refusal::invalid_rotation,
                   [](auto& m) { m.rotation_xyzw[3] = 1 - 2e-6; }},
        BadContent{"ZeroVariance", Refusal::invalid_covariance,
                   [](auto& m) { m.covariance[14] = 0; }},
        BadContent{"NegativeVariance", Refusal::invalid_covariance,
                   [](auto& m) { m.covariance[35] = -0.01; }},
        BadContent{"Asymmetry", Refusal::invalid_covariance,
                   [](auto& m) { m.covariance[1] = 1e-6; }},
        BadContent{"PoseFarAhead", Refusal::invalid_time,
                   [](auto& m) { m.t_pose_ns += nanoseconds(20ms + 1ns).count(); }},
        BadContent{"PoseFarBehind", Refusal::invalid_time,
                   [](auto& m) { m.t_pose_ns -= nanoseconds(20ms + 1ns).count(); }},
        BadContent{
            "StaleImage", Refusal::invalid_time,
            [](auto& m) { m.t_exposure_ns = m.t_pose_ns - nanoseconds(120ms + 1ns).count(); }},
        BadContent{"ImageFromTheFuture", Refusal::invalid_time,
                   [](auto& m) { m.t_exposure_ns = m.protection.t_monotonic_ns + 1; }},
        BadContent{"ArrivalInTheFuture", Refusal::invalid_time,
                   [](auto& m) { m.t_frame_received_ns = m.protection.t_monotonic_ns + 1; }},
        BadContent{"TimeBeforeTheEpoch", Refusal::invalid_time,
                   [](auto& m) { m.t_pose_ns = std::numeric_limits<std::int64_t>::min(); }}),
    [](const auto& test) { return std::string(test.param.name); });

TEST_F(PermissionCoreTest, AcceptsContentAtItsLimits) {
  permit(kT0);
  auto pose = daemon.pose(kT0 + 1ms);
  pose.t_exposure_ns = pose.t_pose_ns - nanoseconds(120ms).count();
  pose.rotation_xyzw[3] = 1 + 0.9e-6;
  core.take(resealed(pose), at(kT0 + 1ms));
  EXPECT_TRUE(core.decide(kT0 + 1ms).is_permitted());
}

TEST_F(PermissionCoreTest, RefusesAContradictoryStopMessage) {
  RecordProperty("requirement", "SR-52");
  using Spoil = std::function<void(msg::MotionStop&)>;
  for (const Spoil& spoil :
       {Spoil([](auto& m) { m.mode = 4; }), Spoil([](auto& m) { m.cause = 2; }),
        Spoil([](auto& m) { m.is_latched = true; }),
        Spoil([](auto& m) { m.is_permitted = false; })}) {
    core = PermissionCore(parameters);
    daemon = Daemon{};
    permit(kT0);
    auto stop = daemon.permitted(kT0);
    spoil(stop);
    core.take(resealed(stop), at(kT0));
    EXPECT_EQ(core.decide(kT0).refusal, Refusal::contradictory_stop);
  }
}

}  // namespace
}  // namespace holdfast::client
