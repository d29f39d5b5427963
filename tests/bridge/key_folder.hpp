// SPDX-License-Identifier: Apache-2.0
// A folder of keys of a test's own.
#pragma once

#include <chrono>
#include <filesystem>
#include <string>

#include <gtest/gtest.h>
#include <unistd.h>

#include "bridge/dds/security.hpp"
#include "bridge/key_store.hpp"

namespace holdfast::bridge {

class KeyFolderTest : public testing::Test {
 protected:
  void SetUp() override {
    folder = std::filesystem::path(testing::TempDir()) /
             ("holdfast-keys-" + std::to_string(getpid()) + "-" +
              testing::UnitTest::GetInstance()->current_test_info()->name());
    std::filesystem::remove_all(folder);
    make_authorities(folder / "authority", std::chrono::days{2});
  }
  void TearDown() override { std::filesystem::remove_all(folder); }

  std::filesystem::path keys_of(const std::string& role, const std::string& name, int days = 1,
                                const std::string& authority = "authority") {
    make_participant(folder / authority, folder / name, *dds::find_role(role), name,
                     std::chrono::days{days});
    return folder / name;
  }

  std::filesystem::path folder;
};

}  // namespace holdfast::bridge
