// SPDX-License-Identifier: Apache-2.0
#include "registration/ct/dicom_pixels.hpp"

#include <algorithm>
#include <bit>
#include <cmath>
#include <cstring>
#include <fstream>
#include <stdexcept>
#include <string_view>

#include <fmt/format.h>
#include <gdcmDataElement.h>
#include <gdcmFragment.h>
#include <gdcmImage.h>
#include <gdcmSequenceOfFragments.h>
#include <gdcmTrace.h>

#include "registration/ct/code_stream.hpp"
#include "registration/ct/hu_conversion.hpp"
#include "rt/core/error.hpp"

namespace holdfast::registration {
namespace {

constexpr double kSideMax = 8192;
constexpr std::uint32_t kItem = 0xE000FFFE, kSequenceEnd = 0xE0DDFFFE;
constexpr std::string_view kRle = "1.2.840.10008.1.2.5", kCompressed = "1.2.840.10008.1.2.4.";

[[noreturn]] void fail(const DicomHeader& header, const std::string& what) {
  throw RefusedError(header.path + ": " + what);
}

int whole_number(const DicomHeader& header, DicomTag tag, const char* name, double low,
                 double high) {
  const auto value = header.numbers(tag, 1);
  if (!value) fail(header, fmt::format("has no valid {} ('{}')", name, header.value(tag)));
  if (!((*value)[0] >= low && (*value)[0] <= high) || (*value)[0] != std::floor((*value)[0]))
    fail(header, fmt::format("{} is {}, must be {} to {}", name, (*value)[0], low, high));
  return static_cast<int>((*value)[0]);
}

void read_pixel_bytes(const DicomHeader& header, std::size_t count, char* to) {
  std::ifstream file(header.path, std::ios::binary);
  file.seekg(static_cast<std::streamoff>(header.pixel_offset));
  if (!file.read(to, static_cast<std::streamsize>(count)))
    fail(header, fmt::format("its pixel data is truncated: {} of {} bytes",
                             std::max<std::streamsize>(file.gcount(), 0), count));
}

void native_pixels(const DicomHeader& header, std::span<std::int16_t> stored) {
  const std::size_t expected = stored.size_bytes();
  if (header.pixel_bytes < expected)
    fail(header,
         fmt::format("its pixel data is truncated: {} of {} bytes", header.pixel_bytes, expected));
  if (header.pixel_bytes > expected + 1)
    fail(header, fmt::format("its pixel data is {} bytes, must be {} for its rows and columns",
                             header.pixel_bytes, expected));
  read_pixel_bytes(header, expected, reinterpret_cast<char*>(stored.data()));
  if (!header.is_big_endian) return;
  for (std::int16_t& value : stored)
    value = static_cast<std::int16_t>(__builtin_bswap16(static_cast<std::uint16_t>(value)));
}

std::uint32_t little32(std::string_view bytes, std::size_t at) {
  std::uint32_t value = 0;
  for (std::size_t k = 4; k-- > 0;) value = value << 8U | static_cast<unsigned char>(bytes[at + k]);
  return value;
}

/// The frame's code stream, its fragments joined; the offset table is left out.
std::string code_stream(const DicomHeader& header) {
  std::string bytes(header.pixel_bytes, '\0');
  read_pixel_bytes(header, bytes.size(), bytes.data());
  std::string stream;
  std::size_t at = 0;
  for (int item = 0; at + 8 <= bytes.size(); ++item) {
    const std::uint32_t tag = little32(bytes, at), length = little32(bytes, at + 4);
    at += 8;
    if (tag == kSequenceEnd) return stream;
    if (tag != kItem)
      fail(header, "its compressed pixel data is broken: no item where one must be");
    if (length > bytes.size() - at) break;
    if (item > 0) stream.append(bytes, at, length);
    at += length;
  }
  fail(header, "its compressed pixel data is truncated");
}

void check_size(const DicomHeader& header, const PixelLayout& layout,
                const std::optional<CodeStreamSize>& size) {
  if (!size) fail(header, "its compressed pixel data has no valid image header");
  if (size->rows != static_cast<std::uint32_t>(layout.rows) ||
      size->columns != static_cast<std::uint32_t>(layout.columns) || size->components != 1)
    fail(header,
         fmt::format("its compressed image is {}x{} of {} components, its header says "
                     "{}x{} of 1",
                     size->columns, size->rows, size->components, layout.columns, layout.rows));
  if (size->bits <= 8 || size->bits > 16)
    fail(header, fmt::format("its compressed image has {} bits, must be 9 to 16", size->bits));
}

std::string gdcm_pixels(const DicomHeader& header, const PixelLayout& layout,
                        const std::string& stream, std::size_t expected) {
  [[maybe_unused]] static const bool is_quiet = [] {  // its chatter would break the one line
    gdcm::Trace::WarningOff();
    gdcm::Trace::ErrorOff();
    return true;
  }();
  const gdcm::SmartPointer<gdcm::SequenceOfFragments> fragments = new gdcm::SequenceOfFragments;
  gdcm::Fragment fragment;
  fragment.SetByteValue(stream.data(), static_cast<std::uint32_t>(stream.size()));
  fragments->AddFragment(fragment);
  gdcm::DataElement element(gdcm::Tag(0x7FE0, 0x0010), 0, gdcm::VR::OB);
  element.SetValue(*fragments);
  gdcm::Image image;
  image.SetNumberOfDimensions(2);
  image.SetDimension(0, static_cast<unsigned>(layout.columns));
  image.SetDimension(1, static_cast<unsigned>(layout.rows));
  image.SetPixelFormat(gdcm::PixelFormat(1, static_cast<unsigned short>(layout.bits_allocated),
                                         static_cast<unsigned short>(layout.bits_stored),
                                         static_cast<unsigned short>(layout.high_bit),
                                         layout.is_signed ? 1 : 0));
  image.SetPhotometricInterpretation(gdcm::PhotometricInterpretation::MONOCHROME2);
  image.SetTransferSyntax(gdcm::TransferSyntax::GetTSType(header.transfer_syntax.c_str()));
  image.SetDataElement(element);
  std::string bytes(expected, '\0');
  if (image.GetBufferLength() != expected || !image.GetBuffer(bytes.data()))
    fail(header, "its compressed pixel data cannot be decoded");
  if (image.GetPixelFormat().GetBitsAllocated() != 16)
    fail(header, "its compressed pixels are not of 16 bits");
  return bytes;
}

std::string compressed_pixels(const DicomHeader& header, const PixelLayout& layout,
                              std::size_t expected) {
  const std::string& syntax = header.transfer_syntax;
  const bool is_rle = syntax == kRle;
  const std::string_view kind =
      syntax.starts_with(kCompressed) ? std::string_view(syntax).substr(kCompressed.size()) : "";
  const bool is_jpeg = kind == "51" || kind == "57" || kind == "70" || kind == "80" || kind == "81";
  const bool is_jpeg2000 = kind == "90" || kind == "91";
  if (!is_rle && !is_jpeg && !is_jpeg2000)
    fail(header, "is in transfer syntax " + syntax + ", which is not read");
  const std::string stream = code_stream(header);
  if (is_rle) {
    auto bytes = decode_rle16(stream, expected / 2);
    if (!bytes) fail(header, "its RLE pixel data is truncated or broken");
    return *std::move(bytes);
  }
  check_size(header, layout, is_jpeg ? jpeg_size(stream) : jpeg2000_size(stream));
  return gdcm_pixels(header, layout, stream, expected);
}

}  // namespace

bool is_lossy(const std::string& transfer_syntax) {
  return transfer_syntax == "1.2.840.10008.1.2.4.51" ||
         transfer_syntax == "1.2.840.10008.1.2.4.81" || transfer_syntax == "1.2.840.10008.1.2.4.91";
}

PixelLayout pixel_layout(const DicomHeader& header) {
  if (!header.has_pixels) fail(header, "holds no pixel data; it may be truncated");
  PixelLayout layout;
  layout.rows = whole_number(header, tag::kRows, "Rows", 2, kSideMax);
  layout.columns = whole_number(header, tag::kColumns, "Columns", 2, kSideMax);
  (void)whole_number(header, tag::kBitsAllocated, "BitsAllocated", 16, 16);
  layout.bits_stored = whole_number(header, tag::kBitsStored, "BitsStored", 9, 16);
  layout.high_bit = whole_number(header, tag::kHighBit, "HighBit", layout.bits_stored - 1, 15);
  layout.is_signed =
      whole_number(header, tag::kPixelRepresentation, "PixelRepresentation", 0, 1) == 1;
  (void)whole_number(header, tag::kSamples, "SamplesPerPixel", 1, 1);
  if (!header.value(tag::kFrames).empty())
    (void)whole_number(header, tag::kFrames, "NumberOfFrames", 1, 1);
  const std::string& photometric = header.value(tag::kPhotometric);
  if (photometric != "MONOCHROME2" && photometric != "MONOCHROME1")
    fail(header, "PhotometricInterpretation is '" + photometric + "', must be MONOCHROME1 or 2");
  const auto slope = header.numbers(tag::kSlope, 1), intercept = header.numbers(tag::kIntercept, 1);
  if (!slope || !intercept || !((*slope)[0] > 0))
    fail(header, fmt::format("has no valid RescaleSlope and RescaleIntercept ('{}', '{}'), so its "
                             "pixels are no HU",
                             header.value(tag::kSlope), header.value(tag::kIntercept)));
  layout.slope = (*slope)[0];
  layout.intercept = (*intercept)[0];
  const std::string& type = header.value(tag::kRescaleType);
  if (!type.empty() && type != "HU") fail(header, "RescaleType is '" + type + "', must be HU");
  return layout;
}

bool decode_hu(const DicomHeader& header, const PixelLayout& layout, std::span<std::int16_t> hu) {
  static_assert(std::endian::native == std::endian::little, "as pixels are stored");
  if (hu.size() != static_cast<std::size_t>(layout.rows) * static_cast<std::size_t>(layout.columns))
    throw std::invalid_argument("decode_hu: room for another number of pixels");
  if (header.is_encapsulated) {
    const std::string bytes = compressed_pixels(header, layout, hu.size_bytes());
    std::memcpy(hu.data(), bytes.data(), hu.size_bytes());
  } else {
    native_pixels(header, hu);
  }
  return convert_to_hu(layout, hu);
}

}  // namespace holdfast::registration
