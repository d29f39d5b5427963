// SPDX-License-Identifier: Apache-2.0
// Read back with GDCM, which shares nothing with the DCMTK that wrote.
#include "tests/sim/or/dicom_series.hpp"

#include <filesystem>

#include <gdcmImageReader.h>
#include <gtest/gtest.h>
#include <unistd.h>

#include "rt/core/error.hpp"

namespace holdfast::sim {
namespace {

namespace fs = std::filesystem;

class DicomSeriesTest : public ::testing::Test {
 protected:
  void SetUp() override {
    folder_ = fs::temp_directory_path() / ("holdfast_dicom_" + std::to_string(getpid()));
    fs::remove_all(folder_);
    volume_.origin_mm = {-21.25, -199.875, 70.5};
    volume_.column_step_mm = {0.4, 0, 0};
    volume_.row_step_mm = {0, 0.48, 0.14};
    volume_.slice_step_mm = {0, 0, 0.6};
    for (int k = 0; k < 9; ++k) {
      cv::Mat_<std::int16_t> slice(12, 16);
      for (int i = 0; i < 12 * 16; ++i)
        slice(i / 16, i % 16) = static_cast<std::int16_t>(i * 21 + k - 1024);
      volume_.slices.push_back(slice);
    }
    parameters_.has_shuffled_names = false;
  }
  void TearDown() override { fs::remove_all(folder_); }

  [[nodiscard]] static bool read(gdcm::ImageReader& reader, const fs::path& path) {
    reader.SetFileName(path.c_str());
    return reader.Read();
  }
  [[nodiscard]] DicomSeries write() {
    fs::remove_all(folder_);
    return write_dicom_series(volume_, parameters_, folder_);
  }

  fs::path folder_;
  CtVolume volume_;
  DicomSeriesParameters parameters_;
};

TEST_F(DicomSeriesTest, HoldsPixelsAndPlaceInEverySyntax) {
  for (const DicomTransfer transfer :
       {DicomTransfer::explicit_little, DicomTransfer::implicit_little, DicomTransfer::explicit_big,
        DicomTransfer::jpeg_lossless, DicomTransfer::rle}) {
    parameters_.transfer = transfer;
    const DicomSeries series = write();
    ASSERT_EQ(series.files.size(), volume_.slices.size());
    gdcm::ImageReader reader;
    ASSERT_TRUE(read(reader, folder_ / series.files[3])) << static_cast<int>(transfer);
    const gdcm::Image& image = reader.GetImage();
    const Eigen::Vector3d expected = volume_.position(0, 0, 3);
    for (unsigned axis = 0; axis < 3; ++axis)
      EXPECT_NEAR(image.GetOrigin(axis), expected[axis], 1e-6);
    EXPECT_NEAR(image.GetDirectionCosines(4), 0.96, 1e-6);
    EXPECT_NEAR(image.GetDirectionCosines(5), 0.28, 1e-6);
    EXPECT_NEAR(image.GetSpacing(0), 0.4, 1e-6);
    EXPECT_NEAR(image.GetSpacing(1), 0.5, 1e-6);
    ASSERT_EQ(image.GetBufferLength(), 12U * 16U * 2U);
    std::vector<std::uint16_t> stored(12 * 16);
    ASSERT_TRUE(image.GetBuffer(reinterpret_cast<char*>(stored.data())));
    for (std::size_t i = 0; i < stored.size(); ++i)
      ASSERT_EQ(stored[i] + image.GetIntercept(), static_cast<double>(i) * 21 + 3 - 1024)
          << static_cast<int>(transfer);
  }
}

TEST_F(DicomSeriesTest, MakesTheFaultsAskedFor) {
  parameters_.faults = {DicomFault::gap};
  EXPECT_EQ(write().files.size(), 8U);
  parameters_.faults = {DicomFault::duplicate};
  EXPECT_EQ(write().files.size(), 10U);
  parameters_.faults = {DicomFault::mixed, DicomFault::second_patient};
  EXPECT_EQ(write().files.size(), 15U);
  parameters_.faults = {DicomFault::truncated};
  const DicomSeries series = write();
  EXPECT_LT(fs::file_size(folder_ / series.files[4]), fs::file_size(folder_ / series.files[3]));
}

TEST_F(DicomSeriesTest, RefusesAFolderInUse) {
  (void)write();
  EXPECT_THROW((void)write_dicom_series(volume_, parameters_, folder_), InputError);
}

}  // namespace
}  // namespace holdfast::sim
