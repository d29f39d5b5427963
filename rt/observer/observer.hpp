// SPDX-License-Identifier: Apache-2.0
// Reads every topic of a Holdfast domain into an ObservedState; writes nothing. With DDS Security
// an observer's keys suffice, which do not allow writing. One thread.
#pragma once

#include "bridge/dds/endpoint.hpp"
#include "rt/observer/observed_state.hpp"

namespace holdfast::observer {

class Observer {
 public:
  /// Throws as bridge::dds::Participant and Reader.
  Observer(const bridge::dds::ParticipantParameters& participant,
           const ObserverParameters& parameters);

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
