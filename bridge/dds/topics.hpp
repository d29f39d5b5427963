// SPDX-License-Identifier: Apache-2.0
// Every topic with its QoS and its end-to-end validity, in one table (topics.cpp gives the reason
// for each policy). Writers and readers of a topic are made from the same row, so they match; QoS
// in DDS is only monitoring and convenience here: what may be acted on is decided by the end-to-end
// check of the receiver.
#pragma once

#include <chrono>
#include <span>

#include "bridge/dds/message_types.hpp"
#include "safety/end_to_end.hpp"

namespace holdfast::bridge::dds {

enum class Reliability : std::uint8_t { best_effort, reliable };
enum class Durability : std::uint8_t {
  none,   ///< DDS volatile: nothing is kept for late joiners
  writer  ///< DDS transient local: the writer keeps its history for late joiners
};

/// One row. A duration of zero means that the policy is off (DDS: infinite).
struct TopicPolicy {
  const char* name;
  safety::DataId data_id;
  std::chrono::nanoseconds validity;  ///< default end-to-end validity of a message
  Reliability reliability;
  Durability durability;
  int writer_depth;  ///< KEEP_LAST
  int reader_depth;  ///< KEEP_LAST
  std::chrono::nanoseconds deadline;
  std::chrono::nanoseconds lifespan;
  std::chrono::nanoseconds liveliness_lease;  ///< MANUAL_BY_TOPIC; zero: AUTOMATIC, infinite
};

/// Message type to its row and its type description.
template <msg::Message M>
struct Topic {
  [[nodiscard]] static const TopicPolicy& policy() noexcept;
  [[nodiscard]] static const dds_topic_descriptor_t& descriptor() noexcept;
};

[[nodiscard]] std::span<const TopicPolicy> topic_policies() noexcept;

}  // namespace holdfast::bridge::dds
