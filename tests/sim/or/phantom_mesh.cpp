// SPDX-License-Identifier: Apache-2.0
#include "tests/sim/or/phantom_mesh.hpp"

#include <algorithm>
#include <atomic>
#include <cmath>
#include <thread>

#include "tests/sim/or/phantom_random.hpp"

namespace holdfast::sim {
namespace {

using Eigen::Vector3f;
using Eigen::Vector3i;

constexpr int kLayer = 8;          // cells; the work is shared out in layers so high
constexpr float kSteepest = 1.5F;  // how fast a distance may change, a mm

// Surface nets (Gibson 1998): one vertex in every cell that the surface passes, one quadrilateral
// about every cell edge that it crosses.
struct Layer {
  std::vector<std::uint64_t> cells;  // rising; of the vertices
  std::vector<Vector3f> vertices, normals;
  std::vector<std::array<std::uint64_t, 4>> quads;  // cell numbers
};

class SurfaceNet {
 public:
  SurfaceNet(const ScalarField& field, const Eigen::AlignedBox3f& bounds, float spacing,
             bool is_distance)
      : field_(field),
        origin_(bounds.min()),
        spacing_(spacing),
        reach_(kSteepest * spacing),
        is_distance_(is_distance) {
    const Vector3f cells = (bounds.sizes() / spacing).array().ceil();
    cells_ = cells.cast<int>();
    cells_.z() = (cells_.z() + kLayer - 1) / kLayer * kLayer;
  }

  [[nodiscard]] int layers() const { return cells_.z() / kLayer; }

  [[nodiscard]] Layer make_layer(int index) const {
    const std::vector<float> values = sample(index * kLayer);
    Layer layer;
    for (int k = 0; k < kLayer; ++k)
      for (int j = 0; j < cells_.y(); ++j)
        for (int i = 0; i < cells_.x(); ++i)
          if (is_crossed(values, {i, j, k})) add_cell(layer, values, {i, j, k}, index * kLayer);
    return layer;
  }

 private:
  [[nodiscard]] Vector3f position(const Vector3f& corner) const {
    return origin_ + spacing_ * corner;
  }
  [[nodiscard]] std::size_t at(const Vector3i& c) const {
    return (static_cast<std::size_t>(c.z()) * static_cast<std::size_t>(cells_.y() + 1) +
            static_cast<std::size_t>(c.y())) *
               static_cast<std::size_t>(cells_.x() + 1) +
           static_cast<std::size_t>(c.x());
  }
  [[nodiscard]] std::uint64_t number(int i, int j, int k) const {
    return (static_cast<std::uint64_t>(k) * static_cast<std::uint64_t>(cells_.y()) +
            static_cast<std::uint64_t>(j)) *
               static_cast<std::uint64_t>(cells_.x()) +
           static_cast<std::uint64_t>(i);
  }

  // The field at the corners of one layer of cells. Of a distance, a value so large that the
  // surface cannot come within a cell of the next corners of the row stands for theirs, too.
  [[nodiscard]] std::vector<float> sample(int k0) const {
    std::vector<float> values(at({0, 0, kLayer + 1}), 0.F);
    for (int k = 0; k <= kLayer; ++k)
      for (int j = 0; j <= cells_.y(); ++j)
        for (int i = 0; i <= cells_.x();) {
          const float value = field_(position(Vector3i(i, j, k0 + k).cast<float>()));
          const int reach = is_distance_ ? static_cast<int>(std::abs(value) / reach_) : 1;
          const int end = std::min(i + std::max(reach, 1), cells_.x() + 1);
          for (; i < end; ++i) values[at({i, j, k})] = value;
        }
    return values;
  }

  // True if the cell's corners are not all on one side.
  [[nodiscard]] bool is_crossed(const std::vector<float>& values, const Vector3i& c) const {
    const float* corner = &values[at(c)];
    const std::size_t row = static_cast<std::size_t>(cells_.x()) + 1;
    const std::size_t plane = row * (static_cast<std::size_t>(cells_.y()) + 1);
    int inside = 0;
    for (const std::size_t first : {std::size_t{0}, row, plane, plane + row})
      inside += (corner[first] < 0.F ? 1 : 0) + (corner[first + 1] < 0.F ? 1 : 0);
    return inside != 0 && inside != 8;
  }

  void add_cell(Layer& layer, const std::vector<float>& values, const Vector3i& c, int k0) const {
    Vector3f sum = Vector3f::Zero();
    int crossings = 0;
    for (int axis = 0; axis < 3; ++axis)
      for (int corner = 0; corner < 4; ++corner) {
        Vector3i a = c;
        a[(axis + 1) % 3] += corner & 1;
        a[(axis + 2) % 3] += corner >> 1;
        Vector3i b = a;
        b[axis] += 1;
        const float va = values[at(a)];
        const float vb = values[at(b)];
        if ((va < 0.F) == (vb < 0.F)) continue;
        sum += a.cast<float>();
        sum[axis] += va / (va - vb);
        ++crossings;
        if (corner == 0) add_quad(layer, c, k0, axis, va < 0.F);
      }
    Vector3f corner = sum / static_cast<float>(crossings);
    corner.z() += static_cast<float>(k0);
    add_vertex(layer, number(c.x(), c.y(), k0 + c.z()), position(corner));
  }

  // The four cells about the edge that starts at the cell's first corner and runs along `axis`.
  void add_quad(Layer& layer, const Vector3i& c, int k0, int axis, bool is_start_inside) const {
    const Vector3i cell{c.x(), c.y(), c.z() + k0};
    const int u = (axis + 1) % 3;
    const int v = (axis + 2) % 3;
    if (cell[u] == 0 || cell[v] == 0) return;
    std::array<std::uint64_t, 4> quad{};
    for (std::size_t n = 0; n < 4; ++n) {
      Vector3i q = cell;
      q[u] -= n == 0 || n == 3 ? 1 : 0;
      q[v] -= n < 2 ? 1 : 0;
      quad[n] = number(q.x(), q.y(), q.z());
    }
    if (!is_start_inside) std::swap(quad[1], quad[3]);
    layer.quads.push_back(quad);
  }

  // Newton's steps along the gradient; a vertex never leaves the neighbourhood of its cell.
  void add_vertex(Layer& layer, std::uint64_t cell, Vector3f p) const {
    const Vector3f start = p;
    const Vector3f g = field_gradient(field_, p);
    for (int step = 0; step < 4; ++step) {
      const float value = field_(p);
      if (std::abs(value) < 1e-4F * g.norm()) break;
      const Vector3f next = p - g * (value / std::max(g.squaredNorm(), 1e-12F));
      if ((next - start).norm() > spacing_) break;
      p = next;
    }
    layer.cells.push_back(cell);
    layer.vertices.push_back(p);
    layer.normals.push_back(field_gradient(field_, p).normalized());
  }

  const ScalarField& field_;
  Vector3f origin_;
  float spacing_, reach_;
  bool is_distance_;
  Vector3i cells_;
};

LitSurface join(std::vector<Layer>& layers) {
  LitSurface surface;
  std::vector<std::uint64_t> cells;
  for (const Layer& layer : layers) {
    cells.insert(cells.end(), layer.cells.begin(), layer.cells.end());
    surface.vertices_mm.insert(surface.vertices_mm.end(), layer.vertices.begin(),
                               layer.vertices.end());
    surface.normals.insert(surface.normals.end(), layer.normals.begin(), layer.normals.end());
  }
  for (const Layer& layer : layers)
    for (const auto& quad : layer.quads) {
      std::array<std::uint32_t, 4> v{};
      for (std::size_t n = 0; n < 4; ++n)
        v[n] = static_cast<std::uint32_t>(std::lower_bound(cells.begin(), cells.end(), quad[n]) -
                                          cells.begin());
      const auto& p = surface.vertices_mm;
      const bool is_02_shorter =
          (p[v[0]] - p[v[2]]).squaredNorm() < (p[v[1]] - p[v[3]]).squaredNorm();
      surface.triangles.push_back(is_02_shorter ? std::array{v[0], v[1], v[2]}
                                                : std::array{v[0], v[1], v[3]});
      surface.triangles.push_back(is_02_shorter ? std::array{v[0], v[2], v[3]}
                                                : std::array{v[1], v[2], v[3]});
    }
  return surface;
}

}  // namespace

Vector3f field_gradient(const ScalarField& field, const Vector3f& p, float step_mm) {
  Vector3f sum = Vector3f::Zero();
  for (const Vector3f& corner :
       {Vector3f(1, 1, 1), Vector3f(1, -1, -1), Vector3f(-1, 1, -1), Vector3f(-1, -1, 1)})
    sum += corner * field(p + step_mm * corner);
  return sum / (4.F * step_mm);
}

LitSurface polygonise(const ScalarField& field, const Eigen::AlignedBox3f& box, float spacing_mm,
                      bool is_distance) {
  const SurfaceNet net(field, box, spacing_mm, is_distance);
  std::vector<Layer> layers(static_cast<std::size_t>(net.layers()));
  std::atomic<int> next{0};
  const auto work = [&] {
    for (int i = next++; i < net.layers(); i = next++)
      layers[static_cast<std::size_t>(i)] = net.make_layer(i);
  };
  std::vector<std::jthread> threads;
  for (unsigned i = 1; i < std::max(1U, std::thread::hardware_concurrency()); ++i)
    threads.emplace_back(work);
  work();
  threads.clear();
  return join(layers);
}

void add_relief(LitSurface& surface, const ScalarField& relief_mm) {
  for (std::size_t i = 0; i < surface.vertices_mm.size(); ++i) {
    Vector3f& p = surface.vertices_mm[i];
    Vector3f& n = surface.normals[i];
    const Vector3f slope = field_gradient(relief_mm, p);
    p += relief_mm(p) * n;
    n = (n - (slope - n * n.dot(slope))).normalized();
  }
}

ScalarField fine_relief(float sigma_um, float width_mm, std::uint32_t seed) {
  return [amplitude = 3.5e-3F * sigma_um, width_mm, seed](const Vector3f& p) {
    return amplitude *
           (smooth_noise(p / width_mm, seed) + 0.5F * smooth_noise(3.F * p / width_mm, seed + 1));
  };
}

void transform(LitSurface& surface, const Eigen::Isometry3d& T_to_from) {
  for (Vector3f& p : surface.vertices_mm) p = (T_to_from * p.cast<double>()).cast<float>();
  for (Vector3f& n : surface.normals) n = (T_to_from.linear() * n.cast<double>()).cast<float>();
}

}  // namespace holdfast::sim
