// SPDX-License-Identifier: Apache-2.0
#include "bridge/openigtlink/igtl_messages.hpp"

#include <cstring>
#include <limits>

#include <igtlImageMessage.h>
#include <igtlStatusMessage.h>
#include <igtlTransformMessage.h>

namespace holdfast::bridge::openigtlink {
namespace {

constexpr std::size_t kDeviceLengthMax = 20, kErrorNameLengthMax = 19;

/// Header, time and the packed bytes of a message whose content is set.
std::string packed(igtl::MessageBase& message, std::string_view device,
                   std::chrono::nanoseconds t_utc) {
  const auto seconds = std::chrono::floor<std::chrono::seconds>(t_utc);
  auto stamp = igtl::TimeStamp::New();
  stamp->SetTime(static_cast<igtlUint32>(seconds.count()),
                 static_cast<igtlUint32>((t_utc - seconds).count()));
  message.SetDeviceName(std::string(device.substr(0, kDeviceLengthMax)).c_str());
  message.SetTimeStamp(stamp);
  message.Pack();
  return {static_cast<const char*>(message.GetPackPointer()),
          static_cast<std::size_t>(message.GetPackSize())};
}

}  // namespace

std::string transform_message(std::string_view device, std::chrono::nanoseconds t_utc,
                              const Eigen::Isometry3d& T_mm) {
  igtl::Matrix4x4 matrix;
  for (int row = 0; row < 4; ++row)
    for (int column = 0; column < 4; ++column)
      matrix[row][column] = static_cast<float>(T_mm.matrix()(row, column));
  const auto message = igtl::TransformMessage::New();
  message->SetMatrix(matrix);
  return packed(*message, device, t_utc);
}

std::string image_message(std::string_view device, std::chrono::nanoseconds t_utc,
                          const Image& image) {
  constexpr int kSideMax = std::numeric_limits<std::uint16_t>::max();
  const auto is_side = [](int px) { return px >= 1 && px <= kSideMax; };
  if (!is_side(image.width_px) || !is_side(image.height_px) ||
      (image.components != 1 && image.components != 3) ||
      image.pixels.size() != static_cast<std::size_t>(image.width_px) *
                                 static_cast<std::size_t>(image.height_px) *
                                 static_cast<std::size_t>(image.components))
    return {};
  const auto message = igtl::ImageMessage::New();
  message->SetDimensions(image.width_px, image.height_px, 1);
  message->SetSpacing(static_cast<float>(image.spacing_x_mm),
                      static_cast<float>(image.spacing_y_mm),
                      static_cast<float>(image.spacing_x_mm));
  message->SetScalarTypeToUint8();
  message->SetNumComponents(image.components);
  message->SetCoordinateSystem(igtl::ImageMessage::COORDINATE_RAS);
  igtl::Matrix4x4 matrix;
  igtl::IdentityMatrix(matrix);
  for (int i = 0; i < 3; ++i) matrix[i][3] = static_cast<float>(image.p_middle_mm[i]);
  message->SetMatrix(matrix);
  message->AllocateScalars();
  std::memcpy(message->GetScalarPointer(), image.pixels.data(), image.pixels.size());
  return packed(*message, device, t_utc);
}

std::string status_message(std::string_view device, std::chrono::nanoseconds t_utc,
                           const Status& status) {
  const auto message = igtl::StatusMessage::New();
  message->SetCode(static_cast<int>(status.code));
  message->SetSubCode(status.sub_code);
  message->SetErrorName(std::string(status.name.substr(0, kErrorNameLengthMax)).c_str());
  message->SetStatusString(status.text.c_str());
  return packed(*message, device, t_utc);
}

}  // namespace holdfast::bridge::openigtlink
