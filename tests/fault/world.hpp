// SPDX-License-Identifier: Apache-2.0
// The whole control side in virtual time, without threads, clocks or middleware: camera and tracker
// (simulated), control step, publisher, wire, guard, client, robot, operator. Everything that
// decides is the product's own code. The world knows the true pose, so it can say when a robot that
// is permitted is wrong. Same seed, same run, bit for bit. A plain value: a copy is a snapshot.
#pragma once

#include <cstdint>
#include <deque>
#include <optional>
#include <random>
#include <variant>
#include <vector>

#include <Eigen/Geometry>

#include "bridge/can/microscope_watch.hpp"
#include "bridge/client/permission.hpp"
#include "bridge/dds/messages.hpp"
#include "rt/control_step.hpp"
#include "rt/guard/guard_core.hpp"

namespace holdfast::fault {

using std::chrono::microseconds;
using std::chrono::milliseconds;
using std::chrono::nanoseconds;

/// Broken wiring, one at a time: what the campaign must find before its zeros mean anything. They
/// live here, in the simulated wiring, never in the product.
enum class Bug : std::uint8_t {
  none,
  publisher_repeats_last_pose,     ///< "keeps the stream alive" while not permitted
  publisher_claims_permission,     ///< motion-stop messages always permit
  robot_keeps_last_pose,           ///< acts on the newest pose it ever got
  frames_stamped_on_arrival,       ///< exposure time lost: the reception is taken for it
  faults_not_reported,             ///< the camera's faults do not reach the loop
  silence_reported_as_frames,      ///< a watchdog thread invents arrivals
  estimate_repeated_as_new,        ///< the newest estimate is sent again with a fresh stamp
  lost_reported_as_tracking,       ///< "last known transform, status OK"
  covariance_not_filled_honestly,  ///< the tracker's covariance is a constant
  registration_kept_after_change,  ///< a new registration is not passed on
  drift_not_measured,              ///< drift is reported as zero
  robot_clock_not_checked,         ///< the client believes validities of a second
  optics_restamped                 ///< the newest look at the microscope is sent again as fresh
};
inline constexpr int kBugCount = 13;
[[nodiscard]] const char* name(Bug bug) noexcept;

/// How the world is out of order now. A fault class sets some of it.
struct Disturbance {
  // Camera
  bool is_camera_silent = false, is_camera_disconnected = false;
  bool is_frozen = false;           ///< the image repeats: the tracker sees the same pose again
  safety::ReasonSet frame_faults;   ///< what the frame check says of each frame
  nanoseconds frame_delay{};        ///< of arrival and estimate
  nanoseconds exposure_error{};     ///< stamped so much later than it was
  bool is_skipping_frames = false;  ///< every other frame is lost, and said to be
  // Tracker
  bool is_tracker_silent = false, is_lost = false, is_degraded = false, has_few_inliers = false;
  bool has_bunched_inliers = false, has_no_drift = false, has_nan = false, has_bad_rotation = false;
  nanoseconds tracker_delay{};
  double estimate_offset_mm = 0;      ///< the tracker is wrong by that, from one frame to the next
  double estimate_rate_mm_per_s = 0;  ///< ... and slides away at this rate
  bool is_drift_seen = true;          ///< the independent check sees that
  double covariance_scale = 1;        ///< honest growth of its sigma
  bool has_other_keyframe = false;
  // The site
  double site_speed_mm_per_s = 0;  ///< on top of the gentle motion
  double site_jump_mm = 0;
  double site_turn_rad_per_s = 0;
  // Loop
  bool is_loop_stalled = false, has_clock_step = false, has_overflow = false;
  nanoseconds wake_lateness{};
  bool has_second_publisher = false;
  // Registration and optics
  bool is_registration_replaced = false, is_registration_withdrawn = false;
  double zoom_step = 0;          ///< the zoom is suddenly so much larger, relatively
  double zoom_rate_per_s = 0;    ///< ... and grows at this rate
  bool is_drive_moving = false;  ///< and the node says that a drive turns it
  double focus_step_mm = 0;
  bool is_encoder_stuck = false;  ///< zoom and focus are told as they were
  double encoder_error = 0;       ///< the zoom is told so much too large
  bool is_node_silent = false, is_node_booting = false, is_node_corrupt = false,
       is_node_skipping = false;
  bool is_bus_off = false, is_bus_passive = false, is_bus_down = false, is_bus_overflowing = false;
  bool is_reader_dead = false;       ///< our thread that reads the microscope
  bool is_reader_restarted = false;  ///< it begins anew, and has never seen the node
  // Wire from daemon to robot
  double loss = 0, duplicates = 0, corruption = 0, reordering = 0;
  nanoseconds wire_delay{};
  bool is_cut_to_robot = false, is_cut_stops = false, is_cut_poses = false,
       is_cut_from_robot = false;
  bool is_truncated = false;    ///< pose messages arrive with a zeroed tail
  bool is_replayed = false;     ///< a recorded permission is sent again for ever
  bool is_masqueraded = false;  ///< another source sends permissions
  // Processes
  bool is_daemon_dead = false, is_publisher_dead = false, is_guard_dead = false;
  nanoseconds daemon_pause{}, guard_pause{};  ///< stopped so long (SIGSTOP), then running as long
  // Robot and operator
  bool has_robot_fault = false, is_robot_silent = false;
  bool is_operator_stop = false, is_operator_corrupt = false;
};

struct WorldOptions {
  bool has_guard = true;
  Bug bug = Bug::none;
  /// A healthy room is not still either: drawn motion, the tracker's noise as its covariance says,
  /// delays that vary, encoders that flicker; all within what a sound set-up shows.
  bool is_lively = false;
  /// In place of the gate's own limit: one that is too strict must show as false stops.
  std::optional<nanoseconds> frame_lateness;
};

/// How the site moves. As it stands: 2 mm/s to and fro with a small turn; a lively room draws it.
struct Motion {
  Eigen::Vector3d direction = Eigen::Vector3d::UnitX();
  double amplitude_mm = 2, rate_rad_per_s = 1, phase_rad = 0;
  double turn_rad = 0.01, turn_rate_rad_per_s = 0.7, turn_phase_rad = 0;
};

/// What one millisecond showed.
struct Observation {
  bool is_permitted = false;  ///< the robot's laser-enable output
  double error_mm = 0;  ///< of the pose that the robot acts on, at the target; 0: not permitted
  bool is_withheld = false;                         ///< the gate's newest decision is to withhold
  safety::Mode mode = safety::Mode::init;           ///< the gate's
  safety::Reason cause = safety::Reason::none;      ///< the gate's
  client::Refusal refusal = client::Refusal::none;  ///< the robot's
  guard::GuardCause guard_cause = guard::GuardCause::none;
};

class World {
 public:
  World(std::uint64_t seed, const WorldOptions& options);

  /// One millisecond.
  Observation step();
  void reseed(std::uint64_t seed) { random_.seed(seed); }
  [[nodiscard]] nanoseconds now() const { return now_; }
  [[nodiscard]] double uniform(double low, double high) {
    return std::uniform_real_distribution<double>(low, high)(random_);
  }
  /// Both included.
  [[nodiscard]] int between(int least, int most) {
    return std::uniform_int_distribution<int>(least, most)(random_);
  }
  [[nodiscard]] safety::Reason cause() const { return state_.gate.cause; }

  Disturbance disturbance;

 private:
  static constexpr std::uint32_t kDaemon = 7, kGuard = 8, kRobot = 9, kStranger = 66;  ///< sources
  struct Envelope {
    nanoseconds t_arrival{};
    std::optional<msg::MotionStop> stop;
    std::optional<msg::CompensatedPose> pose;
  };
  [[nodiscard]] Eigen::Isometry3d T_camera_site_true() const;
  [[nodiscard]] bridge::dds::Clocks clocks() const;
  [[nodiscard]] bool happens(double probability);
  void draw_motion();
  /// Between nothing and `most` in a lively room, else nothing.
  [[nodiscard]] nanoseconds unrest(nanoseconds most);
  void add_noise(perception::MotionEstimate& motion, std::normal_distribution<double>& noise);
  void run_scheduler();
  void suspend_daemon();
  void resume_daemon();
  void hear(const bridge::can::Frame& frame);
  void take_robot_status(const msg::RobotStatus& status);
  using GuardMessage =
      std::variant<msg::MotionStop, msg::CompensatedPose, msg::TrackingHealth, msg::RobotStatus>;
  void tell_guard(const GuardMessage& message);
  void move_site();
  void run_camera();
  void deliver_estimates();
  [[nodiscard]] perception::MotionEstimate estimate();
  void run_microscope();
  [[nodiscard]] double zoom_true() const;
  void run_operator();
  void run_loop();
  void publish(const rt::ControlOutput& output);
  void publish_pose(const rt::ControlOutput& output);
  void send(Envelope envelope);
  void run_wire();
  void run_guard();
  [[nodiscard]] Observation run_robot();
  void report_robot(bool is_permitted);

  WorldOptions options_;
  std::mt19937_64 random_;
  nanoseconds now_ = std::chrono::seconds(1000);
  std::uint64_t steps_ = 0;

  // Truth
  Motion motion_;
  double extra_x_mm_ = 0, extra_turn_rad_ = 0, estimate_slide_mm_ = 0;
  bool has_jumped_ = false;
  Eigen::Isometry3d T_robot_camera_ = Eigen::Isometry3d::Identity();
  safety::RegistrationInput registration_;
  Eigen::Vector3d p_target_ct_mm_ = Eigen::Vector3d::Zero();

  // Processes that are stopped, and what has come for them meanwhile
  nanoseconds t_pause_began_{}, t_last_cycle_{};
  bool is_daemon_suspended_ = false, is_guard_suspended_ = false;
  std::vector<bridge::can::Frame> bus_queue_;
  std::vector<msg::RobotStatus> daemon_inbox_;
  std::vector<GuardMessage> guard_inbox_;
  std::vector<Envelope> half_sent_;  ///< protected, but not yet given to the wire

  // Camera and tracker
  nanoseconds t_next_exposure_{};
  std::uint64_t frame_ = 0;
  struct Pending {
    nanoseconds t_arrival{}, t_estimate{};
    rt::FrameArrival arrival;
    std::optional<rt::StampedEstimate> estimate;
    bool has_arrived = false;
  };
  std::deque<Pending> pending_;
  std::optional<rt::StampedEstimate> newest_estimate_, frozen_;
  bool was_connected_ = true;

  // The microscope on its bus, and our reader
  bridge::can::MicroscopeWatch watch_;
  std::uint8_t heartbeat_counter_ = 0, state_counter_ = 0;
  std::uint64_t bus_drops_ = 0;
  double zoom_turned_ = 0;
  bool is_recovery_wanted_ = false, has_restarted_reader_ = false;
  std::optional<safety::OpticsInput> newest_optics_;

  // Control
  rt::ControlParameters parameters_;
  rt::ControlState state_;
  rt::Readings readings_;
  safety::RobotInput robot_input_;
  bool has_robot_input_ = false, is_input_corrupt_ = false, is_withheld_ = false;
  safety::Receiver robot_receiver_;

  // Operator
  nanoseconds t_operator_{};
  bool has_acknowledged_ = false;

  // Publisher
  nanoseconds t_changed_{}, t_stop_sent_{}, t_health_sent_{}, t_guard_sent_{};
  safety::Mode sent_mode_ = safety::Mode::init;
  safety::Reason sent_cause_ = safety::Reason::none;
  std::uint32_t stop_counter_ = 0, pose_counter_ = 0, health_counter_ = 0,
                registration_counter_ = 0;
  std::uint32_t guard_counter_ = 0, robot_counter_ = 0;
  std::optional<msg::CompensatedPose> last_pose_;
  std::deque<Envelope> wire_;
  nanoseconds t_newest_arrival_{};  ///< a wire that delays does not reorder
  std::optional<Envelope> recorded_;

  guard::GuardCore guard_;
  guard::GuardCause guard_cause_ = guard::GuardCause::daemon_silent;
  client::PermissionCore client_;
  std::optional<client::Pose> kept_pose_;
  nanoseconds t_robot_report_{};
  bool was_permitted_ = false;
};

}  // namespace holdfast::fault
