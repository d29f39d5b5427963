// SPDX-License-Identifier: Apache-2.0
#include "tests/sim/or/cavity_phantom_head.hpp"

#include <algorithm>
#include <array>
#include <cstdint>
#include <cstdlib>
#include <cstring>
#include <memory>

#include <zlib.h>

#include "rt/core/error.hpp"

namespace holdfast::sim {
namespace {

constexpr int kSlices = 108, kRows = 256, kColumns = 256;
constexpr float kPixelMm = 0.9570312F, kSliceMm = 1.5F;
constexpr std::size_t kTarBlock = 512;

using GzFile = std::unique_ptr<gzFile_s, int (*)(gzFile)>;

// Finds the member whose name ends in `name` in a tar stream; leaves the stream at its content.
// Returns its size, 0 if there is none.
std::size_t find_member(gzFile file, const std::string& name) {
  std::array<char, kTarBlock> header{};
  while (gzread(file, header.data(), kTarBlock) == static_cast<int>(kTarBlock)) {
    const std::string member(header.data(), strnlen(header.data(), 100));
    const std::size_t size = std::strtoul(std::string(&header[124], 12).c_str(), nullptr, 8);
    if (member.size() >= name.size() &&
        member.compare(member.size() - name.size(), name.size(), name) == 0)
      return size;
    const std::size_t padded = (size + kTarBlock - 1) / kTarBlock * kTarBlock;
    if (gzseek(file, static_cast<z_off_t>(padded), SEEK_CUR) < 0) return 0;
  }
  return 0;
}

// The four weights and indices of Catmull-Rom interpolation along one axis.
struct Taps {
  std::array<float, 4> weight{};
  std::array<std::size_t, 4> index{};

  Taps(float x, int count, std::size_t stride) {
    const float low = std::floor(x);
    const float t = x - low;
    weight = {0.5F * t * (-1.F + t * (2.F - t)), 0.5F * (2.F + t * t * (-5.F + 3.F * t)),
              0.5F * t * (1.F + t * (4.F - 3.F * t)), 0.5F * t * t * (t - 1.F)};
    for (int i = 0; i < 4; ++i)
      index[static_cast<std::size_t>(i)] =
          static_cast<std::size_t>(std::clamp(static_cast<int>(low) - 1 + i, 0, count - 1)) *
          stride;
  }
};

}  // namespace

HeadCt::HeadCt(const std::string& path) {
  const GzFile file(gzopen(path.c_str(), "rb"), gzclose);
  if (!file)
    throw UnavailableError(path + ": cannot be read; install the package invesalius-examples");
  values_.resize(static_cast<std::size_t>(kSlices) * kRows * kColumns);
  const std::size_t bytes = values_.size() * sizeof(std::int16_t);
  const bool is_complete =
      find_member(file.get(), "/matrix.dat") == bytes &&
      gzread(file.get(), values_.data(), static_cast<unsigned>(bytes)) == static_cast<int>(bytes);
  if (!is_complete) throw UnavailableError(path + ": holds no 108x256x256 matrix.dat of int16");
}

float HeadCt::hounsfield(const Eigen::Vector3f& p_head) const noexcept {
  const Taps column(p_head.x() / kPixelMm, kColumns, 1);
  const Taps row(-p_head.y() / kPixelMm, kRows, kColumns);
  const Taps slice(p_head.z() / kSliceMm, kSlices, static_cast<std::size_t>(kRows) * kColumns);
  float sum = 0.F;
  for (std::size_t k = 0; k < 4; ++k)
    for (std::size_t j = 0; j < 4; ++j) {
      const std::int16_t* line = &values_[slice.index[k] + row.index[j]];
      float along = 0.F;
      for (std::size_t i = 0; i < 4; ++i)
        along += column.weight[i] * static_cast<float>(line[column.index[i]]);
      sum += slice.weight[k] * row.weight[j] * along;
    }
  return sum;
}

}  // namespace holdfast::sim
