// SPDX-License-Identifier: Apache-2.0
#include "rt/commands/ct_reading.hpp"

#include <cstdio>

#include <fcntl.h>
#include <unistd.h>

#include "bridge/command_line.hpp"
#include "registration/ct/dicom_series.hpp"
#include "registration/markups.hpp"
#include "rt/core/error.hpp"

namespace holdfast::rt {
namespace {

/// The line of progress. Meanwhile stderr is shut: GDCM's JPEG 2000 decoder writes to it whatever
/// it is told, and a refusal must be one line.
struct Line {
  int descriptor = dup(STDERR_FILENO);
  bool is_shown = isatty(STDERR_FILENO) == 1;
  Line() {
    const int nowhere = open("/dev/null", O_WRONLY | O_CLOEXEC);
    if (descriptor < 0 || nowhere < 0) return;
    dup2(nowhere, STDERR_FILENO);
    close(nowhere);
  }
  ~Line() {
    std::fflush(stderr);
    if (descriptor < 0) return;
    dup2(descriptor, STDERR_FILENO);
    close(descriptor);
    if (is_shown) std::fputs("\r\033[K", stderr);
  }
  Line(const Line&) = delete;
  Line& operator=(const Line&) = delete;
};

}  // namespace

registration::CtVolume read_ct(const std::string& folder, const std::string& series_uid) {
  const Line line;
  registration::SeriesOptions options;
  options.series_uid = series_uid;
  options.progress = [&line](std::size_t done, std::size_t total) {
    if (bridge::is_interrupted()) throw InterruptedError("interrupted");
    if (line.is_shown && done % 16 == 0)
      dprintf(line.descriptor, "\rslice %zu of %zu", done, total);
  };
  return registration::read_ct_series(folder, options);
}

std::map<std::string, std::string> ct_properties(const registration::CtVolume& volume) {
  return {{registration::kCtSeriesUid, volume.identity.series_uid},
          {registration::kCtStudyUid, volume.identity.study_uid},
          {registration::kCtFrameOfReferenceUid, volume.identity.frame_of_reference_uid}};
}

void add_ct_members(const registration::CtVolume& volume, nlohmann::ordered_json& json) {
  json["series"] = volume.identity.series_uid;
  json["frame_of_reference"] = volume.identity.frame_of_reference_uid;
  json["description"] = volume.description;
  json["slices"] = volume.size[2];
  json["notes"] = volume.notes;
}

}  // namespace holdfast::rt
