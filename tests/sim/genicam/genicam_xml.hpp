// SPDX-License-Identifier: Apache-2.0
// The virtual camera's GenICam description (genicam/virtual_camera.xml), built into the program.
#pragma once

#include <string_view>

namespace holdfast::sim {

[[nodiscard]] std::string_view virtual_camera_genicam_xml() noexcept;

}  // namespace holdfast::sim
