// SPDX-License-Identifier: Apache-2.0
#include "tests/fault/hours.hpp"

#include <filesystem>
#include <fstream>
#include <sstream>

#include <gtest/gtest.h>
#include <unistd.h>

#include "rt/core/error.hpp"

namespace holdfast::fault {
namespace {

HoursOptions short_hours(int count) {
  HoursOptions options;
  options.hour_ms = 1000;
  options.hours = count / 3600.0;
  return options;
}

/// A results file that is gone after the test.
class HoursFile : public ::testing::Test {
 protected:
  HoursFile() {
    std::filesystem::remove(path_);
    options_.results = path_;
  }
  ~HoursFile() override { std::filesystem::remove(path_); }
  [[nodiscard]] std::string text() const {
    std::ostringstream text;
    text << std::ifstream(path_).rdbuf();
    return text.str();
  }

  const std::string path_ =
      std::filesystem::temp_directory_path() / ("holdfast_hours_" + std::to_string(getpid()));
  HoursOptions options_ = short_hours(4);
};

TEST(Hours, DependOnTheSeedAndNotOnTheThreads) {
  HoursOptions options = short_hours(5);
  const HoursResult alone = run_hours(options);
  options.jobs = 3;
  EXPECT_EQ(run_hours(options).digest, alone.digest);
  options.seed = 2;
  EXPECT_NE(run_hours(options).digest, alone.digest);
  EXPECT_EQ(alone.hours.size(), 5U);
  EXPECT_EQ(alone.stops, 0U);
}

TEST(Hours, DifferFromOneAnother) {
  EXPECT_NE(run_hour(1, 0, 1000).digest, run_hour(1, 1, 1000).digest);
}

TEST(Hours, SeeTheFalseStopsOfALimitThatIsTooStrict) {
  HoursOptions options = short_hours(5);
  options.room.frame_lateness = nanoseconds(0);  // frames of a lively room are late at times
  const HoursResult result = run_hours(options);
  EXPECT_GT(result.stops, 0U);
  for (const Hour& hour : result.hours) EXPECT_EQ(hour.stops > 0, hour.first_stop_ms > 0);
  EXPECT_GT(result.rate_upper_95, static_cast<double>(result.stops) / result.virtual_hours);
}

TEST_F(HoursFile, LetsALaterRunGoOn) {
  const HoursResult whole = run_hours(options_);
  std::filesystem::remove(path_);
  HoursOptions first = options_;
  first.hours = 2 / 3600.0;
  (void)run_hours(first);
  EXPECT_EQ(run_hours(options_).digest, whole.digest);
}

TEST_F(HoursFile, IsBelievedForWhatItHolds) {
  (void)run_hours(options_);
  std::string spoilt = text();
  const std::size_t at = spoilt.find("\"stops\": 0");
  ASSERT_NE(at, std::string::npos);
  spoilt[at + 9] = '7';
  std::ofstream(path_) << spoilt;
  EXPECT_EQ(run_hours(options_).stops, 7U);  // not run again
}

TEST_F(HoursFile, OfAnotherSeedIsRefused) {
  (void)run_hours(options_);
  options_.seed = 2;
  EXPECT_THROW((void)run_hours(options_), InputError);
}

TEST_F(HoursFile, OfAProgramThatDecidesOtherwiseIsRefused) {
  (void)run_hours(options_);
  options_.room.frame_lateness = nanoseconds(0);
  EXPECT_THROW((void)run_hours(options_), InputError);
}

TEST_F(HoursFile, ThatIsNoneIsRefused) {
  std::ofstream(path_) << "{\"schema\": 1";
  EXPECT_THROW((void)run_hours(options_), InputError);
}

TEST(Hours, BoundTheirRateAsPoissonHasIt) {  // tables of the chi-squared distribution, halved
  EXPECT_NEAR(poisson_upper_95(0), 2.9957, 1e-4);
  EXPECT_NEAR(poisson_upper_95(1), 4.7439, 1e-4);
  EXPECT_NEAR(poisson_upper_95(10), 16.9622, 1e-4);
}

}  // namespace
}  // namespace holdfast::fault
