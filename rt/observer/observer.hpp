// SPDX-License-Identifier: Apache-2.0
// Reads every topic of a Holdfast domain into an ObservedState; writes nothing. With DDS Security
// an observer's keys suffice, which do not allow writing. One thread.
#pragma once

#include "bridge/config_file.hpp"
#include "bridge/dds/endpoint.hpp"
#include "bridge/security_config.hpp"
#include "rt/observer/observed_state.hpp"

namespace holdfast::observer {

struct ObserverConfig {
  int domain = 0;  ///< the daemon's
  bridge::SecurityConfig security;
  ObserverParameters parameters;
};

/// `domain`, `guard`, `clock` and [dds] of a program that observes. Throws InputError naming file,
/// line, column, key, value.
[[nodiscard]] ObserverConfig read_observer(const bridge::ConfigSection& root);

class Observer {
 public:
  /// Throws as bridge::dds::Participant and Reader.
  explicit Observer(const ObserverConfig& config);

  /// Takes what has arrived; does not wait. To be called at least every silence_max.
  void look();
  [[nodiscard]] const ObservedState& state() const noexcept { return state_; }

 private:
  template <class M>
  void drain(bridge::dds::Reader<M>& reader);

  bridge::dds::Participant participant_;
  bridge::dds::Reader<msg::MotionStop> stops_;
  bridge::dds::Reader<msg::GuardPermission> guard_;
  bridge::dds::Reader<msg::TrackingHealth> health_;
  bridge::dds::Reader<msg::RegistrationInfo> registrations_;
  bridge::dds::Reader<msg::RobotStatus> robot_;
  bridge::dds::Reader<msg::CompensatedPose> poses_;
  ObservedState state_;
};

}  // namespace holdfast::observer
