// SPDX-License-Identifier: Apache-2.0
// A rig (microscope, projector, phantom and its CT scanner) as a program on two pipes: one JSON
// object a line, asked and answered. The virtual one is `holdfast-sim rig`; a real one is another
// program with the same requests (docs/interfaces.md, "Rig"). What it knows of the truth stays in
// it: only "depth-error" is answered from it, with figures.
#pragma once

#include <array>
#include <chrono>
#include <filesystem>
#include <limits>
#include <optional>
#include <string>
#include <vector>

#include <nlohmann/json_fwd.hpp>
#include <sys/types.h>

#include "registration/reconstruction.hpp"

namespace holdfast::rt {

/// A program and its arguments; the first is looked up in PATH.
using RigCommand = std::vector<std::string>;

/// Split at spaces. Throws InputError for an empty one.
[[nodiscard]] RigCommand rig_command(const std::string& text);
/// The command in one line, without the program's folder.
[[nodiscard]] std::string rig_text(const RigCommand& command);
/// `holdfast-sim rig` beside the running program, with further arguments.
[[nodiscard]] RigCommand virtual_rig(const std::vector<std::string>& arguments);

/// One stereo pair. Folders and files as absolute paths: the rig may run elsewhere.
struct PairRequest {
  std::filesystem::path out;  ///< folder for its images
  double zoom = 0;
  int pose = 0;          ///< of the object, 0 on; the same number is the same pose
  std::string lamps;     ///< filtered, or, microscope; empty: as the rig stands
  std::string pattern;   ///< a file (800x600, 8 bit), "random" (diffractive); empty: none
  bool has_off = false;  ///< also a pair of the same pose without the pattern, markers visible
};

struct RigPair {
  registration::StereoShot shot;
  registration::StereoShot off;  ///< only with PairRequest::has_off
};

/// Depth map against what the microscope truly saw. NaN: nothing is known there.
struct DepthJudgement {
  static constexpr double kUnknown = std::numeric_limits<double>::quiet_NaN();
  double coverage = kUnknown;  ///< share of what both cameras see
  double median_mm = kUnknown, mean_mm = kUnknown, p95_mm = kUnknown;
  double share_over_1_mm = kUnknown, share_over_1_mm_off_edges = kUnknown;
};
struct DepthQuestion {
  std::filesystem::path depth;        ///< TIFF, rectified left grid
  std::filesystem::path calibration;  ///< stereo.yaml it was made with
  double zoom = 0;
  int pose = 0;
};

/// The object moves by `motion` ("linear", "spiral", ... as the rig names them) below the left
/// camera, from its pose 0.
struct SequenceRequest {
  std::filesystem::path out;  ///< folder for frames and timestamps.csv
  double zoom = 0;
  std::string motion;
  double rate_hz = 0;
  std::string lamps;         ///< as PairRequest::lamps
  std::string disturbances;  ///< of the picture ("smoke:1:3", ... as the rig names them); or none
};
struct RigSequence {
  int frames = 0;
  cv::Rect region_px;  ///< of the left camera's image that the frames show
};
/// A trajectory against how the object truly moved. NaN: of nothing.
struct TrackingJudgement {
  int frames = 0, lost = 0, silently_wrong = 0;
  double step_mean_um = 0, step_sd_um = 0;  ///< frame to frame (paper B, Eq. 7)
  double absolute_rms_um = 0, absolute_max_um = 0, depth_rms_um = 0, rotation_rms_mrad = 0;
};
struct TrackingQuestion {
  SequenceRequest sequence;           ///< that was tracked
  std::filesystem::path poses;        ///< poses.csv
  std::filesystem::path calibration;  ///< stereo.yaml it was tracked with
  std::filesystem::path rows;         ///< to be written: the errors of each frame (CSV)
  /// Where it is judged; none: where the optical axis meets the site.
  std::optional<std::array<double, 3>> point_site_mm;
};

/// What a robot was told, and where its beam truly landed. NaN: it never was on.
struct BeamQuestion {
  SequenceRequest sequence;           ///< that was followed
  std::filesystem::path commands;     ///< CSV of run_closed_loop()
  std::filesystem::path calibration;  ///< stereo.yaml it was tracked with
  std::filesystem::path rows;         ///< to be written: target and beam, a row a millisecond (CSV)
};
struct BeamJudgement {
  double on_s = 0, on_share = 0;  ///< laser on; of the time since it first was
  double rms_um = 0, p99_um = 0, max_um = 0, uncompensated_rms_um = 0;
};

class Rig {
 public:
  /// Starts the command. Throws UnavailableError when it cannot be.
  explicit Rig(const RigCommand& command);
  /// Ends the program: it ends with its input, and is killed when it does not within a second.
  ~Rig();
  Rig(const Rig&) = delete;
  Rig& operator=(const Rig&) = delete;

  // All: one thread at a time. Throw RefusedError with the rig's own line when it could not do it,
  // UnavailableError with its last line on stderr when it has ended, InterruptedError after SIGINT
  // or SIGTERM, InputError for an unreadable image.

  /// In one line, as rig_text(): by which results are known.
  [[nodiscard]] const std::string& command() const noexcept { return command_; }

  /// out/zoom_Z/left_NN.png and right_NN.png: `pairs` views of the calibration board.
  void boards(double zoom, int pairs, const std::filesystem::path& out);
  /// The object's CT as DICOM files in `out`.
  void ct(const std::filesystem::path& out);
  [[nodiscard]] RigPair pair(const PairRequest& wanted);
  /// Only of a rig that knows the truth.
  [[nodiscard]] DepthJudgement depth_error(const DepthQuestion& question);
  [[nodiscard]] RigSequence sequence(const SequenceRequest& wanted);
  /// Only of a rig that knows the truth.
  [[nodiscard]] TrackingJudgement tracking_error(const TrackingQuestion& question);
  /// How late its robot's beam follows a slow motion.
  [[nodiscard]] std::chrono::nanoseconds robot_lag();
  /// Only of a rig that knows the truth.
  [[nodiscard]] BeamJudgement beam_error(const BeamQuestion& question);

 private:
  [[nodiscard]] nlohmann::json request(const nlohmann::json& what);
  [[nodiscard]] std::string read_line();
  [[noreturn]] void report_end() const;
  std::string name_, command_, unread_;
  pid_t pid_ = -1;
  int to_rig_ = -1, from_rig_ = -1, complaints_ = -1;
};

}  // namespace holdfast::rt
