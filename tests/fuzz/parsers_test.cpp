// SPDX-License-Identifier: Apache-2.0
// Every parser of outside bytes against its seeds, the committed corpus and mutations of both.
// Small and the same in each run, also under the sanitizers; HOLDFAST_FUZZ_SECONDS (`./dev fuzz`)
// makes it go on, with another seed each time. The input that is being tried lies in
// HOLDFAST_FUZZ_KEEP, so that it is there after an abort.
#include <chrono>
#include <cstdlib>
#include <filesystem>
#include <fstream>
#include <iterator>
#include <random>
#include <stdexcept>
#include <string>

#include <gtest/gtest.h>

#include "rt/core/clock.hpp"
#include "rt/core/error.hpp"
#include "tests/fuzz/targets.hpp"

namespace holdfast::fuzz {
namespace {

constexpr int kMutations = 400;

std::vector<Bytes> corpus_of(const Target& target) {
  std::vector<Bytes> corpus = target.seeds();
  const std::filesystem::path folder = std::filesystem::path(HOLDFAST_FUZZ_CORPUS) / target.name;
  if (!std::filesystem::is_directory(folder)) return corpus;
  for (const auto& entry : std::filesystem::directory_iterator(folder)) {
    std::ifstream file(entry.path(), std::ios::binary);
    corpus.emplace_back(std::istreambuf_iterator<char>(file), std::istreambuf_iterator<char>());
  }
  return corpus;
}

class Parser : public ::testing::TestWithParam<const Target*> {
 protected:
  /// True when it was accepted. Every refusal is one line.
  bool try_one(const Bytes& bytes) {
    keep(bytes);
    try {
      GetParam()->take(bytes);
      return true;
    } catch (const Error& refusal) {
      EXPECT_EQ(std::string(refusal.what()).find('\n'), std::string::npos) << refusal.what();
      return false;
    }  // anything else ends the test, and is the finding
  }
  void keep(const Bytes& bytes) const {
    if (keep_.empty()) return;
    std::ofstream file(keep_ + "/" + GetParam()->name, std::ios::binary | std::ios::trunc);
    file.write(reinterpret_cast<const char*>(bytes.data()),
               static_cast<std::streamsize>(bytes.size()));
  }
  static std::string environment(const char* key) {
    const char* value = std::getenv(key);
    return value == nullptr ? "" : value;
  }
  const std::string keep_ = environment("HOLDFAST_FUZZ_KEEP");
};

TEST_P(Parser, RefusesOrKeepsItsPromise) {
  const std::vector<Bytes> corpus = corpus_of(*GetParam());
  ASSERT_FALSE(corpus.empty());
  for (const Bytes& bytes : corpus) (void)try_one(bytes);
  (void)try_one({});
  const std::string seconds = environment("HOLDFAST_FUZZ_SECONDS");
  const bool is_long = !seconds.empty();
  const std::uint64_t seed = is_long ? std::random_device{}() : 1;
  Mutator mutator(seed);
  const auto end = rt::monotonic_now() + std::chrono::seconds(is_long ? std::stoi(seconds) : 0);
  int accepted = 0, tried = 0;
  for (; is_long ? rt::monotonic_now() < end : tried < kMutations; ++tried) {
    accepted += try_one(mutator.next(corpus)) ? 1 : 0;
    ASSERT_FALSE(HasFailure()) << "seed " << seed << ", mutation " << tried;
  }
  RecordProperty("tried", tried);
  RecordProperty("accepted", accepted);
}

std::vector<const Target*> all_targets() {
  std::vector<const Target*> all;
  for (const auto& targets : {message_targets(), file_targets()})
    for (const Target& target : targets) all.push_back(&target);
  return all;
}

INSTANTIATE_TEST_SUITE_P(Of, Parser, ::testing::ValuesIn(all_targets()),
                         [](const auto& target) { return std::string(target.param->name); });

/// The seeds are accepted where they are whole, or their mutations would try nothing.
TEST_P(Parser, AcceptsItsSeed) {
  const std::string name = GetParam()->name;
  const bool needs_files = name == "config";  // that the configuration names
  if (needs_files) return;
  EXPECT_TRUE(try_one(corpus_of(*GetParam()).front()));
}

}  // namespace
}  // namespace holdfast::fuzz
