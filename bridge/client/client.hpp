// SPDX-License-Identifier: Apache-2.0
// For authors of robot controllers: validates everything that Holdfast publishes and answers one
// question, "may I act on a pose now, and on which". The answer is no unless everything says yes:
//   - a fresh, consistent stream of motion-stop messages, the newest of which permits motion, and
//   - a fresh, consistent stream of compensated poses from the same daemon, sent since then, and
//   - a fresh, consistent stream of permissions of the guard for that daemon (unless switched off).
// Silence, a bad CRC, a repeated or skipped counter, age, a second sender, a number that is not
// finite: all are no, with the reason. Standard C++ only; link holdfast::client.
//
// Lengths in mm, angles in rad, times in ns on CLOCK_MONOTONIC. One thread per Client. After
// construction no member function but mismatches() allocates; only wait() waits.
#pragma once

#include <array>
#include <chrono>
#include <cstddef>
#include <cstdint>
#include <memory>
#include <optional>
#include <string>
#include <string_view>
#include <vector>

namespace holdfast::client {

/// How this host's clocks relate to those of the control PC.
enum class ClockRelation : std::uint8_t {
  same_host,        ///< one CLOCK_MONOTONIC
  synchronised_utc  ///< two hosts, CLOCK_REALTIME synchronised (PTP) to within future_tolerance
};

/// Whether an independent guard (holdfast-guard) must agree.
enum class Guard : std::uint8_t {
  required,  ///< no permission without it
  absent     ///< this set-up has none: for benches only; say so to whoever reads your log
};

/// Why the answer is no. On the wire in RobotStatus: the codes are stable.
enum class Refusal : std::uint8_t {
  none = 0,
  // What the streams say or lack
  no_stop_message = 1,         ///< no consistent motion-stop messages yet
  no_pose = 2,                 ///< no consistent poses yet
  not_permitted = 3,           ///< the newest motion-stop message does not permit motion
  stop_silent = 4,             ///< the newest motion-stop message has outlived its validity
  pose_silent = 5,             ///< the newest pose has outlived its validity
  pose_before_permission = 6,  ///< the newest pose was sent before motion was permitted (again)
  sources_differ = 7,          ///< poses and motion-stop messages come from different senders
  second_source = 8,           ///< another sender was heard while the first is alive
  no_guard_message = 9,        ///< no consistent messages of the guard yet
  guard_silent = 10,           ///< the guard's newest message has outlived its validity
  guard_withheld = 11,         ///< the guard does not permit motion
  // What was wrong with a message; holds until `recovery_messages` good ones of its stream followed
  bad_version = 16,
  bad_data_id = 17,  ///< a message of another topic
  no_source = 18,    ///< sender 0
  bad_crc = 19,
  repeated = 20,       ///< counter not advanced
  skipped = 21,        ///< counter advanced by more than one: something was lost
  expired = 22,        ///< older than its validity when it came
  from_future = 23,    ///< stamped ahead of our clock
  time_reversed = 24,  ///< stamped before its predecessor
  invalid_number = 25,
  invalid_rotation = 26,    ///< not a unit quaternion
  invalid_covariance = 27,  ///< a variance that is not positive, or not symmetric
  invalid_time = 28,        ///< pose, exposure and sending times cannot belong together
  contradictory_stop = 29   ///< motion-stop fields contradict each other
};
inline constexpr std::size_t kRefusalCodes = 30;
[[nodiscard]] std::string_view name(Refusal refusal) noexcept;  ///< as spelled above

struct Parameters {
  std::uint32_t domain = 0;   ///< DDS domain
  std::string configuration;  ///< Cyclone XML or file URI; empty: environment CYCLONEDDS_URI
  std::string security{};     ///< folder of `holdfast keys` for a robot; empty: unsecured
  ClockRelation clock = ClockRelation::same_host;
  Guard guard = Guard::required;
  /// A message is valid for as long as it claims, but never longer than this after its sending.
  std::chrono::nanoseconds validity_max = std::chrono::milliseconds(20);
  std::chrono::nanoseconds future_tolerance = std::chrono::milliseconds(1);
  /// Between a frame's exposure and the instant a pose is predicted for.
  std::chrono::nanoseconds extrapolation_max = std::chrono::milliseconds(120);
  /// Between sending and the instant a pose is predicted for, either way.
  std::chrono::nanoseconds pose_lead_max = std::chrono::milliseconds(20);
  /// Consecutive good messages of a stream before it is believed, at first and after a bad one.
  int recovery_messages = 2;
  /// Refuse for this long after the last message of another sender.
  std::chrono::nanoseconds second_source_hold = std::chrono::seconds(1);
};

/// A pose that may be acted on until t_valid_until_ns, and no longer.
struct Pose {
  std::int64_t t_valid_until_ns = 0;     ///< this host's CLOCK_MONOTONIC
  std::int64_t t_pose_ns = 0;            ///< the instant it is predicted for, this host's clock
  std::int64_t t_exposure_ns = 0;        ///< mid-exposure of the newest frame behind it, PC's clock
  std::int64_t t_frame_received_ns = 0;  ///< that frame's arrival, PC's clock
  std::uint64_t frame = 0;               ///< that frame's id
  std::uint64_t registration_id = 0;
  std::uint32_t counter = 0;                ///< of the message
  std::array<double, 3> translation_mm{};   ///< T_robot_ct
  std::array<double, 4> rotation_xyzw{};    ///< T_robot_ct, unit quaternion
  std::array<double, 36> covariance{};      ///< row-major tx,ty,tz,rx,ry,rz (mm, rad), robot axes,
                                            ///< about the target
  std::array<double, 3> target_robot_mm{};  ///< where the target is at t_pose
};

/// What the newest good motion-stop message said. For display and logs: Permission::pose decides.
struct StopState {
  bool is_permitted = false;
  bool is_latched = false;  ///< needs an operator's acknowledgement
  std::uint8_t mode = 0;    ///< safety/gate.hpp Mode
  std::uint8_t cause = 0;   ///< safety/reason.hpp Reason; 0: permitted
  std::uint32_t stop_id = 0;
  std::uint64_t reasons = 0;      ///< bit n: Reason n
  std::uint32_t counter = 0;      ///< of the message
  std::int64_t t_changed_ns = 0;  ///< when this state was entered, PC's clock
  std::int64_t t_evidence_ns =
      0;                       ///< arrival of the faulty input, or the deadline that passed, PC's
  std::int64_t t_sent_ns = 0;  ///< PC's clock
  std::int64_t t_received_ns = 0;  ///< when poll() took it
};

struct Permission {
  std::optional<Pose> pose;  ///< present: act on it, until its t_valid_until_ns. Absent: stop.
  Refusal refusal = Refusal::no_stop_message;  ///< none exactly when there is a pose
  StopState stop;
  std::uint8_t guard_cause = 0;  ///< rt/guard/guard_core.hpp GuardCause; for display and logs
  std::int64_t t_ns = 0;         ///< when this was decided, CLOCK_MONOTONIC

  [[nodiscard]] bool is_permitted() const noexcept { return pose.has_value(); }
};

struct Counts {
  std::uint64_t poses_accepted = 0, poses_refused = 0;
  std::uint64_t stops_accepted = 0, stops_refused = 0;
  std::uint64_t guards_accepted = 0, guards_refused = 0;
  std::array<std::uint64_t, kRefusalCodes> refused_messages{};  ///< by Refusal code
};

/// What the robot tells Holdfast.
struct Report {
  bool is_enabled = false;       ///< motion or laser is enabled right now
  bool has_fault = false;        ///< Holdfast stops on it
  std::uint32_t fault_code = 0;  ///< the robot's own
};

class Client {
 public:
  /// Joins the domain. Throws std::runtime_error (one line: parameter, value, limit, unit; or DDS's
  /// reason) when a parameter is out of range or DDS does not start.
  explicit Client(const Parameters& parameters);
  ~Client();
  Client(const Client&) = delete;
  Client& operator=(const Client&) = delete;

  /// Takes everything that has arrived and answers, for now. Call it in each control cycle, before
  /// acting; do not keep the answer. Does not wait, does not allocate.
  [[nodiscard]] Permission poll() noexcept;

  /// Waits until a message arrives, the permission given last expires, or `timeout` passes,
  /// whichever is first; then poll(). For robots without a cycle of their own.
  void wait(std::chrono::nanoseconds timeout) noexcept;

  /// Publishes the robot's status, with the client's own counts: at least every 50 ms, and at once
  /// on a change. Does not wait. False when it was not sent: Holdfast will notice the silence.
  bool report(const Report& report) noexcept;

  [[nodiscard]] const Counts& counts() const noexcept;
  /// Endpoints on the domain whose QoS does not fit ours, by name; for the start-up log.
  [[nodiscard]] std::vector<std::string> mismatches() const;

 private:
  struct Impl;
  std::unique_ptr<Impl> impl_;
};

}  // namespace holdfast::client
