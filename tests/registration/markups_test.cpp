// SPDX-License-Identifier: Apache-2.0
#include "registration/markups.hpp"

#include <filesystem>
#include <fstream>
#include <limits>
#include <stdexcept>

#include <gtest/gtest.h>
#include <nlohmann/json.hpp>

#include "rt/core/error.hpp"

namespace holdfast::registration {
namespace {

using nlohmann::json;

class MarkupsFile : public ::testing::Test {
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

  Markups read_file(const std::string& text) const {
    std::ofstream(path_, std::ios::binary) << text;
    return read_markups_file(path_);
  }
  std::vector<MarkupPoint> read(const std::string& text) const { return read_file(text).points; }
  /// The points with an identity, and with errors that they share: joint blocks are their own.
  Markups joint() const {
    Markups markups{points_, {{kCtSeriesUid, "1.2.840.7"}, {"note", "a \"text\", µ"}}, {}};
    markups.points[0].covariance_mm2 = Eigen::Vector3d(0.25, 0.5, 1).asDiagonal();
    markups.joint_covariance_mm2 = Eigen::MatrixXd::Zero(6, 6);
    markups.joint_covariance_mm2.topLeftCorner<3, 3>() = *markups.points[0].covariance_mm2;
    markups.joint_covariance_mm2.bottomRightCorner<3, 3>() = *markups.points[1].covariance_mm2;
    markups.joint_covariance_mm2(0, 3) = markups.joint_covariance_mm2(3, 0) = 1e-3;
    markups.joint_covariance_mm2(0, 5) = markups.joint_covariance_mm2(5, 0) = 2e-3;
    return markups;
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

TEST_F(MarkupsFile, ComeBackExactly) {
  const auto back = read(markups_text(points_));
  ASSERT_EQ(back.size(), 2U);
  EXPECT_EQ(back[0].label, "bead-1");
  EXPECT_EQ(back[0].description, "contrast 900 HU");
  EXPECT_EQ(back[0].position_mm, points_[0].position_mm);
  EXPECT_FALSE(back[0].covariance_mm2);
  ASSERT_TRUE(back[1].covariance_mm2);
  EXPECT_EQ(*back[1].covariance_mm2, *points_[1].covariance_mm2);
}

TEST_F(MarkupsFile, IdentityAndJointCovarianceComeBackExactly) {
  const Markups back = read_file(markups_text(joint()));
  EXPECT_EQ(back.properties, joint().properties);
  EXPECT_EQ(back.joint_covariance_mm2, joint().joint_covariance_mm2);
  const Markups plain = read_file(markups_text(points_));
  EXPECT_TRUE(plain.properties.empty());
  EXPECT_EQ(plain.joint_covariance_mm2.size(), 0);
}

TEST_F(MarkupsFile, JointCovarianceOfARasFileIsConverted) {
  json content = json::parse(markups_text(joint()));
  content["markups"][0]["coordinateSystem"] = "RAS";
  const Eigen::MatrixXd got = read_file(content.dump()).joint_covariance_mm2;
  const Eigen::MatrixXd lps = joint().joint_covariance_mm2;
  EXPECT_EQ(got(0, 3), lps(0, 3));
  EXPECT_EQ(got(0, 5), -lps(0, 5));
  EXPECT_EQ(got(5, 5), lps(5, 5));
}

TEST_F(MarkupsFile, RefusesAJointCovarianceOrPropertyByName) {
  const json good = json::parse(markups_text(joint()));
  const auto with = [&](const char* pointer, const json& value) {
    json content = good;
    content[json::json_pointer(pointer)] = value;
    return content.dump();
  };
  json fewer = good;
  fewer["markups"][0]["controlPoints"].erase(1);
  json swapped = good;
  std::swap(swapped["markups"][0]["controlPoints"][0], swapped["markups"][0]["controlPoints"][1]);
  const std::vector<std::pair<std::string, std::string>> cases = {
      {with("/holdfast", 1), "'holdfast' is not an object"},
      {with("/holdfast/properties", json::array()), "properties is not an object"},
      {with("/holdfast/properties/note", 3), "property 'note' is not a text"},
      {with("/holdfast/joint_covariance_mm2", json::array({1})), "36 numbers, as 2 points"},
      {with("/holdfast/joint_covariance_mm2/3", nullptr), "not a finite number"},
      {with("/holdfast/joint_covariance_mm2/3", 0.5), "joint_covariance_mm2 is not symmetric"},
      {with("/holdfast/joint_covariance_mm2/0", -1), "not positive semi-definite"},
      {with("/holdfast/joint_covariance_mm2/0", 0.26), "differs from covariance_mm2 of point"},
      {fewer.dump(), "9 numbers, as 1 points"},
      {swapped.dump(), "differs from covariance_mm2 of point 'b'"},
  };
  for (const auto& [text, expected] : cases) {
    const std::string said = refusal(text);
    EXPECT_NE(said.find(expected), std::string::npos) << expected << " / " << said;
  }
  Markups wrong = joint();
  wrong.points.pop_back();
  EXPECT_THROW((void)markups_text(wrong), std::invalid_argument);
}

TEST_F(MarkupsFile, WritesWhatSlicerRequires) {
  const json content = json::parse(markups_text(points_));
  EXPECT_TRUE(content["@schema"].get<std::string>().find("markups-schema-v1") != std::string::npos);
  const json& list = content["markups"][0];
  EXPECT_EQ(list["type"], "Fiducial");
  EXPECT_EQ(list["coordinateSystem"], "LPS");
  EXPECT_EQ(list["coordinateUnits"], "mm");
  EXPECT_EQ(list["controlPoints"][1]["id"], "2");
  EXPECT_EQ(list["controlPoints"][1]["positionStatus"], "defined");
}

TEST_F(MarkupsFile, RasIsConvertedWithItsCovariance) {
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

TEST_F(MarkupsFile, PointsThatWereNotPlacedAreNoPoints) {
  json content = json::parse(markups_text(points_));
  content["markups"][0]["controlPoints"][0]["positionStatus"] = "undefined";
  content["markups"][0]["controlPoints"][0]["position"] = nullptr;
  const auto back = read(content.dump());
  ASSERT_EQ(back.size(), 1U);
  EXPECT_EQ(back[0].label, "b");
}

TEST_F(MarkupsFile, RefusesBadInputByName) {
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

TEST_F(MarkupsFile, ANumberThatIsNotFiniteIsNotWrittenAsOne) {
  points_[0].position_mm.x() = std::numeric_limits<double>::quiet_NaN();
  EXPECT_NE(refusal(markups_text(points_)), "");
}

}  // namespace
}  // namespace holdfast::registration
