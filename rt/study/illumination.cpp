// SPDX-License-Identifier: Apache-2.0
#include "rt/study/illumination.hpp"

namespace holdfast::rt {

std::string_view name(Illumination illumination) noexcept {
  switch (illumination) {
    case Illumination::adaptive:
      return "adaptive";
    case Illumination::random:
      return "random";
    case Illumination::or_light:
      return "or_light";
    case Illumination::microscope:
      return "microscope";
  }
  return "unknown";
}

bool has_pattern(Illumination illumination) noexcept {
  return illumination == Illumination::adaptive || illumination == Illumination::random;
}

PairRequest lit_by(Illumination illumination, const std::filesystem::path& adaptive) {
  PairRequest request;
  request.has_off = has_pattern(illumination);
  request.lamps = request.has_off                            ? "filtered"
                  : illumination == Illumination::microscope ? "microscope"
                                                             : "or";
  if (illumination == Illumination::adaptive) request.pattern = adaptive.string();
  if (illumination == Illumination::random) request.pattern = "random";
  return request;
}

}  // namespace holdfast::rt
