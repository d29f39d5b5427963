// SPDX-License-Identifier: Apache-2.0
// Keyframes taken later, as the first one leaves the view: each tied to the first by a pose with
// its covariance, proved on other frames before it is used, tied anew when the first is seen again,
// and dropped, all of them, when the first then says otherwise.
//
// What a tied keyframe knows of the site's shape is the first one's, seen from where its own camera
// stood. Where that is unknown it has no patches: the range gained ends with the surface that was
// given, not with the first keyframe's image.
#pragma once

#include <memory>
#include <optional>
#include <vector>

#include <opencv2/core.hpp>

#include "perception/direct_keyframe.hpp"
#include "perception/projection.hpp"
#include "perception/pyramid.hpp"
#include "perception/tie.hpp"

namespace holdfast::perception {

struct TiedKeyframe {
  DirectKeyframe key;
  Tie tie;
  int number = 0;  ///< 1, 2, ...: as MotionEstimate::keyframe
  int proofs = 0;
};

/// What is to become of a frame that has been estimated.
struct TieVerdict {
  enum class Change : std::uint8_t {
    none,
    to_first,  ///< `next_pose` is the frame's since the first keyframe
    to_tied,   ///< the keyframe to use is `next`
    doubted    ///< the tie in use is wrong: the first is to be used, and all to be dropped
  };
  Change change = Change::none;
  TiedKeyframe* next = nullptr;
  Alignment of_first;  ///< to_first; doubted: if solved, the first keyframe's own word
  /// The pose is known too badly, too few patches agree, or the first is not where it should be.
  bool is_loose = false;
};

class KeyframeMaker;

/// Belongs to one first keyframe. One thread at a time. Bounded: keyframes_max, one more in the
/// making, and those given up until the next is made.
class TiedKeyframes {
 public:
  /// With check.is_threaded they are made on a thread of their own, else in tend().
  TiedKeyframes(const CameraModel& camera, const TrackerParameters& parameters);
  ~TiedKeyframes();
  TiedKeyframes(TiedKeyframes&&) noexcept;
  TiedKeyframes& operator=(TiedKeyframes&&) noexcept;

  /// All gone: there is a new first keyframe. `moving_half` as in make_direct_keyframe().
  void start(const cv::Mat& moving_half);
  /// All gone: the first is in use.
  void drop_all();

  /// The one in use; none: the first is.
  [[nodiscard]] TiedKeyframe* current() const noexcept { return current_; }
  void use(TiedKeyframe* next) noexcept {
    current_ = next;
    frames_since_first_ = misses_ = 0;
  }
  /// Lost: which of them to look for in this frame, in turn; none when there is none.
  [[nodiscard]] TiedKeyframe* to_look_for();

  /// The frame's pose since the first.
  [[nodiscard]] CheckedPose since_first(const DirectKeyframe& first,
                                        const CheckedPose& since_current) const;

  /// After every frame that is not lost: proves, makes, ties anew, decides. `out` is since the
  /// keyframe in use; the comparison with the first is noted in it.
  [[nodiscard]] TieVerdict tend(DirectKeyframe& first, const cv::Mat& image, const Pyramid& pyramid,
                                MotionEstimate& out);

 private:
  void collect();
  void prove(const DirectKeyframe& first, const Pyramid& pyramid, const CheckedPose& now);
  void order_if_due(const DirectKeyframe& first, const cv::Mat& image, const CheckedPose& now,
                    const MotionEstimate& out);
  void make_room(const Eigen::Isometry3d& T_camera_first);
  [[nodiscard]] TieVerdict watch_first(DirectKeyframe& first, const cv::Mat& image,
                                       const Pyramid& pyramid, const CheckedPose& now,
                                       MotionEstimate& out);
  [[nodiscard]] bool is_contradicted_by_features(DirectKeyframe& first, const cv::Mat& image,
                                                 const CheckedPose& now) const;
  [[nodiscard]] TiedKeyframe* best(const Eigen::Isometry3d& T_camera_first) const;
  [[nodiscard]] double overlap(const DirectKeyframe& key,
                               const Eigen::Isometry3d& T_camera_key) const;
  [[nodiscard]] double strain(const DirectKeyframe& key, const Eigen::Isometry3d& T_camera_key,
                              double overlap) const;
  [[nodiscard]] bool differs(const PoseDifference& difference) const;
  [[nodiscard]] bool is_loose(const Matrix6d& covariance) const;

  CameraModel camera_;
  TrackerParameters parameters_;
  Projector projector_;
  cv::Mat moving_half_;
  std::unique_ptr<KeyframeMaker> maker_;
  std::vector<std::unique_ptr<TiedKeyframe>> tied_, given_up_;
  std::unique_ptr<TiedKeyframe> newcomer_;
  TiedKeyframe* current_ = nullptr;
  std::optional<Eigen::Isometry3d> T_asked_first_;  // where the last one was asked for
  int made_ = 0, dropped_ = 0;                      // numbers: of the newest, and of those gone
  int frames_since_first_ = 0, misses_ = 0, looked_for_ = 0;
};

}  // namespace holdfast::perception
