// SPDX-License-Identifier: Apache-2.0
// The live view's file: what is written is read; nothing half, old, foreign or absurd is.
#include "bridge/live_view/live_file.hpp"

#include <atomic>
#include <cerrno>
#include <csignal>
#include <cstring>
#include <fstream>
#include <iterator>
#include <limits>
#include <numeric>
#include <thread>

#include <gtest/gtest.h>
#include <sys/resource.h>
#include <sys/stat.h>
#include <unistd.h>

#include "rt/core/error.hpp"

namespace holdfast::bridge {
namespace {

namespace fs = std::filesystem;
using std::chrono::milliseconds;
using std::chrono::nanoseconds;
using Bytes = std::vector<std::uint8_t>;

constexpr dds::Clocks kNow{std::chrono::hours(5), std::chrono::hours(400'000)};

dds::Clocks later(nanoseconds by) {
  return {kNow.monotonic + by, kNow.utc + by};
}

LivePicture picture_of(std::uint64_t frame, dds::Clocks t = kNow) {
  LivePicture p;
  p.frame = frame;
  p.t_exposure = t.monotonic;
  p.t_utc = t.utc;
  p.width_px = 64;
  p.height_px = 48;
  p.factor = 3;
  p.camera_width_px = 200;
  p.camera_height_px = 146;
  p.fx_px = p.fy_px = 9000;
  p.status = perception::TrackingStatus::degraded;
  p.reason = perception::TrackingReason::out_of_focus;
  p.inliers = 2;
  p.visible = 3;
  p.has_motion = true;
  p.from = {32, 24};
  p.to = {-5, 70};
  p.points = {{0, 0}, {63, 47}};
  p.mask.assign(16 * 12, 9);
  p.pixels.resize(64 * 48);
  std::iota(p.pixels.begin(), p.pixels.end(), static_cast<std::uint8_t>(frame));
  return p;
}

Bytes packed(const LivePicture& picture, std::uint64_t sequence = 2) {
  Bytes bytes;
  EXPECT_TRUE(pack_live(picture, sequence, bytes));
  return bytes;
}

LiveBytes verdict_of(const Bytes& bytes) {
  LivePicture ignored;
  return unpack_live(bytes, ignored);
}

/// As `T` at `at`.
template <class T>
Bytes with(Bytes bytes, std::size_t at, T value) {
  std::memcpy(bytes.data() + at, &value, sizeof value);
  return bytes;
}

TEST(LiveLayout, KeepsEverything) {
  const LivePicture given = picture_of(7);
  LivePicture read;
  ASSERT_EQ(unpack_live(packed(given), read), LiveBytes::picture);
  EXPECT_EQ(read.frame, 7U);
  EXPECT_EQ(read.t_exposure, given.t_exposure);
  EXPECT_EQ(read.t_utc, given.t_utc);
  EXPECT_EQ(read.width_px, 64);
  EXPECT_EQ(read.height_px, 48);
  EXPECT_EQ(read.factor, 3);
  EXPECT_EQ(read.fx_px, 9000);
  EXPECT_EQ(read.status, given.status);
  EXPECT_EQ(read.reason, given.reason);
  EXPECT_EQ(read.inliers, 2);
  EXPECT_EQ(read.visible, 3);
  EXPECT_TRUE(read.has_motion);
  EXPECT_EQ(read.to.y_px, 70);
  ASSERT_EQ(read.points.size(), 2U);
  EXPECT_EQ(read.points[1].x_px, 63);
  EXPECT_EQ(read.mask, given.mask);
  EXPECT_EQ(read.pixels, given.pixels);
}

TEST(LiveLayout, RefusesAFileCutShortAnywhere) {
  const Bytes whole = packed(picture_of(1));
  for (std::size_t n = 0; n < whole.size(); n += n < 200 ? 1 : 97)
    EXPECT_NE(verdict_of({whole.begin(), whole.begin() + static_cast<std::ptrdiff_t>(n)}),
              LiveBytes::picture)
        << n;
}

TEST(LiveLayout, SaysWhatItRefuses) {
  const Bytes good = packed(picture_of(1));
  ASSERT_EQ(verdict_of(good), LiveBytes::picture);
  EXPECT_EQ(verdict_of({}), LiveBytes::unfinished);
  EXPECT_EQ(verdict_of(with(good, kLiveSequenceAt, std::uint64_t{3})), LiveBytes::unfinished);
  EXPECT_EQ(verdict_of(with(good, 0, 'X')), LiveBytes::not_ours);
  EXPECT_EQ(verdict_of(with(good, 8, kLiveVersion + 1)), LiveBytes::other_version);
  EXPECT_EQ(verdict_of(with(good, 12, std::uint32_t{160})), LiveBytes::other_version);
}

TEST(LiveLayout, RefusesWhatCannotBe) {
  const Bytes good = packed(picture_of(1));
  // Header's fields from byte 48 on: width, height, channels, factor, camera's width, height,
  // points, inliers, visible, status, reason, has_motion; then fx as double.
  for (int field = 0; field < 12; ++field)
    for (const std::int32_t lie : {-1, 1'000'001, std::numeric_limits<std::int32_t>::max(),
                                   std::numeric_limits<std::int32_t>::min()})
      EXPECT_EQ(verdict_of(with(good, 48 + 4 * static_cast<std::size_t>(field), lie)),
                LiveBytes::damaged)
          << field << ' ' << lie;
  EXPECT_EQ(verdict_of(with(good, 48, std::int32_t{1280})), LiveBytes::damaged) << "too few bytes";
  EXPECT_EQ(verdict_of(with(good, 32, std::int64_t{0})), LiveBytes::damaged) << "no time";
  for (const double lie : {0.0, std::nan(""), std::numeric_limits<double>::infinity()})
    EXPECT_EQ(verdict_of(with(good, 96, lie)), LiveBytes::damaged) << lie;
  for (const float lie : {std::nanf(""), -2.0F, 65.0F})
    EXPECT_EQ(verdict_of(with(good, kLiveHeaderBytes, lie)), LiveBytes::damaged) << lie;
}

class LiveFile : public ::testing::Test {
 protected:
  void SetUp() override { fs::create_directories(folder_); }
  void TearDown() override { fs::remove_all(folder_); }
  void put(const Bytes& bytes) const {
    std::ofstream(file_, std::ios::binary)
        .write(reinterpret_cast<const char*>(bytes.data()),  // NOLINT: the stream's own unit
               static_cast<std::streamsize>(bytes.size()));
    fs::permissions(file_, fs::perms::owner_read | fs::perms::owner_write);
  }

  const fs::path folder_ =
      fs::path("/dev/shm") / ("holdfast-live-" + std::to_string(::getpid()));  // as in a set-up
  const fs::path file_ = folder_ / "live_view";
  LiveReader reader_{file_};
};

TEST_F(LiveFile, ReaderSeesTheNewestPictureWithinItsAge) {
  RecordProperty("requirement", "SR-146");
  LiveWriter writer(file_);
  EXPECT_EQ(reader_.look(kNow), nullptr) << "nothing is written yet";
  for (const std::uint64_t frame : {1U, 2U}) {
    ASSERT_EQ(writer.write(picture_of(frame)), 0);
    const LivePicture* seen = reader_.look(later(kLiveAgeMax));
    ASSERT_NE(seen, nullptr);
    EXPECT_EQ(seen->frame, frame);
    EXPECT_EQ(seen->pixels, picture_of(frame).pixels);
  }
  EXPECT_EQ(reader_.look(later(kLiveAgeMax + nanoseconds(1))), nullptr);
  EXPECT_EQ(reader_.why(), NoPicture::old);
  EXPECT_EQ(reader_.t_seen(), kNow.monotonic + kLiveAgeMax);
}

TEST_F(LiveFile, PictureOfTheFutureOrOfAnEarlierBootIsNone) {
  RecordProperty("requirement", "SR-146");
  EXPECT_TRUE(is_live(picture_of(1), kNow));
  EXPECT_FALSE(is_live(picture_of(1), later(milliseconds(-20))));
  EXPECT_FALSE(is_live(picture_of(1), {kNow.monotonic, kNow.utc + std::chrono::hours(1)}));
  LivePicture absurd = picture_of(1);
  absurd.t_exposure = nanoseconds(std::numeric_limits<std::int64_t>::max());
  EXPECT_FALSE(is_live(absurd, kNow));
}

TEST_F(LiveFile, FileLeftByAKilledDaemonGrowsOld) {
  RecordProperty("requirement", "SR-146");
  put(packed(picture_of(1)));
  EXPECT_NE(reader_.look(kNow), nullptr);
  EXPECT_EQ(reader_.look(later(milliseconds(501))), nullptr);
  EXPECT_EQ(LiveReader(file_).look(later(milliseconds(501))), nullptr) << "a new reader";
}

TEST_F(LiveFile, WriterThatDiesWhileWritingLeavesNoPicture) {
  Bytes torn = packed(picture_of(2), 3);
  put(packed(picture_of(1)));
  ASSERT_NE(reader_.look(kNow), nullptr);
  put(torn);
  const LivePicture* kept = reader_.look(kNow);
  ASSERT_NE(kept, nullptr) << "the one before is still of now";
  EXPECT_EQ(kept->frame, 1U);
  EXPECT_EQ(reader_.look(later(milliseconds(501))), nullptr);
  EXPECT_EQ(LiveReader(file_).look(kNow), nullptr);
}

TEST_F(LiveFile, WriterRestarts) {
  auto first = std::make_unique<LiveWriter>(file_);
  ASSERT_EQ(first->write(picture_of(1)), 0);
  ASSERT_NE(reader_.look(kNow), nullptr);
  LiveWriter second(file_);
  EXPECT_EQ(reader_.look(kNow)->frame, 1U) << "between two writes it is what it was";
  ASSERT_EQ(second.write(picture_of(2)), 0);
  EXPECT_EQ(reader_.look(kNow)->frame, 2U);
  ASSERT_EQ(first->write(picture_of(3)), 0);
  first.reset();
  ASSERT_NE(reader_.look(kNow), nullptr) << "the second's file stays";
  EXPECT_EQ(reader_.look(kNow)->frame, 2U);
}

TEST_F(LiveFile, NothingIsShownWhenTheFileGoes) {
  RecordProperty("requirement", "SR-146");
  EXPECT_EQ(reader_.look(kNow), nullptr);
  EXPECT_EQ(reader_.why(), NoPicture::no_file);
  {
    LiveWriter writer(file_);
    ASSERT_EQ(writer.write(picture_of(1)), 0);
    ASSERT_NE(reader_.look(kNow), nullptr);
    fs::resize_file(file_, 1000);
    ASSERT_NE(reader_.look(kNow), nullptr) << "read before, and still of now";
    EXPECT_EQ(LiveReader(file_).look(kNow), nullptr);
    ASSERT_EQ(writer.write(picture_of(2)), 0);
    EXPECT_NE(LiveReader(file_).look(kNow), nullptr) << "whole again";
  }
  EXPECT_EQ(reader_.look(kNow), nullptr);
  EXPECT_EQ(reader_.why(), NoPicture::no_file);
}

TEST_F(LiveFile, ReaderTakesNoFileThatOthersMayWriteNorWhatIsNone) {
  const auto why = [this] {
    LiveReader reader(file_);
    EXPECT_EQ(reader.look(kNow), nullptr);
    return reader.why();
  };
  put(packed(picture_of(1)));
  fs::permissions(file_, fs::perms::group_write, fs::perm_options::add);
  EXPECT_EQ(why(), NoPicture::not_readable);
  fs::remove(file_);
  ASSERT_EQ(mkfifo(file_.c_str(), 0600), 0);
  EXPECT_EQ(why(), NoPicture::not_readable) << "and does not wait for a writer";
  fs::remove(file_);
  put(packed(picture_of(1)));
  fs::rename(file_, folder_ / "other");
  fs::create_symlink(folder_ / "other", file_);
  EXPECT_EQ(why(), NoPicture::not_readable);
  fs::remove(file_);
  put({'t', 'e', 'x', 't', '\n', ' ', ' ', ' ', ' '});
  EXPECT_EQ(why(), NoPicture::not_ours);
}

TEST_F(LiveFile, WriterMakesItReadableForItsGroupAlone) {
  const mode_t before = umask(0077);
  const LiveWriter writer(file_);
  umask(before);
  struct stat status {};
  ASSERT_EQ(stat(file_.c_str(), &status), 0);
  EXPECT_EQ(status.st_mode & 0777U, 0640U);
}

TEST_F(LiveFile, WriterOverwritesNothingElse) {
  put({'n', 'o', 't', 'e', 's', '.', '.', '.', '.'});
  EXPECT_THROW(LiveWriter{file_}, InputError);
  EXPECT_EQ(fs::file_size(file_), 9U);
  EXPECT_THROW(LiveWriter{folder_}, InputError);
  EXPECT_THROW(LiveWriter{folder_ / "missing" / "live_view"}, InputError);
}

TEST_F(LiveFile, WriteThatFailsEndsThePictureAndNotTheProcess) {
  LiveWriter writer(file_);
  ASSERT_EQ(writer.write(picture_of(1)), 0);
  rlimit before{};
  ASSERT_EQ(getrlimit(RLIMIT_FSIZE, &before), 0);
  const auto handler = std::signal(SIGXFSZ, SIG_IGN);
  const rlimit small{2000, before.rlim_max};
  ASSERT_EQ(setrlimit(RLIMIT_FSIZE, &small), 0);
  const int error = writer.write(picture_of(2));
  ASSERT_EQ(setrlimit(RLIMIT_FSIZE, &before), 0);
  (void)std::signal(SIGXFSZ, handler);
  EXPECT_EQ(error, EFBIG);
  EXPECT_EQ(reader_.look(kNow), nullptr);
  EXPECT_EQ(writer.write(LivePicture{}), EINVAL);
  EXPECT_EQ(writer.write(picture_of(3)), 0);
  EXPECT_NE(reader_.look(kNow), nullptr);
}

TEST_F(LiveFile, NoReaderSeesAMixture) {
  LiveWriter writer(file_);
  std::atomic<bool> is_ending{false};
  std::thread writing([&] {
    LivePicture picture = picture_of(0);
    picture.width_px = picture.height_px = picture.camera_width_px = picture.camera_height_px =
        1280;
    picture.factor = 1;
    picture.mask.resize(320 * 320);
    picture.pixels.resize(1280 * 1280);
    for (std::uint64_t frame = 1; !is_ending; ++frame) {
      picture.frame = frame;
      std::fill(picture.pixels.begin(), picture.pixels.end(), static_cast<std::uint8_t>(frame));
      if (writer.write(picture) != 0) return;
    }
  });
  int mixtures = 0;
  std::uint64_t newest = 0;
  for (int seen = 0; seen < 40;) {
    const LivePicture* picture = reader_.look(kNow);
    if (picture == nullptr || picture->frame == newest) continue;
    newest = picture->frame;
    ++seen;
    for (const std::uint8_t pixel : picture->pixels)
      mixtures += pixel == static_cast<std::uint8_t>(newest) ? 0 : 1;
  }
  is_ending = true;
  writing.join();
  EXPECT_EQ(mixtures, 0);
}

}  // namespace
}  // namespace holdfast::bridge
