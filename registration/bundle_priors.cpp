// SPDX-License-Identifier: Apache-2.0
#include "registration/bundle_priors.hpp"

#include <cmath>

#include <ceres/autodiff_cost_function.h>
#include <ceres/dynamic_autodiff_cost_function.h>
#include <ceres/manifold.h>

namespace holdfast::registration::bundle {
namespace {

/// (value - mean) / sigma, elementwise.
struct PriorResidual {
  Prior prior;
  template <typename T>
  bool operator()(const T* const* value, T* residual) const {
    for (std::size_t i = 0; i < prior.mean.size(); ++i)
      residual[i] = (value[0][i] - prior.mean[i]) / prior.sigma[i];
    return true;
  }
};

/// fx/fy: the pixels are square.
struct AspectResidual {
  template <typename T>
  bool operator()(const T* camera, T* residual) const {
    residual[0] = (camera[0] - camera[1]) / 2e-3;
    return true;
  }
};

void add_prior(ceres::Problem& problem, const Prior& prior, double* block) {
  const int n = static_cast<int>(prior.mean.size());
  auto* cost = new ceres::DynamicAutoDiffCostFunction<PriorResidual, 32>(new PriorResidual{prior});
  cost->AddParameterBlock(n);
  cost->SetNumResiduals(n);
  problem.AddResidualBlock(cost, nullptr, block);
}

}  // namespace

Prior camera_prior(const Camera& camera, cv::Size image, const BundleOptions& options) {
  const double f = std::exp(camera[0]), w = image.width, h = image.height;
  const double r = 0.5 * std::hypot(w, h) / f;  // of the image's corner
  Prior prior;
  prior.mean = {std::log(f), std::log(f), 0.5 * (w - 1), 0.5 * (h - 1), 0, 0, 0, 0, 0, 0, 0, 0, 0};
  prior.sigma = {1, 1, 0.2 * w, 0.2 * h};
  for (const int power : {3, 5, 2, 2, 7})
    prior.sigma.push_back(options.distortion_prior_px / (f * std::pow(r, power)));
  for (const int power : {2, 4, 2, 4})
    prior.sigma.push_back(options.prism_prior_px / (f * std::pow(r, power)));
  return prior;
}

void add_priors(ceres::Problem& problem, Unknowns& unknowns, cv::Size image,
                const BundleOptions& options) {
  for (ZoomUnknowns& zoom : unknowns.zooms)
    for (Camera* camera : {&zoom.left, &zoom.right}) {
      add_prior(problem, camera_prior(*camera, image, options), camera->data());
      problem.AddResidualBlock(
          new ceres::AutoDiffCostFunction<AspectResidual, 1, kIntrinsics>(new AspectResidual),
          nullptr, camera->data());
      if (options.coefficients == 5)
        problem.SetManifold(camera->data(),
                            new ceres::SubsetManifold(kIntrinsics, {9, 10, 11, 12}));
    }
  if (options.is_joint)
    add_prior(problem,
              {std::vector<double>(kBend, 0.0), std::vector<double>(kBend, options.bend_prior_mm)},
              unknowns.bend.data());
  else
    problem.SetParameterBlockConstant(unknowns.bend.data());
}

}  // namespace holdfast::registration::bundle
