// SPDX-License-Identifier: Apache-2.0
// The calibration on the real stereo boards of opencv-doc and mrpt-common.
#include <algorithm>
#include <cmath>
#include <filesystem>

#include <gtest/gtest.h>
#include <opencv2/imgcodecs.hpp>

#include "registration/calibration_images.hpp"
#include "registration/calibration_run.hpp"

namespace holdfast::registration {
namespace {

/// Real pairs, as one zoom.
BoardSearch boards_of(const std::vector<ImagePair>& pairs, const BoardPattern& board) {
  return find_boards({ZoomImages{1.0, pairs}}, board, 2,
                     [](const std::string& path) { return cv::imread(path, cv::IMREAD_GRAYSCALE); },
                     {});
}

TEST(RealBoards, OpenCvsThirteenPairsReachAQuarterOfAPixel) {
  const std::string folder = "/usr/share/doc/opencv-doc/examples/data/";
  ASSERT_TRUE(std::filesystem::exists(folder + "left01.jpg")) << "install opencv-doc";
  std::vector<ImagePair> pairs;
  for (const char* number :
       {"01", "02", "03", "04", "05", "06", "07", "08", "09", "11", "12", "13", "14"})
    pairs.push_back({folder + "left" + number + ".jpg", folder + "right" + number + ".jpg"});
  BoardPattern board;
  board.rows = 6;
  board.square_mm = 25;
  const BoardSearch search = boards_of(pairs, board);
  EXPECT_GE(search.views[0].pairs.size(), 12U);
  CalibrationOptions options;
  options.board = board;
  options.worst_nonrigid_mm = 50;  // a wide-angle rig seen at metres
  const auto outcome =
      calibrate_stereo(search.views, search.image.width, search.image.height, options, {});
  EXPECT_LT(outcome.calibration.zooms[0].rms_px, 0.26);
  EXPECT_NEAR(std::abs(outcome.calibration.zooms[0].T[0]), 83, 4);  // the rig's known base
}

TEST(RealBoards, MrptsPairsAreFound) {
  const std::string folder = "/usr/share/mrpt/datasets/stereo-calib/";
  ASSERT_TRUE(std::filesystem::exists(folder + "0_left.jpg")) << "install mrpt-common";
  std::vector<ImagePair> pairs;
  for (const char* number : {"0", "1", "2", "3"})
    pairs.push_back({folder + number + "_left.jpg", folder + number + "_right.jpg"});
  BoardPattern board;
  board.columns = 9;
  board.rows = 6;
  board.square_mm = 30;
  const BoardSearch search = boards_of(pairs, board);
  EXPECT_GE(search.views[0].pairs.size(), 3U);  // of four, one is hard to see
}

}  // namespace
}  // namespace holdfast::registration
