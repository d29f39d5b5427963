// SPDX-License-Identifier: Apache-2.0
// Plays the daemon's two streams, and the guard that believes it, to a robot, well or badly. The
// only forger of poses.
#pragma once

#include <algorithm>
#include <optional>

#include "bridge/dds/endpoint.hpp"

namespace holdfast::bridge::dds {

struct PoseForger {
  static PoseWriterKey key() { return {}; }
};

class ScriptedDaemon {
 public:
  static constexpr std::chrono::milliseconds kPoseValidity{15};
  static constexpr std::chrono::milliseconds kStopValidity{20};

  /// Secured, one process cannot play both: `has_guard` false leaves the guard out.
  explicit ScriptedDaemon(const Participant& participant, bool has_guard = true)
      : poses_(participant, PoseForger::key()), stops_(participant) {
    if (has_guard) guards_.emplace(participant);
  }

  [[nodiscard]] bool has_robot() const {
    return poses_.status().matched > 0 && stops_.status().matched > 0 &&
           (!guards_ || guards_->status().matched > 0);
  }

  /// One good message on each stream, as of now.
  void permit() {
    (void)stops_.write(permitted());
    if (guards_) (void)guards_->write(vouched());
    (void)poses_.write(pose());
  }
  void stop() { (void)stops_.write(stopped()); }

  [[nodiscard]] msg::CompensatedPose pose() {
    using std::chrono::milliseconds;
    const Clocks now = read_clocks();
    msg::CompensatedPose m{};
    m.t_pose_ns = now.monotonic.count();
    m.t_exposure_ns = (now.monotonic - milliseconds(20)).count();
    m.t_frame_received_ns = (now.monotonic - milliseconds(15)).count();
    m.frame = ++frame_;
    m.translation_mm[2] = 200;
    m.rotation_xyzw[3] = 1;
    for (std::size_t i = 0; i < 6; ++i) m.covariance[7 * i] = 0.01;
    protect(m, source_, ++pose_counter_, kPoseValidity, now);
    return m;
  }
  [[nodiscard]] msg::MotionStop permitted() {
    msg::MotionStop m{};
    m.mode = 3;
    m.is_permitted = true;
    protect(m, source_, ++stop_counter_, kStopValidity, read_clocks());
    return m;
  }
  [[nodiscard]] msg::GuardPermission vouched() {
    msg::GuardPermission m{};
    m.is_permitted = true;
    m.daemon_source = source_;
    protect(m, guard_source_, ++guard_counter_, kStopValidity, read_clocks());
    return m;
  }
  [[nodiscard]] msg::MotionStop stopped() {
    msg::MotionStop m{};
    m.mode = 5;
    m.cause = 9;
    m.is_latched = true;
    m.stop_id = 1;
    protect(m, source_, ++stop_counter_, kStopValidity, read_clocks());
    return m;
  }
  void write(const msg::CompensatedPose& m) { (void)poses_.write(m); }
  void write(const msg::MotionStop& m) { (void)stops_.write(m); }

 private:
  Writer<msg::CompensatedPose> poses_;
  Writer<msg::MotionStop> stops_;
  std::optional<Writer<msg::GuardPermission>> guards_;
  std::uint32_t source_ = random_source();
  std::uint32_t guard_source_ = random_source();
  std::uint32_t guard_counter_ = 0;
  std::uint32_t pose_counter_ = 0, stop_counter_ = 0;
  std::uint64_t frame_ = 0;
};

}  // namespace holdfast::bridge::dds
