// SPDX-License-Identifier: Apache-2.0
#include "registration/opencv_yaml.hpp"

#include <filesystem>
#include <fstream>

#include <gtest/gtest.h>
#include <unistd.h>

#include "rt/core/error.hpp"

namespace holdfast::registration {
namespace {

class OpencvYaml : public ::testing::Test {
 protected:
  ~OpencvYaml() override { std::filesystem::remove(path_); }
  void take(const std::string& text) {
    std::ofstream(path_) << text;
    require_one_document(path_);
  }

 private:
  const std::string path_ =
      std::filesystem::temp_directory_path() / ("holdfast_yaml_" + std::to_string(getpid()));
};

TEST_F(OpencvYaml, OfOneDocumentIsRead) {
  EXPECT_NO_THROW(take("%YAML:1.0\n---\nimage_width: 10\n"));
  EXPECT_NO_THROW(
      take("%YAML:1.2\r\n---  \r\n# a note\n\nm: !!opencv-matrix\n   data: [ 1,\n"
           "       -2. ]\n"));
}

/// With these OpenCV 4.6 reads for ever.
TEST_F(OpencvYaml, ThatGoesOnAfterItsDocumentIsRefused) {
  EXPECT_THROW(take("%YAML:1.\n---%:1\n-\n-"), InputError);
  EXPECT_THROW(take("%YAML:1.0\n---\nb: 1\n...\n-\n-\n"), InputError);
  EXPECT_THROW(take("%YAML:1.0\n---\n{b: 1} -1\n"), InputError);
  EXPECT_THROW(take("%YAML:1.0\n---\n  b: 1\n-1\n"), InputError);
}

TEST_F(OpencvYaml, ThatIsNoneIsRefused) {
  for (const char* text : {"", "image_width: 10\n", "{}", "%YAML:1.0\n", "%YAML:1.0\n---\n",
                           "%YAML:1.0\nimage_width: 10\n", "%YAML:2.0\n---\na: 1\n"})
    EXPECT_THROW(take(text), InputError) << text;
}

}  // namespace
}  // namespace holdfast::registration
