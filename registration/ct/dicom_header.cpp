// SPDX-License-Identifier: Apache-2.0
#include "registration/ct/dicom_header.hpp"

#include <algorithm>
#include <array>
#include <charconv>
#include <cmath>
#include <filesystem>
#include <fstream>
#include <stdexcept>
#include <string_view>

#include "rt/core/error.hpp"

namespace holdfast::registration {
namespace {

constexpr std::uint64_t kFileMaxBytes = 1ULL << 30U, kWindowBytes = 64ULL << 10U;
constexpr std::uint32_t kUndefined = 0xFFFFFFFF, kTextMaxBytes = 4096;
constexpr DicomTag kItem = 0xFFFEE000, kItemEnd = 0xFFFEE00D, kSequenceEnd = 0xFFFEE0DD;
constexpr int kDepthMax = 32;
constexpr std::string_view kImplicit = "1.2.840.10008.1.2", kExplicit = "1.2.840.10008.1.2.1",
                           kBigEndian = "1.2.840.10008.1.2.2";

constexpr std::array<DicomTag, 29> kWanted = {tag::kTransferSyntax, tag::kMediaSopClass,
                                              tag::kImageType,      tag::kSopClass,
                                              tag::kSopInstance,    tag::kModality,
                                              tag::kPatientName,    tag::kSeriesDescription,
                                              tag::kPatientId,      tag::kGantryTilt,
                                              tag::kStudy,          tag::kSeries,
                                              tag::kPosition,       tag::kFrameOfReference,
                                              tag::kOrientation,    tag::kSamples,
                                              tag::kPhotometric,    tag::kFrames,
                                              tag::kRows,           tag::kColumns,
                                              tag::kPixelSpacing,   tag::kBitsAllocated,
                                              tag::kBitsStored,     tag::kHighBit,
                                              tag::kIntercept,      tag::kPixelRepresentation,
                                              tag::kSlope,          tag::kRescaleType,
                                              tag::kPixelData};

bool is_short_number(DicomTag t) {
  return t == tag::kSamples || t == tag::kRows || t == tag::kColumns || t == tag::kBitsAllocated ||
         t == tag::kBitsStored || t == tag::kHighBit || t == tag::kPixelRepresentation;
}

struct Encoding {
  bool is_explicit = true, is_big_endian = false;
};

struct Element {
  DicomTag tag = 0;
  std::uint32_t length = 0;
  bool is_unknown = false;  // VR UN: what is inside an undefined length is implicit little-endian
};

std::string trimmed(std::string text) {
  const auto end = text.find_last_not_of(std::string_view(" \0\t\r\n", 5));
  text.erase(end == std::string::npos ? 0 : end + 1);
  const auto begin = text.find_first_not_of(" \t");
  text.erase(0, std::min(begin, text.size()));
  for (char& c : text)
    if (static_cast<unsigned char>(c) < ' ') c = ' ';
  return text;
}

bool is_letter_pair(char a, char b) {
  return a >= 'A' && a <= 'Z' && b >= 'A' && b <= 'Z';
}

class Walker {
 public:
  Walker(const std::string& path, const std::string& bytes, std::uint64_t file_bytes)
      : path_(path), bytes_(bytes), file_bytes_(file_bytes) {}

  std::optional<DicomHeader> walk() {
    if (!find_start()) return std::nullopt;
    header_.path = path_;
    while (at_ < file_bytes_ && is_meta()) keep(next({}));
    const Encoding encoding = choose_encoding();
    header_.is_big_endian = encoding.is_big_endian;
    while (at_ < file_bytes_ && !header_.has_pixels) {
      const Element element = next(encoding);
      if (element.tag == tag::kPixelData)
        take_pixels(element);
      else if (element.length == kUndefined)
        skip_sequence(element.is_unknown ? Encoding{false, false} : encoding, 0);
      else
        keep(element);
    }
    return std::move(header_);
  }

 private:
  [[noreturn]] void fail(const std::string& what) const { throw RefusedError(path_ + ": " + what); }

  /// The next `count` bytes. Beyond the window but inside the file: the caller reads more.
  const char* take(std::uint64_t count) {
    if (count > file_bytes_ - std::min(at_, file_bytes_))
      fail("is truncated or broken at byte " + std::to_string(at_) + " of its header");
    if (at_ + count > bytes_.size()) throw std::out_of_range("header window");
    const char* from = bytes_.data() + at_;
    at_ += count;
    return from;
  }
  void skip(std::uint64_t count) {
    if (count > file_bytes_ - std::min(at_, file_bytes_))
      fail("is truncated or broken at byte " + std::to_string(at_) + " of its header");
    at_ += count;
  }
  static std::uint32_t number(const char* from, int count, bool is_big_endian) {
    std::uint32_t value = 0;
    for (int k = 0; k < count; ++k)
      value = value << 8U | static_cast<unsigned char>(from[is_big_endian ? k : count - 1 - k]);
    return value;
  }

  bool find_start() {
    if (bytes_.size() >= 132 && bytes_.compare(128, 4, "DICM") == 0) {
      at_ = 132;
      return true;
    }
    if (bytes_.size() < 8) return false;
    // Without preamble: group 2 or 8 first, in a plausible encoding.
    const std::uint32_t group = number(bytes_.data(), 2, false);
    const bool has_vr = is_letter_pair(bytes_[4], bytes_[5]);
    if (group == 0x0002) return has_vr;
    if (group == 0x0800) return has_vr;  // group 8, big-endian
    return group == 0x0008 && (has_vr || (number(bytes_.data() + 4, 4, false) <= 64 &&
                                          number(bytes_.data() + 2, 2, false) <= 0x0018));
  }

  [[nodiscard]] bool is_meta() const {
    return at_ + 2 <= bytes_.size() && number(bytes_.data() + at_, 2, false) == 0x0002;
  }

  Encoding choose_encoding() {
    std::string& uid = header_.transfer_syntax;
    uid = header_.value(tag::kTransferSyntax);
    if (uid.empty()) {
      const char* first = take(6);
      at_ -= 6;
      const bool is_explicit = is_letter_pair(first[4], first[5]);
      const bool is_big = is_explicit && number(first, 2, true) < number(first, 2, false);
      uid = !is_explicit ? kImplicit : is_big ? kBigEndian : kExplicit;
    }
    if (uid == "1.2.840.10008.1.2.1.99" || uid == "1.2.840.10008.1.2.4.95")
      fail("is in transfer syntax " + uid + " (deflated), which is not read");
    return {uid != kImplicit, uid == kBigEndian};
  }

  Element next(Encoding encoding) {
    const char* from = take(8);
    Element element;
    element.tag = number(from, 2, encoding.is_big_endian) << 16U |
                  number(from + 2, 2, encoding.is_big_endian);
    const bool has_vr =
        encoding.is_explicit && (element.tag >> 16U) != 0xFFFE && is_letter_pair(from[4], from[5]);
    if (!has_vr) {
      element.length = number(from + 4, 4, encoding.is_big_endian);
      return element;
    }
    const std::string_view vr(from + 4, 2);
    element.is_unknown = vr == "UN";
    constexpr std::array<std::string_view, 13> kLong = {"OB", "OD", "OF", "OL", "OV", "OW", "SQ",
                                                        "SV", "UC", "UN", "UR", "UT", "UV"};
    if (std::find(kLong.begin(), kLong.end(), vr) == kLong.end())
      element.length = number(from + 6, 2, encoding.is_big_endian);
    else
      element.length = number(take(4), 4, encoding.is_big_endian);
    return element;
  }

  void keep(const Element& element) {
    const DicomTag t = element.tag;
    if (element.length == kUndefined) fail("has an element of undefined length in its meta header");
    if (std::find(kWanted.begin(), kWanted.end(), t) == kWanted.end() || header_.text.count(t) != 0)
      return skip(element.length);
    if (element.length > kTextMaxBytes) fail("has an element of impossible length in its header");
    const char* from = take(element.length);
    if (!is_short_number(t))
      header_.text[t] = trimmed(std::string(from, element.length));
    else if (element.length == 2)
      header_.text[t] = std::to_string(number(from, 2, header_.is_big_endian));
  }

  void skip_sequence(Encoding encoding, int depth) {
    if (depth > kDepthMax) fail("has sequences nested deeper than 32");
    while (true) {
      const Element item = next(encoding);
      if (item.tag == kSequenceEnd) return;
      if (item.tag != kItem) fail("has a broken sequence in its header");
      if (item.length == kUndefined)
        skip_item(encoding, depth + 1);
      else
        skip(item.length);
    }
  }
  void skip_item(Encoding encoding, int depth) {
    while (true) {
      const Element element = next(encoding);
      if (element.tag == kItemEnd) return;
      if (element.length == kUndefined)
        skip_sequence(element.is_unknown ? Encoding{false, false} : encoding, depth);
      else
        skip(element.length);
    }
  }

  void take_pixels(const Element& element) {
    header_.has_pixels = true;
    header_.is_encapsulated = element.length == kUndefined;
    header_.pixel_offset = at_;
    header_.pixel_bytes = header_.is_encapsulated ? file_bytes_ - at_ : element.length;
  }

  const std::string& path_;
  const std::string& bytes_;
  std::uint64_t file_bytes_;
  std::uint64_t at_ = 0;
  DicomHeader header_;
};

}  // namespace

const std::string& DicomHeader::value(DicomTag tag) const {
  static const std::string none;
  const auto it = text.find(tag);
  return it == text.end() ? none : it->second;
}

std::optional<std::vector<double>> DicomHeader::numbers(DicomTag tag, std::size_t count) const {
  std::vector<double> values;
  std::string_view rest = value(tag);
  while (values.size() < count) {
    std::string_view word = rest.substr(0, rest.find('\\'));
    rest.remove_prefix(std::min(word.size() + 1, rest.size()));
    while (word.starts_with(' ') || word.starts_with('+')) word.remove_prefix(1);
    while (word.ends_with(' ')) word.remove_suffix(1);
    double number = 0;
    const auto [end, error] = std::from_chars(word.data(), word.data() + word.size(), number);
    if (word.empty() || error != std::errc{} || end != word.data() + word.size() ||
        !std::isfinite(number))
      return std::nullopt;
    values.push_back(number);
  }
  if (!rest.empty()) return std::nullopt;
  return values;
}

std::optional<DicomHeader> parse_dicom_header(const std::string& path, const std::string& bytes,
                                              std::uint64_t file_bytes) {
  return Walker(path, bytes, file_bytes).walk();
}

std::optional<DicomHeader> read_dicom_header(const std::string& path) {
  std::error_code error;
  const std::uint64_t size = std::filesystem::file_size(path, error);
  if (error) throw InputError(path + ": cannot be read: " + error.message());
  std::ifstream file(path, std::ios::binary);
  std::string bytes(std::min(size, kWindowBytes), '\0');
  if (!file.read(bytes.data(), static_cast<std::streamsize>(bytes.size())))
    throw InputError(path + ": cannot be read");
  try {
    return parse_dicom_header(path, bytes, size);
  } catch (const std::out_of_range&) {  // a long header: read on
    if (size > kFileMaxBytes) throw RefusedError(path + ": is larger than 1 GiB");
    const std::size_t had = bytes.size();
    bytes.resize(size);
    if (!file.read(bytes.data() + had, static_cast<std::streamsize>(size - had)))
      throw InputError(path + ": cannot be read");
    return parse_dicom_header(path, bytes, size);
  }
}

}  // namespace holdfast::registration
