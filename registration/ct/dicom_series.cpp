// SPDX-License-Identifier: Apache-2.0
#include "registration/ct/dicom_series.hpp"

#include <algorithm>
#include <cmath>
#include <filesystem>
#include <map>
#include <mutex>
#include <span>

#include <Eigen/Geometry>
#include <fmt/format.h>

#include "registration/ct/dicom_header.hpp"
#include "registration/ct/dicom_pixels.hpp"
#include "registration/ct/slice_stack.hpp"
#include "registration/worker_pool.hpp"
#include "rt/core/error.hpp"

namespace holdfast::registration {
namespace {

namespace fs = std::filesystem;

constexpr std::size_t kFilesMax = 100'000, kListedMax = 8;
constexpr double kVoxelsMax = 2147483648.0;
constexpr const char* kCtImage = "1.2.840.10008.5.1.4.1.1.2";
constexpr double kUnitTolerance = 1e-3;  // of direction cosines, which are written with few digits

std::vector<std::string> files_below(const std::string& folder) {
  std::error_code error;
  if (!fs::is_directory(folder, error)) throw InputError(folder + ": is not a folder");
  std::vector<std::string> files;
  fs::recursive_directory_iterator it(folder, error);
  for (; !error && it != fs::recursive_directory_iterator(); it.increment(error)) {
    std::error_code ignored;
    if (!it->is_regular_file(ignored)) continue;
    files.push_back(it->path().string());
    if (files.size() > kFilesMax)
      throw InputError(fmt::format("{}: holds more than {} files", folder, kFilesMax));
  }
  if (error) throw InputError(folder + ": cannot be read: " + error.message());
  std::sort(files.begin(), files.end());
  return files;
}

enum class Kind { ct, enhanced_ct, localizer, other_dicom, not_dicom };

Kind kind_of(const std::optional<DicomHeader>& header) {
  if (!header) return Kind::not_dicom;
  const std::string& stated = header->value(tag::kSopClass);
  const std::string& sop_class = stated.empty() ? header->value(tag::kMediaSopClass) : stated;
  if (sop_class == "1.2.840.10008.5.1.4.1.1.2.1" || sop_class == "1.2.840.10008.5.1.4.1.1.2.2")
    return Kind::enhanced_ct;
  const bool is_ct =
      sop_class.empty() ? header->value(tag::kModality) == "CT" : sop_class == kCtImage;
  if (!is_ct) return Kind::other_dicom;
  return header->value(tag::kImageType).find("LOCALIZER") != std::string::npos ? Kind::localizer
                                                                               : Kind::ct;
}

std::string file_name(const std::string& path) {
  return fs::path(path).filename().string();
}

/// The folder's CT slices, and a note for each kind of file that is none.
class Inventory {
 public:
  Inventory(const std::string& folder, const SeriesOptions& options) : folder_(folder) {
    const std::vector<std::string> files = files_below(folder);
    std::vector<std::optional<DicomHeader>> headers(files.size());
    WorkerPool(options.threads).run(static_cast<int>(files.size()), [&](int number) {
      const auto k = static_cast<std::size_t>(number);
      headers[k] = read_dicom_header(files[k]);
    });
    for (std::size_t k = 0; k < files.size(); ++k) {
      const Kind kind = kind_of(headers[k]);
      if (kind == Kind::enhanced_ct)
        throw RefusedError(files[k] + ": is an enhanced (multi-frame) CT, which is not read");
      if (kind == Kind::ct)
        slices_.push_back(*std::move(headers[k]));
      else
        left_out_[kind].push_back(file_name(files[k]));
    }
    if (slices_.empty())
      throw InputError(fmt::format("{}: holds no CT slice ({} files, {} of them DICOM)", folder,
                                   files.size(), files.size() - left_out_[Kind::not_dicom].size()));
  }

  [[nodiscard]] std::vector<std::string> notes() const {
    static const std::map<Kind, const char*> names = {{Kind::localizer, "localizer"},
                                                      {Kind::other_dicom, "other DICOM object"},
                                                      {Kind::not_dicom, "file that is no DICOM"}};
    std::vector<std::string> notes;
    for (const auto& [kind, files] : left_out_) {
      if (files.empty()) continue;
      std::string listed;
      for (std::size_t k = 0; k < std::min<std::size_t>(files.size(), 3); ++k)
        listed += (k == 0 ? "" : ", ") + files[k];
      notes.push_back(fmt::format("left out {} {}(s): {}{}", files.size(), names.at(kind), listed,
                                  files.size() > 3 ? ", ..." : ""));
    }
    return notes;
  }

  /// The slices of one series and one patient.
  [[nodiscard]] std::vector<DicomHeader> choose(const std::string& series_uid) const {
    check_one_patient();
    std::map<std::string, std::vector<const DicomHeader*>> series;
    for (const DicomHeader& slice : slices_) series[slice.value(tag::kSeries)].push_back(&slice);
    auto chosen = series.begin();
    if (!series_uid.empty())
      chosen = series.find(series_uid);
    else if (series.size() > 1)
      throw RefusedError(fmt::format("{}: holds {} CT series, choose one with --series: {}",
                                     folder_, series.size(), listed(series)));
    if (chosen == series.end())
      throw InputError(
          fmt::format("{}: holds no CT series {}, only {}", folder_, series_uid, listed(series)));
    std::vector<DicomHeader> slices;
    for (const DicomHeader* slice : chosen->second) slices.push_back(*slice);
    return slices;
  }

 private:
  void check_one_patient() const {
    const auto patient = [](const DicomHeader& slice) {
      std::string name = slice.value(tag::kPatientName);
      while (name.ends_with('^') || name.ends_with(' ')) name.pop_back();
      return fmt::format("'{}' (id '{}')", name, slice.value(tag::kPatientId));
    };
    const std::string first = patient(slices_.front());
    for (const DicomHeader& slice : slices_)
      if (const std::string other = patient(slice); other != first)
        throw RefusedError(fmt::format("{}: holds two patients: {} in {}, {} in {}", folder_, first,
                                       file_name(slices_.front().path), other,
                                       file_name(slice.path)));
  }

  static std::string listed(const std::map<std::string, std::vector<const DicomHeader*>>& series) {
    std::string text;
    std::size_t count = 0;
    for (const auto& [uid, slices] : series) {
      if (count++ == kListedMax) return text + "; ...";
      text += fmt::format("{}{} ('{}', {} slices)", count == 1 ? "" : "; ", uid,
                          slices.front()->value(tag::kSeriesDescription), slices.size());
    }
    return text;
  }

  const std::string& folder_;
  std::vector<DicomHeader> slices_;
  std::map<Kind, std::vector<std::string>> left_out_;
};

Eigen::Vector3d unit(const DicomHeader& header, const Eigen::Vector3d& direction) {
  if (std::abs(direction.norm() - 1) > kUnitTolerance)
    throw RefusedError(fmt::format("{}: ImageOrientationPatient '{}' is not of unit length",
                                   header.path, header.value(tag::kOrientation)));
  return direction.normalized();
}

SliceGeometry geometry_of(const DicomHeader& header, const PixelLayout& layout) {
  const auto numbers = [&](DicomTag tag, std::size_t count, const char* name) {
    const auto values = header.numbers(tag, count);
    if (!values)
      throw RefusedError(
          fmt::format("{}: has no valid {} ('{}')", header.path, name, header.value(tag)));
    return *values;
  };
  SliceGeometry slice;
  slice.name = header.path;
  slice.rows = layout.rows;
  slice.columns = layout.columns;
  const auto position = numbers(tag::kPosition, 3, "ImagePositionPatient");
  slice.origin_mm = Eigen::Vector3d(position.data());
  if (!(slice.origin_mm.cwiseAbs().maxCoeff() < 1e5))
    throw RefusedError(header.path + ": ImagePositionPatient is beyond 100 m");
  const auto cosines = numbers(tag::kOrientation, 6, "ImageOrientationPatient");
  slice.along_row = unit(header, Eigen::Vector3d(cosines.data()));
  const Eigen::Vector3d column = unit(header, Eigen::Vector3d(cosines.data() + 3));
  if (std::abs(slice.along_row.dot(column)) > kUnitTolerance)
    throw RefusedError(header.path +
                       ": the two directions of ImageOrientationPatient are not "
                       "perpendicular");
  slice.along_column = (column - slice.along_row.dot(column) * slice.along_row).normalized();
  const auto spacing = numbers(tag::kPixelSpacing, 2, "PixelSpacing");
  slice.row_spacing_mm = spacing[0];
  slice.column_spacing_mm = spacing[1];
  for (const double mm : spacing)
    if (!(mm >= 0.01 && mm <= 10))
      throw RefusedError(
          fmt::format("{}: PixelSpacing is {} mm, must be 0.01 to 10 mm", header.path, mm));
  if (const auto tilt = header.numbers(tag::kGantryTilt, 1)) slice.tilt_deg = tilt->front();
  return slice;
}

/// One study, one frame of reference: what the series claims to be.
CtIdentity identity_of(const std::vector<DicomHeader>& slices) {
  const DicomHeader& first = slices.front();
  for (const DicomHeader& slice : slices)
    for (const auto& [tag, name] : {std::pair{tag::kStudy, "StudyInstanceUID"},
                                    std::pair{tag::kFrameOfReference, "FrameOfReferenceUID"}})
      if (slice.value(tag) != first.value(tag))
        throw RefusedError(fmt::format("{}: {} is '{}', but {} has '{}'", slice.path, name,
                                       slice.value(tag), first.path, first.value(tag)));
  return {first.value(tag::kSeries), first.value(tag::kStudy), first.value(tag::kFrameOfReference)};
}

/// Identical slices at one position are one slice; different ones cannot be resolved.
void resolve_duplicates(const SliceStack& stack, const std::vector<DicomHeader>& slices,
                        const std::vector<PixelLayout>& layouts, CtVolume& volume) {
  const auto hu_of = [&](std::size_t k) {
    std::vector<std::int16_t> hu(static_cast<std::size_t>(layouts[k].rows) *
                                 static_cast<std::size_t>(layouts[k].columns));
    (void)decode_hu(slices[k], layouts[k], hu);  // clipping is noted when the volume is decoded
    return hu;
  };
  for (const auto& [kept, other] : stack.duplicates) {
    if (hu_of(kept) != hu_of(other))
      throw RefusedError(fmt::format("{} and {}: stand at one position with different pixels",
                                     slices[kept].path, slices[other].path));
    volume.notes.push_back(fmt::format("left out {}: the same slice as {}",
                                       file_name(slices[other].path),
                                       file_name(slices[kept].path)));
  }
}

void decode(const std::vector<DicomHeader>& slices, const std::vector<PixelLayout>& layouts,
            const std::vector<std::size_t>& order, const SeriesOptions& options, CtVolume& volume) {
  const std::size_t pixels =
      static_cast<std::size_t>(volume.size[0]) * static_cast<std::size_t>(volume.size[1]);
  volume.hu.resize(pixels * order.size());
  std::vector<char> has_clipped(order.size());
  std::mutex mutex;  // of progress
  std::size_t done = 0;
  WorkerPool(options.threads).run(static_cast<int>(order.size()), [&](int number) {
    const auto k = static_cast<std::size_t>(number);
    const std::span<std::int16_t> hu(volume.hu.data() + k * pixels, pixels);
    has_clipped[k] = decode_hu(slices[order[k]], layouts[order[k]], hu) ? 1 : 0;
    if (!options.progress) return;
    const std::lock_guard lock(mutex);
    options.progress(++done, order.size());
  });
  const auto clipped = std::count(has_clipped.begin(), has_clipped.end(), 1);
  if (clipped > 0)
    volume.notes.push_back(
        fmt::format("{} slice(s) hold values beyond +-32767 HU, which were clipped", clipped));
}

}  // namespace

CtVolume read_ct_series(const std::string& folder, const SeriesOptions& options) {
  const Inventory inventory(folder, options);
  const std::vector<DicomHeader> slices = inventory.choose(options.series_uid);
  CtVolume volume;
  volume.notes = inventory.notes();
  volume.identity = identity_of(slices);
  volume.description = slices.front().value(tag::kSeriesDescription);
  std::vector<PixelLayout> layouts;
  std::vector<SliceGeometry> geometry;
  for (const DicomHeader& slice : slices) {
    layouts.push_back(pixel_layout(slice));
    geometry.push_back(geometry_of(slice, layouts.back()));
  }
  const SliceStack stack = stack_slices(geometry);
  volume.notes.insert(volume.notes.end(), stack.notes.begin(), stack.notes.end());
  const SliceGeometry& first = geometry[stack.order.front()];
  volume.size = {first.columns, first.rows, static_cast<int>(stack.order.size())};
  if (static_cast<double>(first.columns) * first.rows * volume.size[2] > kVoxelsMax)
    throw RefusedError(folder + ": the volume has more than 2^31 voxels");
  volume.column_step_mm = first.column_spacing_mm * first.along_row;
  volume.row_step_mm = first.row_spacing_mm * first.along_column;
  for (const std::size_t k : stack.order) volume.slice_origin_mm.push_back(geometry[k].origin_mm);
  if (is_lossy(slices.front().transfer_syntax))
    volume.notes.emplace_back("the pixels were compressed with loss");
  if (volume.identity.frame_of_reference_uid.empty())
    volume.notes.emplace_back("the series names no frame of reference");
  resolve_duplicates(stack, slices, layouts, volume);
  decode(slices, layouts, stack.order, options, volume);
  return volume;
}

}  // namespace holdfast::registration
