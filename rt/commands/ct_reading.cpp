// SPDX-License-Identifier: Apache-2.0
#include "rt/commands/ct_reading.hpp"

#include <cstdio>

#include <unistd.h>

#include "bridge/command_line.hpp"
#include "registration/ct/dicom_series.hpp"
#include "rt/core/error.hpp"

namespace holdfast::rt {

registration::CtVolume read_ct(const std::string& folder, const std::string& series_uid) {
  struct Line {
    bool is_shown = isatty(STDERR_FILENO) == 1;
    ~Line() {
      if (is_shown) std::fputs("\r\033[K", stderr);
    }
  };
  const Line line;
  registration::SeriesOptions options;
  options.series_uid = series_uid;
  options.progress = [&line](std::size_t done, std::size_t total) {
    if (bridge::is_interrupted()) throw InterruptedError("interrupted");
    if (line.is_shown && done % 16 == 0) std::fprintf(stderr, "\rslice %zu of %zu", done, total);
  };
  return registration::read_ct_series(folder, options);
}

void add_ct_members(const registration::CtVolume& volume, nlohmann::ordered_json& json) {
  json["series"] = volume.identity.series_uid;
  json["frame_of_reference"] = volume.identity.frame_of_reference_uid;
  json["description"] = volume.description;
  json["slices"] = volume.size[2];
  json["notes"] = volume.notes;
}

}  // namespace holdfast::rt
