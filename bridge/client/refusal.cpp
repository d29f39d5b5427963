// SPDX-License-Identifier: Apache-2.0
#include "bridge/client/client.hpp"

namespace holdfast::client {

std::string_view name(Refusal refusal) noexcept {
  switch (refusal) {
    case Refusal::none:
      return "none";
    case Refusal::no_stop_message:
      return "no_stop_message";
    case Refusal::no_pose:
      return "no_pose";
    case Refusal::not_permitted:
      return "not_permitted";
    case Refusal::stop_silent:
      return "stop_silent";
    case Refusal::pose_silent:
      return "pose_silent";
    case Refusal::pose_before_permission:
      return "pose_before_permission";
    case Refusal::sources_differ:
      return "sources_differ";
    case Refusal::second_source:
      return "second_source";
    case Refusal::no_guard_message:
      return "no_guard_message";
    case Refusal::guard_silent:
      return "guard_silent";
    case Refusal::guard_withheld:
      return "guard_withheld";
    case Refusal::bad_version:
      return "bad_version";
    case Refusal::bad_data_id:
      return "bad_data_id";
    case Refusal::no_source:
      return "no_source";
    case Refusal::bad_crc:
      return "bad_crc";
    case Refusal::repeated:
      return "repeated";
    case Refusal::skipped:
      return "skipped";
    case Refusal::expired:
      return "expired";
    case Refusal::from_future:
      return "from_future";
    case Refusal::time_reversed:
      return "time_reversed";
    case Refusal::invalid_number:
      return "invalid_number";
    case Refusal::invalid_rotation:
      return "invalid_rotation";
    case Refusal::invalid_covariance:
      return "invalid_covariance";
    case Refusal::invalid_time:
      return "invalid_time";
    case Refusal::contradictory_stop:
      return "contradictory_stop";
  }
  return "unknown";
}

}  // namespace holdfast::client
