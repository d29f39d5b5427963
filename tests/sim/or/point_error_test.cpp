// SPDX-License-Identifier: Apache-2.0
#include "tests/sim/or/point_error.hpp"

#include <filesystem>
#include <fstream>
#include <string>

#include <gtest/gtest.h>
#include <unistd.h>

#include "rt/core/error.hpp"
#include "tests/sim/or/room_output.hpp"

namespace holdfast::sim {
namespace {

using Eigen::Vector3d;
using nlohmann::json;

Phantom two_beads() {
  Phantom phantom;
  phantom.region_of_interest_mm = {Vector3d(-1, -1, -1), Vector3d(1, 1, 1)};
  phantom.markers = {{0, 9, Eigen::Isometry3d::Identity(), {10, 20, 30}},
                     {3, 9, Eigen::Isometry3d::Identity(), {-40, 50, -60}}};
  return phantom;
}

class TruthFile : public testing::Test {
 protected:
  void TearDown() override { std::filesystem::remove(path_); }
  const std::string& holding(const std::string& text) {
    std::ofstream(path_) << text;
    return path_;
  }
  template <typename Read>
  std::string refusal(const std::string& text, const Read& read) {
    try {
      (void)read(holding(text));
    } catch (const InputError& error) {
      return error.what();
    }
    return "accepted";
  }

 private:
  std::string path_ = (std::filesystem::temp_directory_path() /
                       ("holdfast_point_error_test_" + std::to_string(getpid()) + ".json"))
                          .string();
};

TEST_F(TruthFile, BeadsAreReadFromBothTheScansAndTheRooms) {
  const Phantom phantom = two_beads();
  const std::string of_ct = ct_truth(phantom, {}).dump();
  const Eigen::Isometry3d T_camera_ct(Eigen::Translation3d(1, 2, 3));
  const std::string of_room =
      json{{"poses", {{{"markers", markers_json(phantom, T_camera_ct)}}}}}.dump();
  for (const std::string& text : {of_ct, of_room}) {
    const std::vector<TruePoint> beads = true_beads(holding(text));
    ASSERT_EQ(beads.size(), 2U) << text;
    EXPECT_EQ(beads[0].label, "0");
    EXPECT_EQ(beads[1].label, "3");
    EXPECT_EQ(beads[0].p_mm, Vector3d(10, 20, 30));
    EXPECT_EQ(beads[1].p_mm, Vector3d(-40, 50, -60));
  }
  const std::vector<TruePoint> seen = true_points(holding(of_room), "bead_camera", 0);
  ASSERT_EQ(seen.size(), 2U);
  EXPECT_EQ(seen[1].p_mm, Vector3d(-39, 52, -57));
}

TEST_F(TruthFile, AnotherFileIsRefusedInOneLine) {
  const auto beads = [](const std::string& path) { return true_beads(path); };
  const auto markers = [](const std::string& path) {
    return true_points(path, "marker_camera", 1);
  };
  const std::string of_room =
      json{{"poses", {{{"markers", markers_json(two_beads(), Eigen::Isometry3d::Identity())}}}}}
          .dump();
  for (const std::string text :
       {"", "no JSON", "[]", "{}", R"({"poses": []})", R"({"markers": [{"id": 1}]})",
        R"({"poses": [{"T_camera_site": []}]})",
        R"({"markers": [{"id": 1, "bead_ct_mm": [1]}]})"}) {
    const std::string line = refusal(text, beads);
    EXPECT_TRUE(line.ends_with(": not a truth file of `holdfast-sim ct` or `or` with beads"))
        << text << ": " << line;
  }
  for (const std::string& text : {ct_truth(two_beads(), {}).dump(), of_room}) {
    const std::string line = refusal(text, markers);
    EXPECT_TRUE(
        line.ends_with(": not a truth file of `holdfast-sim or` with 'marker_camera' of pose 1"))
        << line;
  }
  EXPECT_TRUE(refusal(ct_truth({}, {}).dump(), beads).ends_with(": the phantom has no markers"));
  EXPECT_THROW((void)true_beads("/no/such/file"), InputError);
}

TEST(PointError, PairsByTheNumberOfTheLabel) {
  const std::vector<TruePoint> truth{{"0", {0, 0, 0}}, {"3", {10, 0, 0}}, {"7", {0, 10, 0}}};
  std::vector<registration::MarkupPoint> measured;
  const auto measure = [&](const std::string& label, const Vector3d& p_mm) {
    registration::MarkupPoint& point = measured.emplace_back();
    point.label = label;
    point.position_mm = p_mm;
  };
  measure("marker 3", {10, 0, 0.4});
  measure("marker 00", {0.3, 0, 0});
  measure("marker 9", {0, 10, 0});
  const PointError error = error_by_label(measured, truth);
  ASSERT_EQ(error.points.size(), 2U);
  EXPECT_NEAR(error.max_mm, 0.4, 1e-12);
  EXPECT_NEAR(error.rms_mm, std::sqrt((0.4 * 0.4 + 0.3 * 0.3) / 2), 1e-12);
  EXPECT_TRUE(std::isnan(error.rms_after_rigid_mm));
  EXPECT_EQ(error.missing, 1);
  EXPECT_EQ(error.surplus, 1);
}

TEST(PointError, ARigidMotionIsTakenOutOfWhatIsLeft) {
  const std::vector<TruePoint> truth{
      {"0", {0, 0, 0}}, {"1", {10, 0, 0}}, {"2", {0, 10, 0}}, {"3", {0, 0, 10}}};
  std::vector<registration::MarkupPoint> measured;
  for (const TruePoint& p : truth) {
    registration::MarkupPoint& m = measured.emplace_back();
    m.position_mm = p.p_mm + Vector3d(0.5, 0, 0);
  }
  const PointError error = error_by_place(measured, truth, 1);
  EXPECT_NEAR(error.rms_mm, 0.5, 1e-12);
  EXPECT_NEAR(error.rms_after_rigid_mm, 0, 1e-12);
  EXPECT_EQ(error_by_place(measured, truth, 0.4).missing, 4);
}

}  // namespace
}  // namespace holdfast::sim
