// SPDX-License-Identifier: Apache-2.0
#include "registration/registration_file.hpp"

#include <fstream>
#include <limits>

#include <gtest/gtest.h>
#include <nlohmann/json.hpp>

#include "rt/core/error.hpp"

namespace holdfast::registration {
namespace {

class RegistrationFile : public ::testing::Test {
 protected:
  void SetUp() override {
    folder_ = std::filesystem::path{::testing::TempDir()} /
              (std::string{"registration_"} +
               ::testing::UnitTest::GetInstance()->current_test_info()->name());
    std::filesystem::create_directories(folder_);
    std::ofstream{folder_ / "keyframe.png"} << "pixels";
    std::ofstream{folder_ / "depth.tiff"} << "depths";
    registration_.T_camera_ct = Eigen::Translation3d(1.25, -2.5, 200.1) *
                                Eigen::AngleAxisd(0.3, Eigen::Vector3d(1, 2, 3).normalized());
    registration_.covariance = Eigen::Matrix<double, 6, 6>::Identity() * 1e-3;
    registration_.fre_mm = 0.1;
    registration_.zoom = 1.2;
    registration_.focus_mm = 200;
    registration_.ct_identity = "1.2.840.1";
    registration_.tre.push_back({{1, 2, 3}, 0.08, Eigen::Matrix3d::Identity() * 0.002});
    registration_.keyframe = "keyframe.png";
    registration_.depth = "depth.tiff";
  }
  void TearDown() override { std::filesystem::remove_all(folder_); }

  std::filesystem::path write(const std::string& text) const {
    std::ofstream{folder_ / "registration.json"} << text;
    return folder_ / "registration.json";
  }
  [[nodiscard]] std::string sealed() const { return sealed_registration(registration_, folder_); }
  static std::string refusal(const std::filesystem::path& file) {
    try {
      (void)load_registration(file);
    } catch (const InputError& e) {
      return e.what();
    }
    return "";
  }

  std::filesystem::path folder_;
  Registration registration_;
};

TEST_F(RegistrationFile, ReadsBackExactlyWhatWasSealed) {
  const Registration read = load_registration(write(sealed()));
  EXPECT_TRUE(read.T_camera_ct.matrix() == registration_.T_camera_ct.matrix());
  EXPECT_TRUE(read.covariance == registration_.covariance);
  ASSERT_EQ(read.tre.size(), 1U);
  EXPECT_EQ(read.tre[0].p_target_ct_mm, Eigen::Vector3d(1, 2, 3));
  EXPECT_EQ(read.keyframe, folder_ / "keyframe.png");
  EXPECT_NE(read.id(), 0U);
}

TEST_F(RegistrationFile, RefusesAnyChangedDigit) {
  RecordProperty("requirement", "SR-80");
  std::string text = sealed();
  const auto at = text.find("200.1");
  ASSERT_NE(at, std::string::npos);
  text[at + 4] = '2';
  EXPECT_NE(refusal(write(text)).find("wrong checksum"), std::string::npos);
}

TEST_F(RegistrationFile, RefusesAChangedKeyframeAndAMissingDepth) {
  const auto file = write(sealed());
  std::ofstream{folder_ / "keyframe.png"} << "pixelz";
  EXPECT_NE(refusal(file).find("is not the one that was registered"), std::string::npos);
  std::ofstream{folder_ / "keyframe.png"} << "pixels";
  EXPECT_EQ(refusal(file), "");
  std::filesystem::remove(folder_ / "depth.tiff");
  EXPECT_NE(refusal(file).find("depth.tiff"), std::string::npos);
}

TEST_F(RegistrationFile, RefusesToSealWhatItWouldNotLoad) {
  const Registration good = registration_;
  registration_.T_camera_ct.linear() *= -1;  // a mirrored CT
  EXPECT_THROW((void)sealed(), InputError);
  registration_ = good;
  registration_.T_camera_ct.translation().x() = std::numeric_limits<double>::quiet_NaN();
  EXPECT_THROW((void)sealed(), InputError);
  registration_ = good;
  registration_.covariance(0, 1) = 1;
  EXPECT_THROW((void)sealed(), InputError);
  registration_ = good;
  registration_.covariance(5, 5) = -1e-3;
  EXPECT_THROW((void)sealed(), InputError);
}

TEST_F(RegistrationFile, NamesTheMissingMember) {
  for (const char* key : {"T_camera_ct", "covariance", "fre_mm", "zoom", "focus_mm", "ct", "tre",
                          "keyframe", "depth", "files_sha256", "checksum"}) {
    auto content = nlohmann::json::parse(sealed());
    content.erase(key);
    EXPECT_NE(refusal(write(content.dump())), "") << key;
  }
}

/// Such a text parses, but whoever then prints or copies it would run out of stack.
TEST_F(RegistrationFile, RefusesJsonNestedDeeperThanAnyOfOurFiles) {
  constexpr std::size_t kDepth = 1'000'000;
  const std::string nested = R"({"a":)" + std::string(kDepth, '[') + std::string(kDepth, ']') + "}";
  EXPECT_NE(refusal(write(nested)).find("nested too deep"), std::string::npos);
}

TEST_F(RegistrationFile, RefusesWhatIsNotARegistration) {
  EXPECT_NE(refusal(write("")).find("is not JSON"), std::string::npos);
  EXPECT_NE(refusal(write("[]")).find("not a JSON object"), std::string::npos);
  EXPECT_NE(refusal(write(std::string(200000, '['))).find("is not JSON"), std::string::npos);
  EXPECT_NE(refusal(folder_ / "absent.json"), "");
}

}  // namespace
}  // namespace holdfast::registration
