// SPDX-License-Identifier: Apache-2.0
#include "registration/evaluation.hpp"

#include <algorithm>
#include <cmath>
#include <limits>
#include <numeric>

#include <fmt/format.h>
#include <nanoflann.hpp>
#include <opencv2/imgproc.hpp>

#include "registration/point_sample.hpp"
#include "registration/triangle_tree.hpp"

namespace holdfast::registration {
namespace {

/// What nanoflann asks of a point set.
struct VertexCloud {
  const std::vector<Eigen::Vector3f>& vertices;
  [[nodiscard]] std::size_t kdtree_get_point_count() const { return vertices.size(); }
  [[nodiscard]] float kdtree_get_pt(std::size_t i, std::size_t axis) const {
    return vertices[i](static_cast<Eigen::Index>(axis));
  }
  template <class Box>
  bool kdtree_get_bbox(Box&) const {
    return false;
  }
};
using VertexTree =
    nanoflann::KDTreeSingleIndexAdaptor<nanoflann::L2_Simple_Adaptor<float, VertexCloud>,
                                        VertexCloud, 3>;

double percentile(const std::vector<double>& sorted, double share) {
  const double at = share * static_cast<double>(sorted.size() - 1);
  const auto low = static_cast<std::size_t>(at);
  const std::size_t high = std::min(low + 1, sorted.size() - 1);
  return sorted[low] + (at - static_cast<double>(low)) * (sorted[high] - sorted[low]);
}

std::vector<Eigen::Vector3d> points_in_region(const TriangleMesh& surface,
                                              const EvaluationOptions& options) {
  std::vector<Eigen::Vector3d> points;
  for (const Eigen::Vector3f& vertex : surface.vertices_mm) {
    const Eigen::Vector3d p = options.T_reference_surface * vertex.cast<double>();
    if (!options.region_mm || options.region_mm->contains(p)) points.push_back(p);
  }
  return points;
}

void draw_scale(cv::Mat& image, double scale_max_mm) {
  constexpr int kBar = 18, kMargin = 8, kText = 64;
  const int height = image.rows;
  cv::Mat bar(height, 1, CV_8UC1);
  for (int y = 0; y < height; ++y)
    bar.at<std::uint8_t>(y) =
        cv::saturate_cast<std::uint8_t>(255.0 * (height - 1 - y) / (height - 1));
  cv::applyColorMap(bar, bar, cv::COLORMAP_VIRIDIS);
  cv::Mat wide(height, image.cols + 2 * kMargin + kBar + kText, CV_8UC3, cv::Scalar::all(255));
  image.copyTo(wide(cv::Rect{0, 0, image.cols, height}));
  for (int x = 0; x < kBar; ++x) bar.copyTo(wide.col(image.cols + kMargin + x));
  const int x_text = image.cols + kMargin + kBar + 4;
  for (const double share : {0.0, 0.5, 1.0}) {
    const int y = std::clamp(static_cast<int>((1 - share) * height) + 4, 12, height - 4);
    cv::putText(wide, fmt::format("{:.2g} mm", share * scale_max_mm), {x_text, y},
                cv::FONT_HERSHEY_SIMPLEX, 0.38, cv::Scalar::all(30), 1, cv::LINE_AA);
  }
  image = wide;
}

}  // namespace

DistanceFigures distance_figures(std::vector<double> distances_mm) {
  DistanceFigures f;
  f.count = distances_mm.size();
  if (f.count == 0) {
    const double nan = std::numeric_limits<double>::quiet_NaN();
    f.mean_mm = f.sd_mm = f.rmse_mm = f.median_mm = f.p90_mm = f.p95_mm = f.p99_mm = f.max_mm =
        f.share_over_1_mm = nan;
    return f;
  }
  std::sort(distances_mm.begin(), distances_mm.end());
  const auto n = static_cast<double>(f.count);
  f.mean_mm = std::accumulate(distances_mm.begin(), distances_mm.end(), 0.0) / n;
  double squares = 0, deviations = 0;
  for (const double d : distances_mm) {
    squares += d * d;
    deviations += (d - f.mean_mm) * (d - f.mean_mm);
  }
  f.rmse_mm = std::sqrt(squares / n);
  f.sd_mm = f.count > 1 ? std::sqrt(deviations / (n - 1)) : 0;
  f.median_mm = percentile(distances_mm, 0.5);
  f.p90_mm = percentile(distances_mm, 0.9);
  f.p95_mm = percentile(distances_mm, 0.95);
  f.p99_mm = percentile(distances_mm, 0.99);
  f.max_mm = distances_mm.back();
  f.share_over_1_mm =
      static_cast<double>(distances_mm.end() -
                          std::upper_bound(distances_mm.begin(), distances_mm.end(), 1.0)) /
      n;
  return f;
}

struct ReferenceSurface::Trees {
  explicit Trees(const TriangleMesh& reference)
      : vertices_mm(reference.vertices_mm), triangles(reference) {}
  std::vector<Eigen::Vector3f> vertices_mm;
  VertexCloud cloud{vertices_mm};
  VertexTree vertices{3, cloud, nanoflann::KDTreeSingleIndexAdaptorParams{12}};
  TriangleTree triangles;
};

ReferenceSurface::ReferenceSurface(const TriangleMesh& reference)
    : trees_(std::make_unique<const Trees>(reference)) {}
ReferenceSurface::~ReferenceSurface() = default;

Evaluation evaluate_surface(const TriangleMesh& surface, const TriangleMesh& reference,
                            const EvaluationOptions& options) {
  return evaluate_surface(surface, ReferenceSurface(reference), options);
}

Evaluation evaluate_surface(const TriangleMesh& surface, const ReferenceSurface& reference,
                            const EvaluationOptions& options) {
  Evaluation evaluation;
  evaluation.p_reference_mm = points_in_region(surface, options);
  evaluation.points_in_region = evaluation.p_reference_mm.size();
  draw(evaluation.p_reference_mm, options.points, options.seed);

  const std::vector<Eigen::Vector3f>& vertices_mm = reference.trees_->vertices_mm;
  const VertexTree& vertices = reference.trees_->vertices;
  const TriangleTree& triangles = reference.trees_->triangles;
  std::vector<double> to_vertex, to_triangle;
  for (const Eigen::Vector3d& p : evaluation.p_reference_mm) {
    const Eigen::Vector3f q = p.cast<float>();
    unsigned nearest = 0;
    float squared = 0;
    if (vertices.knnSearch(q.data(), 1, &nearest, &squared) == 0) continue;
    to_vertex.push_back((p - vertices_mm[nearest].cast<double>()).norm());
    if (const ClosestPoint closest = triangles.closest(p); closest.is_found)
      to_triangle.push_back(closest.distance_mm);
  }
  evaluation.to_vertex = distance_figures(to_vertex);
  evaluation.to_triangle = distance_figures(to_triangle);
  evaluation.distance_mm = triangles.size() > 0 ? std::move(to_triangle) : std::move(to_vertex);
  return evaluation;
}

cv::Mat heat_map(const Evaluation& evaluation, double scale_max_mm) {
  constexpr int kLongerSidePx = 720;
  constexpr int kEmptyGrey = 225;
  Eigen::AlignedBox3d box;
  for (const Eigen::Vector3d& p : evaluation.p_reference_mm) box.extend(p);
  if (box.isEmpty() || evaluation.distance_mm.size() != evaluation.p_reference_mm.size()) return {};
  const Eigen::Vector3d size = box.sizes();
  const double px_per_mm = kLongerSidePx / std::max({size.x(), size.y(), 1e-3});
  // A dot is as wide as the drawn points lie apart on average, so that they just close the area.
  const double spacing_mm = std::sqrt(std::max(size.x() * size.y(), 1e-6) /
                                      static_cast<double>(evaluation.distance_mm.size()));
  const int radius_px =
      std::clamp(static_cast<int>(std::ceil(0.7 * spacing_mm * px_per_mm)), 1, 12);
  const int cols = static_cast<int>(size.x() * px_per_mm) + 2 * radius_px + 1;
  const int rows = std::max(static_cast<int>(size.y() * px_per_mm) + 2 * radius_px + 1, 120);

  cv::Mat value(rows, cols, CV_8UC1, cv::Scalar::all(0));
  cv::Mat is_known(rows, cols, CV_8UC1, cv::Scalar::all(0));
  for (std::size_t i = 0; i < evaluation.distance_mm.size(); ++i) {
    const Eigen::Vector3d at = (evaluation.p_reference_mm[i] - box.min()) * px_per_mm;
    const cv::Point centre{static_cast<int>(at.x()) + radius_px,
                           static_cast<int>(at.y()) + radius_px};
    const double level = 255 * std::min(evaluation.distance_mm[i] / scale_max_mm, 1.0);
    cv::circle(value, centre, radius_px, cv::Scalar::all(level), cv::FILLED);
    cv::circle(is_known, centre, radius_px, cv::Scalar::all(255), cv::FILLED);
  }
  cv::Mat image;
  cv::applyColorMap(value, image, cv::COLORMAP_VIRIDIS);
  image.setTo(cv::Scalar::all(kEmptyGrey), is_known == 0);
  draw_scale(image, scale_max_mm);
  return image;
}

}  // namespace holdfast::registration
