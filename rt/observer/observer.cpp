// SPDX-License-Identifier: Apache-2.0
#include "rt/observer/observer.hpp"

namespace holdfast::observer {

using bridge::dds::Clocks;

Observer::Observer(const bridge::dds::ParticipantParameters& participant,
                   const ObserverParameters& parameters)
    : participant_(participant),
      stops_(participant_),
      guard_(participant_),
      health_(participant_),
      registrations_(participant_),
      robot_(participant_),
      poses_(participant_),
      state_(parameters) {}

template <class M>
void Observer::drain(bridge::dds::Reader<M>& reader) {
  reader.drain([this](const M& message, Clocks now) { state_.take(message, now); });
}

void Observer::look() {
  drain(stops_);
  drain(guard_);
  drain(health_);
  drain(registrations_);
  drain(robot_);
  drain(poses_);
  state_.pass(bridge::dds::read_clocks());
}

}  // namespace holdfast::observer
