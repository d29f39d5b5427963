// SPDX-License-Identifier: Apache-2.0
// A folder of DICOM files as one CT volume in patient coordinates, or a refusal that names what is
// wrong. Strict on purpose: what cannot be resolved is refused, never averaged or guessed.
//
// It cannot see a mirrored CT whose headers are consistent (pixels flipped under an unchanged
// orientation): that takes a second look at the same anatomy, and `register` refuses it.
#pragma once

#include <cstddef>
#include <functional>
#include <string>

#include "registration/ct/ct_volume.hpp"

namespace holdfast::registration {

struct SeriesOptions {
  std::string series_uid;  ///< empty: the only series there is
  int threads = 2;         ///< that read and decode
  /// Called now and then, one call at a time, from any of the threads; may throw to end the work.
  std::function<void(std::size_t done, std::size_t total)> progress;
};

/// Reads the folder and what is below it (at most 100,000 files; a volume of at most 2^31 voxels).
/// Files that are no CT slices (other objects, localizers, DICOMDIR, other files) are left out and
/// noted. Throws
/// - InputError: no such folder, no CT slice in it, no series of that UID;
/// - RefusedError: several series and none chosen, two patients, studies or frames of reference,
///   anything stack_slices(), pixel_layout() or decode_hu() refuse, two slices at one position with
///   different pixels, an enhanced (multi-frame) CT.
[[nodiscard]] CtVolume read_ct_series(const std::string& folder, const SeriesOptions& options = {});

}  // namespace holdfast::registration
