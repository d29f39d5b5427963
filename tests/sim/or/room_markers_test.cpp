// SPDX-License-Identifier: Apache-2.0
// The ear's four markers in whole images of both cameras at three zooms, detected by
// their print.
#include <algorithm>
#include <vector>

#include <gtest/gtest.h>
#include <opencv2/aruco.hpp>

#include "tests/sim/or/room.hpp"

namespace holdfast::sim {
namespace {

std::vector<int> markers_in(const cv::Mat& image) {
  std::vector<int> ids;
  std::vector<std::vector<cv::Point2f>> corners;
  const auto parameters = cv::aruco::DetectorParameters::create();
  parameters->adaptiveThreshWinSizeMax = 83;
  parameters->adaptiveThreshWinSizeStep = 20;
  cv::aruco::detectMarkers(image, cv::aruco::getPredefinedDictionary(cv::aruco::DICT_4X4_50),
                           corners, ids, parameters);
  std::sort(ids.begin(), ids.end());
  return ids;
}

TEST(EarRoom, BothCamerasShowAllFourMarkersAtEveryZoom) {
  const RoomConfig config;
  const Phantom phantom = make_phantom(config);
  const Microscope microscope(config.optics);
  Renderer renderer(phantom.surfaces, phantom.n_view_ct);
  RoomShot shot;
  shot.T_ct_head = head_poses(config, phantom, microscope.focus_mm()).front();
  for (const double zoom : {1.1, 1.3, 1.5}) {
    shot.optics = microscope.at(zoom, config.visit);
    for (const Side side : {Side::left, Side::right})
      EXPECT_EQ(markers_in(renderer.image(shot, side)), (std::vector<int>{0, 1, 2, 3}))
          << zoom << (side == Side::left ? " left" : " right");
  }
}

}  // namespace
}  // namespace holdfast::sim
