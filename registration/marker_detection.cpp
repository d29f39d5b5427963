// SPDX-License-Identifier: Apache-2.0
#include "registration/marker_detection.hpp"

#include <algorithm>
#include <cmath>
#include <map>
#include <optional>

#include <Eigen/Eigenvalues>
#include <opencv2/aruco.hpp>
#include <opencv2/calib3d.hpp>

#include "registration/triangulation.hpp"
#include "rt/core/error.hpp"

namespace holdfast::registration {
namespace {

constexpr double kSystematicPx = 0.01;  // print, blur and sampling: what averaging does not remove

float sample(const cv::Mat& grey, const cv::Point2d& p) {
  const int x = static_cast<int>(std::floor(p.x)), y = static_cast<int>(std::floor(p.y));
  const auto fx = static_cast<float>(p.x - x), fy = static_cast<float>(p.y - y);
  const auto at = [&](int i, int j) { return static_cast<float>(grey.at<std::uint8_t>(j, i)); };
  return (1 - fy) * ((1 - fx) * at(x, y) + fx * at(x + 1, y)) +
         fy * ((1 - fx) * at(x, y + 1) + fx * at(x + 1, y + 1));
}

bool is_inside(const cv::Mat& grey, const cv::Point2d& p) {
  return p.x >= 0 && p.y >= 0 && p.x < grey.cols - 1 && p.y < grey.rows - 1;
}

/// Place of a dark-to-light edge along `outwards` (unit) near `start`: the equal-area position of
/// the step between the two plateaus, centred until it stays. Symmetrical blur does not move it.
std::optional<cv::Point2d> edge_point(const cv::Mat& grey, const cv::Point2d& start,
                                      const cv::Point2d& outwards, double reach) {
  constexpr double kStep = 0.5;
  const int n = static_cast<int>(std::lround(reach / kStep));
  double at = 0;
  for (int iteration = 0; iteration < 8; ++iteration) {
    std::vector<double> profile;
    for (int i = -n; i <= n; ++i) {
      const cv::Point2d p = start + (at + kStep * i) * outwards;
      if (!is_inside(grey, p)) return std::nullopt;
      profile.push_back(static_cast<double>(sample(grey, p)));
    }
    const std::size_t plateau = std::max<std::size_t>(2, profile.size() / 5);
    double dark = 0, light = 0, sum = 0;
    for (std::size_t i = 0; i < plateau; ++i) {
      dark += profile[i] / static_cast<double>(plateau);
      light += profile[profile.size() - 1 - i] / static_cast<double>(plateau);
    }
    if (!(light - dark > 10)) return std::nullopt;
    // Trapezoids: the share of the window that is light.
    for (std::size_t i = 0; i < profile.size(); ++i)
      sum += (i == 0 || i + 1 == profile.size() ? 0.5 : 1.0) * (profile[i] - dark) / (light - dark);
    const double move = kStep * n - kStep * sum;
    at += move;
    if (std::abs(at) > 2 * reach) return std::nullopt;
    if (std::abs(move) < 1e-3) break;
  }
  return start + at * outwards;
}

struct Line {
  Eigen::Vector2d point, direction;
  double offset_variance = 0, angle_variance = 0;  // about `point`
};

/// Total least squares, points beyond 3 robust standard deviations left out twice.
std::optional<Line> fitted_line(std::vector<Eigen::Vector2d> points, double floor_sigma) {
  Line line;
  for (int round = 0; round < 3; ++round) {
    if (points.size() < 8) return std::nullopt;
    const auto n = static_cast<double>(points.size());
    line.point.setZero();
    for (const auto& p : points) line.point += p / n;
    Eigen::Matrix2d scatter = Eigen::Matrix2d::Zero();
    for (const auto& p : points) scatter += (p - line.point) * (p - line.point).transpose();
    const Eigen::SelfAdjointEigenSolver<Eigen::Matrix2d> solver(scatter);
    line.direction = solver.eigenvectors().col(1);
    const Eigen::Vector2d normal = solver.eigenvectors().col(0);
    const double variance = std::max(solver.eigenvalues()[0] / (n - 2), 1e-30);
    // Neighbouring profiles share pixels: half of them count. The floor does not average out.
    line.offset_variance = 2 * variance / n + floor_sigma * floor_sigma;
    line.angle_variance = 2 * variance / solver.eigenvalues()[1] +
                          12 * floor_sigma * floor_sigma * n / (12 * solver.eigenvalues()[1]);
    std::vector<double> distances;
    for (const auto& p : points) distances.push_back(std::abs(normal.dot(p - line.point)));
    const auto middle = distances.begin() + static_cast<std::ptrdiff_t>(distances.size() / 2);
    std::nth_element(distances.begin(), middle, distances.end());
    const double limit = 3 * 1.4826 * *middle + 1e-9;
    std::erase_if(points, [&](const Eigen::Vector2d& p) {
      return std::abs(normal.dot(p - line.point)) > limit;
    });
  }
  return line;
}

Eigen::Vector2d meeting(const Line& a, const Line& b) {
  const double cross = a.direction.x() * b.direction.y() - a.direction.y() * b.direction.x();
  const Eigen::Vector2d d = b.point - a.point;
  return a.point + a.direction * (d.x() * b.direction.y() - d.y() * b.direction.x()) / cross;
}

/// Sides 0..3, from corner i to corner i+1; corner i is where sides i-1 and i meet.
Eigen::Matrix<double, 8, 1> meetings(const std::array<Line, 4>& sides) {
  Eigen::Matrix<double, 8, 1> corners;
  for (std::size_t i = 0; i < 4; ++i)
    corners.segment<2>(static_cast<Eigen::Index>(2 * i)) = meeting(sides.at((i + 3) % 4), sides[i]);
  return corners;
}

Eigen::Matrix<double, 8, 8> corner_covariance(const std::array<Line, 4>& sides) {
  const Eigen::Matrix<double, 8, 1> here = meetings(sides);
  Eigen::Matrix<double, 8, 8> covariance = Eigen::Matrix<double, 8, 8>::Zero();
  for (std::size_t i = 0; i < 4; ++i)
    for (const bool is_offset : {true, false}) {
      std::array<Line, 4> moved = sides;
      Line& line = moved.at(i);
      const Eigen::Vector2d normal(-line.direction.y(), line.direction.x());
      if (is_offset)
        line.point += std::sqrt(line.offset_variance) * normal;
      else
        line.direction = (line.direction + std::sqrt(line.angle_variance) * normal).normalized();
      const Eigen::Matrix<double, 8, 1> change = meetings(moved) - here;
      covariance += change * change.transpose();
    }
  return covariance;
}

class Refinement {
 public:
  Refinement(const cv::Mat& grey, const cv::Matx33d& K, const cv::Mat& distortion, int bits)
      : grey_(grey), K_(K), distortion_(distortion), bits_(bits) {}

  [[nodiscard]] std::optional<DetectedMarker> refined(int id,
                                                      std::array<cv::Point2d, 4> corners) const {
    std::array<Line, 4> sides;
    // Twice: the second time the profiles stand on the fitted square.
    for (int round = 0; round < 2; ++round) {
      for (std::size_t i = 0; i < 4; ++i) {
        const auto line = side(corners[i], corners.at((i + 1) % 4), corners.at((i + 2) % 4));
        if (!line) return std::nullopt;
        sides.at(i) = *line;
      }
      corners = to_pixels(meetings(sides));
    }
    DetectedMarker marker{id, corners, {}};
    const double f = 0.5 * (K_(0, 0) + K_(1, 1));
    marker.covariance_px2 = f * f * corner_covariance(sides);
    return marker;
  }

 private:
  [[nodiscard]] std::optional<Line> side(const cv::Point2d& from, const cv::Point2d& to,
                                         const cv::Point2d& inside) const {
    const double length = cv::norm(to - from);
    cv::Point2d outwards(-(to - from).y / length, (to - from).x / length);
    if (outwards.dot(inside - from) > 0) outwards = -outwards;
    const double module = length / (bits_ + 2);  // the black frame is one module wide
    const double reach = std::clamp(0.45 * module, 2.0, 8.0);
    std::vector<cv::Point2d> pixels;
    const int count = std::clamp(static_cast<int>(length), 12, 200);
    for (int i = 0; i < count; ++i) {
      const double share = 0.1 + 0.8 * i / (count - 1);
      if (const auto p = edge_point(grey_, from + share * (to - from), outwards, reach))
        pixels.push_back(*p);
    }
    if (pixels.size() < static_cast<std::size_t>(count) / 2) return std::nullopt;
    return fitted_line(rays(pixels, K_, distortion_), kSystematicPx / K_(0, 0));
  }

  [[nodiscard]] std::array<cv::Point2d, 4> to_pixels(
      const Eigen::Matrix<double, 8, 1>& rays) const {
    std::vector<cv::Point3d> points;
    for (Eigen::Index i = 0; i < 4; ++i) points.emplace_back(rays[2 * i], rays[2 * i + 1], 1);
    std::vector<cv::Point2d> pixels;
    cv::projectPoints(points, cv::Vec3d(), cv::Vec3d(), K_, distortion_, pixels);
    return {pixels[0], pixels[1], pixels[2], pixels[3]};
  }

  const cv::Mat& grey_;
  cv::Matx33d K_;
  cv::Mat distortion_;
  int bits_;
};

}  // namespace

int marker_dictionary(const std::string& name) {
  static const std::map<std::string, int> names = {
      {"4x4_50", cv::aruco::DICT_4X4_50},
      {"4x4_100", cv::aruco::DICT_4X4_100},
      {"4x4_250", cv::aruco::DICT_4X4_250},
      {"4x4_1000", cv::aruco::DICT_4X4_1000},
      {"5x5_50", cv::aruco::DICT_5X5_50},
      {"5x5_100", cv::aruco::DICT_5X5_100},
      {"5x5_250", cv::aruco::DICT_5X5_250},
      {"5x5_1000", cv::aruco::DICT_5X5_1000},
      {"6x6_50", cv::aruco::DICT_6X6_50},
      {"6x6_100", cv::aruco::DICT_6X6_100},
      {"6x6_250", cv::aruco::DICT_6X6_250},
      {"6x6_1000", cv::aruco::DICT_6X6_1000},
      {"7x7_50", cv::aruco::DICT_7X7_50},
      {"7x7_100", cv::aruco::DICT_7X7_100},
      {"7x7_250", cv::aruco::DICT_7X7_250},
      {"7x7_1000", cv::aruco::DICT_7X7_1000},
      {"aruco_original", cv::aruco::DICT_ARUCO_ORIGINAL}};
  const auto it = names.find(name);
  if (it == names.end())
    throw InputError("--dictionary is '" + name + "', must be one of 4x4_50 … 7x7_1000");
  return it->second;
}

std::vector<DetectedMarker> detect_markers(const cv::Mat& grey, int dictionary,
                                           const cv::Matx33d& camera_matrix,
                                           const cv::Mat& distortion) {
  const auto words = cv::aruco::getPredefinedDictionary(dictionary);
  std::vector<std::vector<cv::Point2f>> quads;
  std::vector<int> ids;
  cv::aruco::detectMarkers(grey, words, quads, ids);
  const Refinement refinement(grey, camera_matrix, distortion, words->markerSize);
  std::vector<DetectedMarker> markers;
  for (std::size_t i = 0; i < ids.size(); ++i) {
    const auto& q = quads[i];
    if (auto marker = refinement.refined(ids[i], {q[0], q[1], q[2], q[3]}))
      markers.push_back(*marker);
  }
  std::stable_sort(markers.begin(), markers.end(),
                   [](const DetectedMarker& a, const DetectedMarker& b) { return a.id < b.id; });
  return markers;
}

}  // namespace holdfast::registration
