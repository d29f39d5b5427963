// SPDX-License-Identifier: Apache-2.0
// libFuzzer's side of the targets: `holdfast-fuzz-parsers --target=NAME CORPUS...` with libFuzzer's
// own options; `--target=NAME --seeds=DIR` writes the target's seeds there and ends, `--targets`
// prints the names. A finding aborts, and libFuzzer keeps the input. Driven by fuzz.py.
#include <cstdint>
#include <cstdlib>
#include <fstream>
#include <optional>
#include <string>
#include <string_view>

#include <fmt/format.h>

#include "tests/fuzz/targets.hpp"

namespace {

using holdfast::fuzz::all_targets;
using holdfast::fuzz::Target;

const Target* g_target = nullptr;

void write_seeds(const Target& target, const std::string& folder) {
  int number = 0;
  for (const auto& bytes : target.seeds()) {
    std::ofstream file(fmt::format("{}/seed{}", folder, number++), std::ios::binary);
    file.write(reinterpret_cast<const char*>(bytes.data()),
               static_cast<std::streamsize>(bytes.size()));
  }
}

std::optional<std::string> option(int argc, char** argv, std::string_view key) {
  for (int i = 1; i < argc; ++i)
    if (const std::string_view text = argv[i]; text.starts_with(key))
      return std::string(text.substr(key.size()));
  return std::nullopt;
}

}  // namespace

extern "C" int LLVMFuzzerInitialize(int* argc, char*** argv) {
  if (option(*argc, *argv, "--targets")) {
    for (const Target* target : all_targets()) fmt::print("{}\n", target->name);
    std::exit(0);
  }
  const std::string name = option(*argc, *argv, "--target=").value_or("");
  for (const Target* target : all_targets())
    if (target->name == name) g_target = target;
  if (g_target == nullptr) {
    fmt::print(stderr, "holdfast-fuzz-parsers: --target={}: no such target\n", name);
    std::exit(2);
  }
  if (const auto folder = option(*argc, *argv, "--seeds=")) {
    write_seeds(*g_target, *folder);
    std::exit(0);
  }
  return 0;
}

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  (void)is_accepted(*g_target, {data, size});
  return 0;
}
