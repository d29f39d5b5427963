// SPDX-License-Identifier: Apache-2.0
// What the study and the set-up flow are made of: rows, page, region, rig, depth.
#include <algorithm>
#include <chrono>
#include <cmath>
#include <filesystem>
#include <fstream>
#include <string>

#include <gtest/gtest.h>
#include <nlohmann/json.hpp>
#include <opencv2/calib3d.hpp>
#include <unistd.h>

#include "registration/pattern_table.hpp"
#include "rt/core/error.hpp"
#include "rt/study/fiducial_region.hpp"
#include "rt/study/illumination.hpp"
#include "rt/study/pattern_choice.hpp"
#include "rt/study/rig.hpp"
#include "rt/study/setup_flow.hpp"
#include "rt/study/study_report.hpp"
#include "rt/study/study_row.hpp"
#include "rt/study/tracking_report.hpp"
#include "rt/study/trajectory_file.hpp"

namespace holdfast::rt {
namespace {

using nlohmann::json;
namespace fs = std::filesystem;

StudyRow row_with(double closest_mm, const std::string& refusal = "") {
  StudyRow row;
  row.zoom = 1.3;
  row.illumination = "adaptive";
  row.method = "sgm";
  row.closest_mean_mm = closest_mm;
  row.refusal = refusal;
  return row;
}

TEST(StudyRow, SurvivesItsFile) {
  StudyRow row = row_with(0.21, "period_slip: \"41\" % of, 35 %");
  row.repeat = 7;
  row.coverage = 0.97;
  const StudyRow back = row_of(json::parse(as_json(row).dump()));
  EXPECT_EQ(back.repeat, 7);
  EXPECT_EQ(back.closest_mean_mm, 0.21);
  EXPECT_EQ(back.coverage, 0.97);
  EXPECT_EQ(back.refusal, row.refusal);
  EXPECT_TRUE(std::isnan(back.truth_median_mm));
  EXPECT_THROW((void)row_of(json::parse("{}")), InputError);
}

TEST(StudyRow, CsvLeavesUnknownEmptyAndQuotesText) {
  const std::string csv = csv_text({row_with(0.5, "too \"dark\", 3")});
  const std::string line = csv.substr(csv.find('\n') + 1);
  EXPECT_EQ(line, "1.3,adaptive,0,sgm,,,,,0.5,,,,,,,,,,,,,\"too \"\"dark\"\", 3\"\n");
}

TEST(StudyCell, ARefusalIsCountedAndNoFigureOfItAveraged) {
  const std::vector<StudyRow> rows{row_with(0.2), row_with(0.4),
                                   row_with(StudyRow::kUnknown, "no_pattern: 0.1")};
  const StudyCell cell = cell_of(rows, 1.3, "adaptive", "sgm");
  EXPECT_EQ(cell.repeats, 3);
  EXPECT_EQ(cell.refused, 1);
  EXPECT_NEAR(cell.mean.closest_mean_mm, 0.3, 1e-12);
  EXPECT_TRUE(std::isnan(cell.mean.coverage));
  EXPECT_EQ(cell_of(rows, 1.3, "adaptive", "opencv").repeats, 0);
}

TEST(StudyPage, IsOneFileThatShowsPaperAndOursApart) {
  StudySettings settings;
  settings.zooms = {1.3};
  settings.patterns.resize(1);
  settings.rig = {"/usr/bin/holdfast-sim", "rig"};
  const std::string html = study_html(
      settings, {row_with(0.21), row_with(StudyRow::kUnknown, "a < b & c")}, 0.1, {{"map", "PNG"}});
  EXPECT_NE(html.find("class=\"q\">0.5 ± 0.3<"), std::string::npos);  // quoted, adaptive at 1.3
  EXPECT_NE(html.find("0.21 ± –"), std::string::npos);
  EXPECT_NE(html.find("1 of 2 refused"), std::string::npos);
  EXPECT_NE(html.find("a &lt; b &amp; c"), std::string::npos);
  EXPECT_NE(html.find("Not for clinical use"), std::string::npos);
  EXPECT_NE(html.find("src=\"data:image/png;base64,UE5H\""), std::string::npos);
  EXPECT_EQ(html.find("nan"), std::string::npos);
  for (const char* outside : {"<script", "href=", "src=\"http", "url("})
    EXPECT_EQ(html.find(outside), std::string::npos) << outside;
}

/// Of one zoom's two adaptive rows: single shot and burst.
std::string page_with_burst(double burst_median_mm, double burst_wrong) {
  StudySettings settings;
  settings.zooms = {1.3};
  settings.patterns.resize(1);
  settings.shots = 8;
  settings.rig = {"rig"};
  StudyRow single = row_with(0.2), burst = row_with(0.1, "no_surface: 3 %");
  single.triangle_median_mm = 0.0611;
  single.truth_over_1_mm_off_edges = 0.0123;
  burst.method = "burst";
  burst.triangle_median_mm = burst_median_mm;
  burst.truth_over_1_mm_off_edges = burst_wrong;
  return study_html(settings, {single, burst}, 0.1, {});
}

TEST(StudyPage, ShowsTheBurstBesideTheSingleShotAndMarksWhatMissesItsAim) {
  const std::string html = page_with_burst(0.0443, 0.0009);
  const auto single = html.find("<td>single shot</td>");
  const auto burst = html.find("<td>burst of 8 <small>(1 of 1 refused)</small></td>");
  ASSERT_NE(single, std::string::npos);
  ASSERT_NE(burst, std::string::npos);
  EXPECT_LT(single, burst);
  EXPECT_NE(html.find("<b class=\"m\">0.061</b>"), std::string::npos);
  EXPECT_NE(html.find("<b class=\"m\">1.23 %</b>"), std::string::npos);
  EXPECT_NE(html.find("<td>0.044</td>", burst), std::string::npos);
  EXPECT_NE(html.find("<td>0.09 %</td>", burst), std::string::npos);
  const std::string worse = page_with_burst(0.0451, 0.0011);
  EXPECT_NE(worse.find("<b class=\"m\">0.045</b>"), std::string::npos);
  EXPECT_NE(worse.find("<b class=\"m\">0.11 %</b>"), std::string::npos);
  EXPECT_EQ(worse.find("nan"), std::string::npos);
}

TEST(StudyPage, SaysNothingOfABurstThatWasNotTaken) {
  StudySettings settings;
  settings.zooms = {1.3};
  settings.patterns.resize(1);
  settings.rig = {"rig"};
  EXPECT_EQ(study_html(settings, {row_with(0.2)}, 0.1, {}).find("burst"), std::string::npos);
}

TEST(Base64, IsThatOfRfc4648) {
  EXPECT_EQ(base64(""), "");
  EXPECT_EQ(base64("f"), "Zg==");
  EXPECT_EQ(base64("fo"), "Zm8=");
  EXPECT_EQ(base64("foo"), "Zm9v");
  EXPECT_EQ(base64("foobar"), "Zm9vYmFy");
  EXPECT_EQ(base64(std::string("\xff\x00\xfe", 3)), "/wD+");
}

TEST(ZoomChart, SkipsWhatIsUnknown) {
  const double unknown = std::nan("");
  const std::string svg = zoom_chart("t", {1.1, 1.2, 1.3}, {{"a", "red", {1, unknown, 3}}});
  EXPECT_EQ(svg.find("nan"), std::string::npos);
  EXPECT_NE(svg.find("<path d=\"M"), std::string::npos);
}

registration::Markups square_of_beads() {
  registration::Markups beads;
  for (const auto& [x, y] : {std::pair{30.0, 30.0}, {-30.0, -30.0}, {30.0, -30.0}, {-30.0, 30.0}}) {
    registration::MarkupPoint& bead = beads.points.emplace_back();
    bead.position_mm = {100 + x, y, 0.1 * x};
  }
  return beads;
}

TEST(FiducialRegion, LiesBetweenTheBeadsAndKeepsClearOfThem) {
  const FiducialRegion region(square_of_beads(), 9);
  EXPECT_TRUE(region.contains({100, 0, 0}));
  EXPECT_TRUE(region.contains({100, 0, 25}));  // whatever the height
  EXPECT_TRUE(region.contains({122, 22, 0}));
  EXPECT_FALSE(region.contains({128, 28, 3}));
  EXPECT_FALSE(region.contains({135, 0, 3}));
  EXPECT_FALSE(region.contains({65, 0, -3}));
}

TEST(FiducialRegion, RefusesBeadsInALine) {
  registration::Markups beads;
  for (int i = 0; i < 4; ++i) beads.points.emplace_back().position_mm = {10.0 * i, 0, 0};
  EXPECT_THROW(FiducialRegion{beads}, InputError);
}

TEST(DepthForCamera, APlaneStaysTheSamePlane) {
  registration::Rectification geometry;
  geometry.size_px = {160, 120};
  cv::Matx33d R1;
  cv::Rodrigues(cv::Vec3d(0.02, -0.03, 0.01), R1);
  geometry.R1 = R1;
  geometry.P1 = {2000, 0, 80, 0, 0, 2000, 60, 0, 0, 0, 1, 0};
  // n . p = 200 in the rectified frame.
  const cv::Vec3d n = cv::normalize(cv::Vec3d(0.1, -0.05, 1));
  cv::Mat1f rectified(120, 160);
  for (int y = 0; y < 120; ++y)
    for (int x = 0; x < 160; ++x)
      rectified(y, x) =
          static_cast<float>(200 / n.dot(cv::Vec3d((x - 80) / 2000.0, (y - 60) / 2000.0, 1)));
  const cv::Matx33d K(1900, 0, 75, 0, 1900, 66, 0, 0, 1);
  const cv::Mat1f depth = depth_for_camera(rectified, geometry, K);
  int known = 0;
  for (int y = 0; y < 120; ++y)
    for (int x = 0; x < 160; ++x) {
      if (std::isnan(depth(y, x))) continue;
      ++known;
      const cv::Vec3d p = static_cast<double>(depth(y, x)) * (K.inv() * cv::Vec3d(x, y, 1));
      EXPECT_NEAR(n.dot(R1 * p), 200, 0.02) << x << "," << y;  // half a pixel on the slope
    }
  EXPECT_GT(known, 5'000);
  EXPECT_LT(known, 160 * 120);  // turned by two pixels in a hundred and more: a rim is unknown
}

TEST(Illumination, AsksForAPatternOnlyWhereOneIsProjected) {
  const PairRequest adaptive = lit_by(Illumination::adaptive, "/p/x.png");
  EXPECT_EQ(adaptive.pattern, "/p/x.png");
  EXPECT_TRUE(adaptive.has_off);
  const PairRequest microscope = lit_by(Illumination::microscope, "/p/x.png");
  EXPECT_EQ(microscope.pattern, "");
  EXPECT_EQ(microscope.lamps, "microscope");
  EXPECT_FALSE(microscope.has_off);
}

TEST(PatternChoice, TakesTheNearestZoomOfTheFile) {
  const fs::path file = fs::temp_directory_path() / ("patterns_" + std::to_string(getpid()));
  const registration::PatternTableHead head{registration::PatternKind::lattice, false, 7};
  std::ofstream(file) << registration::patterns_toml(
      head, {{1.1, {3, 5}, 0.1, 9}, {1.3, {6, 2}, 0.2, 9}});
  const registration::PatternParameters found = pattern_for(1.25, read_best_patterns(file));
  const registration::PatternParameters other = pattern_for(1.0, read_best_patterns(file));
  EXPECT_EQ(found.kind, registration::PatternKind::lattice);
  EXPECT_EQ(found.seed, 7U);
  EXPECT_NE(found.dot_px, other.dot_px);
  for (const char* wrong : {"", "[[pattern]]\nzoom = 1.2\n",
                            "[[pattern]]\nzoom = 1.2\nkind = \"aperiodic\"\n"
                            "distance_px = 99\ndot_px = 4\nseed = 1\n",
                            "zoom ="}) {
    std::ofstream(file, std::ios::trunc) << wrong;
    EXPECT_THROW((void)read_best_patterns(file), InputError) << wrong;
  }
  fs::remove(file);
}

class RigProgram : public testing::Test {
 protected:
  void TearDown() override { fs::remove(path_); }
  std::string saying(const std::string& script) {
    std::ofstream(path_) << "#!/bin/sh\n" << script;
    fs::permissions(path_, fs::perms::owner_all);
    return path_.string();
  }

 private:
  fs::path path_ = fs::temp_directory_path() / ("holdfast_rig_" + std::to_string(getpid()));
};

TEST_F(RigProgram, ReadsTheJudgementAndWhatIsUnknown) {
  Rig rig(
      {saying("read line\ncase \"$line\" in *depth-error*'\"pose\":2'*) "
              "echo '{\"coverage\": 0.5, \"median_mm\": null}';; "
              "*) echo '{\"error\": \"what?\"}';; esac\nread line\n")});
  const DepthJudgement judgement = rig.depth_error({"/d.tiff", "/s.yaml", 1.3, 2});
  EXPECT_EQ(judgement.coverage, 0.5);
  EXPECT_TRUE(std::isnan(judgement.median_mm));
}

TEST_F(RigProgram, ItsErrorIsARefusalWithItsWords) {
  Rig rig({saying("read line; echo '{\"error\": \"lamp is broken\"}'; read line\n")});
  try {
    rig.ct("/tmp/nowhere");
    FAIL() << "accepted";
  } catch (const RefusedError& error) {
    EXPECT_STREQ(error.what(), "rig: lamp is broken");
  }
}

TEST_F(RigProgram, OneThatEndsOrTalksNonsenseIsNotThere) {
  {
    Rig rig({saying("read line; echo first >&2; echo no camera >&2; exit 0\n")});
    try {
      rig.ct("/tmp/nowhere");
      FAIL() << "accepted";
    } catch (const UnavailableError& error) {
      EXPECT_TRUE(std::string(error.what()).ends_with("its last words: no camera")) << error.what();
    }
    EXPECT_THROW(rig.ct("/tmp/nowhere"), UnavailableError);
  }
  Rig rig({saying("read line; echo hello; read line\n")});
  EXPECT_THROW(rig.ct("/tmp/nowhere"), UnavailableError);
  EXPECT_THROW(Rig({"/no/such/rig"}), UnavailableError);
}

TEST_F(RigProgram, IsAskedForNothingWhenTheSetUpWouldProjectALattice) {
  RecordProperty("requirement", "SR-96");
  const fs::path folder = fs::temp_directory_path() / ("setup_" + std::to_string(getpid()));
  fs::create_directories(folder);
  std::ofstream(folder / "registration.json") << "{}";
  SetupSettings settings;
  settings.rig = {saying("read line; echo '{\"error\": \"asked\"}'; read line\n")};
  const auto tell = [](const std::string&) {};
  settings.pattern.kind = registration::PatternKind::lattice;
  const SetupOutcome lattice = run_setup(settings, folder, tell);
  EXPECT_TRUE(lattice.stages.empty());
  EXPECT_EQ(lattice.refusal,
            "pattern: a lattice is for comparisons: a surface under it may be a period off");
  EXPECT_FALSE(fs::exists(folder / "registration.json"));
  settings.pattern.kind = registration::PatternKind::aperiodic;
  EXPECT_EQ(run_setup(settings, folder, tell).refusal, "rig: asked");
  fs::remove_all(folder);
}

TrackingRow tracked(const std::string& scene, const std::string& motion,
                    const std::string& method) {
  TrackingRow row;
  row.scene = scene;
  row.motion = motion;
  row.method = method;
  row.judged.frames = 90;
  row.judged.lost = 2;
  row.judged.step_mean_um = 0.25;
  row.judged.depth_rms_um = std::nan("");
  row.stages = {{"mask", 3, 4, 5}, {"total", 7, 9, 12}};
  row.x_um = {0, 1000, 2000};
  row.y_um = {0, 500, 0};
  row.error_x_um = row.error_y_um = {0, 1, 2};
  row.step_x_um = row.step_y_um = {1, -1};
  return row;
}

TEST(TrackingReport, QuotesThePaperBesideItsOwnMethodOnly) {
  TrackingSettings settings;
  TrackingResult result;
  result.rows = {tracked("cavity_bone", "linear", "direct"),
                 tracked("cavity_bone", "linear", "paper")};
  std::string html = tracking_html(settings, result);
  const auto first = html.find("93.9 ± 118.4");
  ASSERT_NE(first, std::string::npos);
  EXPECT_EQ(html.find("93.9 ± 118.4", first + 1), std::string::npos);
  EXPECT_EQ(html.find("nan"), std::string::npos) << "no figure that is none";
  EXPECT_EQ(html.find("<script"), std::string::npos);
  result.rows[1].motion = "breathing";
  EXPECT_EQ(tracking_html(settings, result).find("93.9"), std::string::npos);
}

TEST(TrackingReport, ARefusalIsARowWithItsReason) {
  TrackingResult result;
  result.rows = {tracked("cavity_bone", "spiral", "orb")};
  result.rows[0].refusal = "too <few> features";
  EXPECT_NE(tracking_html({}, result).find("refused: too &lt;few&gt; features"), std::string::npos);
  const std::string csv = tracking_csv(result);
  EXPECT_NE(csv.find("cavity_bone,spiral,orb,90,2,0,0.25,"), std::string::npos) << csv;
  EXPECT_EQ(csv.find("nan"), std::string::npos);
}

TEST(TrajectoryFile, ALostFrameHasNoNumberAndAnUnknownUncertaintyNone) {
  using namespace std::chrono_literals;
  perception::MotionEstimate e;
  const std::string header = trajectory_header();
  const auto columns = std::count(header.begin(), header.end(), ',');
  const std::string lost = trajectory_row(3, 100ns, e);
  EXPECT_EQ(lost, "3,100,lost" + std::string(static_cast<std::size_t>(columns - 2), ',') + "\n");
  EXPECT_EQ(tum_row(100ns, e), "");
  e.status = perception::TrackingStatus::tracking;
  e.covariance.setConstant(std::nan(""));
  const std::string row = trajectory_row(3, 100ns, e);
  EXPECT_EQ(std::count(row.begin(), row.end(), ','), columns);
  EXPECT_EQ(row.find("nan"), std::string::npos) << row;
}

}  // namespace
}  // namespace holdfast::rt
