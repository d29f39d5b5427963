// SPDX-License-Identifier: Apache-2.0
// OpenIGTLink for 3D Slicer: transforms while they hold, and STATUS, which says so or why not
// (docs/ros2.md beside it). The making of messages is pure; IgtlOutlet paces them. One thread.
#pragma once

#include <string>

#include "bridge/openigtlink/igtl_messages.hpp"
#include "bridge/openigtlink/igtl_server.hpp"
#include "rt/outlets/live_poses.hpp"

namespace holdfast::outlets {

struct IgtlSettings {
  bool is_on = false;
  bridge::openigtlink::ServerParameters server;
  double rate_hz = 30;  ///< of transforms, at most
};

// Device names. Patient: the CT's coordinates as Slicer has them, RAS, mm.
inline constexpr const char* kStatusDevice = "Holdfast";
inline constexpr const char* kCameraToPatient = "CameraToPatient";
inline constexpr const char* kRobotToPatient = "RobotToPatient";

[[nodiscard]] bridge::openigtlink::Status to_status(const observer::ObservedState& state,
                                                    nanoseconds now);
[[nodiscard]] Eigen::Isometry3d T_patient_robot(const LivePose& pose);
[[nodiscard]] Eigen::Isometry3d T_patient_camera(const LiveSite& site);

class IgtlOutlet {
 public:
  /// Throws as Server.
  explicit IgtlOutlet(const IgtlSettings& settings);
  /// Sends what is new and due.
  void tell(const observer::ObservedState& state, bridge::dds::Clocks now);
  [[nodiscard]] bridge::openigtlink::Server& server() noexcept { return server_; }

 private:
  void tell_status(const observer::ObservedState& state, bridge::dds::Clocks now);

  bridge::openigtlink::Server server_;
  LiveFeed feed_;
  nanoseconds t_status_{};
  std::string told_;  // what the newest STATUS said
};

}  // namespace holdfast::outlets
