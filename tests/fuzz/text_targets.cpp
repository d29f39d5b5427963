// SPDX-License-Identifier: Apache-2.0
// Texts: configuration, calibrations, registration, points, patterns. A seal guards against
// accidents, not against someone who seals anew: what is sealed is tried with its right seal too.
#include <cmath>
#include <fstream>
#include <iterator>
#include <string>
#include <string_view>

#include <nlohmann/json.hpp>

#include "bridge/camera_file.hpp"
#include "registration/hand_eye_file.hpp"
#include "registration/markups.hpp"
#include "registration/pattern_table.hpp"
#include "registration/registration_file.hpp"
#include "registration/sealed_json.hpp"
#include "registration/stereo_calibration.hpp"
#include "registration/transform_file.hpp"
#include "rt/daemon_config.hpp"
#include "tests/fuzz/memory_file.hpp"
#include "tests/fuzz/targets.hpp"

namespace holdfast::fuzz {
namespace {

using nlohmann::json;

Bytes content_of(const char* path) {
  std::ifstream file(path, std::ios::binary);
  return {std::istreambuf_iterator<char>(file), std::istreambuf_iterator<char>()};
}

std::vector<Bytes> config_seeds() {
  return {content_of(HOLDFAST_CONFIG_DIR "/holdfastd.toml"),
          content_of(HOLDFAST_CONFIG_DIR "/demo.toml")};
}

std::vector<Bytes> camera_seeds() {
  return {content_of(HOLDFAST_FUZZ_SEEDS "/camera.yaml")};
}

std::vector<Bytes> stereo_seeds() {
  return {content_of(HOLDFAST_FUZZ_SEEDS "/stereo.yaml")};
}

std::vector<Bytes> registration_seeds() {
  registration::Registration registration;
  registration.T_camera_ct.translation() = Eigen::Vector3d(1, 2, 200);
  registration.covariance.diagonal().setConstant(1e-3);
  registration.tre.push_back({});
  registration.zoom = 1.1;
  registration.focus_mm = 200;
  return {bytes_of_text(sealed_registration(registration, "/"))};
}

std::vector<Bytes> markup_seeds() {
  registration::Markups markups;
  for (int i = 0; i < 4; ++i)
    markups.points.push_back({std::to_string(i), Eigen::Vector3d(i, 2 * i, 3),
                              Eigen::Matrix3d::Identity() * 0.01, "bead"});
  markups.joint_covariance_mm2 = Eigen::MatrixXd::Identity(12, 12) * 0.01;
  return {bytes_of_text(markups_text(markups))};
}

std::vector<Bytes> transform_seeds() {
  return {bytes_of_text(registration::transform_text(Eigen::Isometry3d::Identity()))};
}

std::vector<Bytes> hand_eye_seeds() {
  registration::HandEyeCalibration calibration;
  calibration.covariance.diagonal().setConstant(1e-4);
  calibration.zoom = 1.3;
  calibration.focus_mm = 200;
  calibration.image_width_px = 2456;
  calibration.image_height_px = 2054;
  calibration.camera_matrix.diagonal() = Eigen::Vector3d(20000, 20000, 1);
  return {bytes_of_text(sealed_hand_eye(calibration))};
}

constexpr registration::PatternTableHead kTableHead{};

std::vector<Bytes> pattern_table_seeds() {
  registration::PatternEvaluation evaluation;
  evaluation.zoom = 1.3;
  return {bytes_of_text(pattern_table_text(kTableHead, {evaluation}))};
}

void take_config(std::span<const std::uint8_t> bytes) {
  const MemoryFile file(bytes);
  const rt::DaemonConfig config = rt::load_daemon_config(file.path());
  require(!safety::invalid_limit(config.limits), "a configuration with unusable limits");
}

void take_camera(std::span<const std::uint8_t> bytes) {
  const MemoryFile file(bytes);
  const perception::CameraModel camera = bridge::read_camera_file(file.path());
  require(!perception::invalid_camera(camera), "a camera that is none");
}

void take_stereo(std::span<const std::uint8_t> bytes) {
  const MemoryFile file(bytes);
  (void)registration::read_stereo_calibration(file.path());
}

void check(const registration::Registration& read) {
  require(read.T_camera_ct.matrix().allFinite() && read.covariance.allFinite(),
          "a registration that is no number");
}

void check(const registration::HandEyeCalibration& read) {
  require(read.T_robot_camera.matrix().allFinite() && read.covariance.allFinite(),
          "a hand-eye calibration that is no number");
}

/// The text as it is and, where it is a JSON object, with its right seal.
template <class Load>
void take_sealed(std::span<const std::uint8_t> bytes, const Load& load) {
  const std::string text(bytes.begin(), bytes.end());
  json content = registration::parse_json(text);
  if (content.is_object()) {
    content["checksum"] = registration::seal_of(content);
    const Bytes sealed = bytes_of_text(content.dump());
    const MemoryFile file(sealed);
    check(load(file.path()));
  }
  const MemoryFile file(bytes);
  check(load(file.path()));
}

void take_registration(std::span<const std::uint8_t> bytes) {
  take_sealed(bytes, [](const std::string& path) { return registration::load_registration(path); });
}

void take_hand_eye(std::span<const std::uint8_t> bytes) {
  take_sealed(bytes, [](const std::string& path) { return registration::load_hand_eye(path); });
}

void take_pattern_table(std::span<const std::uint8_t> bytes) {
  const std::string_view text(reinterpret_cast<const char*>(bytes.data()), bytes.size());
  for (const auto& evaluation : registration::parse_pattern_table("patterns.csv", text, kTableHead))
    require(std::isfinite(evaluation.objective_mm), "an evaluation that is no number");
}

void take_markups(std::span<const std::uint8_t> bytes) {
  const MemoryFile file(bytes);
  for (const registration::MarkupPoint& point : registration::read_markups_file(file.path()).points)
    require(point.position_mm.allFinite(), "a point that is no number");
}

void take_transform(std::span<const std::uint8_t> bytes) {
  const MemoryFile file(bytes);
  require(registration::read_transform(file.path()).matrix().allFinite(),
          "a transform that is no number");
}

}  // namespace

std::span<const Target> text_targets() {
  static const Target targets[] = {{"config", config_seeds, take_config},
                                   {"camera", camera_seeds, take_camera},
                                   {"stereo", stereo_seeds, take_stereo},
                                   {"registration", registration_seeds, take_registration},
                                   {"hand_eye", hand_eye_seeds, take_hand_eye},
                                   {"markups", markup_seeds, take_markups},
                                   {"transform", transform_seeds, take_transform},
                                   {"pattern_table", pattern_table_seeds, take_pattern_table}};
  return targets;
}

}  // namespace holdfast::fuzz
