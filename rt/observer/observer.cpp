// SPDX-License-Identifier: Apache-2.0
#include "rt/observer/observer.hpp"

namespace holdfast::observer {

using bridge::dds::Clocks;

ObserverConfig read_observer(const bridge::ConfigSection& root) {
  ObserverConfig config;
  config.domain = root.integer("domain", config.domain, {0, 230});
  config.parameters.has_guard = root.boolean("guard", true);
  if (root.choice("clock", "same_host", {"same_host", "synchronised_utc"}) != "same_host")
    config.parameters.clock = safety::ClockRelation::synchronised_utc;
  config.security = bridge::read_security(root.section("dds"));
  return config;
}

Observer::Observer(const ObserverConfig& config)
    : participant_({.domain = static_cast<std::uint32_t>(config.domain),
                    .configuration = {},
                    .security = config.security.folder.string()}),
      stops_(participant_),
      guard_(participant_),
      health_(participant_),
      registrations_(participant_),
      robot_(participant_),
      poses_(participant_),
      state_(config.parameters) {}

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
