// SPDX-License-Identifier: Apache-2.0
// What the commands on a CT share: reading the series with progress and interruption, and the
// members of their JSON that tell which CT it was.
#pragma once

#include <map>
#include <string>

#include <nlohmann/json.hpp>

#include "registration/ct/ct_volume.hpp"

namespace holdfast::rt {

/// Reads the series; a line of progress on stderr when that is a terminal. Throws InterruptedError
/// after SIGINT or SIGTERM, else as registration::read_ct_series.
[[nodiscard]] registration::CtVolume read_ct(const std::string& folder,
                                             const std::string& series_uid);

/// Which CT it was, as the properties of markups (registration/markups.hpp).
[[nodiscard]] std::map<std::string, std::string> ct_properties(
    const registration::CtVolume& volume);

/// Adds `series`, `frame_of_reference`, `description`, `slices` and `notes`.
void add_ct_members(const registration::CtVolume& volume, nlohmann::ordered_json& json);

}  // namespace holdfast::rt
