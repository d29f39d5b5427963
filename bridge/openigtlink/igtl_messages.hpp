// SPDX-License-Identifier: Apache-2.0
// OpenIGTLink messages (protocol version 1, header with CRC-64) as the bytes that go out. Any
// thread; allocates.
#pragma once

#include <chrono>
#include <cstdint>
#include <string>
#include <string_view>

#include <Eigen/Geometry>

namespace holdfast::bridge::openigtlink {

/// The codes of STATUS that we send (the protocol's own numbers).
enum class StatusCode : std::uint16_t {
  ok = 1,
  emergency = 3,   ///< a stop that stays until somebody acknowledges it
  time_out = 7,    ///< nothing is heard
  not_ready = 13,  ///< not permitted, may become so
};

struct Status {
  StatusCode code = StatusCode::time_out;
  std::int64_t sub_code = 0;  ///< the reason's number; 0: none
  std::string_view name;      ///< of the reason; cut to the field's 19 characters
  std::string text;           ///< a sentence
};

/// TRANSFORM: `T_mm` takes coordinates of the first to those of the second that `device` names
/// ("CameraToPatient"), in mm. `device` is cut to 20 characters. `t_utc` since 1970-01-01.
[[nodiscard]] std::string transform_message(std::string_view device, std::chrono::nanoseconds t_utc,
                                            const Eigen::Isometry3d& T_mm);

[[nodiscard]] std::string status_message(std::string_view device, std::chrono::nanoseconds t_utc,
                                         const Status& status);

}  // namespace holdfast::bridge::openigtlink
