// SPDX-License-Identifier: Apache-2.0
#include "registration/ct/bit_cubes.hpp"

#include <algorithm>
#include <array>
#include <bit>
#include <cmath>
#include <cstdint>
#include <limits>
#include <vector>

#include <nmmintrin.h>
#include <vtkMarchingCubesTriangleCases.h>

#include "registration/worker_pool.hpp"
#include "rt/core/error.hpp"

namespace holdfast::registration {
namespace {

using Word = std::uint64_t;

/// Edges (numbered as in vtkMarchingCubes) of each case's triangles.
struct CubeCase {
  std::uint8_t count = 0;  // of triangles
  std::array<std::uint8_t, 15> edges{};
};

const std::array<CubeCase, 256>& cube_cases() {
  static const std::array<CubeCase, 256> cases = [] {
    std::array<CubeCase, 256> list;
    const vtkMarchingCubesTriangleCases* from = vtkMarchingCubesTriangleCases::GetCases();
    for (CubeCase& to : list) {
      std::size_t n = 0;
      for (; n < 15 && from->edges[n] >= 0; ++n)
        to.edges.at(n) = static_cast<std::uint8_t>(from->edges[n]);
      to.count = static_cast<std::uint8_t>(n / 3);
      ++from;
    }
    return list;
  }();
  return cases;
}

/// Bit b of the result: value b is more than `below`. 64 values.
Word bits_above(const std::int16_t* values, std::int16_t below) {
  const __m128i limit = _mm_set1_epi16(below);
  const auto* at = reinterpret_cast<const __m128i*>(values);
  Word word = 0;
  for (int i = 0; i < 4; ++i) {
    const __m128i low = _mm_cmpgt_epi16(_mm_loadu_si128(at + 2 * i), limit);
    const __m128i high = _mm_cmpgt_epi16(_mm_loadu_si128(at + 2 * i + 1), limit);
    const auto sixteen = static_cast<unsigned>(_mm_movemask_epi8(_mm_packs_epi16(low, high)));
    word |= static_cast<Word>(sixteen) << (16 * i);
  }
  return word;
}

/// Calls work(b) for every bit of the word, lowest first.
template <class Work>
void for_bits(Word word, const Work& work) {
  for (; word != 0; word &= word - 1) work(std::countr_zero(word));
}

/// How many of a row's edges along x, along y and along z cross the surface; later, the number of
/// the first vertex of each.
using RowVertices = std::array<std::uint32_t, 3>;

/// Four rows of voxels around a row of cells, by words; n: the same, one voxel on.
struct CellRow {
  std::array<Word, 4> m{}, n{};  // (j, k), (j+1, k), (j, k+1), (j+1, k+1)
  Word active = 0;               // cells that hold some surface
};

class BitCubes {
 public:
  BitCubes(const CtVolume& volume, const Eigen::AlignedBox<int, 3>& box, double iso_hu,
           bool is_turned, int threads)
      : volume_(volume),
        first_(box.min()),
        n_(box.sizes() + Eigen::Vector3i::Ones()),
        words_((static_cast<std::size_t>(n_.x()) + 63) / 64),
        iso_(static_cast<float>(iso_hu)),
        below_(static_cast<std::int16_t>(std::ceil(iso_hu) - 1)),
        is_turned_(is_turned),
        pool_(threads) {}

  TriangleMesh build() {
    bits_.resize(rows() * words_ + 1);
    vertices_.resize(rows());
    triangles_.resize(rows());
    pool_.run(n_.z(), [this](int k) { mark(k); });
    pool_.run(n_.z(), [this](int k) { count(k); });
    number();
    // Room for the triangles is written to before it is filled: one thread's work meanwhile.
    pool_.run(n_.z() + 1, [this](int task) {
      if (task == 0)
        mesh_.triangles.resize(triangle_count_);
      else
        place(task - 1);
    });
    pool_.run(n_.z() - 1, [this](int k) { connect(k); });
    return std::move(mesh_);
  }

 private:
  [[nodiscard]] std::size_t rows() const {
    return static_cast<std::size_t>(n_.y()) * static_cast<std::size_t>(n_.z());
  }
  [[nodiscard]] std::size_t row(int j, int k) const {
    return static_cast<std::size_t>(k) * static_cast<std::size_t>(n_.y()) +
           static_cast<std::size_t>(j);
  }
  [[nodiscard]] const Word* bits(int j, int k) const { return &bits_[row(j, k) * words_]; }
  [[nodiscard]] const std::int16_t* values(int j, int k) const {
    const auto columns = static_cast<std::size_t>(volume_.size[0]);
    const auto of_slice = static_cast<std::size_t>(volume_.size[1]);
    return volume_.hu.data() +
           (static_cast<std::size_t>(first_.z() + k) * of_slice +
            static_cast<std::size_t>(first_.y() + j)) *
               columns +
           static_cast<std::size_t>(first_.x());
  }
  /// Voxels of word w that have a next one in their row.
  [[nodiscard]] Word has_next(std::size_t w) const {
    const std::size_t left = last_voxel() - std::min(64 * w, last_voxel());
    return left >= 64 ? ~Word{0} : (Word{1} << left) - 1;
  }
  [[nodiscard]] std::size_t last_voxel() const { return static_cast<std::size_t>(n_.x()) - 1; }
  /// The word of the voxels one further along their row.
  [[nodiscard]] Word next(const Word* row_bits, std::size_t w) const {
    const Word carried = w + 1 < words_ ? row_bits[w + 1] << 63U : 0;
    return row_bits[w] >> 1U | carried;
  }

  void mark(int k) {
    for (int j = 0; j < n_.y(); ++j) {
      const std::int16_t* v = values(j, k);
      Word* to = &bits_[row(j, k) * words_];
      const std::size_t whole = static_cast<std::size_t>(n_.x()) / 64;
      for (std::size_t w = 0; w < whole; ++w) to[w] = bits_above(v + 64 * w, below_);
      if (whole == words_) continue;
      std::array<std::int16_t, 64> rest;
      rest.fill(std::numeric_limits<std::int16_t>::min());
      std::copy(v + 64 * whole, v + n_.x(), rest.begin());
      to[whole] = bits_above(rest.data(), below_);
    }
  }

  /// Words of the row's edges along x, y and z that cross the surface.
  [[nodiscard]] std::array<Word, 3> crossed(int j, int k, std::size_t w) const {
    const Word here = bits(j, k)[w];
    return {(here ^ next(bits(j, k), w)) & has_next(w),
            j + 1 < n_.y() ? here ^ bits(j + 1, k)[w] : 0,
            k + 1 < n_.z() ? here ^ bits(j, k + 1)[w] : 0};
  }

  [[nodiscard]] CellRow cells(int j, int k, std::size_t w) const {
    CellRow c;
    Word any = 0, all = ~Word{0};
    for (std::size_t i = 0; i < 4; ++i) {
      const Word* of_row = bits(j + static_cast<int>(i % 2), k + static_cast<int>(i / 2));
      c.m.at(i) = of_row[w];
      c.n.at(i) = next(of_row, w);
      any |= c.m[i] | c.n[i];
      all &= c.m[i] & c.n[i];
    }
    c.active = any & ~all & has_next(w);
    return c;
  }

  /// The corners of cell b that reach iso, one bit each in vtkMarchingCubes' order.
  [[nodiscard]] static std::size_t case_of(const CellRow& c, int b) {
    const auto at = [b](Word word) { return static_cast<std::size_t>(word >> b & 1U); };
    return at(c.m[0]) | at(c.n[0]) << 1U | at(c.n[1]) << 2U | at(c.m[1]) << 3U | at(c.m[2]) << 4U |
           at(c.n[2]) << 5U | at(c.n[3]) << 6U | at(c.m[3]) << 7U;
  }

  void count(int k) {
    for (int j = 0; j < n_.y(); ++j) {
      RowVertices found{};
      std::size_t triangles = 0;
      for (std::size_t w = 0; w < words_; ++w) {
        const std::array<Word, 3> edges = crossed(j, k, w);
        for (std::size_t axis = 0; axis < 3; ++axis)
          found.at(axis) += static_cast<std::uint32_t>(std::popcount(edges.at(axis)));
        if (j + 1 == n_.y() || k + 1 == n_.z()) continue;
        const CellRow c = cells(j, k, w);
        for_bits(c.active, [&](int b) { triangles += cases_[case_of(c, b)].count; });
      }
      vertices_[row(j, k)] = found;
      triangles_[row(j, k)] = triangles;
    }
  }

  /// From counts to the first number of each row.
  void number() {
    std::size_t vertices = 0, triangles = 0;
    for (std::size_t r = 0; r < rows(); ++r) {
      for (std::uint32_t& of_axis : vertices_[r]) {
        const std::size_t count = of_axis;
        of_axis = static_cast<std::uint32_t>(vertices);
        vertices += count;
      }
      const std::size_t count = triangles_[r];
      triangles_[r] = triangles;
      triangles += count;
    }
    if (vertices > std::numeric_limits<std::uint32_t>::max())
      throw RefusedError("the surface has more than 2^32 vertices: give an ROI");
    mesh_.vertices_mm.resize(vertices);
    triangle_count_ = triangles;
  }

  [[nodiscard]] float share(std::int16_t from, std::int16_t to) const {
    constexpr float kEnd = 1e-3F;
    const auto a = static_cast<float>(from), b = static_cast<float>(to);
    return std::clamp((iso_ - a) / (b - a), kEnd, 1 - kEnd);
  }

  [[nodiscard]] const Eigen::Vector3d& slice_origin_mm(int k) const {
    return volume_
        .slice_origin_mm[static_cast<std::size_t>(first_.z()) + static_cast<std::size_t>(k)];
  }

  void place(int k) {
    const Eigen::Vector3d& origin = slice_origin_mm(k);
    Eigen::Vector3d up = Eigen::Vector3d::Zero();
    if (k + 1 < n_.z()) up = slice_origin_mm(k + 1) - origin;
    const std::array<Eigen::Vector3f, 3> steps{volume_.column_step_mm.cast<float>(),
                                               volume_.row_step_mm.cast<float>(), up.cast<float>()};
    for (int j = 0; j < n_.y(); ++j) {
      const Eigen::Vector3f start =
          (origin + (first_.y() + j) * volume_.row_step_mm + first_.x() * volume_.column_step_mm)
              .cast<float>();
      const std::int16_t* here = values(j, k);
      const std::array<const std::int16_t*, 3> there{here + 1,
                                                     j + 1 < n_.y() ? values(j + 1, k) : here,
                                                     k + 1 < n_.z() ? values(j, k + 1) : here};
      RowVertices at = vertices_[row(j, k)];
      for (std::size_t w = 0; w < words_; ++w) {
        const std::array<Word, 3> edges = crossed(j, k, w);
        for (std::size_t axis = 0; axis < 3; ++axis)
          for_bits(edges.at(axis), [&](int b) {
            const std::size_t i = 64 * w + static_cast<std::size_t>(b);
            mesh_.vertices_mm[at.at(axis)++] = start + static_cast<float>(i) * steps[0] +
                                               share(here[i], there.at(axis)[i]) * steps.at(axis);
          });
      }
    }
  }

  void connect(int k) {
    for (int j = 0; j + 1 < n_.y(); ++j) {
      // Numbers of the first vertices of the four rows of edges along x, two along y, two along z.
      std::array<std::uint32_t, 8> start{
          vertices_[row(j, k)][0],         vertices_[row(j + 1, k)][0], vertices_[row(j, k + 1)][0],
          vertices_[row(j + 1, k + 1)][0], vertices_[row(j, k)][1],     vertices_[row(j, k + 1)][1],
          vertices_[row(j, k)][2],         vertices_[row(j + 1, k)][2]};
      std::array<std::uint32_t, 3>* to = mesh_.triangles.data() + triangles_[row(j, k)];
      for (std::size_t w = 0; w < words_; ++w) {
        const CellRow c = cells(j, k, w);
        const Word along = has_next(w);
        const std::array<Word, 8> edges{(c.m[0] ^ c.n[0]) & along, (c.m[1] ^ c.n[1]) & along,
                                        (c.m[2] ^ c.n[2]) & along, (c.m[3] ^ c.n[3]) & along,
                                        c.m[0] ^ c.m[1],           c.m[2] ^ c.m[3],
                                        c.m[0] ^ c.m[2],           c.m[1] ^ c.m[3]};
        for_bits(c.active, [&](int b) { to = add_triangles(case_of(c, b), b, start, edges, to); });
        for (std::size_t e = 0; e < 8; ++e)
          start.at(e) += static_cast<std::uint32_t>(std::popcount(edges.at(e)));
      }
    }
  }

  [[nodiscard]] std::array<std::uint32_t, 3>* add_triangles(
      std::size_t which, int b, const std::array<std::uint32_t, 8>& start,
      const std::array<Word, 8>& edges, std::array<std::uint32_t, 3>* to) const {
    const Word before = (Word{1} << b) - 1;
    std::array<std::uint32_t, 8> at, next_at;  // of the cell's own edge, and of the one beyond it
    for (std::size_t e = 0; e < 8; ++e) {
      at.at(e) = start.at(e) + static_cast<std::uint32_t>(std::popcount(edges.at(e) & before));
      next_at.at(e) = at.at(e) + static_cast<std::uint32_t>(edges.at(e) >> b & 1U);
    }
    const std::array<std::uint32_t, 12> vertex{at[0], next_at[4], at[1], at[4],
                                               at[2], next_at[5], at[3], at[5],
                                               at[6], next_at[6], at[7], next_at[7]};
    const CubeCase& cube = cases_[which];
    for (std::size_t t = 0; t < cube.count; ++t, ++to) {
      const std::uint32_t p = vertex[cube.edges[3 * t]], q = vertex[cube.edges[3 * t + 1]],
                          r = vertex[cube.edges[3 * t + 2]];
      *to = is_turned_ ? std::array{p, r, q} : std::array{p, q, r};
    }
    return to;
  }

  const std::array<CubeCase, 256>& cases_ = cube_cases();
  const CtVolume& volume_;
  Eigen::Vector3i first_, n_;
  std::size_t words_;
  float iso_;
  std::int16_t below_;
  bool is_turned_;
  WorkerPool pool_;
  std::vector<Word> bits_;              // by rows
  std::vector<RowVertices> vertices_;   // a row
  std::vector<std::size_t> triangles_;  // a row of cells
  std::size_t triangle_count_ = 0;
  TriangleMesh mesh_;
};

}  // namespace

TriangleMesh bit_cubes(const CtVolume& volume, const Eigen::AlignedBox<int, 3>& box, double iso_hu,
                       bool is_turned, int threads) {
  return BitCubes(volume, box, iso_hu, is_turned, threads).build();
}

}  // namespace holdfast::registration
