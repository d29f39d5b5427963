// SPDX-License-Identifier: Apache-2.0
#include "tests/sim/or/room.hpp"

#include <filesystem>
#include <fstream>
#include <string>

#include <gtest/gtest.h>
#include <unistd.h>

#include "rt/core/error.hpp"

namespace holdfast::sim {
namespace {

class RoomConfigFile : public testing::Test {
 protected:
  void TearDown() override { std::filesystem::remove(path_); }
  RoomConfig read(const std::string& text) {
    std::ofstream(path_) << text;
    return read_room_config(path_);
  }
  std::string refusal(const std::string& text) {
    try {
      (void)read(text);
    } catch (const InputError& error) {
      return error.what();
    }
    return "accepted";
  }

 private:
  std::filesystem::path path_ = std::filesystem::temp_directory_path() /
                                ("holdfast_room_test_" + std::to_string(getpid()) + ".toml");
};

TEST_F(RoomConfigFile, EmptyIsTheDefaults) {
  const RoomConfig read_one = read(""), plain;
  EXPECT_EQ(read_one.phantom, plain.phantom);
  EXPECT_EQ(read_one.zoom, plain.zoom);
  EXPECT_EQ(read_one.calibration_zooms.size(), 5U);
  EXPECT_EQ(read_one.faults.missing_right, -1);
}

TEST_F(RoomConfigFile, ValuesArriveWhereTheyBelong) {
  const RoomConfig c = read(
      "seed = 7\n[microscope]\nzoom = 1.5\n[lights]\npattern_off_or_light = "
      "0.4\n[calibration]\nzoom_count = 3\n"
      "[faults]\nsmeared_view = 2\nswap_sides = true\n");
  EXPECT_EQ(c.phantom_seed, 7U);  // has none of its own
  EXPECT_EQ(c.optics.seed, 7U);
  EXPECT_EQ(c.zoom, 1.5);
  EXPECT_EQ(c.off_or_light, 0.4);
  ASSERT_EQ(c.calibration_zooms.size(), 3U);
  EXPECT_NEAR(c.calibration_zooms[1], 1.3, 1e-12);
  EXPECT_EQ(c.faults.smeared_view, 2);
  EXPECT_TRUE(c.faults.swaps_sides);
}

TEST_F(RoomConfigFile, RefusesWithTheKeysName) {
  const std::pair<const char*, const char*> cases[] = {
      {"[lights]\nor_lihgt = 1\n", "or_lihgt"},
      {"[lamps]\nor_light = 1\n", "lamps"},
      {"[microscope]\nzoom = 1.6\n", "zoom"},
      {"[microscope]\nzoom = nan\n", "zoom"},
      {"[sensor]\nbits = 10\n", "bits"},
      {"[lights]\npattern = \"stripes\"\n", "pattern"},
      {"[lights]\npattern = \"file\"\n", "pattern_file"},
      {"[poses]\ncount = 0\n", "count"},
      {"[phantom]\nkind = 3\n", "kind"},
      {"[faults]\nmissing_right = -2\n", "missing_right"},
  };
  for (const auto& [text, key] : cases)
    EXPECT_NE(refusal(text).find(key), std::string::npos) << text << refusal(text);
}

}  // namespace
}  // namespace holdfast::sim
