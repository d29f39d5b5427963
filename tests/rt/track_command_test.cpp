// SPDX-License-Identifier: Apache-2.0
// The built `holdfast track`: exit codes, the one line of a failure, and the trajectory's columns.
#include <algorithm>
#include <cstdlib>
#include <filesystem>
#include <fstream>
#include <sstream>
#include <string>

#include <gtest/gtest.h>
#include <nlohmann/json.hpp>
#include <opencv2/imgcodecs.hpp>
#include <opencv2/videoio.hpp>
#include <sys/wait.h>
#include <unistd.h>

namespace {

namespace fs = std::filesystem;

const std::string kSequence = "/usr/share/visp-images-data/ViSP-images/mire-2/";

class TrackCommand : public ::testing::Test {
 protected:
  const fs::path folder = fs::path(::testing::TempDir()) /
                          ("holdfast-track-" + std::to_string(getpid()) +
                           ::testing::UnitTest::GetInstance()->current_test_info()->name());
  std::string out, err;

  void SetUp() override {
    fs::create_directories(folder / "frames");
    for (const char* number : {"0001", "0010", "0020", "0030"})
      fs::copy_file(kSequence + "image." + number + ".pgm",
                    folder / "frames" / (std::string(number) + ".pgm"));
    write_camera(384);
  }
  void TearDown() override { fs::remove_all(folder); }

  void write_camera(int width) const {
    std::ofstream(folder / "camera.yaml")
        << "%YAML:1.0\n---\nimage_width: " << width
        << "\nimage_height: 288\ncamera_matrix: !!opencv-matrix\n   rows: 3\n   cols: 3\n   dt: d\n"
           "   data: [ 600., 0., 192., 0., 600., 144., 0., 0., 1. ]\n"
           "distortion_coefficients: !!opencv-matrix\n   rows: 1\n   cols: 5\n   dt: d\n"
           "   data: [ 0., 0., 0., 0., 0. ]\n";
  }
  static std::string content(const fs::path& file) {
    std::stringstream text;
    text << std::ifstream(file).rdbuf();
    return text.str();
  }
  int run(const std::string& arguments) {
    const std::string command = "cd '" + folder.string() + "' && '" HOLDFAST_PROGRAM "' track " +
                                arguments + " >stdout.txt 2>stderr.txt";
    const int status = std::system(command.c_str());
    out = content(folder / "stdout.txt");
    err = content(folder / "stderr.txt");
    return WIFEXITED(status) ? WEXITSTATUS(status) : -1;
  }
  void expect_refused(const std::string& arguments, int code) {
    EXPECT_EQ(run(arguments), code) << arguments;
    EXPECT_EQ(std::count(err.begin(), err.end(), '\n'), 1) << arguments << ": " << err;
    EXPECT_FALSE(fs::exists(folder / "poses.csv")) << arguments;
  }
};

const std::string kGood = "--frames frames --camera camera.yaml --plane-mm 300 --out poses.csv";

TEST_F(TrackCommand, WritesOneRowAFrameAndOneJsonObject) {
  ASSERT_EQ(run(kGood + " --fps 10 --tum poses.tum --json"), 0) << err;
  std::istringstream csv(content(folder / "poses.csv"));
  std::string line;
  std::getline(csv, line);
  EXPECT_EQ(line,
            "frame,t_ns,status,dx_um,dy_um,rotation_rad,scale,tx_mm,ty_mm,tz_mm,qx,qy,qz,qw,"
            "sigma_t_mm,sigma_r_rad,inliers,drift_um,latency_us");
  std::getline(csv, line);
  EXPECT_EQ(line.rfind("0,0,tracking,0.0000,0.0000,0.000000000,1.000000000,0.0000000,", 0), 0U)
      << line;
  int rows = 1;
  while (std::getline(csv, line)) {
    EXPECT_EQ(std::count(line.begin(), line.end(), ','), 18) << line;
    EXPECT_EQ(line.rfind(std::to_string(rows) + "," + std::to_string(rows) + "00000000,", 0), 0U);
    ++rows;
  }
  EXPECT_EQ(rows, 4);
  const auto json = nlohmann::json::parse(out);
  EXPECT_EQ(json["frames"], 4);
  EXPECT_EQ(json["lost"], 0);
  EXPECT_EQ(json["tied_keyframes"]["used"], 0) << "the first is never left";
  EXPECT_EQ(json["tied_keyframes"]["frames"], 0);
  for (const char* stage : {"mask", "detect", "match", "model", "total"})
    EXPECT_GE(json["timing_ms"][stage]["p99"], json["timing_ms"][stage]["median"]);
  EXPECT_EQ(err, "");
  EXPECT_NE(content(folder / "poses.tum"), "");
}

TEST_F(TrackCommand, LostFramesHaveNoNumbers) {
  cv::imwrite((folder / "frames/0015.pgm").string(), cv::Mat(288, 384, CV_8UC1, cv::Scalar(0)));
  ASSERT_EQ(run(kGood + " --fps 10"), 0) << err;
  const std::string csv = content(folder / "poses.csv");
  EXPECT_NE(csv.find("\n2,200000000,lost,,,,,,,,,,,,,,,,\n"), std::string::npos) << csv;
  EXPECT_NE(csv.find("\n3,300000000,relocalised,"), std::string::npos) << csv;
}

TEST_F(TrackCommand, BadUsageAndBadInputAreTwoInOneLine) {
  const std::string base = "--frames frames --camera camera.yaml --out poses.csv ";
  expect_refused(base, 2);  // no site
  for (const char* depth : {"-1", "0", "nan", "inf", "x"})
    expect_refused(base + "--plane-mm " + depth, 2);
  expect_refused(kGood + " --depth d.tiff", 2);
  expect_refused(base + "--depth none.tiff", 2);
  expect_refused(base + "--surface none.ply", 2);
  expect_refused(kGood + " --nonsense", 2);
  expect_refused(kGood + " --fps 0", 2);
  expect_refused(kGood + " --features 3", 2);
  expect_refused(kGood + " --mask none.png", 2);
  expect_refused("--frames nowhere --camera camera.yaml --plane-mm 300 --out poses.csv", 2);
  expect_refused("--frames frames --camera none.yaml --plane-mm 300 --out poses.csv", 2);
  write_camera(640);
  expect_refused(kGood, 2);
}

TEST_F(TrackCommand, ABrokenFrameOrVideoIsTwoAndLeavesNothing) {
  std::ofstream(folder / "frames/0020.pgm") << "P5 384";
  expect_refused(kGood, 2);
  EXPECT_NE(err.find("0020.pgm"), std::string::npos) << err;
  const std::string video = (folder / "v.avi").string();
  {
    cv::VideoWriter writer(video, cv::VideoWriter::fourcc('M', 'J', 'P', 'G'), 25, {384, 288});
    for (int i = 0; i < 20; ++i) writer.write(cv::imread(kSequence + "image.0001.pgm"));
  }
  fs::resize_file(video, fs::file_size(video) / 2);
  expect_refused("--frames v.avi --camera camera.yaml --plane-mm 300 --out poses.csv", 2);
}

TEST_F(TrackCommand, NothingToTrackIsRefused) {
  const cv::Mat black(288, 384, CV_8UC1, cv::Scalar(0));
  for (const char* name : {"0010", "0020", "0030"})
    cv::imwrite((folder / "frames" / (std::string(name) + ".pgm")).string(), black);
  expect_refused(kGood + " --json", 1);
  cv::imwrite((folder / "frames/0001.pgm").string(), black);
  expect_refused(kGood, 1);
}

TEST_F(TrackCommand, HelpShowsAnExample) {
  EXPECT_EQ(run("--help"), 0);
  EXPECT_NE(out.find("Example"), std::string::npos);
}

}  // namespace
