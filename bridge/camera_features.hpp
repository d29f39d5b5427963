// SPDX-License-Identifier: Apache-2.0
// Writes CameraParameters into a camera's GenICam features. Private to the camera source.
#pragma once

#include <chrono>
#include <string>

#include <arv.h>

#include "bridge/camera_source.hpp"

namespace holdfast::bridge {

/// Throws `error` as ours: UnavailableError when the device does not answer, InputError otherwise.
/// Frees it. Does nothing when it is null.
void throw_if(GError* error, const std::string& what);

/// Pixel format, region, exposure, gain, trigger, frame rate (when free running), in that order
/// (each bounds the next). Throws InputError naming feature, value and the range or the entries
/// that the camera offers. Returns the exposure that the camera took, which may be rounded to its
/// own steps.
[[nodiscard]] std::chrono::nanoseconds write_features(ArvCamera* camera,
                                                      const CameraParameters& parameters);

}  // namespace holdfast::bridge
