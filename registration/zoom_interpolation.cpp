// SPDX-License-Identifier: Apache-2.0
// calibration_at_zoom: parabolas through neighbouring records, blended.
#include <algorithm>
#include <cmath>
#include <utility>

#include <Eigen/LU>
#include <fmt/format.h>
#include <opencv2/calib3d.hpp>

#include "registration/stereo_calibration.hpp"
#include "rt/core/error.hpp"

namespace holdfast::registration {
namespace {

constexpr double kSameZoom = 1e-6;

/// The records in coordinates where they vary smoothly with zoom, over x = log zoom.
struct Samples {
  std::vector<double> x;
  std::vector<Eigen::VectorXd> values;
  std::vector<Eigen::MatrixXd> covariances;  // empty: unknown
};

/// Coordinates in which a parameter means the same at every zoom. What the views leave uncertain
/// is uncertain in company: a principal point with the camera's turn, a coefficient with the next.
/// These companies are the same at all zooms once the principal point is an angle from the image's
/// middle, (cx - c0) / f, and a coefficient is what it does in pixels, k / f^(its power): so
/// covariances of several zooms may be added. Focal lengths are logarithms: magnification is a
/// ratio.
class SmoothCoordinates {
 public:
  SmoothCoordinates(const StereoCalibration& calibration, Eigen::Index coefficients)
      : middle_{0.5 * (calibration.image_width_px - 1), 0.5 * (calibration.image_height_px - 1)},
        f_px_(calibration.zooms.front().camera_matrix_left(0, 0)),
        n_(coefficients) {}

  [[nodiscard]] Eigen::VectorXd from_parameters(Eigen::VectorXd value) const {
    for (const Eigen::Index side : {Eigen::Index{0}, 4 + n_}) {
      const double f = value[side];
      for (Eigen::Index i = 0; i < n_; ++i) value[side + 4 + i] *= scale(i, f);
      for (const Eigen::Index i : {side, side + 1}) {
        value[i + 2] = (value[i + 2] - middle_[i - side]) / value[i];
        value[i] = std::log(value[i]);
      }
    }
    return value;
  }

  [[nodiscard]] Eigen::VectorXd to_parameters(Eigen::VectorXd value) const {
    for (const Eigen::Index side : {Eigen::Index{0}, 4 + n_}) {
      for (const Eigen::Index i : {side, side + 1}) {
        value[i] = std::exp(value[i]);
        value[i + 2] = middle_[i - side] + value[i + 2] * value[i];
      }
      const double f = value[side];
      for (Eigen::Index i = 0; i < n_; ++i) value[side + 4 + i] /= scale(i, f);
    }
    return value;
  }

  /// The derivative of from_parameters().
  [[nodiscard]] Eigen::MatrixXd jacobian(const Eigen::VectorXd& value) const {
    const Eigen::VectorXd smooth = from_parameters(value);
    Eigen::MatrixXd j = Eigen::MatrixXd::Identity(value.size(), value.size());
    for (const Eigen::Index side : {Eigen::Index{0}, 4 + n_}) {
      for (const Eigen::Index i : {side, side + 1}) {
        j(i, i) = j(i + 2, i + 2) = 1 / value[i];
        j(i + 2, i) = -smooth[i + 2] / value[i];
      }
      for (Eigen::Index i = 0; i < n_; ++i) {
        j(side + 4 + i, side + 4 + i) = scale(i, value[side]);
        j(side + 4 + i, side) -= kPowers[i] * smooth[side + 4 + i] / value[side];
      }
    }
    return j;
  }

 private:
  /// In OpenCV's order, k1 k2 p1 p2 k3 k4 k5 k6 s1 s2 s3 s4 and the sensor's tilt.
  static constexpr double kPowers[14] = {2, 4, 1, 1, 6, 2, 4, 6, 1, 3, 1, 3, 0, 0};

  [[nodiscard]] double scale(Eigen::Index i, double f) const {
    return std::pow(f_px_ / f, kPowers[i]);
  }

  double middle_[2];
  double f_px_;  // where coefficients keep their values
  Eigen::Index n_;
};

ZoomCalibration padded(ZoomCalibration zoom, int coefficients) {
  const int n = static_cast<int>(zoom.distortion_left.total());
  if (n == coefficients) return zoom;
  const Eigen::MatrixXd old = zoom.parameter_covariance;
  for (cv::Mat* distortion : {&zoom.distortion_left, &zoom.distortion_right}) {
    cv::Mat longer = cv::Mat::zeros(1, coefficients, CV_64F);
    distortion->reshape(1, 1).copyTo(longer.colRange(0, n));
    *distortion = longer;
  }
  if (old.size() == 0) return zoom;
  const auto place = [n, coefficients](Eigen::Index i) {
    return i + (i >= 4 + n ? coefficients - n : 0) + (i >= 2 * (4 + n) ? coefficients - n : 0);
  };
  const Eigen::Index size = 2 * (4 + coefficients) + 6;
  zoom.parameter_covariance = Eigen::MatrixXd::Zero(size, size);
  for (Eigen::Index r = 0; r < old.rows(); ++r)
    for (Eigen::Index c = 0; c < old.cols(); ++c)
      zoom.parameter_covariance(place(r), place(c)) = old(r, c);
  return zoom;
}

Samples samples_of(const StereoCalibration& calibration, int coefficients,
                   const SmoothCoordinates& smooth) {
  Samples samples;
  for (const ZoomCalibration& record : calibration.zooms) {
    const ZoomCalibration zoom = padded(record, coefficients);
    const Eigen::VectorXd value = parameter_vector(zoom);
    samples.x.push_back(std::log(zoom.zoom));
    samples.values.push_back(smooth.from_parameters(value));
    if (zoom.parameter_covariance.size() == 0) continue;
    const Eigen::MatrixXd j = smooth.jacobian(value);
    samples.covariances.emplace_back(j * zoom.parameter_covariance * j.transpose());
  }
  if (samples.covariances.size() != samples.x.size()) samples.covariances.clear();
  return samples;
}

/// Weights over all records of the polynomial through records first .. first+count-1, at x.
Eigen::VectorXd lagrange(const std::vector<double>& nodes, std::size_t first, std::size_t count,
                         double x) {
  Eigen::VectorXd weights = Eigen::VectorXd::Zero(static_cast<Eigen::Index>(nodes.size()));
  for (std::size_t i = first; i < first + count; ++i) {
    double weight = 1;
    for (std::size_t j = first; j < first + count; ++j)
      if (j != i) weight *= (x - nodes[j]) / (nodes[i] - nodes[j]);
    weights[static_cast<Eigen::Index>(i)] = weight;
  }
  return weights;
}

/// The weights to use, and those of an equally defensible answer: their difference is what the
/// interpolation does not know.
std::pair<Eigen::VectorXd, Eigen::VectorXd> weights_at(const std::vector<double>& nodes, double x) {
  const std::size_t n = nodes.size();
  const auto above =
      static_cast<std::size_t>(std::upper_bound(nodes.begin(), nodes.end(), x) - nodes.begin());
  const std::size_t left = std::clamp<std::size_t>(above, 1, n - 1) - 1;  // x in [left, left + 1]
  const Eigen::VectorXd line = lagrange(nodes, left, 2, x);
  if (x < nodes.front() || x > nodes.back())
    return {line, n == 2 ? lagrange(nodes, x < nodes.front() ? 0 : 1, 1, x)
                         : lagrange(nodes, x < nodes.front() ? 0 : n - 3, 3, x)};
  const double share = (x - nodes[left]) / (nodes[left + 1] - nodes[left]);
  if (n == 2) return {line, lagrange(nodes, share < 0.5 ? 0 : 1, 1, x)};
  if (n == 3) return {lagrange(nodes, 0, 3, x), line};
  if (left == 0) return {lagrange(nodes, 0, 3, x), lagrange(nodes, 0, 4, x)};
  if (left == n - 2) return {lagrange(nodes, n - 3, 3, x), lagrange(nodes, n - 4, 4, x)};
  const Eigen::VectorXd before = lagrange(nodes, left - 1, 3, x);
  const Eigen::VectorXd after = lagrange(nodes, left, 3, x);
  const Eigen::VectorXd blended = (1 - share) * before + share * after;
  return {blended, share < 0.5 ? after : before};
}

Eigen::MatrixXd covariance_of(const Samples& samples, const Eigen::VectorXd& weights,
                              const Eigen::VectorXd& disagreement) {
  Eigen::MatrixXd covariance = disagreement * disagreement.transpose();
  // Records of one joint calibration are correlated in a way that the file does not hold. For any
  // correlation: Cov(sum w_i v_i) <= sum|w| * sum |w_i| Cov(v_i).
  const double total = weights.cwiseAbs().sum();
  for (std::size_t k = 0; k < samples.covariances.size(); ++k)
    covariance += total * std::abs(weights[static_cast<Eigen::Index>(k)]) * samples.covariances[k];
  return covariance;
}

Eigen::VectorXd combined(const Samples& samples, const Eigen::VectorXd& weights) {
  Eigen::VectorXd value = Eigen::VectorXd::Zero(samples.values.front().size());
  for (std::size_t k = 0; k < samples.values.size(); ++k)
    value += weights[static_cast<Eigen::Index>(k)] * samples.values[k];
  return value;
}

void check_range(const StereoCalibration& calibration, double zoom, bool may_extrapolate) {
  if (calibration.zooms.empty()) throw InputError("the stereo calibration holds no zoom");
  const double low = calibration.zooms.front().zoom, high = calibration.zooms.back().zoom;
  if (calibration.zooms.size() < 2)
    throw InputError(fmt::format("zoom is {:g}, but only {:g} is calibrated", zoom, low));
  if (zoom > low && zoom < high) return;
  if (!may_extrapolate || !(zoom > 0 && zoom < 1e3))
    throw InputError(
        fmt::format("zoom is {:g}, must be {:g} to {:g}, the calibrated range", zoom, low, high));
}

}  // namespace

ZoomCalibration calibration_at_zoom(const StereoCalibration& calibration, double zoom,
                                    bool may_extrapolate) {
  const auto& records = calibration.zooms;
  for (const ZoomCalibration& record : records)
    if (std::abs(record.zoom - zoom) <= kSameZoom) return record;
  check_range(calibration, zoom, may_extrapolate);
  std::size_t coefficients = 0;
  for (const ZoomCalibration& record : records)
    coefficients = std::max(coefficients, record.distortion_left.total());
  const int n = static_cast<int>(coefficients);
  const SmoothCoordinates smooth(calibration, n);
  const Samples samples = samples_of(calibration, n, smooth);
  const auto [weights, others] = weights_at(samples.x, std::log(zoom));
  const Eigen::VectorXd value = combined(samples, weights);

  const Eigen::VectorXd parameters = smooth.to_parameters(value);
  ZoomCalibration result = with_parameters(padded(records.front(), n), parameters);
  result.zoom = zoom;
  result.focus_mm = 0;
  for (std::size_t k = 0; k < records.size(); ++k) {
    result.focus_mm += weights[static_cast<Eigen::Index>(k)] * records[k].focus_mm;
    result.rms_px = std::max(result.rms_px, records[k].rms_px);
    result.pairs_used = std::min(result.pairs_used, records[k].pairs_used);
  }
  result.parameter_covariance.resize(0, 0);
  if (samples.covariances.empty()) return result;
  const Eigen::MatrixXd back = smooth.jacobian(parameters).inverse();
  const Eigen::MatrixXd covariance =
      back * covariance_of(samples, weights, value - combined(samples, others)) * back.transpose();
  result.parameter_covariance = 0.5 * (covariance + covariance.transpose());
  return result;
}

}  // namespace holdfast::registration
