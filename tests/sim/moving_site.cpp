// SPDX-License-Identifier: Apache-2.0
#include "tests/sim/moving_site.hpp"

#include <algorithm>
#include <cmath>

namespace holdfast::sim {
namespace {

using std::chrono::nanoseconds;

constexpr double kHomeMmPerS = 2, kHomeRadPerS = 0.0873;

double home_duration_s(const SitePose& from) {
  return std::max(from.t_mm.norm() / kHomeMmPerS,
                  from.q.angularDistance(Eigen::Quaterniond::Identity()) / kHomeRadPerS);
}

nanoseconds from_seconds(double seconds) {
  return nanoseconds(std::llround(seconds * 1e9));
}

}  // namespace

MovingSite::MovingSite(const SceneParameters& scene, std::string_view program, double scale,
                       bool loop, nanoseconds t_start)
    : scene_(scene), scale_(scale), loop_(loop) {
  programs_.push_back(std::make_unique<Program>(
      Program{t_start, {}, 0, Trajectory(program, scale, loop, scene.depth_mm)}));
}

void MovingSite::set_program(std::string_view program, nanoseconds t) {
  Trajectory trajectory(program, scale_, loop_, scene_.parameters().depth_mm);
  const std::lock_guard lock(mutex_);
  const SitePose from = locked_pose_at(t);
  programs_.push_back(
      std::make_unique<Program>(Program{t, from, home_duration_s(from), std::move(trajectory)}));
}

const MovingSite::Program& MovingSite::program_at(nanoseconds t) const {
  std::size_t i = programs_.size() - 1;
  while (i > 0 && programs_[i]->t_start > t) --i;
  return *programs_[i];
}

SitePose MovingSite::locked_pose_at(nanoseconds t) const {
  const Program& program = program_at(t);
  const double since_s = std::chrono::duration<double>(t - program.t_start).count();
  if (since_s >= program.home_s)
    return program.trajectory.at(from_seconds(since_s - program.home_s));
  const double share = std::max(0.0, since_s / program.home_s);
  return {program.from.t_mm * (1 - share),
          program.from.q.slerp(share, Eigen::Quaterniond::Identity())};
}

SitePose MovingSite::pose_at(nanoseconds t) const {
  const std::lock_guard lock(mutex_);
  return locked_pose_at(t);
}

std::vector<MovingSite::Start> MovingSite::starts(nanoseconds from, nanoseconds to) const {
  const std::lock_guard lock(mutex_);
  std::vector<Start> found;
  for (std::size_t i = 0; i < programs_.size(); ++i) {
    const Program& program = *programs_[i];
    const nanoseconds until =
        i + 1 < programs_.size() ? std::min(to, programs_[i + 1]->t_start) : to;
    if (program.home_s > 0 && program.t_start >= from && program.t_start < until)
      found.push_back({program.t_start, "home"});
    const nanoseconds t_program = program.t_start + from_seconds(program.home_s);
    if (until <= t_program) continue;
    for (const auto& start : program.trajectory.starts(from - t_program, until - t_program))
      found.push_back({t_program + start.t, start.name});
  }
  return found;
}

cv::Size MovingSite::sensor_px() const noexcept {
  return {scene_.parameters().width_px, scene_.parameters().height_px};
}

void MovingSite::render(nanoseconds t_mid_exposure, const View& view, bridge::PixelFormat format,
                        const cv::Rect& region, std::uint8_t* pixels) {
  scene_.render(pose_at(t_mid_exposure), view, format, region, pixels);
}

}  // namespace holdfast::sim
