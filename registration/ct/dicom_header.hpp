// SPDX-License-Identifier: Apache-2.0
// The elements of one DICOM file that the CT reader needs, and where its pixels lie. A walk of our
// own over the file's elements: a length field never makes it allocate or read more than the file
// holds, whatever the bytes say. (GDCM's reader allocates what the field says, up to 4 GiB.)
#pragma once

#include <cstdint>
#include <map>
#include <optional>
#include <string>
#include <vector>

namespace holdfast::registration {

/// group << 16 | element
using DicomTag = std::uint32_t;

namespace tag {
constexpr DicomTag kTransferSyntax = 0x00020010, kMediaSopClass = 0x00020002;
constexpr DicomTag kImageType = 0x00080008, kSopClass = 0x00080016, kSopInstance = 0x00080018;
constexpr DicomTag kModality = 0x00080060, kSeriesDescription = 0x0008103E;
constexpr DicomTag kPatientName = 0x00100010, kPatientId = 0x00100020;
constexpr DicomTag kGantryTilt = 0x00181120;
constexpr DicomTag kStudy = 0x0020000D, kSeries = 0x0020000E, kFrameOfReference = 0x00200052;
constexpr DicomTag kPosition = 0x00200032, kOrientation = 0x00200037;
constexpr DicomTag kSamples = 0x00280002, kPhotometric = 0x00280004, kFrames = 0x00280008;
constexpr DicomTag kRows = 0x00280010, kColumns = 0x00280011, kPixelSpacing = 0x00280030;
constexpr DicomTag kBitsAllocated = 0x00280100, kBitsStored = 0x00280101, kHighBit = 0x00280102;
constexpr DicomTag kPixelRepresentation = 0x00280103, kIntercept = 0x00281052;
constexpr DicomTag kSlope = 0x00281053, kRescaleType = 0x00281054, kPixelData = 0x7FE00010;
}  // namespace tag

struct DicomHeader {
  std::string path;
  std::string transfer_syntax;           ///< UID; what the bytes look like where none is given
  bool is_big_endian = false;            ///< of the pixels
  std::map<DicomTag, std::string> text;  ///< trimmed; 16-bit numbers as decimals
  bool has_pixels = false, is_encapsulated = false;
  std::uint64_t pixel_offset = 0, pixel_bytes = 0;  ///< encapsulated: to the file's end

  /// The value, empty where there is none.
  [[nodiscard]] const std::string& value(DicomTag tag) const;
  /// `count` finite numbers separated by backslashes; nothing when it is anything else.
  [[nodiscard]] std::optional<std::vector<double>> numbers(DicomTag tag, std::size_t count) const;
};

/// Nothing when the file is not DICOM at all. Throws RefusedError, naming the file, when it is one
/// but is cut short or broken before its pixels, is larger than 1 GiB or uses a transfer syntax
/// whose elements cannot be read; InputError when it cannot be opened.
[[nodiscard]] std::optional<DicomHeader> read_dicom_header(const std::string& path);

/// The same from the file's first bytes. Throws std::out_of_range when `bytes` ends too early while
/// the file, `file_bytes` long, goes on.
[[nodiscard]] std::optional<DicomHeader> parse_dicom_header(const std::string& path,
                                                            const std::string& bytes,
                                                            std::uint64_t file_bytes);

}  // namespace holdfast::registration
