// SPDX-License-Identifier: Apache-2.0
#include "bridge/live_view/live_layout.hpp"

#include <algorithm>
#include <bit>
#include <cmath>
#include <cstring>
#include <type_traits>

namespace holdfast::bridge {
namespace {

static_assert(std::endian::native == std::endian::little, "the layout is the memory's");

struct Header {
  char magic[8];
  std::uint32_t version, header_bytes;
  std::uint64_t sequence, frame;
  std::int64_t t_exposure_ns, t_utc_ns;
  std::int32_t width_px, height_px, channels, factor, camera_width_px, camera_height_px;
  std::int32_t points, inliers, visible, status, reason, has_motion;
  double fx_px, fy_px, cx_px, cy_px, plane_depth_mm;
  LivePoint from, to;
  std::uint64_t reserved[2];
};
static_assert(sizeof(Header) == kLiveHeaderBytes && std::is_trivially_copyable_v<Header>);
static_assert(offsetof(Header, sequence) == kLiveSequenceAt);

constexpr std::size_t kPointsBytes = kLivePointsMax * sizeof(LivePoint);

bool is_within(double value, double low, double high) noexcept {
  return value >= low && value <= high;  // NaN is not
}
bool is_within(LivePoint p, LivePoint low, LivePoint high) noexcept {
  return p.x_px >= low.x_px && p.x_px <= high.x_px && p.y_px >= low.y_px && p.y_px <= high.y_px;
}

bool is_side(int px) noexcept {
  return px >= kLiveSideMinPx && px <= kLiveSideMaxPx && px % kLiveMaskCellPx == 0;
}

/// What is shown, and no more than the rest of a division, makes the camera's side.
bool is_side_of(int px, int factor, int camera_px) noexcept {
  return camera_px <= kLiveCameraSideMaxPx && px * factor <= camera_px &&
         (px + kLiveMaskCellPx) * factor > camera_px;
}

bool is_size(const Header& h) noexcept {
  return is_side(h.width_px) && is_side(h.height_px) && (h.channels == 1 || h.channels == 3) &&
         h.factor >= 1 && h.factor <= kLiveFactorMax &&
         is_side_of(h.width_px, h.factor, h.camera_width_px) &&
         is_side_of(h.height_px, h.factor, h.camera_height_px);
}

std::size_t mask_bytes(const Header& h) noexcept {
  return static_cast<std::size_t>(h.width_px / kLiveMaskCellPx) *
         static_cast<std::size_t>(h.height_px / kLiveMaskCellPx);
}

std::size_t pixel_bytes(const Header& h) noexcept {
  return static_cast<std::size_t>(h.width_px) * static_cast<std::size_t>(h.height_px) *
         static_cast<std::size_t>(h.channels);
}

std::size_t bytes_of(const Header& h) noexcept {
  return sizeof h + kPointsBytes + mask_bytes(h) + pixel_bytes(h);
}

/// Anywhere the page may draw to; the site's motion may end outside the picture.
bool is_place(LivePoint p) noexcept {
  constexpr float kFarPx = 1e6;
  return is_within(p, {-kFarPx, -kFarPx}, {kFarPx, kFarPx});
}

bool is_inside(LivePoint p, const Header& h) noexcept {
  return is_within(p, {-1, -1}, {static_cast<float>(h.width_px), static_cast<float>(h.height_px)});
}

bool is_sound(const Header& h) noexcept {
  constexpr int kCountMax = 1'000'000;
  constexpr double kLengthMaxPx = 1e6, kDepthMaxMm = 1e4;
  constexpr auto kStatusMax = static_cast<int>(perception::TrackingStatus::lost);
  constexpr auto kReasonMax = static_cast<int>(perception::TrackingReason::out_of_focus);
  return is_size(h) && h.t_exposure_ns > 0 && h.t_utc_ns > 0 &&
         is_within(h.points, 0, static_cast<double>(kLivePointsMax)) &&
         is_within(h.inliers, 0, kCountMax) && is_within(h.visible, 0, kCountMax) &&
         is_within(h.status, 0, kStatusMax) && is_within(h.reason, 0, kReasonMax) &&
         is_within(h.has_motion, 0, 1) && is_within(h.fx_px, 1, kLengthMaxPx) &&
         is_within(h.fy_px, 1, kLengthMaxPx) && is_within(h.cx_px, -kLengthMaxPx, kLengthMaxPx) &&
         is_within(h.cy_px, -kLengthMaxPx, kLengthMaxPx) &&
         is_within(h.plane_depth_mm, 0, kDepthMaxMm) && is_place(h.from) && is_place(h.to);
}

Header header_of(const LivePicture& p, std::uint64_t sequence) noexcept {
  Header h{};
  std::memcpy(h.magic, kLiveMagic.data(), sizeof h.magic);
  h.version = kLiveVersion;
  h.header_bytes = sizeof h;
  h.sequence = sequence;
  h.frame = p.frame;
  h.t_exposure_ns = p.t_exposure.count();
  h.t_utc_ns = p.t_utc.count();
  h.width_px = p.width_px;
  h.height_px = p.height_px;
  h.channels = p.channels;
  h.factor = p.factor;
  h.camera_width_px = p.camera_width_px;
  h.camera_height_px = p.camera_height_px;
  h.points = static_cast<std::int32_t>(std::min(p.points.size(), kLivePointsMax));
  h.inliers = p.inliers;
  h.visible = p.visible;
  h.status = static_cast<std::int32_t>(p.status);
  h.reason = static_cast<std::int32_t>(p.reason);
  h.has_motion = p.has_motion ? 1 : 0;
  h.fx_px = p.fx_px;
  h.fy_px = p.fy_px;
  h.cx_px = p.cx_px;
  h.cy_px = p.cy_px;
  h.plane_depth_mm = p.plane_depth_mm;
  h.from = p.from;
  h.to = p.to;
  return h;
}

void take_header(const Header& h, LivePicture& p) {
  p.frame = h.frame;
  p.t_exposure = std::chrono::nanoseconds(h.t_exposure_ns);
  p.t_utc = std::chrono::nanoseconds(h.t_utc_ns);
  p.width_px = h.width_px;
  p.height_px = h.height_px;
  p.channels = h.channels;
  p.factor = h.factor;
  p.camera_width_px = h.camera_width_px;
  p.camera_height_px = h.camera_height_px;
  p.inliers = h.inliers;
  p.visible = h.visible;
  p.status = static_cast<perception::TrackingStatus>(h.status);
  p.reason = static_cast<perception::TrackingReason>(h.reason);
  p.has_motion = h.has_motion != 0;
  p.fx_px = h.fx_px;
  p.fy_px = h.fy_px;
  p.cx_px = h.cx_px;
  p.cy_px = h.cy_px;
  p.plane_depth_mm = h.plane_depth_mm;
  p.from = h.from;
  p.to = h.to;
}

LiveBytes judge(std::span<const std::uint8_t> bytes, Header& h) noexcept {
  if (bytes.empty()) return LiveBytes::unfinished;
  const std::size_t known = std::min(bytes.size(), kLiveMagic.size());
  const bool is_blank =
      std::all_of(bytes.begin(), bytes.begin() + static_cast<std::ptrdiff_t>(known),
                  [](std::uint8_t byte) { return byte == 0; });
  if (is_blank && bytes.size() <= sizeof h) return LiveBytes::unfinished;
  if (std::memcmp(bytes.data(), kLiveMagic.data(), known) != 0) return LiveBytes::not_ours;
  if (bytes.size() < sizeof h) return LiveBytes::damaged;
  std::memcpy(&h, bytes.data(), sizeof h);
  if (h.version != kLiveVersion || h.header_bytes != sizeof h) return LiveBytes::other_version;
  if (h.sequence % 2 != 0) return LiveBytes::unfinished;
  return is_sound(h) ? LiveBytes::picture : LiveBytes::damaged;
}

}  // namespace

bool pack_live(const LivePicture& picture, std::uint64_t sequence,
               std::vector<std::uint8_t>& bytes) {
  const Header h = header_of(picture, sequence);
  if (!is_sound(h) || picture.mask.size() != mask_bytes(h) ||
      picture.pixels.size() != pixel_bytes(h))
    return false;
  bytes.assign(bytes_of(h), 0);
  std::uint8_t* to = bytes.data();
  std::memcpy(to, &h, sizeof h);
  to += sizeof h;
  const auto points = static_cast<std::size_t>(h.points);
  if (points > 0) std::memcpy(to, picture.points.data(), points * sizeof(LivePoint));
  to = std::copy(picture.mask.begin(), picture.mask.end(), to + kPointsBytes);
  std::copy(picture.pixels.begin(), picture.pixels.end(), to);
  return true;
}

LiveBytes unpack_live(std::span<const std::uint8_t> bytes, LivePicture& picture) {
  Header h{};
  const LiveBytes verdict = judge(bytes, h);
  if (verdict != LiveBytes::picture) return verdict;
  if (bytes.size() < bytes_of(h)) return LiveBytes::damaged;
  take_header(h, picture);
  const std::uint8_t* from = bytes.data() + sizeof h;
  picture.points.resize(static_cast<std::size_t>(h.points));
  if (h.points > 0)
    std::memcpy(picture.points.data(), from, picture.points.size() * sizeof(LivePoint));
  if (!std::all_of(picture.points.begin(), picture.points.end(),
                   [&h](LivePoint p) { return is_inside(p, h); }))
    return LiveBytes::damaged;
  from += kPointsBytes;
  picture.mask.assign(from, from + mask_bytes(h));
  from += mask_bytes(h);
  picture.pixels.assign(from, from + pixel_bytes(h));
  return LiveBytes::picture;
}

}  // namespace holdfast::bridge
