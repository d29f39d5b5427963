// SPDX-License-Identifier: Apache-2.0
#include "registration/markups.hpp"

#include <filesystem>
#include <fstream>
#include <limits>

#include <gtest/gtest.h>
#include <nlohmann/json.hpp>

#include "rt/core/error.hpp"

namespace holdfast::registration {
namespace {

using nlohmann::json;

class Markups : public ::testing::Test {
 protected:
  void SetUp() override {
    path_ = (std::filesystem::path{::testing::TempDir()} /
             (std::string{"markups_"} +
              ::testing::UnitTest::GetInstance()->current_test_info()->name()))
                .string();
    MarkupPoint a{"bead-1", {1.25, -2.5, 0.1}, std::nullopt, "contrast 900 HU"}, b{"b", {}, {}, ""};
    Eigen::Matrix3d covariance;
    covariance << 4, 1, 0.5, 1, 3, 0.25, 0.5, 0.25, 2;
    b.covariance_mm2 = covariance * 1e-4;
    points_ = {a, b};
  }
  void TearDown() override { std::filesystem::remove(path_); }

  std::vector<MarkupPoint> read(const std::string& text) const {
    std::ofstream(path_, std::ios::binary) << text;
    return read_markups(path_);
  }
  std::string refusal(const std::string& text) const {
    try {
      (void)read(text);
    } catch (const InputError& e) {
      return e.what();
    }
    return "";
  }

  std::string path_;
  std::vector<MarkupPoint> points_;
};

TEST_F(Markups, ComeBackExactly) {
  const auto back = read(markups_text(points_));
  ASSERT_EQ(back.size(), 2U);
  EXPECT_EQ(back[0].label, "bead-1");
  EXPECT_EQ(back[0].description, "contrast 900 HU");
  EXPECT_EQ(back[0].position_mm, points_[0].position_mm);
  EXPECT_FALSE(back[0].covariance_mm2);
  ASSERT_TRUE(back[1].covariance_mm2);
  EXPECT_EQ(*back[1].covariance_mm2, *points_[1].covariance_mm2);
}

TEST_F(Markups, WritesWhatSlicerRequires) {
  const json content = json::parse(markups_text(points_));
  EXPECT_TRUE(content["@schema"].get<std::string>().find("markups-schema-v1") != std::string::npos);
  const json& list = content["markups"][0];
  EXPECT_EQ(list["type"], "Fiducial");
  EXPECT_EQ(list["coordinateSystem"], "LPS");
  EXPECT_EQ(list["coordinateUnits"], "mm");
  EXPECT_EQ(list["controlPoints"][1]["id"], "2");
  EXPECT_EQ(list["controlPoints"][1]["positionStatus"], "defined");
}

TEST_F(Markups, RasIsConvertedWithItsCovariance) {
  json content = json::parse(markups_text(points_));
  content["markups"][0]["coordinateSystem"] = "RAS";
  const auto back = read(content.dump());
  EXPECT_EQ(back[0].position_mm, Eigen::Vector3d(-1.25, 2.5, 0.1));
  const Eigen::Matrix3d &got = *back[1].covariance_mm2, &lps = *points_[1].covariance_mm2;
  EXPECT_EQ(got(0, 1), lps(0, 1));
  EXPECT_EQ(got(0, 2), -lps(0, 2));
  EXPECT_EQ(got(1, 2), -lps(1, 2));
  EXPECT_EQ(got(2, 2), lps(2, 2));
}

TEST_F(Markups, PointsThatWereNotPlacedAreNoPoints) {
  json content = json::parse(markups_text(points_));
  content["markups"][0]["controlPoints"][0]["positionStatus"] = "undefined";
  content["markups"][0]["controlPoints"][0]["position"] = nullptr;
  const auto back = read(content.dump());
  ASSERT_EQ(back.size(), 1U);
  EXPECT_EQ(back[0].label, "b");
}

TEST_F(Markups, RefusesBadInputByName) {
  const json good = json::parse(markups_text(points_));
  const auto with = [&](const char* pointer, const json& value) {
    json content = good;
    content[json::json_pointer(pointer)] = value;
    return content.dump();
  };
  json many = good;
  many["markups"][0]["controlPoints"] =
      json::array_t(10'001, good["markups"][0]["controlPoints"][0]);
  const std::string points = "/markups/0/controlPoints";
  const std::string covariance = points + "/1/covariance_mm2";
  const std::vector<std::pair<std::string, std::string>> cases = {
      {"", "is not JSON"},
      {"{\"markups\": [", "is not JSON"},
      {std::string(100'000, '['), "is not JSON"},
      {"[]", "no list 'markups'"},
      {"{\"markups\": {}}", "no list 'markups'"},
      {"{\"markups\": []}", "no control point"},
      {"{\"markups\": [7]}", "not an object"},
      {with("/markups/0/type", "Line"), "'Line'"},
      {with("/markups/0/coordinateSystem", "IJK"), "'IJK'"},
      {with("/markups/0/coordinateSystem", 1), "coordinateSystem is not a text"},
      {with("/markups/0/coordinateUnits", "m"), "'m'"},
      {with(points.c_str(), json::array()), "no control point"},
      {with(points.c_str(), 3), "no list 'controlPoints'"},
      {with((points + "/0").c_str(), 3), "not an object"},
      {with((points + "/0/position").c_str(), json::array({1, 2})), "position of point 'bead-1'"},
      {with((points + "/0/position/1").c_str(), nullptr), "not a finite number"},
      {with((points + "/0/position/1").c_str(), "1"), "not a finite number"},
      {with((points + "/0/label").c_str(), 4), "label is not a text"},
      {with(covariance.c_str(), json::array({1})), "9 numbers"},
      {with((covariance + "/1").c_str(), 1), "not symmetric"},
      {with((covariance + "/0").c_str(), -1), "not positive semi-definite"},
      {many.dump(), "more than 10000"},
  };
  for (const auto& [text, expected] : cases) {
    const std::string said = refusal(text);
    EXPECT_NE(said.find(expected), std::string::npos) << expected << " / " << said;
    EXPECT_NE(said.find(path_), std::string::npos) << said;
  }
  std::string infinite = good.dump();
  infinite.replace(infinite.find("1.25"), 4, "1e999");
  EXPECT_NE(refusal(infinite), "");
  EXPECT_THROW((void)read_markups(path_ + ".none"), InputError);
  EXPECT_THROW((void)read_markups(::testing::TempDir()), InputError);
}

TEST_F(Markups, ANumberThatIsNotFiniteIsNotWrittenAsOne) {
  points_[0].position_mm.x() = std::numeric_limits<double>::quiet_NaN();
  EXPECT_NE(refusal(markups_text(points_)), "");
}

}  // namespace
}  // namespace holdfast::registration
