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

/// A flat picture, 8 bit.
struct Image {
  int width_px = 0, height_px = 0;
  int components = 1;       ///< 1 grey, 3 red, green, blue
  std::string_view pixels;  ///< row by row, components together
  double spacing_x_mm = 1, spacing_y_mm = 1;
  /// Of the middle between the first and the last pixel's centres. x goes along the rows, y down.
  Eigen::Vector3d p_middle_mm = Eigen::Vector3d::Zero();
};

/// IMAGE, in the coordinates that p_middle_mm has, told as RAS: a receiver turns nothing. Empty
/// when the sizes do not fit together or are beyond the protocol's 65535.
[[nodiscard]] std::string image_message(std::string_view device, std::chrono::nanoseconds t_utc,
                                        const Image& image);

[[nodiscard]] std::string status_message(std::string_view device, std::chrono::nanoseconds t_utc,
                                         const Status& status);

}  // namespace holdfast::bridge::openigtlink
