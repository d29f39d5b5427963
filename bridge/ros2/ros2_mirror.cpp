// SPDX-License-Identifier: Apache-2.0
#include "bridge/ros2/ros2_mirror.hpp"

#include <memory>

#include <dds/dds.h>

#include "bridge/idl/ros2_mirror.h"

namespace holdfast::bridge::ros2 {
namespace {

using Header = std_msgs_msg_dds__Header_;
using TransformStamped = geometry_msgs_msg_dds__TransformStamped_;
using PoseStamped = geometry_msgs_msg_dds__PoseWithCovarianceStamped_;
using TfMessage = tf2_msgs_msg_dds__TFMessage_;
using KeyValue = diagnostic_msgs_msg_dds__KeyValue_;
using DiagnosticStatus = diagnostic_msgs_msg_dds__DiagnosticStatus_;
using Image = sensor_msgs_msg_dds__Image_;
using DiagnosticArray = diagnostic_msgs_msg_dds__DiagnosticArray_;

constexpr double kMetresPerMm = 1e-3;

struct FreeQos {
  void operator()(dds_qos_t* qos) const noexcept { dds_delete_qos(qos); }
};

/// What ROS 2 nodes ask for by default, and nothing that would keep them from matching: reliable
/// (matches best-effort readers too), no deadline, lifespan or latency budget.
dds::Entity make_writer(const dds::Participant& participant, const dds_topic_descriptor_t& type,
                        const char* name, dds_durability_kind_t durability, int depth) {
  const dds::Entity topic(dds_create_topic(participant.handle(), &type, name, nullptr, nullptr),
                          std::string("create topic ") + name);
  const std::unique_ptr<dds_qos_t, FreeQos> qos(dds_create_qos());
  dds_qset_reliability(qos.get(), DDS_RELIABILITY_RELIABLE, 0);  // no write waits
  dds_qset_durability(qos.get(), durability);
  dds_qset_history(qos.get(), DDS_HISTORY_KEEP_LAST, depth);
  dds_qset_writer_data_lifecycle(qos.get(), false);  // a writer that ends makes no sample
  return {dds_create_writer(participant.handle(), topic.handle(), qos.get(), nullptr),
          std::string("write ") + name};
}

// The C types hold plain pointers: what they point to is the caller's and outlives the write, which
// does not change it.
char* text(const std::string& s) {
  return const_cast<char*>(s.c_str());  // NOLINT(cppcoreguidelines-pro-type-const-cast)
}

template <class Sequence, class T>
void put(std::vector<T>& from, Sequence& to) {
  to._buffer = from.data();
  to._length = to._maximum = static_cast<std::uint32_t>(from.size());
  to._release = false;
}

Header header(std::chrono::nanoseconds t_utc, const std::string& frame) {
  const auto seconds = std::chrono::floor<std::chrono::seconds>(t_utc);
  Header result{};
  result.stamp.sec = static_cast<std::int32_t>(seconds.count());
  result.stamp.nanosec = static_cast<std::uint32_t>((t_utc - seconds).count());
  result.frame_id = text(frame);
  return result;
}

geometry_msgs_msg_dds__Quaternion_ quaternion(const Eigen::Quaterniond& q) {
  return {q.x(), q.y(), q.z(), q.w()};
}

TransformStamped to_ros(const StampedTransform& from) {
  TransformStamped result{};
  result.header = header(from.t_utc, from.frame);
  result.child_frame_id = text(from.child_frame);
  const Eigen::Vector3d t = from.T_frame_child_mm.translation() * kMetresPerMm;
  result.transform.translation = {t.x(), t.y(), t.z()};
  result.transform.rotation =
      quaternion(Eigen::Quaterniond(from.T_frame_child_mm.linear()).normalized());
  return result;
}

bool write(const dds::Entity& writer, const void* sample) {
  return dds_write(writer.handle(), sample) == DDS_RETCODE_OK;
}

bool write_transforms(const dds::Entity& writer, std::span<const StampedTransform> transforms) {
  std::vector<TransformStamped> all;
  all.reserve(transforms.size());
  for (const StampedTransform& transform : transforms) all.push_back(to_ros(transform));
  TfMessage message{};
  put(all, message.transforms);
  return write(writer, &message);
}

}  // namespace

Mirror::Mirror(const dds::ParticipantParameters& participant, bool has_images)
    : participant_(participant),
      tf_(make_writer(participant_, tf2_msgs_msg_dds__TFMessage__desc, kTfTopic,
                      DDS_DURABILITY_VOLATILE, 100)),
      tf_static_(make_writer(participant_, tf2_msgs_msg_dds__TFMessage__desc, kTfStaticTopic,
                             DDS_DURABILITY_TRANSIENT_LOCAL, 1)),
      pose_(make_writer(participant_, geometry_msgs_msg_dds__PoseWithCovarianceStamped__desc,
                        kPoseTopic, DDS_DURABILITY_VOLATILE, 10)),
      diagnostics_(make_writer(participant_, diagnostic_msgs_msg_dds__DiagnosticArray__desc,
                               kDiagnosticsTopic, DDS_DURABILITY_VOLATILE, 10)) {
  if (has_images)
    image_.emplace(make_writer(participant_, sensor_msgs_msg_dds__Image__desc, kImageTopic,
                               DDS_DURABILITY_VOLATILE, 1));
}

bool Mirror::publish(std::span<const StampedTransform> transforms) {
  return write_transforms(tf_, transforms);
}

bool Mirror::publish_static(std::span<const StampedTransform> transforms) {
  return write_transforms(tf_static_, transforms);
}

bool Mirror::publish(const StampedPose& pose) {
  PoseStamped message{};
  message.header = header(pose.t_utc, pose.frame);
  const Eigen::Vector3d p = pose.position_mm * kMetresPerMm;
  message.pose.pose.position = {p.x(), p.y(), p.z()};
  message.pose.pose.orientation = quaternion(pose.orientation);
  for (int row = 0; row < 6; ++row)
    for (int column = 0; column < 6; ++column) {
      const double unit = (row < 3 ? kMetresPerMm : 1) * (column < 3 ? kMetresPerMm : 1);
      message.pose.covariance[6 * row + column] = pose.covariance(row, column) * unit;
    }
  return write(pose_, &message);
}

bool Mirror::publish(std::chrono::nanoseconds t_utc, std::span<const Diagnostic> diagnostics) {
  const std::string no_frame;
  const std::string hardware = "holdfast";
  std::vector<std::vector<KeyValue>> values(diagnostics.size());
  std::vector<DiagnosticStatus> all(diagnostics.size());
  for (std::size_t i = 0; i < diagnostics.size(); ++i) {
    const Diagnostic& from = diagnostics[i];
    for (const auto& [key, value] : from.values) values[i].push_back({text(key), text(value)});
    all[i].level = static_cast<std::uint8_t>(from.level);
    all[i].name = text(from.name);
    all[i].message = text(from.message);
    all[i].hardware_id = text(hardware);
    put(values[i], all[i].values);
  }
  DiagnosticArray message{};
  message.header = header(t_utc, no_frame);
  put(all, message.status);
  return write(diagnostics_, &message);
}

bool Mirror::publish(const StampedImage& image) {
  if (!image_) return false;
  const std::string encoding = image.channels == 3 ? "rgb8" : "mono8";
  Image message{};
  message.header = header(image.t_utc, image.frame);
  message.height = static_cast<std::uint32_t>(image.height_px);
  message.width = static_cast<std::uint32_t>(image.width_px);
  message.encoding = text(encoding);
  message.step = static_cast<std::uint32_t>(image.width_px * image.channels);
  // The write does not change it.
  message.data._buffer =
      const_cast<std::uint8_t*>(  // NOLINT(cppcoreguidelines-pro-type-const-cast)
          image.pixels.data());
  message.data._length = message.data._maximum = static_cast<std::uint32_t>(image.pixels.size());
  return write(*image_, &message);
}

}  // namespace holdfast::bridge::ros2
