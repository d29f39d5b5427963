// SPDX-License-Identifier: Apache-2.0
// The built `holdfast hand-eye` on drawn images of an aiming beam's spots: what it writes, and that
// bad input ends with its exit code, one line that names it, and no file.
#include <algorithm>
#include <cstdlib>
#include <filesystem>
#include <fstream>
#include <sstream>
#include <string>

#include <fmt/format.h>
#include <gtest/gtest.h>
#include <nlohmann/json.hpp>
#include <sys/wait.h>
#include <unistd.h>

#include "registration/hand_eye_file.hpp"
#include "rt/core/error.hpp"
#include "tests/registration/hand_eye/drawn_spot_images.hpp"

namespace holdfast::registration {
namespace {

namespace fs = std::filesystem;
using nlohmann::json;

class HandEyeCommand : public ::testing::Test {
 protected:
  static fs::path good() {
    return fs::path(::testing::TempDir()) / ("holdfast-hand-eye-" + std::to_string(getpid()));
  }

  static void draw_all() {
    if (is_drawn_) return;
    test::DrawnSpots options;
    options.count = 8;
    options.pixel_sigma_px = 0;  // the images have their own
    drawn_ = test::draw_hand_eye(options);
    fs::create_directories(good());
    test::write_spot_images(drawn_, good(), 3);
    is_drawn_ = true;
  }

  static void TearDownTestSuite() { fs::remove_all(good()); }
  void SetUp() override {
    draw_all();
    fs::remove(good() / "out.json");
    spots_ = json::parse(content("spots.json"));
  }

  static std::string content(const std::string& name) {
    std::stringstream text;
    text << std::ifstream(good() / name).rdbuf();
    return text.str();
  }
  int run(const std::string& more = "") {
    std::ofstream(good() / "now.json") << spots_;
    const std::string command = "cd '" + good().string() +
                                "' && '" HOLDFAST
                                "' hand-eye --spots now.json --calibration "
                                "stereo.yaml --zoom 1.3 --out out.json " +
                                more + " >out.txt 2>err.txt </dev/null";
    const int status = std::system(command.c_str());
    err_ = content("err.txt");
    return WIFEXITED(status) ? WEXITSTATUS(status) : -1;
  }
  void expect_refused(int code, const std::string& part, const std::string& more = "") {
    EXPECT_EQ(run(more), code) << part;
    EXPECT_EQ(std::count(err_.begin(), err_.end(), '\n'), 1) << err_;
    EXPECT_NE(err_.find(part), std::string::npos) << err_;
    EXPECT_FALSE(fs::exists(good() / "out.json")) << part;
  }

  static inline bool is_drawn_ = false;
  static inline test::DrawnHandEye drawn_;
  json spots_;
  std::string err_;
};

TEST_F(HandEyeCommand, FindsTheCameraAndSealsIt) {
  ASSERT_EQ(run("--json --snippet out.toml"), 0) << err_;
  const HandEyeCalibration found = load_hand_eye(good() / "out.json");
  const json result = json::parse(content("out.txt"));
  EXPECT_EQ(result["spots"].size(), 8U);
  EXPECT_EQ(result["checksum"], found.checksum);
  const Eigen::Vector3d middle(0, 0, 200);
  const double error_mm = (found.T_robot_camera * middle - drawn_.T_robot_camera * middle).norm();
  EXPECT_LT(error_mm, 4 * result["predicted"]["rms_mm"].get<double>());
  EXPECT_LT(error_mm, 0.2);
  EXPECT_EQ(found.zoom, 1.3);
  EXPECT_NE(content("out.toml").find("hand_eye = \"out.json\""), std::string::npos);

  std::string text = content("out.json");
  const auto at = text.find("\"zoom\": 1.3");
  ASSERT_NE(at, std::string::npos);
  text.replace(at, 11, "\"zoom\": 1.4");
  std::ofstream(good() / "changed.json") << text;
  EXPECT_THROW((void)load_hand_eye(good() / "changed.json"), InputError) << "sealed";
}

TEST_F(HandEyeCommand, RefusesByName) {
  const json good_spots = spots_;
  spots_["spots"][2]["left"] = "left_off.png";
  expect_refused(1, "s03 (left): no spot");
  spots_ = good_spots;
  for (json& spot : spots_["spots"]) std::swap(spot["left"], spot["right"]);
  expect_refused(1, "swapped");
  spots_ = good_spots;
  for (json& spot : spots_["spots"]) spot["point_mm"][0] = -spot["point_mm"][0].get<double>();
  expect_refused(1, "left-handed");
  spots_ = good_spots;
  spots_["spots"][4]["point_mm"][1] = 0;
  expect_refused(1, "s05 lies", "--json");
  spots_ = good_spots;
  expect_refused(2, "zoom", "--zoom 2.6");

  spots_ = good_spots;
  spots_.erase("sigma_mm");
  expect_refused(2, "sigma_mm is missing");
  spots_ = good_spots;
  spots_["spots"][1].erase("point_mm");
  expect_refused(2, "spots[1]: either point_mm or origin_mm");
  spots_ = good_spots;
  spots_["spots"][1]["point_mm"][2] = "x";
  expect_refused(2, "point_mm is not a finite number");
  spots_ = good_spots;
  spots_["spots"][1]["right"] = "nowhere.png";
  expect_refused(2, "nowhere.png");
  spots_ = json::array();
  expect_refused(2, "is not a JSON object");
}

}  // namespace
}  // namespace holdfast::registration
