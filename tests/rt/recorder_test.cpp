// SPDX-License-Identifier: Apache-2.0
// The recorder's thread and its files: what it writes is what the tape held, whatever the disk
// does.
#include "rt/recorder.hpp"

#include <atomic>
#include <cerrno>
#include <filesystem>
#include <fstream>
#include <memory>
#include <string>
#include <thread>

#include <gtest/gtest.h>
#include <unistd.h>

#include "bridge/recorder/segment_folder.hpp"
#include "rt/core/error.hpp"
#include "rt/recording_fields.hpp"
#include "rt/replay.hpp"
#include "tests/rt/recorded_day.hpp"

namespace holdfast::rt {
namespace {

namespace fs = std::filesystem;
using testing::RecordedDay;

class RecorderTest : public ::testing::Test {
 protected:
  void SetUp() override {
    folder_ = fs::path(::testing::TempDir()) /
              ("recorder-" + std::to_string(getpid()) + "-" +
               ::testing::UnitTest::GetInstance()->current_test_info()->name());
    fs::remove_all(folder_);
    budget_ = kNoLimit;
    refusal_ = ENOSPC;
  }
  void TearDown() override { fs::remove_all(folder_); }

  /// Never more on the tape than it holds: the recorder's thread may be late here.
  void record(Recorder& recorder, RecordedDay& day, std::uint64_t cycles) {
    for (std::uint64_t i = 0; i < cycles; ++i) {
      while (day.cycles() - recorder.status().taken >= CycleTape::kCycles)
        std::this_thread::yield();
      day.record(recorder.tape());
    }
  }
  static void wait_until_taken(const Recorder& recorder, const RecordedDay& day) {
    while (recorder.status().taken < day.cycles()) std::this_thread::yield();
  }
  [[nodiscard]] std::vector<fs::path> files() const { return bridge::recordings_in(folder_); }
  [[nodiscard]] std::uint64_t bytes() const {
    std::uint64_t sum = 0;
    for (const fs::path& file : files()) sum += fs::file_size(file);
    return sum;
  }

  static constexpr std::int64_t kNoLimit = std::int64_t{1} << 60U;
  /// A disk that holds `budget_` more bytes, then is full.
  static ssize_t write_to_small_disk(int descriptor, const void* data, std::size_t count) {
    if (budget_ <= 0) {
      errno = refusal_;
      return -1;
    }
    const ssize_t written =
        ::write(descriptor, data, std::min(count, static_cast<std::size_t>(budget_)));
    if (written > 0) budget_ -= written;
    return written;
  }

  fs::path folder_;
  static inline std::atomic<std::int64_t> budget_{kNoLimit};
  static inline std::atomic<int> refusal_{ENOSPC};
};

TEST_F(RecorderTest, ADayReplaysBitForBit) {
  RecordProperty("requirement", "SR-122");
  RecordedDay day;
  {
    Recorder recorder({folder_}, testing::day_session());
    record(recorder, day, RecordedDay::kDay);
  }
  const ReplayReport report = replay(files());
  EXPECT_EQ(report.cycles, RecordedDay::kDay);
  EXPECT_EQ(report.compared, RecordedDay::kDay);
  EXPECT_GE(report.states, RecordedDay::kDay / CycleTape::kStateEvery - 1);
  EXPECT_EQ(report.differences, 0U);
  EXPECT_EQ(report.missing, 0U);
  EXPECT_TRUE(report.cuts.empty());
}

TEST_F(RecorderTest, KeepsTheNewestWithinItsBoundAndEachFileReplaysAlone) {
  constexpr std::uint64_t kBound = 8'000'000;
  RecordedDay day;
  {
    Recorder recorder({folder_, kBound}, testing::day_session());
    for (int i = 0; i < 24; ++i) {
      record(recorder, day, 1000);
      wait_until_taken(recorder, day);
      EXPECT_LE(bytes(), kBound);
    }
  }
  ASSERT_GT(files().size(), 3U);
  EXPECT_LE(bytes(), kBound);
  const ReplayReport all = replay(files());
  EXPECT_EQ(all.differences, 0U);
  EXPECT_EQ(all.missing, 0U) << "the oldest files were deleted whole: no gap between those left";
  EXPECT_EQ(all.without_state, 0U);
  EXPECT_LT(all.compared, day.cycles());
  EXPECT_GT(all.compared, 4000U);
  for (const fs::path& file : files()) {
    const ReplayReport one = replay({file});
    EXPECT_EQ(one.compared, one.cycles) << file;
    EXPECT_EQ(one.differences, 0U) << file;
  }
}

TEST_F(RecorderTest, AFailingDiskIsNamedCountedAndLeftBehindWhenItWorksAgain) {
  RecordProperty("requirement", "SR-121");
  RecordedDay day;
  std::uint64_t lost = 0;
  refusal_ = EIO;
  {
    budget_ = 2'500'000;
    Recorder recorder({folder_}, testing::day_session(), &write_to_small_disk);
    while (recorder.status().condition == RecorderCondition::recording) record(recorder, day, 100);
    EXPECT_EQ(recorder.status().condition, RecorderCondition::write_failed);
    EXPECT_EQ(recorder.status().error, EIO);
    record(recorder, day, 1500);  // past a state: it tries again, in vain
    wait_until_taken(recorder, day);
    EXPECT_EQ(recorder.status().condition, RecorderCondition::write_failed);
    EXPECT_GE(recorder.status().lost, 1500U);
    budget_ = kNoLimit;
    record(recorder, day, 2500);
    wait_until_taken(recorder, day);
    EXPECT_EQ(recorder.status().condition, RecorderCondition::recording);
    lost = recorder.status().lost;
  }
  const ReplayReport report = replay(files());
  EXPECT_EQ(report.differences, 0U);
  EXPECT_EQ(report.missing, lost);
  EXPECT_EQ(report.cycles + lost, day.cycles());
  EXPECT_EQ(report.compared, report.cycles) << "it resumes with a state";
  EXPECT_EQ(report.gaps.size(), 1U);
}

TEST_F(RecorderTest, AFullDiskIsNamedAndRecordingGoesOnWhenThereIsRoom) {
  RecordProperty("requirement", "SR-121");
  RecordedDay day;
  {
    budget_ = 2'500'000;
    Recorder recorder({folder_}, testing::day_session(), &write_to_small_disk);
    while (recorder.status().condition == RecorderCondition::recording) record(recorder, day, 100);
    EXPECT_EQ(recorder.status().condition, RecorderCondition::disk_full);
    EXPECT_EQ(recorder.status().error, ENOSPC);
    budget_ = kNoLimit;
    record(recorder, day, 2500);
    wait_until_taken(recorder, day);
    EXPECT_EQ(recorder.status().condition, RecorderCondition::recording);
  }
  const ReplayReport report = replay(files());
  EXPECT_EQ(report.differences, 0U);
  EXPECT_EQ(report.compared, report.cycles);
  EXPECT_GE(report.cycles, 1500U);
}

TEST_F(RecorderTest, OnAFullDiskItsOwnOldestFilesGoFirst) {
  RecordedDay day;
  budget_ = kNoLimit;
  Recorder recorder({folder_, 16'000'000}, testing::day_session(), &write_to_small_disk);
  record(recorder, day, 6000);  // three files
  wait_until_taken(recorder, day);
  const std::vector<fs::path> before = files();
  ASSERT_GE(before.size(), 3U);
  budget_ = 0;
  record(recorder, day, 1000);
  wait_until_taken(recorder, day);
  while (fs::exists(before.front())) std::this_thread::yield();  // ctest's limit is the bound
  SUCCEED();
}

TEST_F(RecorderTest, WhatATapeCouldNotHoldIsAGapThatTheReplayReports) {
  const auto tape_day = std::make_unique<RecordedDay>();
  const auto tape = std::make_unique<CycleTape>();
  for (std::uint64_t i = 0; i < CycleTape::kCycles + 100; ++i) tape_day->record(*tape);
  EXPECT_EQ(tape->dropped(), 100U);
  // The state before the gap and, after it, the state that the next taken cycle left.
  TapedCycle cycle;
  TapedState state;
  for (std::uint64_t i = 0; i < CycleTape::kCycles; ++i) ASSERT_TRUE(tape->try_pop(cycle));
  while (tape->try_pop(state)) {
  }
  tape_day->record(*tape);
  ASSERT_TRUE(tape->try_pop(cycle));
  ASSERT_TRUE(tape->try_pop(state));
  EXPECT_EQ(cycle.info.index, CycleTape::kCycles + 100);
  EXPECT_EQ(state.after, cycle.info.index);
}

TEST_F(RecorderTest, RefusesAFolderThatCannotBeWrittenOrIsInUse) {
  fs::create_directories(folder_);
  std::ofstream(folder_ / "file") << "x";
  EXPECT_THROW(Recorder({folder_ / "file"}, testing::day_session()), InputError);
  const Recorder first({folder_}, testing::day_session());
  EXPECT_THROW(Recorder({folder_}, testing::day_session()), InputError);
}

TEST_F(RecorderTest, TouchesNoFileButItsOwn) {
  fs::create_directories(folder_);
  std::ofstream(folder_ / "notes.mcap") << "x";
  std::ofstream(folder_ / "holdfast-notes.txt") << "x";
  RecordedDay day;
  {
    Recorder recorder({folder_, 8'000'000}, testing::day_session());
    record(recorder, day, 12'000);
  }
  EXPECT_TRUE(fs::exists(folder_ / "notes.mcap"));
  EXPECT_TRUE(fs::exists(folder_ / "holdfast-notes.txt"));
}

TEST(RecordingSchema, NamesTheLastCodeOfEachEnumeration) {
  const std::string schema = bridge::ros2::schema_text<perception::MotionEstimate>();
  for (const char* code : {"TRACKING_NONE", "TRACKING_FIXED_PATTERN", "STATUS_LOST"})
    EXPECT_NE(schema.find(code), std::string::npos) << code;
  EXPECT_EQ(schema.find("UNKNOWN"), std::string::npos);
}

}  // namespace
}  // namespace holdfast::rt
