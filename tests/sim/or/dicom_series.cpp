// SPDX-License-Identifier: Apache-2.0
#include "tests/sim/or/dicom_series.hpp"

#include <algorithm>
#include <cmath>
#include <mutex>
#include <numbers>

#include <dcmtk/config/osconfig.h>
#include <dcmtk/dcmdata/dcrledrg.h>
#include <dcmtk/dcmdata/dcrleerg.h>
#include <dcmtk/dcmdata/dcrlerp.h>
#include <dcmtk/dcmdata/dctk.h>
#include <dcmtk/dcmjpeg/djencode.h>
#include <dcmtk/dcmjpeg/djrplol.h>
#include <fmt/core.h>
#include <opencv2/imgproc.hpp>

#include "rt/core/error.hpp"
#include "tests/sim/or/phantom_random.hpp"

namespace holdfast::sim {
namespace {

namespace fs = std::filesystem;
using Eigen::Vector3d;

constexpr int kStoredZeroHu = 1024;
constexpr std::size_t kThickSlices = 4;  // of the second series, in slices of the first

void must(const OFCondition& condition, const std::string& what) {
  if (condition.bad()) throw InputError(fmt::format("{}: DICOM: {}", what, condition.text()));
}

// One patient's one series.
struct Identity {
  std::string name, patient_id, study_uid, frame_uid, series_uid, description;
  int series_number = 1;
  std::uint64_t instance_root = 0;
};

std::string uid(PhantomRandom& random) {
  return fmt::format("2.25.{}", random.bits() | 1U);
}

Identity draw_identity(PhantomRandom& random) {
  Identity identity;
  const unsigned number = static_cast<unsigned>(random.bits() % 100000);
  identity.name = fmt::format("PHANTOM^NR{:05}", number);
  identity.patient_id = fmt::format("PH{:05}", number);
  identity.study_uid = uid(random);
  identity.frame_uid = uid(random);
  identity.series_uid = uid(random);
  identity.description = "Temporal bone 0.6";
  identity.instance_root = random.bits();
  return identity;
}

// Each within the 16 characters of a DS; + 0.0 makes a negative zero positive.
std::string decimals(const Vector3d& v) {
  return fmt::format("{:.10g}\\{:.10g}\\{:.10g}", v.x() + 0.0, v.y() + 0.0, v.z() + 0.0);
}

double gantry_tilt_deg(const CtVolume& volume) {
  const Vector3d normal = volume.column_step_mm.cross(volume.row_step_mm).normalized();
  const double along = volume.slice_step_mm.normalized().dot(normal);
  const double across = volume.slice_step_mm.normalized().dot(volume.row_step_mm.normalized());
  return std::atan2(across, along) * 180 / std::numbers::pi;
}

class Writer {
 public:
  Writer(const CtVolume& volume, const DicomSeriesParameters& parameters, fs::path folder)
      : volume_(volume),
        parameters_(parameters),
        folder_(std::move(folder)),
        random_(0xd1c00000ULL + parameters.seed) {}

  DicomSeries write() {
    const Identity identity = draw_identity(random_);
    const std::size_t middle = volume_.slices.size() / 2;
    for (std::size_t k = 0; k < volume_.slices.size(); ++k) {
      if (has(DicomFault::gap) && k == middle) continue;
      const std::string file = write_slice(identity, k, volume_.slices[k], k + 1, k + 1);
      if (has(DicomFault::truncated) && k == middle)
        fs::resize_file(folder_ / file, fs::file_size(folder_ / file) * 6 / 10);
    }
    write_extras(identity, middle);
    return {identity.study_uid, identity.series_uid, identity.frame_uid, files_};
  }

 private:
  [[nodiscard]] bool has(DicomFault fault) const { return parameters_.faults.count(fault) != 0; }

  void write_extras(const Identity& identity, std::size_t middle) {
    const std::size_t count = volume_.slices.size();
    if (has(DicomFault::duplicate))
      write_slice(identity, middle, volume_.slices[middle], middle + 1, middle + 1);
    if (has(DicomFault::conflicting_duplicate)) {
      cv::Mat_<std::int16_t> other;
      cv::blur(volume_.slices[middle], other, {3, 3});
      write_slice(identity, middle, other, middle + 1, count + 1);
    }
    if (has(DicomFault::mixed)) {
      Identity thick = identity;
      thick.series_uid = uid(random_);
      thick.series_number = 2;
      thick.description = "Overview";
      thick.instance_root = random_.bits();
      write_overview(thick);
    }
    if (has(DicomFault::second_patient)) write_overview(draw_identity(random_));
  }

  void write_overview(const Identity& identity) {
    for (std::size_t k = 0; k < volume_.slices.size(); k += kThickSlices)
      write_slice(identity, k, volume_.slices[k], k / kThickSlices + 1, k + 1);
  }

  std::string write_slice(const Identity& identity, std::size_t slice,
                          const cv::Mat_<std::int16_t>& pixels, std::size_t instance,
                          std::size_t instance_uid) {
    DcmFileFormat file;
    DcmDataset& data = *file.getDataset();
    const auto put = [&data](const DcmTagKey& tag, const std::string& value) {
      must(data.putAndInsertString(tag, value.c_str()), "header");
    };
    put(DCM_SpecificCharacterSet, "ISO_IR 100");
    put(DCM_ImageType, "ORIGINAL\\PRIMARY\\AXIAL");
    put(DCM_SOPClassUID, UID_CTImageStorage);
    put(DCM_SOPInstanceUID, fmt::format("2.25.{}{:05}", identity.instance_root, instance_uid));
    put_patient(put, identity);
    put(DCM_InstanceNumber, std::to_string(instance));
    put_geometry(put, slice);
    put_pixels(data, put, pixels);
    const std::string name = next_name();
    save(file, folder_ / name);
    files_.push_back(name);
    return name;
  }

  template <typename Put>
  static void put_patient(const Put& put, const Identity& identity) {
    put(DCM_StudyDate, "20240105");
    put(DCM_StudyTime, "101500");
    put(DCM_AccessionNumber, "");
    put(DCM_Modality, "CT");
    put(DCM_Manufacturer, "Virtual operating room");
    put(DCM_ReferringPhysicianName, "");
    put(DCM_SeriesDescription, identity.description);
    put(DCM_PatientName, identity.name);
    put(DCM_PatientID, identity.patient_id);
    put(DCM_PatientBirthDate, "");
    put(DCM_PatientSex, "O");
    put(DCM_PatientPosition, "HFS");
    put(DCM_StudyInstanceUID, identity.study_uid);
    put(DCM_SeriesInstanceUID, identity.series_uid);
    put(DCM_StudyID, "1");
    put(DCM_SeriesNumber, std::to_string(identity.series_number));
    put(DCM_FrameOfReferenceUID, identity.frame_uid);
    put(DCM_PositionReferenceIndicator, "");
  }

  template <typename Put>
  void put_geometry(const Put& put, std::size_t slice) const {
    put(DCM_KVP, "120");
    put(DCM_SliceThickness, fmt::format("{:.6g}", volume_.slice_thickness_mm));
    put(DCM_GantryDetectorTilt, fmt::format("{:.6f}", gantry_tilt_deg(volume_)));
    put(DCM_ImagePositionPatient, decimals(volume_.position(0, 0, static_cast<double>(slice))));
    put(DCM_ImageOrientationPatient, decimals(volume_.column_step_mm.normalized()) + "\\" +
                                         decimals(volume_.row_step_mm.normalized()));
    put(DCM_PixelSpacing,
        fmt::format("{:.10g}\\{:.10g}", volume_.row_step_mm.norm(), volume_.column_step_mm.norm()));
    put(DCM_RescaleIntercept, std::to_string(-kStoredZeroHu));
    put(DCM_RescaleSlope, "1");
    put(DCM_RescaleType, "HU");
    put(DCM_WindowCenter, "200");
    put(DCM_WindowWidth, "2800");
  }

  template <typename Put>
  void put_pixels(DcmDataset& data, const Put& put, const cv::Mat_<std::int16_t>& pixels) const {
    put(DCM_PhotometricInterpretation, "MONOCHROME2");
    const auto number = [&data](const DcmTagKey& tag, int value) {
      must(data.putAndInsertUint16(tag, static_cast<Uint16>(value)), "header");
    };
    number(DCM_SamplesPerPixel, 1);
    number(DCM_Rows, pixels.rows);
    number(DCM_Columns, pixels.cols);
    number(DCM_BitsAllocated, 16);
    number(DCM_BitsStored, 12);
    number(DCM_HighBit, 11);
    number(DCM_PixelRepresentation, 0);
    std::vector<Uint16> stored;
    stored.reserve(pixels.total());
    for (int row = 0; row < pixels.rows; ++row)
      for (int column = 0; column < pixels.cols; ++column) {
        const int from = has(DicomFault::mirrored) ? pixels.cols - 1 - column : column;
        stored.push_back(
            static_cast<Uint16>(std::clamp(pixels(row, from) + kStoredZeroHu, 0, 4095)));
      }
    must(data.putAndInsertUint16Array(DCM_PixelData, stored.data(), stored.size()), "pixels");
  }

  std::string next_name() {
    if (!parameters_.has_shuffled_names) return fmt::format("IM{:04}.dcm", files_.size() + 1);
    return fmt::format("{:08X}.dcm", random_.bits() & 0xffffffffU);
  }

  void save(DcmFileFormat& file, const fs::path& path) const {
    E_TransferSyntax syntax = EXS_LittleEndianExplicit;
    const DJ_RPLossless jpeg;
    const DcmRLERepresentationParameter rle;
    const DcmRepresentationParameter* compression = nullptr;
    switch (parameters_.transfer) {
      case DicomTransfer::explicit_little:
        break;
      case DicomTransfer::implicit_little:
        syntax = EXS_LittleEndianImplicit;
        break;
      case DicomTransfer::explicit_big:
        syntax = EXS_BigEndianExplicit;
        break;
      case DicomTransfer::jpeg_lossless:
        syntax = EXS_JPEGProcess14SV1;
        compression = &jpeg;
        break;
      case DicomTransfer::rle:
        syntax = EXS_RLELossless;
        compression = &rle;
        break;
    }
    if (compression != nullptr)
      must(file.getDataset()->chooseRepresentation(syntax, compression), path.string());
    must(file.saveFile(path.c_str(), syntax), path.string());
  }

  const CtVolume& volume_;
  const DicomSeriesParameters& parameters_;
  fs::path folder_;
  PhantomRandom random_;
  std::vector<std::string> files_;
};

void register_encoders() {
  static std::once_flag once;
  std::call_once(once, [] {
    DJEncoderRegistration::registerCodecs();
    OFLog::configure(OFLogger::ERROR_LOG_LEVEL);
    DcmRLEEncoderRegistration::registerCodecs();
  });
}

}  // namespace

DicomSeries write_dicom_series(const CtVolume& volume, const DicomSeriesParameters& parameters,
                               const fs::path& folder) {
  register_encoders();
  std::error_code error;
  if (fs::exists(folder) && !fs::is_empty(folder, error))
    throw InputError(folder.string() + ": not an empty folder");
  const fs::path partial = (folder / "").parent_path().string() + ".partial";
  fs::remove_all(partial, error);
  fs::create_directories(partial, error);
  if (error) throw InputError(fmt::format("{}: {}", partial.string(), error.message()));
  try {
    DicomSeries series = Writer(volume, parameters, partial).write();
    fs::rename(partial, folder);
    return series;
  } catch (const fs::filesystem_error& failure) {
    fs::remove_all(partial, error);
    throw InputError(fmt::format("{}: {}", folder.string(), failure.code().message()));
  } catch (...) {
    fs::remove_all(partial, error);
    throw;
  }
}

}  // namespace holdfast::sim
