// SPDX-License-Identifier: Apache-2.0
#include "bridge/dds/topics.hpp"

#include <array>

namespace holdfast::bridge::dds {
namespace {

using std::chrono::milliseconds;
using std::chrono::seconds;
constexpr std::chrono::nanoseconds kOff{0};

// Common to all topics, set in endpoint.cpp:
//   ownership SHARED       EXCLUSIVE would silently pick one of two writers; a second one must
//   show. max_blocking_time 0    no writer ever waits for a slow reader. latency_budget 0 anything
//   else does not match readers with the default. autodispose off        a writer that ends makes
//   no sample: silence is the signal. destination order      by reception: sender clocks decide
//   nothing inside the middleware.
constexpr std::array<TopicPolicy, 7> kPolicies{{
    {.name = "holdfast/compensated_pose",
     .data_id = safety::DataId::compensated_pose,
     .validity = milliseconds(15),
     .reliability = Reliability::best_effort,  // a pose sent again would be too old to act on
     .durability = Durability::none,           // an old pose must never reach a late joiner
     .writer_depth = 1,                        // only the newest pose means anything
     .reader_depth = 64,            // 64 ms at 1 kHz: a slow poller still sees every counter
     .deadline = kOff,              // its absence is normal whenever motion is not permitted
     .lifespan = milliseconds(20),  // the longest validity: older ones leave unread caches too
     .liveliness_lease = kOff},     // motion_stop carries the heartbeat
    {.name = "holdfast/motion_stop",
     .data_id = safety::DataId::motion_stop,
     .validity = milliseconds(20),          // four repetitions, one each 5 ms
     .reliability = Reliability::reliable,  // a lost packet must not hide a stop till the next one
     .durability = Durability::none,        // repeated every 5 ms: late joiners wait no longer
     .writer_depth = 8,                     // a burst of changes survives one lost packet, in order
     .reader_depth = 64,                    // every change is seen even by a slow poller
     .deadline = milliseconds(20),          // reported as an event; the authority is the age check
     .lifespan = kOff,                      // a stop does not stop being one by waiting
     .liveliness_lease = milliseconds(100)},  // asserted by the writes themselves: a hung publisher
                                              // loses it though its process lives
    {.name = "holdfast/tracking_health",
     .data_id = safety::DataId::tracking_health,
     .validity = milliseconds(200),
     .reliability = Reliability::best_effort,  // for display; the next one replaces it
     .durability = Durability::none,           // at least ten a second
     .writer_depth = 1,                        // as above
     .reader_depth = 16,                       // half a second of frames at 30/s
     .deadline = milliseconds(200),            // two periods of the slowest allowed rate
     .lifespan = kOff,                         // an old picture of health, stamped, still informs
     .liveliness_lease = kOff},                // motion_stop carries the heartbeat
    {.name = "holdfast/registration_info",
     .data_id = safety::DataId::registration_info,
     .validity = std::chrono::hours(1),
     .reliability = Reliability::reliable,  // sent only on change
     .durability = Durability::writer,      // late joiners must learn it
     .writer_depth = 1,                     // one registration holds at a time
     .reader_depth = 1,                     // as above
     .deadline = kOff,                      // may never change
     .lifespan = kOff,                      // holds until withdrawn
     .liveliness_lease = kOff},             // motion_stop carries the heartbeat
    {.name = "holdfast/robot_status",
     .data_id = safety::DataId::robot_status,
     .validity = milliseconds(100),
     .reliability = Reliability::reliable,    // a fault must not be lost
     .durability = Durability::none,          // repeated every 50 ms
     .writer_depth = 8,                       // as motion_stop
     .reader_depth = 16,                      // as motion_stop, at its lower rate
     .deadline = milliseconds(100),           // two periods; the authority is robot_silence_max
     .lifespan = kOff,                        // a fault does not stop being one by waiting
     .liveliness_lease = milliseconds(200)},  // as motion_stop
    {.name = "holdfast/operator_command",
     .data_id = safety::DataId::operator_command,
     .validity = milliseconds(500),
     .reliability = Reliability::reliable,  // sent once
     .durability = Durability::none,        // a restarted daemon must never get an old command
     .writer_depth = 8,                     // as motion_stop
     .reader_depth = 16,                    // as motion_stop
     .deadline = kOff,                      // comes when a person decides
     .lifespan = milliseconds(500),         // the validity: a command does not act later
     .liveliness_lease = kOff},             // nobody waits for an operator
    {.name = "holdfast/guard_permission",
     .data_id = safety::DataId::guard_permission,
     .validity = milliseconds(10),            // five repetitions, one each 2 ms
     .reliability = Reliability::reliable,    // as motion_stop
     .durability = Durability::none,          // as motion_stop
     .writer_depth = 8,                       // as motion_stop
     .reader_depth = 64,                      // as motion_stop
     .deadline = milliseconds(20),            // as motion_stop
     .lifespan = kOff,                        // as motion_stop
     .liveliness_lease = milliseconds(100)},  // as motion_stop
}};

constexpr const TopicPolicy& row(safety::DataId id) noexcept {
  return kPolicies.at(static_cast<std::size_t>(id) - 1);
}

}  // namespace

std::span<const TopicPolicy> topic_policies() noexcept {
  return kPolicies;
}

#define HOLDFAST_TOPIC(M, id)                                           \
  static_assert(row(safety::DataId::id).data_id == safety::DataId::id); \
  template <>                                                           \
  const TopicPolicy& Topic<msg::M>::policy() noexcept {                 \
    return row(safety::DataId::id);                                     \
  }                                                                     \
  template <>                                                           \
  const dds_topic_descriptor_t& Topic<msg::M>::descriptor() noexcept {  \
    return holdfast_msg_##M##_desc;                                     \
  }
HOLDFAST_TOPIC(CompensatedPose, compensated_pose)
HOLDFAST_TOPIC(MotionStop, motion_stop)
HOLDFAST_TOPIC(TrackingHealth, tracking_health)
HOLDFAST_TOPIC(RegistrationInfo, registration_info)
HOLDFAST_TOPIC(RobotStatus, robot_status)
HOLDFAST_TOPIC(OperatorCommand, operator_command)
HOLDFAST_TOPIC(GuardPermission, guard_permission)
#undef HOLDFAST_TOPIC

}  // namespace holdfast::bridge::dds
