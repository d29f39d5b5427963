// SPDX-License-Identifier: Apache-2.0
// Writers of topics that ROS 2 nodes see natively, without a bridge process: names (`rt/...`),
// types, QoS and encoding are those of ROS 2's own nodes. Takes the house's units (mm, rad) and
// writes ROS's (m, rad); frame names and axes are the caller's (docs/ros2.md). Writes only: there
// is no reader, so nothing can come in. Nothing waits: a slow reader loses samples. One thread;
// allocates.
#pragma once

#include <chrono>
#include <cstdint>
#include <optional>
#include <span>
#include <string>
#include <utility>
#include <vector>

#include <Eigen/Geometry>

#include "bridge/dds/participant.hpp"

namespace holdfast::bridge::ros2 {

/// geometry_msgs/TransformStamped: takes coordinates in `child_frame` to `frame`.
struct StampedTransform {
  std::string frame, child_frame;
  std::chrono::nanoseconds t_utc{};  ///< since 1970-01-01, as ROS time is
  Eigen::Isometry3d T_frame_child_mm = Eigen::Isometry3d::Identity();  ///< translation in mm
};

/// geometry_msgs/PoseWithCovarianceStamped.
struct StampedPose {
  std::string frame;
  std::chrono::nanoseconds t_utc{};
  Eigen::Vector3d position_mm = Eigen::Vector3d::Zero();
  Eigen::Quaterniond orientation = Eigen::Quaterniond::Identity();
  /// About `position_mm`: tx, ty, tz, rx, ry, rz in the fixed axes of `frame` (mm, rad).
  Eigen::Matrix<double, 6, 6> covariance = Eigen::Matrix<double, 6, 6>::Zero();
};

/// sensor_msgs/Image, 8 bit.
struct StampedImage {
  std::string frame;
  std::chrono::nanoseconds t_utc{};
  int width_px = 0, height_px = 0;
  int channels = 1;                      ///< 1: mono8; 3: rgb8
  std::span<const std::uint8_t> pixels;  ///< row by row, channels together
};

enum class DiagnosticLevel : std::uint8_t { ok = 0, warn = 1, error = 2, stale = 3 };

/// diagnostic_msgs/DiagnosticStatus.
struct Diagnostic {
  DiagnosticLevel level = DiagnosticLevel::stale;
  std::string name, message;
  std::vector<std::pair<std::string, std::string>> values;
};

/// The names on the wire; ROS 2 shows them without `rt`.
inline constexpr const char* kTfTopic = "rt/tf";
inline constexpr const char* kTfStaticTopic = "rt/tf_static";
inline constexpr const char* kPoseTopic = "rt/holdfast/target_pose";
inline constexpr const char* kImageTopic = "rt/holdfast/image";
inline constexpr const char* kDiagnosticsTopic = "rt/diagnostics";

class Mirror {
 public:
  /// Throws as dds::Participant; UnavailableError when a writer cannot be made. Images have a topic
  /// only where there may be some.
  explicit Mirror(const dds::ParticipantParameters& participant, bool has_images = false);

  // False when the middleware did not take it.
  bool publish(std::span<const StampedTransform> transforms);
  /// Kept for late joiners, as tf_static is: only for what never changes.
  bool publish_static(std::span<const StampedTransform> transforms);
  bool publish(const StampedPose& pose);
  bool publish(std::chrono::nanoseconds t_utc, std::span<const Diagnostic> diagnostics);
  /// False also without has_images.
  bool publish(const StampedImage& image);

 private:
  dds::Participant participant_;
  dds::Entity tf_, tf_static_, pose_, diagnostics_;
  std::optional<dds::Entity> image_;
};

}  // namespace holdfast::bridge::ros2
