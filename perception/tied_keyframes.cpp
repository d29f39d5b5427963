// SPDX-License-Identifier: Apache-2.0
#include "perception/tied_keyframes.hpp"

#include <algorithm>
#include <cmath>
#include <utility>

#include "perception/keyframe_maker.hpp"
#include "perception/tracker_rules.hpp"

namespace holdfast::perception {
namespace {

constexpr int kMissesMax = 2;        // times that the first is not where it should be seen well
constexpr double kMovedPx = 6;       // typically in the image: a frame that can prove something
constexpr double kElsewhere = 0.12;  // of the image's width, or rad: worth another attempt
constexpr double kContrastMin = 0.8, kContrastMax = 1.25;  // a blurred frame makes no keyframe

/// By how much the image has moved between two poses since the first, px, and turned, rad.
struct Move {
  double px, rad;
};
Move move_between(const Eigen::Isometry3d& T_a_first, const Eigen::Isometry3d& T_b_first,
                  const CameraModel& camera, double z_mm) {
  const Eigen::Isometry3d T_b_a = T_b_first * T_a_first.inverse(Eigen::Isometry);
  const Eigen::Vector3d p(0, 0, z_mm);
  const double rad = Eigen::AngleAxisd(T_b_a.linear()).angle();
  const double middle_px = camera.f_px() * (project(T_b_a * p) - project(p)).norm();
  return {std::max(middle_px, 0.25 * camera.width_px * rad), rad};
}

}  // namespace

TiedKeyframes::TiedKeyframes(const CameraModel& camera, const TrackerParameters& parameters)
    : camera_(camera), parameters_(parameters), projector_(camera) {
  camera_.distortion = camera.distortion.clone();
  tied_.reserve(static_cast<std::size_t>(parameters.ties.keyframes_max));
  given_up_.reserve(2 * tied_.capacity() + 2);
}
TiedKeyframes::~TiedKeyframes() = default;
TiedKeyframes::TiedKeyframes(TiedKeyframes&&) noexcept = default;
TiedKeyframes& TiedKeyframes::operator=(TiedKeyframes&&) noexcept = default;

void TiedKeyframes::start(const cv::Mat& moving_half) {
  drop_all();
  moving_half_ = moving_half.clone();
  if (parameters_.ties.keyframes_max > 0 && !maker_)
    maker_ = std::make_unique<KeyframeMaker>(camera_, parameters_, parameters_.check.is_threaded);
}

void TiedKeyframes::drop_all() {
  for (auto& tied : tied_) given_up_.push_back(std::move(tied));
  tied_.clear();
  if (newcomer_) given_up_.push_back(std::move(newcomer_));
  dropped_ = made_;
  T_asked_first_.reset();
  use(nullptr);
}

TiedKeyframe* TiedKeyframes::to_look_for() {
  if (tied_.empty()) return nullptr;
  return tied_[static_cast<std::size_t>(looked_for_++) % tied_.size()].get();
}

CheckedPose TiedKeyframes::since_first(const DirectKeyframe& first,
                                       const CheckedPose& since_current) const {
  if (current_ == nullptr) return since_current;
  return through(current_->tie, since_current, current_->key.given.site.p_pivot_mm(),
                 first.given.site.p_pivot_mm());
}

/// Share of the keyframe's patches whose middle is in the image.
double TiedKeyframes::overlap(const DirectKeyframe& key,
                              const Eigen::Isometry3d& T_camera_key) const {
  constexpr double kMarginPx = 6;
  const auto& patches = key.patches[0].geometry;
  const auto visible = std::count_if(patches.begin(), patches.end(), [&](const auto& patch) {
    const Eigen::Vector3d p = T_camera_key * patch.p_site_mm;
    if (!(p.z() > 1e-3)) return false;
    const Eigen::Vector2d u = projector_.pixel(p);
    return u.x() > kMarginPx && u.y() > kMarginPx && u.x() < camera_.width_px - kMarginPx &&
           u.y() < camera_.height_px - kMarginPx;
  });
  return static_cast<double>(visible) / static_cast<double>(patches.size());
}

/// How far a pose is from its keyframe: 1 where it is of no more use.
double TiedKeyframes::strain(const DirectKeyframe& key, const Eigen::Isometry3d& T_camera_key,
                             double overlap) const {
  const Eigen::Vector3d& p = key.given.site.p_centre_mm();
  const double scale = p.z() / (T_camera_key * p).z();
  return std::max(
      {(1 - overlap) / (1 - parameters_.ties.overlap_min),
       std::abs(scale - 1) / parameters_.health.scale_change_max,
       Eigen::AngleAxisd(T_camera_key.linear()).angle() / parameters_.health.rotation_max_rad});
}

bool TiedKeyframes::differs(const PoseDifference& difference) const {
  return difference.um > parameters_.check.limit_um ||
         (difference.um > parameters_.ties.limit_um &&
          difference.sigma > parameters_.ties.limit_sigma);
}

bool TiedKeyframes::is_loose(const Matrix6d& covariance) const {
  return !(sigma_um(covariance) <= parameters_.ties.sigma_max_um &&
           rotation_sigma_rad(covariance) <= parameters_.ties.rotation_sigma_max_rad);
}

/// Of an order given before all were dropped nothing is wanted any more.
void TiedKeyframes::collect() {
  auto made = maker_->take();
  if (!made || !made->keyframe) return;
  auto& to = made->keyframe->number > dropped_ ? newcomer_ : given_up_.emplace_back();
  to = std::move(made->keyframe);
}

/// The keyframe at whose sight the most patches are in view.
TiedKeyframe* TiedKeyframes::best(const Eigen::Isometry3d& T_camera_first) const {
  TiedKeyframe* best = nullptr;
  double most = 0;
  for (const auto& tied : tied_) {
    const Eigen::Isometry3d T = T_camera_first * tied->tie.T_tied_first.inverse(Eigen::Isometry);
    const double share = overlap(tied->key, T);
    const double visible = share * static_cast<double>(tied->key.patches[0].size());
    if (visible <= most || strain(tied->key, T, share) >= parameters_.ties.strain_leave) continue;
    most = visible;
    best = tied.get();
  }
  return most >= parameters_.direct.inliers_good ? best : nullptr;
}

/// The one farthest from here goes.
void TiedKeyframes::make_room(const Eigen::Isometry3d& T_camera_first) {
  if (tied_.size() < static_cast<std::size_t>(parameters_.ties.keyframes_max)) return;
  auto farthest = tied_.end();
  double most = -1;
  for (auto i = tied_.begin(); i != tied_.end(); ++i) {
    const Eigen::Isometry3d T = T_camera_first * (*i)->tie.T_tied_first.inverse(Eigen::Isometry);
    const double s = strain((*i)->key, T, overlap((*i)->key, T));
    if (i->get() == current_ || s <= most) continue;
    most = s;
    farthest = i;
  }
  if (farthest == tied_.end()) return;
  given_up_.push_back(std::move(*farthest));
  tied_.erase(farthest);
}

/// Another frame must see the same motion by the newcomer as without it.
void TiedKeyframes::prove(const DirectKeyframe& first, const Pyramid& pyramid,
                          const CheckedPose& now) {
  const TieParameters& p = parameters_.ties;
  if (!newcomer_) return;
  DirectKeyframe& key = newcomer_->key;
  const Tie& tie = newcomer_->tie;
  const Eigen::Vector3d& p_pivot = key.given.site.p_pivot_mm();
  if (move_between(tie.T_tied_first, now.T_camera_site, camera_, p_pivot.z()).px <
      kMovedPx * (1 + newcomer_->proofs))
    return;
  const Eigen::Isometry3d T_start = now.T_camera_site * tie.T_tied_first.inverse(Eigen::Isometry);
  const Alignment a = key.aligner.align(key.patches, pyramid, T_start, 1);
  const bool is_sound = a.is_solved && a.quality.inliers >= parameters_.direct.inliers_good &&
                        a.quality.inliers >= p.share_good * a.quality.visible;
  if (!is_sound || differs(between(through(tie, {a.T_camera_site, a.covariance}, p_pivot,
                                           first.given.site.p_pivot_mm()),
                                   now, first.given.site.p_pivot_mm()))) {
    given_up_.push_back(std::move(newcomer_));
    return;
  }
  if (++newcomer_->proofs < p.proofs) return;
  make_room(now.T_camera_site);
  tied_.push_back(std::move(newcomer_));
}

void TiedKeyframes::order_if_due(const DirectKeyframe& first, const cv::Mat& image,
                                 const CheckedPose& now, const MotionEstimate& out) {
  const TieParameters& p = parameters_.ties;
  if (newcomer_ || !maker_->is_idle()) return;
  if (out.inliers < p.share_good * out.matches || out.contrast < kContrastMin ||
      out.contrast > kContrastMax || is_loose(now.covariance))
    return;
  if (T_asked_first_) {
    const Move move = move_between(*T_asked_first_, now.T_camera_site, camera_,
                                   first.given.site.p_pivot_mm().z());
    if (move.px < kElsewhere * camera_.width_px && move.rad < kElsewhere) return;
  }
  for (const auto& tied : tied_) {
    const Eigen::Isometry3d T = now.T_camera_site * tied->tie.T_tied_first.inverse(Eigen::Isometry);
    if (strain(tied->key, T, overlap(tied->key, T)) < p.strain_new) return;  // one sees this well
  }
  T_asked_first_ = now.T_camera_site;
  KeyframeOrder order;
  order.image = image;
  order.site = first.given.site;
  order.mask = first.given.mask;
  order.moving_half = moving_half_;
  order.tie = {now.T_camera_site, now.covariance};
  order.number = ++made_;
  order.given_up.swap(given_up_);
  given_up_.reserve(2 * tied_.capacity() + 2);
  maker_->order(std::move(order));
}

/// The first keyframe's features see the site elsewhere than the tied keyframe says.
bool TiedKeyframes::is_contradicted_by_features(DirectKeyframe& first, const cv::Mat& image,
                                                const CheckedPose& now) const {
  const auto check = first.features.next(image, now, false);
  if (!check || !check->motion.fit) return false;  // it may be out of view
  const MotionFit& fit = *check->motion.fit;
  const double um = displacement_um(check->of.T_camera_site, fit.pose.T_camera_site,
                                    first.given.site.p_pivot_mm());
  const CheckParameters& p = parameters_.check;
  return um >
         p.limit_um + p.limit_sigma * (sigma_um(fit.covariance) + sigma_um(check->of.covariance));
}

TieVerdict TiedKeyframes::watch_first(DirectKeyframe& first, const cv::Mat& image,
                                      const Pyramid& pyramid, const CheckedPose& now,
                                      MotionEstimate& out) {
  const TieParameters& p = parameters_.ties;
  const Eigen::Vector3d& p_first = first.given.site.p_pivot_mm();
  TieVerdict verdict;
  // Fewer agree than where it was made: something moves by itself, and the first may know what.
  const bool is_disputed = out.inliers < p.share_good * out.matches;
  verdict.is_loose = is_loose(now.covariance) || misses_ > kMissesMax || is_disputed;
  const auto doubt = [&]() -> TieVerdict& {
    verdict.change = TieVerdict::Change::doubted;
    return verdict;
  };
  if (is_contradicted_by_features(first, image, now)) return doubt();
  if (++frames_since_first_ < p.watch_every && !is_disputed) return verdict;
  frames_since_first_ = 0;
  const double seen = overlap(first, now.T_camera_site);
  if (seen * static_cast<double>(first.patches[0].size()) < 1.5 * parameters_.direct.inliers_min)
    return verdict;
  const Alignment a =
      first.aligner.align(first.patches, pyramid, now.T_camera_site, kPyramidLevels - 1);
  const bool is_sound = a.is_solved && a.quality.inliers >= parameters_.direct.inliers_min &&
                        a.quality.inliers >= parameters_.direct.share_good * a.quality.visible &&
                        a.quality.spread >= parameters_.health.spread_min;
  if (!is_sound) {
    const bool is_well_in_view = strain(first, now.T_camera_site, seen) < p.strain_leave;
    misses_ = is_well_in_view ? misses_ + 1 : 0;
    return verdict;
  }
  misses_ = 0;
  const CheckedPose word{a.T_camera_site, a.covariance};
  const PoseDifference difference = between(now, word, p_first);
  out.has_tie_jump = true;
  out.tie_jump_um = difference.um;
  out.tie_jump_sigma = difference.sigma;
  verdict.of_first = a;
  if (differs(difference)) return doubt();
  const Tie again = tie_between({out.T_camera_site, out.covariance}, word,
                                current_->key.given.site.p_pivot_mm(), p_first);
  if (sigma_um(again.covariance) < sigma_um(current_->tie.covariance)) current_->tie = again;
  const double share =
      static_cast<double>(a.quality.visible) / static_cast<double>(first.patches[0].size());
  if (strain(first, a.T_camera_site, share) < p.strain_new)
    verdict.change = TieVerdict::Change::to_first;
  return verdict;
}

TieVerdict TiedKeyframes::tend(DirectKeyframe& first, const cv::Mat& image, const Pyramid& pyramid,
                               MotionEstimate& out) {
  TieVerdict verdict;
  if (!maker_) return verdict;
  collect();
  const CheckedPose now = since_first(first, {out.T_camera_site, out.covariance});
  if (current_ != nullptr) {
    verdict = watch_first(first, image, pyramid, now, out);
    if (verdict.change != TieVerdict::Change::none) return verdict;
  }
  const bool is_good = out.status == TrackingStatus::tracking && !verdict.is_loose;
  if (is_good) prove(first, pyramid, now);
  const double in_view = static_cast<double>(out.matches) / std::max(out.features, 1);
  const double strain_now =
      strain(current_ != nullptr ? current_->key : first, out.T_camera_site, in_view);
  if (is_good && strain_now > parameters_.ties.strain_new) order_if_due(first, image, now, out);
  const bool is_leaving = strain_now > parameters_.ties.strain_leave &&
                          (is_good || out.reason == TrackingReason::too_few_inliers ||
                           out.reason == TrackingReason::inliers_bunched);
  if (!is_leaving) return verdict;
  verdict.next = best(now.T_camera_site);
  if (verdict.next != nullptr && verdict.next != current_)
    verdict.change = TieVerdict::Change::to_tied;
  return verdict;
}

}  // namespace holdfast::perception
