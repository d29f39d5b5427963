// SPDX-License-Identifier: Apache-2.0
#include "perception/matcher.hpp"

#include <algorithm>
#include <bit>
#include <cmath>

namespace holdfast::perception {
namespace {

constexpr int kNone = 257;  // beyond any distance of 256 bits

struct Best {
  int distance = kNone, runner_up = kNone, index = -1;

  void offer(int d, int i) noexcept {
    if (d < distance) {
      runner_up = distance;
      distance = d;
      index = i;
    } else if (d < runner_up) {
      runner_up = d;
    }
  }
  [[nodiscard]] bool is_distinct(const MatchParameters& p) const noexcept {
    return index >= 0 && distance <= p.distance_max && distance < p.ratio_max * runner_up;
  }
};

int hamming(const Descriptor& a, const Descriptor& b) noexcept {
  return std::popcount(a[0] ^ b[0]) + std::popcount(a[1] ^ b[1]) + std::popcount(a[2] ^ b[2]) +
         std::popcount(a[3] ^ b[3]);
}

std::vector<Match> mutual(const std::vector<Best>& rows, const std::vector<Best>& columns,
                          const MatchParameters& parameters) {
  std::vector<Match> matches;
  matches.reserve(rows.size());
  for (std::size_t i = 0; i < rows.size(); ++i) {
    if (!rows[i].is_distinct(parameters)) continue;
    const Best& back = columns[static_cast<std::size_t>(rows[i].index)];
    if (back.index == static_cast<int>(i) && back.is_distinct(parameters))
      matches.push_back({static_cast<int>(i), rows[i].index, rows[i].distance});
  }
  return matches;
}

/// The features of an image by square cells, so that those near a place are found quickly.
class CellIndex {
 public:
  CellIndex(const std::vector<cv::Point2f>& pixels, double cell_px) : cell_px_(cell_px) {
    for (const cv::Point2d p : pixels) {
      columns_ = std::max(columns_, cell_of(p.x) + 1);
      rows_ = std::max(rows_, cell_of(p.y) + 1);
    }
    starts_.assign(static_cast<std::size_t>(columns_) * static_cast<std::size_t>(rows_) + 1, 0);
    for (const cv::Point2d p : pixels) ++starts_[cell(p) + 1];
    for (std::size_t c = 1; c < starts_.size(); ++c) starts_[c] += starts_[c - 1];
    members_.assign(pixels.size(), 0);
    std::vector<int> next = starts_;
    for (std::size_t i = 0; i < pixels.size(); ++i)
      members_[static_cast<std::size_t>(next[cell(pixels[i])]++)] = static_cast<int>(i);
  }

  template <typename Visit>
  void visit_near(cv::Point2d place, double radius_px, Visit visit) const {
    const auto first = [&](double v) { return std::max(0, cell_of(v - radius_px)); };
    const auto last = [&](double v, int n) { return std::min(n - 1, cell_of(v + radius_px)); };
    for (int y = first(place.y); y <= last(place.y, rows_); ++y)
      for (int x = first(place.x); x <= last(place.x, columns_); ++x) {
        const int index = y * columns_ + x;
        const auto c = static_cast<std::size_t>(index);
        for (int k = starts_[c]; k < starts_[c + 1]; ++k)
          visit(members_[static_cast<std::size_t>(k)]);
      }
  }

 private:
  [[nodiscard]] int cell_of(double v) const {
    return static_cast<int>(std::clamp(std::floor(v / cell_px_), -1.0, 1e6));
  }
  [[nodiscard]] std::size_t cell(cv::Point2d p) const {
    const int index = cell_of(p.y) * columns_ + cell_of(p.x);
    return static_cast<std::size_t>(index);
  }
  double cell_px_;
  int columns_ = 1, rows_ = 1;
  std::vector<int> starts_, members_;
};

}  // namespace

std::vector<Match> match_all(const Features& first, const Features& second,
                             const MatchParameters& parameters) {
  std::vector<Best> rows(first.descriptors.size()), columns(second.descriptors.size());
  for (std::size_t i = 0; i < rows.size(); ++i) {
    const Descriptor descriptor = first.descriptors[i];
    Best best;
    for (std::size_t j = 0; j < columns.size(); ++j) {
      const int distance = hamming(descriptor, second.descriptors[j]);
      best.offer(distance, static_cast<int>(j));
      columns[j].offer(distance, static_cast<int>(i));
    }
    rows[i] = best;
  }
  return mutual(rows, columns, parameters);
}

std::vector<Match> match_near(const Features& first, const std::vector<cv::Point2d>& predicted,
                              const Features& second, const MatchParameters& parameters) {
  std::vector<Best> rows(first.descriptors.size()), columns(second.descriptors.size());
  const double radius = parameters.search_radius_px;
  const CellIndex index(second.pixels, std::max(8.0, radius / 2));
  for (std::size_t i = 0; i < rows.size(); ++i) {
    const cv::Point2d place = predicted[i];
    if (!std::isfinite(place.x) || !std::isfinite(place.y)) continue;
    index.visit_near(place, radius, [&](int j) {
      const auto k = static_cast<std::size_t>(j);
      const cv::Point2d away = cv::Point2d(second.pixels[k]) - place;
      if (away.dot(away) > radius * radius) return;
      const int distance = hamming(first.descriptors[i], second.descriptors[k]);
      rows[i].offer(distance, j);
      columns[k].offer(distance, static_cast<int>(i));
    });
  }
  return mutual(rows, columns, parameters);
}

}  // namespace holdfast::perception
