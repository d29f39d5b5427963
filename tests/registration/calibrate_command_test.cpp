// SPDX-License-Identifier: Apache-2.0
// The built `holdfast calibrate`: what it makes of good images, and that bad ones end with their
// exit code, one line that names them, and no file.
#include <algorithm>
#include <cmath>
#include <cstdlib>
#include <filesystem>
#include <fstream>
#include <random>
#include <sstream>
#include <string>
#include <utility>

#include <fmt/format.h>
#include <gtest/gtest.h>
#include <nlohmann/json.hpp>
#include <opencv2/imgcodecs.hpp>
#include <sys/wait.h>
#include <unistd.h>

#include "registration/stereo_calibration.hpp"
#include "tests/registration/support/flat_render.hpp"

namespace holdfast::registration {
namespace {

namespace fs = std::filesystem;

constexpr int kPairs = 9;

double print(double x, double y) {
  const double u = x / 3 + 5, v = y / 3 + 3;
  if (u < 0 || v < 0 || u >= 10 || v >= 6) return 210;
  return (static_cast<int>(u) + static_cast<int>(v)) % 2 == 0 ? 40 : 200;
}

class CalibrateCommand : public ::testing::Test {
 protected:
  static fs::path root() {
    return fs::path(::testing::TempDir()) / ("holdfast-calibrate-" + std::to_string(getpid()));
  }
  static fs::path good() { return root() / "good"; }
  static fs::path image(const fs::path& folder, const char* side, int pair) {
    return folder / "zoom_1.3" / fmt::format("{}_{:02}.png", side, pair);
  }

  /// Nine pairs, drawn once.
  static void SetUpTestSuite() {
    fs::create_directories(good() / "zoom_1.3");
    std::mt19937 random(7);
    std::uniform_real_distribution<double> within(-1, 1);
    const Eigen::Isometry3d T_right_left =
        (Eigen::Translation3d(24, 0, 1.4) * Eigen::AngleAxisd(-0.12, Eigen::Vector3d::UnitY()))
            .inverse();
    for (int i = 0; i < kPairs; ++i) {
      test::FlatView view;
      view.f_px = 1600;
      const double towards = 2.4 * i;
      // Every part of the field, tilted in all directions.
      view.T_camera_plane =
          Eigen::Translation3d(22.0 * (i % 3 - 1), 17.0 * (i / 3 - 1), 200 + 5 * within(random)) *
          Eigen::AngleAxisd(0.6, Eigen::Vector3d(std::cos(towards), std::sin(towards), 0)) *
          Eigen::AngleAxisd(0.2 * within(random), Eigen::Vector3d::UnitZ());
      for (const bool is_left : {true, false}) {
        test::FlatView one = view;
        if (!is_left) one.T_camera_plane = T_right_left * view.T_camera_plane;
        one.seed = static_cast<std::uint32_t>(2 * i + (is_left ? 1 : 2));
        cv::imwrite(image(good(), is_left ? "left" : "right", i).string(),
                    test::render(one, print));
      }
    }
  }
  static void TearDownTestSuite() { fs::remove_all(root()); }

  void SetUp() override { fs::copy(good(), folder, fs::copy_options::recursive); }
  void TearDown() override { fs::remove_all(folder); }

  static std::string content(const fs::path& file) {
    std::stringstream text;
    text << std::ifstream(file).rdbuf();
    return text.str();
  }
  int run(const std::string& arguments) {
    const std::string command = "cd '" + folder.string() +
                                "' && '" HOLDFAST_PROGRAM
                                "' calibrate --images . --out stereo.yaml --json " +
                                arguments + " >stdout.txt 2>stderr.txt";
    const int status = std::system(command.c_str());
    out = content(folder / "stdout.txt");
    err = content(folder / "stderr.txt");
    return WIFEXITED(status) ? WEXITSTATUS(status) : -1;
  }
  void expect_refused(int code, const std::string& names, const std::string& arguments = "") {
    EXPECT_EQ(run(arguments), code) << err;
    EXPECT_EQ(std::count(err.begin(), err.end(), '\n'), 1) << err;
    EXPECT_NE(err.find(names), std::string::npos) << err;
    EXPECT_EQ(out, "");
    EXPECT_FALSE(fs::exists(folder / "stereo.yaml"));
  }

  const fs::path folder = root() / "case";
  std::string out, err;
};

TEST_F(CalibrateCommand, GoodImagesGiveACalibrationWithItsCovariance) {
  ASSERT_EQ(run(""), 0) << err;
  const auto json = nlohmann::json::parse(out);
  EXPECT_EQ(json["zooms"][0]["pairs_used"], kPairs);
  EXPECT_LT(json["zooms"][0]["rms"]["reprojection_left_px"], 0.1);
  EXPECT_LT(json["zooms"][0]["predicted_nonrigid_mm"], 0.15);
  const auto calibration = read_stereo_calibration((folder / "stereo.yaml").string());
  EXPECT_NEAR(std::hypot(calibration.zooms[0].T[0], calibration.zooms[0].T[2]), 24.04, 0.5);
  EXPECT_EQ(calibration.zooms[0].parameter_covariance.rows(), 38);
}

TEST_F(CalibrateCommand, RefusesAnImageWithoutItsPartner) {
  fs::remove(image(folder, "right", 3));
  expect_refused(1, "left_03.png");
}

TEST_F(CalibrateCommand, RefusesSwappedSides) {
  for (int i = 0; i < kPairs; ++i) {
    fs::rename(image(folder, "left", i), folder / "other.png");
    fs::rename(image(folder, "right", i), image(folder, "left", i));
    fs::rename(folder / "other.png", image(folder, "right", i));
  }
  expect_refused(1, "swapped");
}

TEST_F(CalibrateCommand, RefusesTooFewWholeBoards) {
  for (const int i : {0, 1, 3, 4}) {  // those in the left half, cut off in one of both
    cv::Mat grey = cv::imread(image(folder, "left", i).string(), cv::IMREAD_GRAYSCALE);
    grey(cv::Rect(0, 0, grey.cols / 2, grey.rows)).setTo(210);
    cv::imwrite(image(folder, "left", i).string(), grey);
  }
  expect_refused(1, "5 pairs show the whole board");
}

TEST_F(CalibrateCommand, RefusesTheWrongCountOfCorners) {
  expect_refused(1, "9x5", "--board 8x6");
}

TEST_F(CalibrateCommand, RefusesTheWrongSizeOfSquares) {
  expect_refused(1, "squares", "--square-mm 6 --focus-mm 200");
}

TEST_F(CalibrateCommand, RefusesViewsThatAreAllAlike) {
  for (int i = 1; i < kPairs; ++i)
    for (const char* side : {"left", "right"})
      fs::copy_file(image(folder, side, 0), image(folder, side, i),
                    fs::copy_options::overwrite_existing);
  expect_refused(1, "do not constrain the model");
}

TEST_F(CalibrateCommand, BadUsageIsTwo) {
  expect_refused(2, "--board", "--board nonsense");
  expect_refused(2, "--square-mm", "--square-mm 0");
}

}  // namespace
}  // namespace holdfast::registration
