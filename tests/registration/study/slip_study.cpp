// SPDX-License-Identifier: Apache-2.0
#include "tests/registration/study/slip_study.hpp"

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <cstdio>
#include <span>

#include <fmt/format.h>

#include "registration/reconstruction.hpp"
#include "tests/registration/support/stereo_rig.hpp"

namespace holdfast::test {
namespace {

/// One random pose over one random relief with dots of random size, turn and place.
StereoRig random_rig(std::uint32_t seed, bool is_lattice) {
  cv::RNG random(seed);
  StereoRig rig;
  rig.image_px = {400, 320};
  rig.focal_px = 4000;
  rig.is_lattice = is_lattice;
  rig.seed = seed;
  rig.dot_pitch_mm = random.uniform(0.5, 1.6);
  rig.dot_radius_mm = rig.dot_pitch_mm * random.uniform(0.2, 0.38);
  rig.dots_turn_rad = random.uniform(-0.3, 0.3);
  rig.dots_shift_mm = random.uniform(0.0, 2.0);
  rig.relief_mm = random.uniform(0.5, 4.0);
  rig.distance_mm = random.uniform(190.0, 210.0);
  rig.contrast_grey = random.uniform(60.0, 150.0);
  rig.texture_grey = random.uniform(0.0, 8.0);
  rig.noise_grey = random.uniform(0.5, 3.0);
  return rig;
}

struct Handed {
  registration::ReconstructionStatus status;
  double wrong = 0;  // share of the points further than 2 mm away
};

/// With the parameters of the microscope's images, though this one is smaller.
Handed reconstructed(const StereoRig& rig, const registration::StereoShot& shot, bool has_check) {
  constexpr double kWrongMm = 2;
  registration::ReconstructionOptions options;
  options.match = registration::match_parameters_for({2456, 2054});
  if (!has_check) options.match->repetition.correlation_min = 2;  // never reached
  options.may_be_lattice = !has_check;
  registration::Reconstructor reconstructor(rig.calibration(), rig.image_px, options);
  const registration::Reconstruction result = reconstructor.reconstruct(std::span(&shot, 1));
  double wrong = 0, known = 0;
  for (int y = 0; y < result.depth_mm.rows; y += 3)
    for (int x = 0; x < result.depth_mm.cols; x += 3) {
      const auto z = static_cast<double>(result.depth_mm(y, x));
      if (std::isnan(z)) continue;
      ++known;
      const double truth = rig.true_depth_mm(reconstructor.rectification(), result.region_px.x + x,
                                             result.region_px.y + y);
      wrong += std::abs(z - truth) > kWrongMm ? 1 : 0;
    }
  return {result.status, known > 0 ? wrong / known : 0};
}

struct Count {
  int poses = 0, refused = 0, refused_for_slip = 0, slipped = 0, undetected = 0;
  double worst = 0;

  void print(bool is_lattice) const {
    fmt::print(
        "{}: {} poses: {} slip without the check, {} with it (at most {:.2f} % of the points); {} "
        "refused, {} of them as repeating\n",
        is_lattice ? "lattice" : "aperiodic", poses, slipped, undetected, 100 * worst, refused,
        refused_for_slip);
    std::fflush(stdout);
  }
};

}  // namespace

void study_slips(int first, int poses, bool is_lattice) {
  constexpr double kSlip = 0.005;
  constexpr int kPosesPerLine = 50;
  Count count;
  for (int i = first; i < first + poses; ++i) {
    const StereoRig rig = random_rig(static_cast<std::uint32_t>(i), is_lattice);
    const registration::StereoShot shot{rig.left(), rig.right()};
    const Handed handed = reconstructed(rig, shot, true);
    ++count.poses;
    count.refused += handed.status != registration::ReconstructionStatus::done ? 1 : 0;
    count.refused_for_slip += handed.status == registration::ReconstructionStatus::period_slip ||
                                      handed.status == registration::ReconstructionStatus::lattice
                                  ? 1
                                  : 0;
    count.undetected += handed.wrong > kSlip ? 1 : 0;
    count.worst = std::max(count.worst, handed.wrong);
    count.slipped += reconstructed(rig, shot, false).wrong > kSlip ? 1 : 0;
    if (count.poses % kPosesPerLine == 0 || count.poses == poses) count.print(is_lattice);
  }
}

}  // namespace holdfast::test
