// SPDX-License-Identifier: Apache-2.0
// Every parser of outside bytes against its seeds, each of them cut short everywhere, and the
// committed corpus, in which what libFuzzer found stays found. New inputs are libFuzzer's work:
// `./dev fuzz`.
#include <filesystem>
#include <fstream>
#include <iterator>
#include <string>

#include <gtest/gtest.h>

#include "tests/fuzz/targets.hpp"

namespace holdfast::fuzz {
namespace {

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

class Parser : public ::testing::TestWithParam<const Target*> {};

TEST_P(Parser, RefusesOrKeepsItsPromiseOverItsCorpus) {
  const std::vector<Bytes> corpus = corpus_of(*GetParam());
  ASSERT_FALSE(corpus.empty());
  (void)is_accepted(*GetParam(), {});
  for (const Bytes& bytes : corpus) (void)is_accepted(*GetParam(), bytes);
}

TEST_P(Parser, RefusesOrKeepsItsPromiseWhereItsSeedIsCutShort) {
  constexpr std::size_t kCuts = 64;
  const Bytes seed = corpus_of(*GetParam()).front();
  for (std::size_t i = 0; i < kCuts; ++i)
    (void)is_accepted(*GetParam(), std::span(seed).first(seed.size() * i / kCuts));
}

/// The seeds are accepted where they are whole, or what is made of them would try nothing.
TEST_P(Parser, AcceptsItsSeed) {
  const std::string name = GetParam()->name;
  const bool needs_files = name == "config";  // that the configuration names
  if (needs_files) return;
  EXPECT_TRUE(is_accepted(*GetParam(), corpus_of(*GetParam()).front()));
}

INSTANTIATE_TEST_SUITE_P(Of, Parser, ::testing::ValuesIn(all_targets()),
                         [](const auto& target) { return std::string(target.param->name); });

}  // namespace
}  // namespace holdfast::fuzz
