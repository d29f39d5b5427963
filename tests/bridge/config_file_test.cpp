// SPDX-License-Identifier: Apache-2.0
#include "bridge/config_file.hpp"

#include <cmath>
#include <fstream>

#include <gtest/gtest.h>

#include "rt/core/error.hpp"

namespace holdfast::bridge {
namespace {

using namespace std::chrono_literals;

class ConfigFileTest : public ::testing::Test {
 protected:
  void SetUp() override {
    const auto* info = ::testing::UnitTest::GetInstance()->current_test_info();
    file_ = std::filesystem::path{::testing::TempDir()} /
            (std::string{"holdfast_"} + info->name() + ".toml");
  }
  void TearDown() override { std::filesystem::remove(file_); }
  ConfigFile write(const std::string& text) {
    std::ofstream{file_} << text;
    return ConfigFile{file_};
  }
  template <class F>
  std::string message_of(F&& f) {
    try {
      f();
    } catch (const InputError& e) {
      return e.what();
    }
    return "";
  }
  std::filesystem::path file_;
};

TEST_F(ConfigFileTest, ReadsValuesAndConvertsDurationsByTheKeysUnit) {
  const ConfigFile config = write("[a]\nx_mm = 1\nname = 'n'\non = true\nwait_ms = 1.5\n");
  const ConfigSection a = config.root().section("a");
  EXPECT_EQ(a.number("x_mm", 0, {0, 2}), 1.0);
  EXPECT_EQ(a.text("name", ""), "n");
  EXPECT_TRUE(a.boolean("on", false));
  EXPECT_EQ(a.duration("wait_ms", 0ns, {0, 10}), 1500us);
  EXPECT_NO_THROW(config.refuse_unknown_keys());
}

TEST_F(ConfigFileTest, KeepsDefaultsWhenTheTableIsMissing) {
  const ConfigFile config = write("");
  const ConfigSection a = config.root().section("a");
  EXPECT_EQ(a.number("x_mm", 7, {0, 10}), 7.0);
  EXPECT_EQ(a.duration("wait_ms", 3ms, {0, 10}), 3ms);
  EXPECT_EQ(a.integer("n", 4, {0, 10}), 4);
}

TEST_F(ConfigFileTest, NamesPlaceValueLimitAndUnitOfAValueOutOfRange) {
  RecordProperty("requirement", "SR-82");
  const ConfigFile config = write("\n[safety]\n  pose_validity_ms = 500\n");
  const std::string message = message_of([&] {
    (void)config.root().section("safety").duration("pose_validity_ms", 15ms, {1, 20});
  });
  EXPECT_EQ(message,
            file_.string() + ":3:22: safety.pose_validity_ms = 500 is out of range 1 to 20 ms");
}

TEST_F(ConfigFileTest, RefusesNanAndInfinity) {
  for (const char* value : {"nan", "inf", "-inf"}) {
    const ConfigFile config = write(std::string{"x_mm = "} + value + "\n");
    EXPECT_THROW((void)config.root().number("x_mm", 0, {-1e9, 1e9}), InputError) << value;
  }
}

TEST_F(ConfigFileTest, SuggestsTheRightUnitForAnUnknownKey) {
  RecordProperty("requirement", "SR-82");
  const ConfigFile config = write("[safety]\npose_validity_us = 15000\n");
  (void)config.root().section("safety").duration("pose_validity_ms", 15ms, {1, 20});
  const std::string message = message_of([&] { config.refuse_unknown_keys(); });
  EXPECT_NE(message.find("safety.pose_validity_us: unknown key"), std::string::npos) << message;
  EXPECT_NE(message.find("did you mean 'pose_validity_ms'?"), std::string::npos) << message;
}

TEST_F(ConfigFileTest, RefusesAnUnknownTable) {
  const ConfigFile config = write("[safty]\n");
  (void)config.root().section("safety");
  EXPECT_NE(message_of([&] { config.refuse_unknown_keys(); }).find("did you mean 'safety'?"),
            std::string::npos);
}

TEST_F(ConfigFileTest, RefusesWrongTypes) {
  RecordProperty("requirement", "SR-82");
  const ConfigFile config = write("n = 1.5\nb = 1\nt = 2\nl = [1, 2]\ns = 3\n");
  const ConfigSection root = config.root();
  EXPECT_THROW((void)root.integer("n", 0, {0, 9}), InputError);
  EXPECT_THROW((void)root.boolean("b", false), InputError);
  EXPECT_THROW((void)root.text("t", ""), InputError);
  EXPECT_THROW((void)root.numbers("l", {}, 3, {0, 9}), InputError);
  EXPECT_THROW((void)root.section("s"), InputError);
}

TEST_F(ConfigFileTest, RefusesAnIntegerThatDoesNotFit) {
  const ConfigFile config = write("n = 4294967297\n");
  EXPECT_THROW((void)config.root().integer("n", 0, {0, 100}), InputError);
}

TEST_F(ConfigFileTest, ReportsSyntaxErrorsWithLineAndColumn) {
  const std::string message = message_of([&] { (void)write("a = 1\nb = = 2\n"); });
  EXPECT_EQ(message.rfind(file_.string() + ":2:", 0), 0U) << message;
}

TEST_F(ConfigFileTest, RefusesInOneLineWhateverTheFileSays) {
  const std::string syntax = message_of([&] { (void)write("flag = tru\n"); });
  const std::string key = message_of([&] { write("\"two\\nlines\" = 1\n").refuse_unknown_keys(); });
  for (const std::string& message : {syntax, key}) {
    EXPECT_FALSE(message.empty());
    EXPECT_EQ(message.find('\n'), std::string::npos) << message;
  }
}

TEST_F(ConfigFileTest, ReportsAMissingFile) {
  EXPECT_THROW(ConfigFile{"/nonexistent/x.toml"}, InputError);
}

TEST_F(ConfigFileTest, ResolvesRelativePathsAgainstTheFile) {
  const ConfigFile config = write("file = 'k.png'\n");
  EXPECT_EQ(config.root().path("file"), file_.parent_path() / "k.png");
  EXPECT_THROW((void)config.root().path("missing"), InputError);
}

}  // namespace
}  // namespace holdfast::bridge
