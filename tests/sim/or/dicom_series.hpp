// SPDX-License-Identifier: Apache-2.0
// A CT volume as the DICOM files that a hospital would send, and with the faults that hospitals
// send, too. Written with DCMTK: the product reads with another library.
#pragma once

#include <cstdint>
#include <filesystem>
#include <set>
#include <string>
#include <vector>

#include "tests/sim/or/ct_scanner.hpp"

namespace holdfast::sim {

/// No JPEG-LS: DCMTK's encoder and the decoder that OpenCV and GDCM bring define the same C
/// symbols, so one crashes the other in a process that holds both. The tool dcmcjpls converts
/// files.
enum class DicomTransfer {
  explicit_little,  ///< Explicit VR Little Endian
  implicit_little,
  explicit_big,
  jpeg_lossless,  ///< process 14, first-order prediction
  rle
};

/// A tilted gantry is no fault of the files: scan() makes it.
enum class DicomFault {
  gap,                    ///< the slice in the middle is missing
  duplicate,              ///< the slice in the middle is there twice, with the same pixels
  conflicting_duplicate,  ///< twice, with different pixels and another instance UID
  mixed,                  ///< a second series of the study in the folder: thick slices
  second_patient,         ///< a series of another patient in the folder
  truncated,              ///< the file of the slice in the middle ends after 60 % of its bytes
  mirrored                ///< rows are stored right to left; the headers do not say so
};

struct DicomSeriesParameters {
  DicomTransfer transfer = DicomTransfer::explicit_little;
  std::set<DicomFault> faults;
  bool has_shuffled_names = true;  ///< else IM0001.dcm ... in the order of the slices
  std::uint32_t seed = 1;          ///< of every UID, of the file names and of the patient
};

struct DicomSeries {
  std::string study_uid, series_uid, frame_of_reference_uid;  ///< of the series asked for
  std::vector<std::string> files;  ///< names in the folder, in the order written; all series
};

/// Writes the volume into `folder`, which appears whole or not at all and must not exist before, or
/// be empty. Stored as unsigned 12 bit, HU = stored - 1024, so every syntax holds it exactly.
/// Throws InputError when the folder cannot be written. Not for several threads at once.
DicomSeries write_dicom_series(const CtVolume& volume, const DicomSeriesParameters& parameters,
                               const std::filesystem::path& folder);

}  // namespace holdfast::sim
