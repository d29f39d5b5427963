// SPDX-License-Identifier: Apache-2.0
#include "registration/ct/bead_search.hpp"

#include <algorithm>
#include <cmath>
#include <numbers>
#include <tuple>

#include <fmt/format.h>

#include "rt/core/error.hpp"

namespace holdfast::registration {
namespace {

// Bright pieces are looked for at each of these levels: a bead of glass in air, of metal in bone.
constexpr std::array<int, 5> kLevelsHu = {2600, 2000, 1500, 1000, 500};
constexpr std::size_t kCandidatesMax = 256, kListedMax = 6;
constexpr double kContrastMinHu = 400, kResidualMax = 0.06, kSphericityMin = 0.35;
constexpr double kContrastShareMin = 0.5;  // of the beads' median: beads are alike

struct Piece {
  std::size_t voxels = 0;
  Eigen::Vector3d mean_index = Eigen::Vector3d::Zero();
  Eigen::AlignedBox3i box;
};

class Pieces {
 public:
  explicit Pieces(const CtVolume& volume) : volume_(volume), is_seen_(volume.hu.size()) {}

  /// The connected pieces (faces) of voxels at least `level_hu`, up to `voxels_max` each.
  std::vector<Piece> at(int level_hu, std::size_t voxels_max) {
    std::fill(is_seen_.begin(), is_seen_.end(), false);
    std::vector<Piece> found;
    for (std::size_t at = 0; at < volume_.hu.size(); ++at) {
      if (volume_.hu[at] < level_hu || is_seen_[at]) continue;
      const Piece piece = grow(at, level_hu);
      if (piece.voxels <= voxels_max) found.push_back(piece);
    }
    return found;
  }

 private:
  Piece grow(std::size_t start, int level_hu) {
    const auto columns = static_cast<std::size_t>(volume_.size[0]);
    const std::size_t slice = columns * static_cast<std::size_t>(volume_.size[1]);
    Piece piece;
    stack_.assign(1, start);
    is_seen_[start] = true;
    while (!stack_.empty()) {
      const std::size_t at = stack_.back();
      stack_.pop_back();
      const std::array<int, 3> index = {static_cast<int>(at % columns),
                                        static_cast<int>(at % slice / columns),
                                        static_cast<int>(at / slice)};
      const Eigen::Vector3i here(index[0], index[1], index[2]);
      ++piece.voxels;
      piece.mean_index += here.cast<double>();
      piece.box.extend(here);
      const std::array<std::size_t, 3> stride = {1, columns, slice};
      for (std::size_t axis = 0; axis < 3; ++axis) {
        if (index[axis] > 0) visit(at - stride[axis], level_hu);
        if (index[axis] + 1 < volume_.size[axis]) visit(at + stride[axis], level_hu);
      }
    }
    piece.mean_index /= static_cast<double>(piece.voxels);
    return piece;
  }
  void visit(std::size_t at, int level_hu) {
    if (is_seen_[at] || volume_.hu[at] < level_hu) return;
    is_seen_[at] = true;
    stack_.push_back(at);
  }

  const CtVolume& volume_;
  std::vector<bool> is_seen_;
  std::vector<std::size_t> stack_;
};

/// Centres of all pieces that could be a bead by size alone; each place once.
std::vector<Eigen::Vector3d> candidates(const CtVolume& volume, double diameter_mm) {
  const Eigen::Matrix3d steps = volume.ct_from_index().linear();
  const double voxel_mm3 = std::abs(steps.determinant());
  const double ball_mm3 = std::numbers::pi / 6 * std::pow(diameter_mm, 3);
  // Blur and clipping widen a bead to at most about twice its diameter.
  const auto most = static_cast<std::size_t>(8 * ball_mm3 / voxel_mm3) + 8;
  const double least = 0.1 * ball_mm3 / voxel_mm3;
  std::vector<Eigen::Vector3d> places;
  Pieces pieces(volume);
  for (const int level : kLevelsHu)
    for (const Piece& piece : pieces.at(level, most)) {
      const Eigen::Vector3d extent_mm =
          (piece.box.sizes().cast<double>().array() * steps.colwise().norm().transpose().array());
      const Eigen::Vector3d place = volume.point_at(piece.mean_index);
      const bool is_known = std::any_of(places.begin(), places.end(), [&](const auto& other) {
        return (other - place).norm() < diameter_mm;
      });
      if (is_known || static_cast<double>(piece.voxels) < std::max(least, 2.0) ||
          extent_mm.maxCoeff() > 2.5 * diameter_mm)
        continue;
      places.push_back(place);
      if (places.size() > kCandidatesMax)
        throw RefusedError(fmt::format(
            "more than {} bright pieces of about {} mm: this is no scan in which beads stand out",
            kCandidatesMax, diameter_mm));
    }
  return places;
}

/// Why a fit is no bead; empty when it is one.
std::string fault_of(const BeadFit& fit, const Eigen::Vector3d& place, double diameter_mm) {
  if (!fit.has_converged) return "no ball fits";
  if ((fit.p_ct_mm - place).norm() > diameter_mm / 2) return "the ball that fits lies elsewhere";
  if (fit.contrast_hu < kContrastMinHu)
    return fmt::format("contrast {:.0f} HU, must be {:.0f} HU", fit.contrast_hu, kContrastMinHu);
  if (fit.sphericity < kSphericityMin)
    return fmt::format("sphericity {:.2f}, must be {:.2f}", fit.sphericity, kSphericityMin);
  if (fit.residual_share > kResidualMax)
    return fmt::format("residual {:.1f} % of the contrast, at most {:.0f} %: size or shape differ",
                       100 * fit.residual_share, 100 * kResidualMax);
  if (fit.blur_mm > 0.75 * diameter_mm || fit.elongation > 1.6 || fit.elongation < 0.6)
    return fmt::format("blur {:.2f} mm, elongation {:.2f}: not of a bead's size", fit.blur_mm,
                       fit.elongation);
  return {};
}

void reject_unlike(BeadSearch& search) {
  if (search.beads.size() < 3) return;
  std::vector<double> contrast;
  for (const BeadFit& bead : search.beads) contrast.push_back(bead.contrast_hu);
  const auto middle = contrast.begin() + static_cast<std::ptrdiff_t>(contrast.size() / 2);
  std::nth_element(contrast.begin(), middle, contrast.end());
  const double least = kContrastShareMin * *middle;
  for (const BeadFit& bead : search.beads)
    if (bead.contrast_hu < least)
      search.rejected.push_back(
          {bead.p_ct_mm, fmt::format("contrast {:.0f} HU, the other beads have {:.0f} HU",
                                     bead.contrast_hu, *middle)});
  std::erase_if(search.beads, [&](const BeadFit& bead) { return bead.contrast_hu < least; });
}

std::string at(const Eigen::Vector3d& p) {
  return fmt::format("({:.2f}, {:.2f}, {:.2f})", p.x(), p.y(), p.z());
}

}  // namespace

BeadSearch find_beads(const CtVolume& volume, double diameter_mm) {
  if (!(diameter_mm >= 0.5 && diameter_mm <= 10))
    throw InputError(fmt::format("--diameter-mm {}, must be 0.5 to 10 mm", diameter_mm));
  const double voxel_mm = volume.ct_from_index().linear().colwise().norm().maxCoeff();
  if (voxel_mm > diameter_mm)
    throw RefusedError(fmt::format("voxels of {:.2f} mm are too coarse for beads of {} mm",
                                   voxel_mm, diameter_mm));
  // The scanner's upper limit shows as a plateau at the highest value there is.
  const int highest = *std::max_element(volume.hu.begin(), volume.hu.end());
  const auto at_highest = std::count(volume.hu.begin(), volume.hu.end(), highest);
  const int limit = at_highest >= 4 ? highest : 40'000;
  BeadSearch search;
  for (const Eigen::Vector3d& place : candidates(volume, diameter_mm)) {
    const BeadFit fit = fit_bead(volume, place, diameter_mm, limit);
    const std::string fault = fault_of(fit, place, diameter_mm);
    if (fault.empty())
      search.beads.push_back(fit);
    else
      search.rejected.push_back({place, fault});
  }
  reject_unlike(search);
  std::sort(search.beads.begin(), search.beads.end(), [](const BeadFit& a, const BeadFit& b) {
    return std::lexicographical_compare(a.p_ct_mm.data(), a.p_ct_mm.data() + 3, b.p_ct_mm.data(),
                                        b.p_ct_mm.data() + 3);
  });
  return search;
}

std::vector<MarkupPoint> bead_points(const BeadSearch& search, std::optional<int> expected) {
  const auto found = search.beads.size();
  if (found == 0 || (expected && found != static_cast<std::size_t>(*expected))) {
    std::string text = fmt::format("found {} bead(s)", found);
    if (expected) text += fmt::format(", expected {}", *expected);
    for (std::size_t k = 0; k < std::min(found, kListedMax); ++k)
      text += (k == 0 ? ": " : ", ") + at(search.beads[k].p_ct_mm);
    for (std::size_t k = 0; k < std::min(search.rejected.size(), kListedMax); ++k)
      text += fmt::format("; no bead at {}: {}", at(search.rejected[k].p_ct_mm),
                          search.rejected[k].reason);
    throw RefusedError(text);
  }
  std::vector<MarkupPoint> points;
  for (const BeadFit& bead : search.beads) {
    MarkupPoint point;
    point.label = fmt::format("bead-{}", points.size() + 1);
    point.position_mm = bead.p_ct_mm;
    point.covariance_mm2 = bead.covariance_mm2;
    point.description = fmt::format("contrast {:.0f} HU{}, sphericity {:.2f}, residual {:.1f} %",
                                    bead.contrast_hu, bead.is_clipped ? " (clipped)" : "",
                                    bead.sphericity, 100 * bead.residual_share);
    points.push_back(std::move(point));
  }
  return points;
}

}  // namespace holdfast::registration
