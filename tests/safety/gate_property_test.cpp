// SPDX-License-Identifier: Apache-2.0
// A million random cycles (fixed seeds): quiet spells and storms of faults, an operator who arms,
// stops and acknowledges, rightly and wrongly. Whatever happens: an approved pose means that every
// condition holds, judged here from the inputs and written independently of the monitors; and a
// latched stop stays until its two steps.
#include <cmath>
#include <random>

#include <gtest/gtest.h>

#include "safety/numbers.hpp"
#include "tests/safety/faults.hpp"

namespace holdfast::safety {
namespace {

using std::chrono::microseconds;
using std::chrono::milliseconds;
using std::chrono::nanoseconds;

constexpr int kCyclesPerSeed = 125'000;

bool all_finite(const Inputs& in) {
  return in.T_robot_camera.matrix().allFinite() && in.prediction->covariance.allFinite() &&
         in.prediction->T_camera_site.matrix().allFinite() &&
         in.registration.T_site_ct.matrix().allFinite() && in.registration.covariance.allFinite() &&
         in.registration.p_target_site_mm.allFinite() &&
         std::isfinite(in.prediction->speed_mm_per_s);
}

bool has_trusted_image(const Limits& limits, const Inputs& in) {
  const CameraInput& camera = in.camera;
  const TrackingInput& tracking = in.tracking;
  return camera.is_connected && camera.has_frame && camera.faults.empty() &&
         elapsed(camera.t_last_frame_received, in.now) <=
             limits.frame_period + limits.frame_lateness &&
         tracking.has_estimate && !tracking.is_lost && !tracking.is_degraded &&
         !tracking.contradicts_filter && in.now <= tracking.t_exposure + limits.estimate_age_max &&
         tracking.t_exposure <= in.now + limits.frame_future_max &&
         tracking.registration_id == in.registration.id && tracking.inliers >= limits.inliers_min &&
         tracking.inlier_spread >= limits.inlier_spread_min && tracking.has_drift &&
         tracking.drift_mm >= 0 && tracking.drift_mm <= limits.drift_max_mm;
}

bool has_trusted_motion(const Limits& limits, const Inputs& in) {
  if (!in.prediction || !in.registration.is_loaded || !all_finite(in)) return false;
  const Eigen::Isometry3d& T = in.prediction->T_camera_site;
  const Eigen::Vector3d& p = in.registration.p_target_site_mm;
  const Eigen::Matrix3d gram = T.linear().transpose() * T.linear();
  // A bound from below: what the prediction alone contributes along each axis.
  const double variance = in.prediction->covariance.diagonal().head<3>().maxCoeff();
  return gram.isIdentity(1e-5) && (T * p - p).norm() <= limits.displacement_max_mm &&
         Eigen::AngleAxisd(T.linear()).angle() <= limits.rotation_max_rad + 1e-9 &&
         in.prediction->speed_mm_per_s >= 0 &&
         in.prediction->speed_mm_per_s <= limits.speed_max_mm_per_s && variance > 0 &&
         std::sqrt(variance) <= limits.sigma_target_max_mm;
}

bool has_trusted_optics(const Limits& limits, const Inputs& in) {
  const OpticsInput& optics = in.optics;
  const RegistrationInput& made_with = in.registration;
  if (!optics.is_declared_fixed) {
    const bool is_read = optics.has_report && optics.is_known && optics.faults.empty() &&
                         !optics.is_moving && in.now <= optics.t_report + limits.optics_age_max;
    if (!is_read || !(std::abs(optics.zoom - made_with.zoom) <= limits.zoom_tolerance) ||
        !(std::abs(optics.focus_mm - made_with.focus_mm) <= limits.focus_tolerance_mm))
      return false;
  }
  const double zoomed = optics.is_declared_fixed ? 1 : optics.zoom / made_with.zoom;
  return std::abs(in.tracking.scale / zoomed - 1) <= limits.scale_mismatch_max + 1e-9;
}

bool has_trusted_surroundings(const Limits& limits, const Inputs& in) {
  return in.robot.has_status && !in.robot.has_fault &&
         in.now <= in.robot.t_last_status + limits.robot_silence_max &&
         in.loop.wake_lateness <= limits.loop_lateness_max &&
         std::abs(in.loop.clock_divergence.count()) <= limits.clock_step_max.count() &&
         !in.loop.message_corrupt && !in.loop.second_publisher && !in.loop.internal_fault &&
         in.operator_command.command != Command::stop;
}

/// What a careful observer of inputs and decisions knows, without looking at the gate's state.
struct Observer {
  Mode mode = Mode::init;
  std::uint32_t stop_id = 0;
  std::optional<Timestamp> t_acknowledged;
  std::optional<Timestamp> t_last;
  std::optional<Timestamp> t_last_unwell;
  std::optional<std::uint64_t> verified_id;
};

class GateProperty : public ::testing::TestWithParam<unsigned>, public test::GateDriver {
 protected:
  double uniform() { return std::uniform_real_distribution<double>(0, 1)(random); }
  template <typename List>
  const auto& any(const List& list) {
    return list[std::uniform_int_distribution<std::size_t>(0, list.size() - 1)(random)];
  }

  void advance() {
    if (uniform() < 0.001) is_storm = !is_storm;
    now += microseconds(500 + static_cast<int>(1000 * uniform()));
    if (uniform() < 1e-4) now -= milliseconds(5);
  }

  OperatorInput operator_does() {
    const double dice = uniform();
    const std::uint32_t id = uniform() < 0.9 ? state.stop_id : state.stop_id - 1;
    if (dice < 2e-4) return {Command::stop, 0};
    if (dice < 4e-4) return {Command::disarm, 0};
    if (dice < 0.01) return {Command::acknowledge, id};
    if (dice < 0.03) return {Command::confirm, id};
    if (dice < 0.08) return {Command::arm, 0};
    return {};
  }

  Inputs next_inputs() {
    advance();
    Inputs in = test::good_inputs(now);
    in.tracking.is_new = uniform() < 0.5;
    in.operator_command = operator_does();
    in.registration.id = registration_id;
    if (uniform() < 2e-5) in.registration.id = ++registration_id;
    in.tracking.registration_id = in.registration.id;
    const double rate = is_storm ? 0.2 : 3e-4;
    while (uniform() < rate) {
      // The inputs that a fault reaches into may have been taken away by the one before.
      if (!in.prediction) break;
      any(test::all_faults()).inject(in, limits);
    }
    return in;
  }

  void check(const Inputs& in, const Decision& decision) {
    const bool is_backwards = observer.t_last && in.now < *observer.t_last;
    const bool is_good = has_trusted_image(limits, in) && has_trusted_motion(limits, in) &&
                         has_trusted_optics(limits, in) && has_trusted_surroundings(limits, in) &&
                         !is_backwards;
    ASSERT_EQ(decision.approved.has_value(), decision.mode == Mode::permitted);
    ASSERT_EQ(decision.cause == Reason::none, decision.mode == Mode::permitted);
    if (decision.approved) {
      ++approvals;
      ASSERT_TRUE(is_good);
      ASSERT_EQ(decision.approved->t_pose(), in.now);
      ASSERT_EQ(decision.approved->registration_id(), in.registration.id);
      ASSERT_TRUE(observer.verified_id == in.registration.id);
      const bool is_armed =
          observer.mode == Mode::ready && in.operator_command.command == Command::arm;
      const bool is_recovered = observer.mode == Mode::hold && observer.t_last_unwell &&
                                in.now - *observer.t_last_unwell >= limits.hold_recovery;
      ASSERT_TRUE(observer.mode == Mode::permitted || is_armed || is_recovered);
    }
    if (observer.mode == Mode::stop_latched) check_stop(in, decision, is_good);
    observe(in, decision, is_good);
  }

  void check_stop(const Inputs& in, const Decision& decision, bool is_good) {
    if (decision.mode == Mode::stop_latched) {
      ASSERT_EQ(decision.stop_id, observer.stop_id);
      return;
    }
    ++releases;
    ASSERT_EQ(decision.mode, Mode::ready);
    ASSERT_TRUE(is_good);
    ASSERT_EQ(in.operator_command.command, Command::confirm);
    ASSERT_EQ(in.operator_command.stop_id, observer.stop_id);
    ASSERT_TRUE(observer.t_acknowledged.has_value());
    const Duration after = in.now - *observer.t_acknowledged;
    ASSERT_GE(after, limits.confirm_min);
    ASSERT_LE(after, limits.confirm_max);
    ASSERT_GT(in.tracking.t_exposure, *observer.t_acknowledged);
  }

  void observe(const Inputs& in, const Decision& decision, bool is_good) {
    const OperatorInput& command = in.operator_command;
    if (command.command == Command::acknowledge) {
      observer.t_acknowledged.reset();
      if (observer.mode == Mode::stop_latched && command.stop_id == observer.stop_id) {
        observer.t_acknowledged = in.now;
      }
    }
    if (command.command == Command::confirm || !decision.reasons.with(Severity::stop).empty() ||
        decision.mode != Mode::stop_latched) {
      observer.t_acknowledged.reset();
    }
    if (!is_good) observer.t_last_unwell = in.now;
    const bool is_same = in.registration.is_loaded && observer.verified_id == in.registration.id;
    if (!is_same) observer.verified_id.reset();
    const bool is_verified_now =
        decision.mode == Mode::ready &&
        (observer.mode == Mode::unregistered || observer.mode == Mode::stop_latched);
    if (is_verified_now && has_trusted_image(limits, in) && has_trusted_motion(limits, in)) {
      observer.verified_id = in.registration.id;
    }
    observer.mode = decision.mode;
    observer.stop_id = decision.stop_id;
    observer.t_last = in.now;
  }

  std::mt19937_64 random{GetParam()};
  bool is_storm = false;
  std::uint64_t registration_id = test::kRegistrationId;
  Observer observer;
  int approvals = 0;
  int releases = 0;
};

TEST_P(GateProperty, ApprovesOnlyWhenEverythingHoldsAndStaysStoppedUntilReleased) {
  RecordProperty("requirement", "SR-01,SR-24,SR-26,SR-34");
  limits.confirm_min = milliseconds(50);
  for (int cycle = 0; cycle < kCyclesPerSeed; ++cycle) {
    const Inputs inputs = next_inputs();
    const Decision decision = Gate::decide(limits, inputs, state);
    ASSERT_NO_FATAL_FAILURE(check(inputs, decision)) << "cycle " << cycle;
  }
  // The run is worth something only if it permitted, stopped and went on, often.
  EXPECT_GT(approvals, kCyclesPerSeed / 20);
  EXPECT_GT(releases, 5);
  RecordProperty("approvals", approvals);
  RecordProperty("releases", releases);
}
INSTANTIATE_TEST_SUITE_P(Seeds, GateProperty, ::testing::Range(1U, 9U));

}  // namespace
}  // namespace holdfast::safety
