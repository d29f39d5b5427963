// SPDX-License-Identifier: Apache-2.0
// Is the stated error of a registration true? Many registrations whose truth is known, and how
// often it lies in the predicted 95 % region.
#include <algorithm>
#include <atomic>
#include <cmath>
#include <cstdio>
#include <filesystem>
#include <optional>
#include <string>
#include <thread>
#include <vector>

#include <CLI/CLI.hpp>
#include <Eigen/Cholesky>
#include <boost/math/distributions/beta.hpp>
#include <fmt/format.h>
#include <nlohmann/json.hpp>
#include <opencv2/core.hpp>
#include <unistd.h>

#include "bridge/command_line.hpp"
#include "registration/ct_registration.hpp"
#include "rt/core/error.hpp"
#include "tests/registration/tre/drawn_registration.hpp"
#include "tests/registration/tre/rendered_registration.hpp"

namespace {

using namespace holdfast;

struct Options {
  std::uint32_t count = 1000, seed = 1;
  int pairs = 19, threads = 2;
  std::string rendered;
};

/// One target depth over all registrations.
struct Coverage {
  std::vector<double> error_mm;
  int inside = 0;
  double squared_sigmas = 0, predicted_mm2 = 0;

  void add(const registration::Registration& r, const Eigen::Isometry3d& truth,
           const Eigen::Vector3d& p_ct) {
    const Eigen::Vector3d e = r.T_camera_ct * p_ct - truth * p_ct;
    const Eigen::Matrix3d covariance =
        registration::target_covariance(r.T_camera_ct, r.covariance, p_ct);
    const double squared = e.dot(covariance.ldlt().solve(e));
    constexpr double kChiSquared95 = 7.815;
    inside += squared <= kChiSquared95 ? 1 : 0;
    squared_sigmas += squared;
    predicted_mm2 += covariance.trace();
    error_mm.push_back(e.norm());
  }
};

nlohmann::ordered_json as_json(const Coverage& c) {
  const auto n = static_cast<double>(c.error_mm.size());
  double sum = 0, squares = 0;
  for (const double e : c.error_mm) {
    sum += e;
    squares += e * e;
  }
  const double mean = sum / n, sd = std::sqrt(std::max(0.0, squares / n - mean * mean));
  namespace math = boost::math;
  const double k = c.inside;
  // Clopper and Pearson's interval.
  const double low = k > 0 ? math::quantile(math::beta_distribution<>{k, n - k + 1}, 0.025) : 0;
  const double high = k < n ? math::quantile(math::beta_distribution<>{k + 1, n - k}, 0.975) : 1;
  return {{"registrations", c.error_mm.size()},
          {"in_95_share", k / n},
          {"in_95_interval", {low, high}},
          {"squared_sigmas", c.squared_sigmas / n},
          {"rms_mm", std::sqrt(squares / n)},
          {"predicted_rms_mm", std::sqrt(c.predicted_mm2 / n)},
          {"mean_plus_3_sd_mm", mean + 3 * sd},
          {"max_mm", *std::max_element(c.error_mm.begin(), c.error_mm.end())}};
}

/// One set-up: what was registered, and the truth; or why it was refused.
struct Trial {
  std::optional<registration::Registration> fiducials, fused;
  Eigen::Isometry3d T_camera_ct, T_ct_head;
  double focus_mm = 0;
  std::string refusal, fusion_refusal;
};

registration::Registration registered(const registration::RegistrationInput& input) {
  const auto result = registration::register_ct(input);
  if (result.status != registration::RegistrationStatus::registered)
    throw RefusedError(result.reason);
  return result.registration;
}

Trial drawn_trial(const Options& options, std::uint32_t seed) {
  registration::test::DrawnRig rig;
  rig.seed = seed;
  rig.zoom = 1.1 + 0.1 * ((seed + 4) % 5);
  rig.pairs = options.pairs;
  const sim::Phantom phantom = sim::make_ear_phantom(1000 + seed, sim::PhantomParts::scan_only);
  const auto drawn = registration::test::draw_measurement(rig, phantom);
  registration::RegistrationInput input;
  input.fixed = drawn.beads;
  input.moving = registration::markups_of(drawn.markers);
  return {registered(input), {}, drawn.T_camera_ct, drawn.T_ct_head, drawn.optics.focus_mm, {}, {}};
}

Trial rendered_trial(const Options& options, std::uint32_t seed) {
  registration::test::RenderedRig rig;
  rig.seed = seed;
  rig.pairs = options.pairs;
  auto rendered = registration::test::render_measurement(
      rig, std::filesystem::path(options.rendered) / fmt::format("s{}", seed));
  Trial trial{{}, {}, rendered.T_camera_ct, rendered.T_ct_head, rendered.focus_mm, {}, {}};
  registration::RegistrationInput fiducials = rendered.input;
  fiducials.fixed_surface.reset();
  fiducials.moving_surface.reset();
  trial.fiducials = registered(fiducials);
  rendered.input.is_refined = true;
  try {
    trial.fused = registered(rendered.input);
  } catch (const RefusedError& e) {
    trial.fusion_refusal = e.what();
  }
  return trial;
}

std::vector<Trial> all_trials(const Options& options) {
  std::vector<Trial> trials(options.count);
  std::atomic<std::uint32_t> next{0};
  const auto work = [&] {
    for (std::uint32_t i = next++; i < options.count; i = next++) {
      const std::uint32_t seed = options.seed + i;
      try {
        trials[i] =
            options.rendered.empty() ? drawn_trial(options, seed) : rendered_trial(options, seed);
      } catch (const RefusedError& e) {
        trials[i].refusal = e.what();
      }
      if (isatty(STDERR_FILENO) == 1) fmt::print(stderr, "\r{}/{}", i + 1, options.count);
    }
  };
  std::vector<std::thread> workers;
  for (int t = 0; t < options.threads; ++t) workers.emplace_back(work);
  for (std::thread& worker : workers) worker.join();
  return trials;
}

/// Straight below the microscope: in the focal plane, and deeper.
struct Depths {
  Coverage site, deep;
  void add(const registration::Registration& r, const Trial& trial) {
    constexpr double kDeepMm = 15;
    site.add(r, trial.T_camera_ct, trial.T_ct_head * Eigen::Vector3d(0, 0, trial.focus_mm));
    deep.add(r, trial.T_camera_ct,
             trial.T_ct_head * Eigen::Vector3d(0, 0, trial.focus_mm + kDeepMm));
  }
};

nlohmann::ordered_json as_json(const Depths& d) {
  if (d.site.error_mm.empty()) return nullptr;
  return {{"site", as_json(d.site)}, {"deep", as_json(d.deep)}};
}

void run(const Options& options) {
  cv::setNumThreads(1);
  Depths fiducials, fused;
  nlohmann::ordered_json json{{"count", options.count}, {"pairs", options.pairs}};
  json["refused"] = nlohmann::ordered_json::object();
  const std::vector<Trial> trials = all_trials(options);
  for (std::uint32_t i = 0; i < options.count; ++i) {
    const Trial& trial = trials[i];
    const std::string seed = fmt::format("seed {}", options.seed + i);
    if (trial.fiducials)
      fiducials.add(*trial.fiducials, trial);
    else
      json["refused"][seed] = trial.refusal;
    if (trial.fused) fused.add(*trial.fused, trial);
    if (!trial.fusion_refusal.empty()) json["fusion_refused"][seed] = trial.fusion_refusal;
  }
  json["fiducials"] = as_json(fiducials);
  if (!options.rendered.empty()) json["fused"] = as_json(fused);
  fmt::print("{}\n", json.dump(1));
}

}  // namespace

int main(int argc, char** argv) {
  Options options;
  CLI::App app{"How often a registration's predicted 95 % region contains the truth.",
               "holdfast-bench-tre"};
  app.add_option("--count", options.count, "Registrations")
      ->check(CLI::Range(1U, 1'000'000U))
      ->capture_default_str();
  app.add_option("--pairs", options.pairs, "Of each calibration")->capture_default_str();
  app.add_option("--seed", options.seed, "Of the first; the next has the next")
      ->capture_default_str();
  app.add_option("--threads", options.threads, "Set-ups at a time")->capture_default_str();
  app.add_option(
      "--rendered", options.rendered,
      "Folder for whole set-ups with rendered images, minutes each; what stands there is "
      "used. Default: the pixels are drawn");
  app.footer(
      "Example: a thousand drawn set-ups, and 20 rendered ones, fiducials alone and fused\n"
      "  holdfast-bench-tre --count 1000\n"
      "  holdfast-bench-tre --count 20 --pairs 8 --rendered setups/\n"
      "Drawn: corners of board and markers (true lens, seating of each visit, holders as made, "
      "detection noise), beads.\nNot drawn: surfaces.");
  app.callback([&options] { run(options); });
  return holdfast::bridge::run_command_line(app, argc, argv);
}
