// SPDX-License-Identifier: Apache-2.0
#include "bridge/dds/publication_watch.hpp"

#include <algorithm>
#include <array>
#include <utility>

#include <dds/dds.h>

namespace holdfast::bridge::dds {

PublicationWatch::PublicationWatch(const Participant& participant, std::string topic)
    : topic_(std::move(topic)) {
  require(dds_get_instance_handle(participant.handle(), &own_participant_), "name the participant");
  reader_ = Entity(
      dds_create_reader(participant.handle(), DDS_BUILTIN_TOPIC_DCPSPUBLICATION, nullptr, nullptr),
      "read the list of writers");
  waitset_ = Entity(dds_create_waitset(participant.handle()), "create a waitset");
  require(dds_set_status_mask(reader_.handle(), DDS_DATA_AVAILABLE_STATUS), "watch discovery");
  require(dds_waitset_attach(waitset_.handle(), reader_.handle(), 0), "watch discovery");
}

void PublicationWatch::update(const void* sample, std::uint64_t instance, bool is_alive) {
  if (!is_alive) {
    std::erase(others_, instance);
    return;
  }
  const auto& writer = *static_cast<const dds_builtintopic_endpoint_t*>(sample);
  if (writer.participant_instance_handle == own_participant_ || topic_ != writer.topic_name) return;
  if (std::find(others_.begin(), others_.end(), instance) == others_.end())
    others_.push_back(instance);
}

bool PublicationWatch::has_other_writer() noexcept {
  constexpr std::size_t kBatch = 32;
  std::array<void*, kBatch> samples{};  // null: loaned by Cyclone
  std::array<dds_sample_info_t, kBatch> info;
  try {
    for (;;) {
      const int n = dds_take(reader_.handle(), samples.data(), info.data(), kBatch, kBatch);
      if (n < 0) is_sound_ = false;
      if (n <= 0) break;
      for (std::size_t i = 0; i < static_cast<std::size_t>(n); ++i) {
        const bool is_alive = info[i].instance_state == DDS_IST_ALIVE;
        if (is_alive && !info[i].valid_data) continue;
        update(samples[i], info[i].instance_handle, is_alive);
      }
      dds_return_loan(reader_.handle(), samples.data(), n);
    }
  } catch (...) {
    is_sound_ = false;
  }
  return !is_sound_ || !others_.empty();  // a watch that cannot see assumes the worst
}

bool PublicationWatch::wait_for_other_writer(std::chrono::nanoseconds patience) {
  const dds_time_t until = dds_time() + patience.count();
  while (!has_other_writer()) {
    const dds_return_t woken = dds_waitset_wait_until(waitset_.handle(), nullptr, 0, until);
    require(woken, "wait for discovery");
    if (woken == 0) return has_other_writer();
  }
  return true;
}

}  // namespace holdfast::bridge::dds
