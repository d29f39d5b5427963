// SPDX-License-Identifier: Apache-2.0
#include "bridge/dds/endpoint.hpp"

#include <algorithm>
#include <cstring>
#include <string>

#include <dds/dds.h>

namespace holdfast::bridge::dds {

struct EndpointRecord {
  std::string topic;
  std::size_t sample_size;
  std::shared_ptr<MismatchLog> log;
};

namespace {

struct FreeQos {
  void operator()(dds_qos_t* qos) const noexcept { dds_delete_qos(qos); }
};
using Qos = std::unique_ptr<dds_qos_t, FreeQos>;

struct FreeListener {
  void operator()(dds_listener_t* listener) const noexcept { dds_delete_listener(listener); }
};
using Listener = std::unique_ptr<dds_listener_t, FreeListener>;

Qos qos_of(const TopicPolicy& policy, int depth) {
  Qos qos(dds_create_qos());
  dds_qset_reliability(qos.get(),
                       policy.reliability == Reliability::reliable ? DDS_RELIABILITY_RELIABLE
                                                                   : DDS_RELIABILITY_BEST_EFFORT,
                       0);
  dds_qset_durability(qos.get(), policy.durability == Durability::writer
                                     ? DDS_DURABILITY_TRANSIENT_LOCAL
                                     : DDS_DURABILITY_VOLATILE);
  dds_qset_history(qos.get(), DDS_HISTORY_KEEP_LAST, depth);
  dds_qset_ownership(qos.get(), DDS_OWNERSHIP_SHARED);
  dds_qset_latency_budget(qos.get(), 0);
  dds_qset_destination_order(qos.get(), DDS_DESTINATIONORDER_BY_RECEPTION_TIMESTAMP);
  dds_qset_writer_data_lifecycle(qos.get(), false);
  if (policy.deadline.count() > 0) dds_qset_deadline(qos.get(), policy.deadline.count());
  if (policy.lifespan.count() > 0) dds_qset_lifespan(qos.get(), policy.lifespan.count());
  if (policy.liveliness_lease.count() > 0)
    dds_qset_liveliness(qos.get(), DDS_LIVELINESS_MANUAL_BY_TOPIC, policy.liveliness_lease.count());
  return qos;
}

const char* policy_name(std::uint32_t id) noexcept {
  switch (id) {
    case DDS_DURABILITY_QOS_POLICY_ID:
      return "DURABILITY";
    case DDS_PRESENTATION_QOS_POLICY_ID:
      return "PRESENTATION";
    case DDS_DEADLINE_QOS_POLICY_ID:
      return "DEADLINE";
    case DDS_LATENCYBUDGET_QOS_POLICY_ID:
      return "LATENCY_BUDGET";
    case DDS_OWNERSHIP_QOS_POLICY_ID:
      return "OWNERSHIP";
    case DDS_LIVELINESS_QOS_POLICY_ID:
      return "LIVELINESS";
    case DDS_PARTITION_QOS_POLICY_ID:
      return "PARTITION";
    case DDS_RELIABILITY_QOS_POLICY_ID:
      return "RELIABILITY";
    case DDS_DESTINATIONORDER_QOS_POLICY_ID:
      return "DESTINATION_ORDER";
    case DDS_TYPE_CONSISTENCY_ENFORCEMENT_QOS_POLICY_ID:
      return "TYPE_CONSISTENCY";
    case DDS_DATA_REPRESENTATION_QOS_POLICY_ID:
      return "DATA_REPRESENTATION";
    default:
      return "unnamed";
  }
}

// Called on a Cyclone thread; an exception must not unwind into C.
void record(void* argument, const char* peer, std::uint32_t policy_id) noexcept {
  const auto& endpoint = *static_cast<const EndpointRecord*>(argument);
  try {
    endpoint.log->add(endpoint.topic + ": " + peer + " " + policy_name(policy_id));
  } catch (...) {  // out of memory: EndpointStatus::incompatible still counts it
  }
}

void on_offered(dds_entity_t /*writer*/, const dds_offered_incompatible_qos_status_t status,
                void* argument) {
  record(argument, "a reader elsewhere requests another", status.last_policy_id);
}

void on_requested(dds_entity_t /*reader*/, const dds_requested_incompatible_qos_status_t status,
                  void* argument) {
  record(argument, "a writer elsewhere offers another", status.last_policy_id);
}

Listener listener_for(EndpointRecord& record) {
  Listener listener(dds_create_listener(nullptr));
  // reset_on_invoke false: the counts stay readable through status().
  dds_lset_offered_incompatible_qos_arg(listener.get(), on_offered, &record, false);
  dds_lset_requested_incompatible_qos_arg(listener.get(), on_requested, &record, false);
  return listener;
}

}  // namespace

Endpoint::Endpoint(const Participant& participant, Direction direction, const TopicPolicy& policy,
                   const dds_topic_descriptor_t& descriptor)
    : direction_(direction),
      record_(std::make_unique<EndpointRecord>(
          EndpointRecord{policy.name, descriptor.m_size, participant.mismatches()})) {
  const bool writes = direction == Direction::writer;
  const std::string where =
      std::string(policy.name) + " on domain " + std::to_string(participant.domain());
  topic_ =
      Entity(dds_create_topic(participant.handle(), &descriptor, policy.name, nullptr, nullptr),
             "create topic " + where);
  const Qos qos = qos_of(policy, writes ? policy.writer_depth : policy.reader_depth);
  const Listener listener = listener_for(*record_);
  entity_ = writes ? Entity(dds_create_writer(participant.handle(), topic_.handle(), qos.get(),
                                              listener.get()),
                            "write " + where)
                   : Entity(dds_create_reader(participant.handle(), topic_.handle(), qos.get(),
                                              listener.get()),
                            "read " + where);
}

Endpoint::~Endpoint() = default;

void Endpoint::register_instance(const void* sample) {
  dds_instance_handle_t handle = 0;
  require(dds_register_instance(entity_.handle(), &handle, sample),
          "register the instance of " + record_->topic);
}

bool Endpoint::write(const void* sample) const noexcept {
  return dds_write(entity_.handle(), sample) == DDS_RETCODE_OK;
}

bool Endpoint::wait_for_acknowledgements(std::chrono::nanoseconds timeout) const noexcept {
  return dds_wait_for_acks(entity_.handle(), timeout.count()) == DDS_RETCODE_OK;
}

int Endpoint::take(std::span<void*> samples) const noexcept {
  constexpr std::size_t kMax = 32;
  std::array<dds_sample_info_t, kMax> info;
  const std::size_t size = std::min(samples.size(), kMax);
  for (;;) {
    const int taken = dds_take(entity_.handle(), samples.data(), info.data(), size,
                               static_cast<std::uint32_t>(size));
    if (taken <= 0) return taken;
    int valid = 0;
    for (int i = 0; i < taken; ++i) {
      const auto from = static_cast<std::size_t>(i);
      if (!info[from].valid_data) continue;  // a writer came or went: no data
      if (valid != i)
        std::memcpy(samples[static_cast<std::size_t>(valid)], samples[from], record_->sample_size);
      ++valid;
    }
    if (valid > 0) return valid;
  }
}

EndpointStatus Endpoint::status() const noexcept {
  EndpointStatus result;
  const dds_entity_t e = entity_.handle();
  if (direction_ == Direction::writer) {
    dds_publication_matched_status_t matched{};
    if (dds_get_publication_matched_status(e, &matched) == 0)
      result.matched = matched.current_count;
    dds_offered_deadline_missed_status_t deadline{};
    if (dds_get_offered_deadline_missed_status(e, &deadline) == 0)
      result.deadlines_missed = deadline.total_count;
    dds_offered_incompatible_qos_status_t qos{};
    if (dds_get_offered_incompatible_qos_status(e, &qos) == 0)
      result.incompatible = qos.total_count;
    return result;
  }
  dds_subscription_matched_status_t matched{};
  if (dds_get_subscription_matched_status(e, &matched) == 0) result.matched = matched.current_count;
  dds_requested_deadline_missed_status_t deadline{};
  if (dds_get_requested_deadline_missed_status(e, &deadline) == 0)
    result.deadlines_missed = deadline.total_count;
  dds_requested_incompatible_qos_status_t qos{};
  if (dds_get_requested_incompatible_qos_status(e, &qos) == 0)
    result.incompatible = qos.total_count;
  dds_liveliness_changed_status_t liveliness{};
  if (dds_get_liveliness_changed_status(e, &liveliness) == 0) result.alive = liveliness.alive_count;
  return result;
}

}  // namespace holdfast::bridge::dds
