// SPDX-License-Identifier: Apache-2.0
// Surfaces, depth maps, DICOM slices, live views, recordings.
#include <algorithm>
#include <string>
#include <string_view>

#include <opencv2/imgcodecs.hpp>

#include "bridge/depth_file.hpp"
#include "bridge/live_view/live_layout.hpp"
#include "bridge/recorder/mcap_reader.hpp"
#include "bridge/recorder/mcap_writer.hpp"
#include "registration/ct/dicom_header.hpp"
#include "registration/ct/dicom_pixels.hpp"
#include "registration/mesh_file.hpp"
#include "rt/core/error.hpp"
#include "rt/recording_file.hpp"
#include "rt/replay.hpp"
#include "tests/fuzz/memory_file.hpp"
#include "tests/fuzz/targets.hpp"

namespace holdfast::fuzz {
namespace {

constexpr int kDepthWidth = 8, kDepthHeight = 6;

std::vector<Bytes> mesh_seeds() {
  registration::TriangleMesh mesh;
  for (int i = 0; i < 5; ++i)
    mesh.vertices_mm.emplace_back(static_cast<float>(i), static_cast<float>(i * i), 200.0F);
  mesh.triangles = {{0, 1, 2}, {1, 2, 3}, {2, 3, 4}};
  mesh.R_rectified_camera = Eigen::Matrix3d::Identity();
  return {bytes_of_text(ply_bytes(mesh)), bytes_of_text(stl_bytes(mesh))};
}

void take_mesh(std::span<const std::uint8_t> bytes) {
  const MemoryFile file(bytes);
  const registration::TriangleMesh mesh = registration::read_mesh(file.path());
  require(!mesh.vertices_mm.empty(), "a surface without vertices");
  for (const Eigen::Vector3f& vertex : mesh.vertices_mm)
    require(vertex.allFinite(), "a vertex that is no number");
  for (const auto& triangle : mesh.triangles)
    for (const std::uint32_t index : triangle)
      require(index < mesh.vertices_mm.size(), "an index out of range");
}

std::vector<Bytes> depth_seeds() {
  const cv::Mat depth(kDepthHeight, kDepthWidth, CV_32FC1, cv::Scalar(200));
  Bytes bytes;
  cv::imencode(".tiff", depth, bytes);
  return {bytes};
}

void take_depth(std::span<const std::uint8_t> bytes) {
  const MemoryFile file(bytes);
  const cv::Mat depth = bridge::read_depth_file(file.path(), kDepthWidth, kDepthHeight);
  require(depth.type() == CV_32FC1 && depth.cols == kDepthWidth && depth.rows == kDepthHeight,
          "a depth map of another kind");
}

/// Explicit VR, little-endian; the value is padded to an even length.
std::string element(unsigned group, unsigned number, std::string_view vr, std::string value) {
  if (value.size() % 2 != 0) value += vr == "UI" ? '\0' : ' ';
  const auto bytes = [](std::size_t n, int count) {
    std::string text;
    for (int i = 0; i < count; ++i) text += static_cast<char>(n >> (8U * static_cast<unsigned>(i)));
    return text;
  };
  std::string head = bytes(group, 2) + bytes(number, 2) + std::string(vr);
  head += vr == "OW" ? std::string(2, '\0') + bytes(value.size(), 4) : bytes(value.size(), 2);
  return head + value;
}

std::string number16(unsigned n) {
  return {static_cast<char>(n & 0xffU), static_cast<char>(n >> 8U)};
}

/// A slice of 4 x 4.
std::vector<Bytes> dicom_seeds() {
  const std::string slice =
      element(0x0008, 0x0016, "UI", "1.2.840.10008.5.1.4.1.1.2") +
      element(0x0008, 0x0060, "CS", "CT") + element(0x0010, 0x0020, "LO", "ear") +
      element(0x0020, 0x0032, "DS", "0\\0\\0") + element(0x0020, 0x0037, "DS", "1\\0\\0\\0\\1\\0") +
      element(0x0028, 0x0002, "US", number16(1)) + element(0x0028, 0x0004, "CS", "MONOCHROME2") +
      element(0x0028, 0x0010, "US", number16(4)) + element(0x0028, 0x0011, "US", number16(4)) +
      element(0x0028, 0x0030, "DS", "0.5\\0.5") + element(0x0028, 0x0100, "US", number16(16)) +
      element(0x0028, 0x0101, "US", number16(16)) + element(0x0028, 0x0102, "US", number16(15)) +
      element(0x0028, 0x0103, "US", number16(1)) + element(0x0028, 0x1052, "DS", "-1024") +
      element(0x0028, 0x1053, "DS", "1") + element(0x7fe0, 0x0010, "OW", std::string(32, '\1'));
  std::vector<Bytes> seeds;
  // As it is, as JPEG lossless, as RLE: what follows the pixels' head then is none, and is refused.
  for (const char* syntax :
       {"1.2.840.10008.1.2.1", "1.2.840.10008.1.2.4.70", "1.2.840.10008.1.2.5"})
    seeds.push_back(bytes_of_text(std::string(128, '\0') + "DICM" +
                                  element(0x0002, 0x0010, "UI", syntax) + slice));
  return seeds;
}

void take_dicom(std::span<const std::uint8_t> bytes) {
  constexpr std::int64_t kPixelsMax = 1 << 20;  // more would only take longer
  const MemoryFile file(bytes);
  const auto header = registration::read_dicom_header(file.path());
  if (!header) return;
  const registration::PixelLayout layout = registration::pixel_layout(*header);
  const std::int64_t pixels = std::int64_t{layout.rows} * layout.columns;
  if (pixels > kPixelsMax) return;
  std::vector<std::int16_t> hu(static_cast<std::size_t>(pixels));
  (void)registration::decode_hu(*header, layout, hu);
}

std::vector<Bytes> live_seeds() {
  bridge::LivePicture picture;
  picture.width_px = picture.height_px = picture.camera_width_px = picture.camera_height_px = 16;
  picture.t_exposure = picture.t_utc = std::chrono::nanoseconds(1);
  picture.points = {{1, 2}, {3, 4}};
  picture.mask.resize(16);
  picture.pixels.resize(256);
  Bytes grey, colour;
  require(pack_live(picture, 2, grey), "a seed that is none");
  picture.channels = 3;
  picture.pixels.resize(768);
  require(pack_live(picture, 2, colour), "a seed that is none");
  return {grey, colour};
}

void take_live(std::span<const std::uint8_t> bytes) {
  bridge::LivePicture picture;
  if (unpack_live(bytes, picture) != bridge::LiveBytes::picture)
    throw InputError("no live picture");
  const auto width = static_cast<std::size_t>(picture.width_px),
             height = static_cast<std::size_t>(picture.height_px);
  require(picture.pixels.size() == width * height * static_cast<std::size_t>(picture.channels),
          "pixels of another size");
  require(picture.mask.size() == (width / 4) * (height / 4), "a mask of another size");
  Bytes again;
  require(pack_live(picture, 2, again), "a picture that cannot be written");
}

/// A session and one cycle, as the daemon writes them.
std::string recording() {
  rt::RecordingFile file({}, rt::RecordedRegistration{});
  file.add(rt::TapedCycle{});
  file.mcap().finish();
  return file.mcap().pending();
}

std::vector<Bytes> recording_seeds() {
  return {bytes_of_text(recording())};
}

void take_recording(std::span<const std::uint8_t> bytes) {
  const MemoryFile file(bytes);
  (void)rt::replay({file.path()});
}

/// What stands in a recording's message, behind checksums that are right: the first byte says which
/// of its messages becomes the rest.
void take_recorded_message(std::span<const std::uint8_t> bytes) {
  if (bytes.empty()) return;
  static const Bytes whole = bytes_of_text(recording());
  const MemoryFile source(whole);
  bridge::mcap::Reader reader(source.path());
  bridge::mcap::Writer writer("fuzz");
  bridge::mcap::Message message;
  for (unsigned number = 0; reader.next(message); ++number) {
    const auto& channel = *message.channel;
    const auto schema =
        writer.add_schema(channel.schema.name, channel.schema.encoding, channel.schema.text);
    const auto id = writer.add_channel(schema, channel.topic, channel.encoding);
    const std::string_view other(reinterpret_cast<const char*>(bytes.data()) + 1, bytes.size() - 1);
    writer.message(id, message.sequence,
                   std::chrono::nanoseconds(static_cast<std::int64_t>(message.t_log_ns)),
                   number == bytes[0] ? other : message.data);
  }
  writer.finish();
  const Bytes changed = bytes_of_text(writer.pending());
  const MemoryFile file(changed);
  (void)rt::replay({file.path()});
}

std::vector<Bytes> recorded_message_seeds() {
  const Bytes whole = bytes_of_text(recording());
  const MemoryFile source(whole);
  bridge::mcap::Reader reader(source.path());
  bridge::mcap::Message message;
  std::vector<Bytes> seeds;
  while (reader.next(message)) {
    seeds.push_back({static_cast<std::uint8_t>(seeds.size())});
    seeds.back().insert(seeds.back().end(), message.data.begin(), message.data.end());
  }
  return seeds;
}

}  // namespace

std::span<const Target> binary_targets() {
  static const Target targets[] = {
      {"mesh", mesh_seeds, take_mesh},
      {"depth", depth_seeds, take_depth},
      {"dicom", dicom_seeds, take_dicom},
      {"live_view", live_seeds, take_live},
      {"recording", recording_seeds, take_recording},
      {"recorded_message", recorded_message_seeds, take_recorded_message}};
  return targets;
}

}  // namespace holdfast::fuzz
