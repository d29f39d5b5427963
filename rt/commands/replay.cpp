// SPDX-License-Identifier: Apache-2.0
// `holdfast replay`: a recording through the same control step; every decision must come out again.
#include "rt/replay.hpp"

#include <cstdio>
#include <filesystem>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include <fmt/format.h>
#include <nlohmann/json.hpp>
#include <unistd.h>

#include "bridge/atomic_file.hpp"
#include "bridge/command_line.hpp"
#include "bridge/recorder/segment_folder.hpp"
#include "rt/commands/commands.hpp"
#include "rt/core/clock.hpp"
#include "rt/core/error.hpp"
#include "rt/decision_table.hpp"

namespace holdfast::rt {
namespace {

constexpr const char* kExample =
    "Example: everything in the daemon's folder\n"
    "  holdfast replay recordings/ --json\n"
    "or one file of it\n"
    "  holdfast replay recordings/holdfast-20260504T071500.000Z-00003.mcap\n"
    "and what was decided in each cycle, for a spreadsheet\n"
    "  holdfast replay recordings/ --csv decisions.csv\n"
    "A file that ends in the middle of a record, as after a kill, is replayed up to there. Exit\n"
    "codes: 1 a decision came out otherwise, or none could be compared; 2 damaged, no recording, "
    "or\n"
    "one of another version.";

struct Options {
  std::filesystem::path source;
  std::string csv;
  bool is_json = false;
};

/// The decisions as a file, which appears when all of them came out again.
class TableFile {
 public:
  explicit TableFile(const std::string& path) : file_(path), rows_(decision_table_header()) {}
  void add(const RecordedInput& input, const ControlOutput& output) {
    append_decision_row(rows_, input, output);
    if (rows_.size() > kBlockBytes) flush();
  }
  void commit() {
    flush();
    file_.commit();
  }

 private:
  static constexpr std::size_t kBlockBytes = 1 << 20;
  void flush() {
    file_.write(rows_);
    rows_.clear();
  }
  bridge::AtomicFile file_;
  std::string rows_;
};

double seconds(std::chrono::nanoseconds time) {
  return std::chrono::duration<double>(time).count();
}

std::vector<std::filesystem::path> files_of(const std::filesystem::path& source) {
  if (!std::filesystem::is_directory(source)) return {source};
  auto files = bridge::recordings_in(source);
  if (files.empty())
    throw InputError(fmt::format("{}: holds no recording (holdfast-*.mcap)", source.string()));
  return files;
}

std::string text_of(const ReplayDifference& d) {
  return fmt::format("{}: cycle {}: {} was {}, the replay says {}", d.file.string(), d.cycle,
                     d.field, d.recorded, d.replayed);
}

nlohmann::ordered_json json_of(const ReplayReport& report, double wall_s) {
  nlohmann::ordered_json json = {{"files", report.files},
                                 {"runs", report.runs},
                                 {"cycles", report.cycles},
                                 {"decisions_compared", report.compared},
                                 {"states_compared", report.states},
                                 {"differences", report.differences}};
  json["first_difference"] = nullptr;
  if (const auto& d = report.first_difference)
    json["first_difference"] = {{"file", d->file.string()},
                                {"cycle", d->cycle},
                                {"field", d->field},
                                {"recorded", d->recorded},
                                {"replayed", d->replayed}};
  json["missing_cycles"] = report.missing;
  json["gaps"] = nlohmann::json::array();
  for (const RecordedGap& gap : report.gaps)
    json["gaps"].push_back({{"first_cycle", gap.first_cycle}, {"count", gap.count}});
  json["not_compared_without_state"] = report.without_state;
  json["cut_off"] = nlohmann::json::array();
  for (const ReplayCut& cut : report.cuts)
    json["cut_off"].push_back(
        {{"file", cut.file.string()}, {"at_byte", cut.at_byte}, {"bytes", cut.bytes}});
  json["recorded_s"] = seconds(report.recorded);
  json["wall_s"] = wall_s;
  return json;
}

void print(const ReplayReport& report, double wall_s) {
  fmt::print("{} file{}, {} run{}, {:.1f} s recorded, replayed in {:.1f} s\n", report.files,
             report.files == 1 ? "" : "s", report.runs, report.runs == 1 ? "" : "s",
             seconds(report.recorded), wall_s);
  fmt::print("{} cycles; {} decisions and {} states compared, {} differ\n", report.cycles,
             report.compared, report.states, report.differences);
  if (report.missing + report.without_state > 0)
    fmt::print("{} cycles are missing in {} gaps; {} more not compared, for want of a state\n",
               report.missing, report.gaps.size(), report.without_state);
  for (const ReplayCut& cut : report.cuts)
    fmt::print("{}: was not closed; whole up to byte {}, {} bytes of a record cut off\n",
               cut.file.string(), cut.at_byte, cut.bytes);
}

void run(const Options& options) {
  bridge::catch_interrupts();
  const std::chrono::nanoseconds t_begin = monotonic_now();
  const bool is_progress_shown = isatty(STDERR_FILENO) == 1;
  ReplayWatch watch;
  watch.is_interrupted = bridge::is_interrupted;
  if (is_progress_shown)
    watch.on_file = [](const std::filesystem::path& file) {
      fmt::print(stderr, "\r\033[K{}", file.filename().string());
    };
  const std::vector<std::filesystem::path> files = files_of(options.source);
  std::optional<TableFile> table;
  if (!options.csv.empty()) {
    table.emplace(options.csv);
    watch.on_cycle = [&table](const RecordedInput& input, const ControlOutput& output) {
      table->add(input, output);
    };
  }
  const ReplayReport report = replay(files, watch);
  if (is_progress_shown) fmt::print(stderr, "\r\033[K");
  const double wall_s = seconds(monotonic_now() - t_begin);
  if (options.is_json)
    fmt::print("{}\n", json_of(report, wall_s).dump());
  else
    print(report, wall_s);
  if (report.first_difference) throw RefusedError(text_of(*report.first_difference));
  if (report.compared == 0)
    throw RefusedError(fmt::format("{}: no decision to compare", options.source.string()));
  if (table) table->commit();
}

}  // namespace

void add_replay(CLI::App& app) {
  auto options = std::make_shared<Options>();
  CLI::App* command = app.add_subcommand(
      "replay", "Feeds a recording through the control step; every decision must come out again.");
  command->add_option("source", options->source, "a recording, or a folder of them")->required();
  command->add_option("--csv", options->csv, "Write the decisions as a table, one row a cycle");
  command->add_flag("--json", options->is_json, "one JSON object on stdout");
  command->footer(kExample);
  command->callback([options] { run(*options); });
}

}  // namespace holdfast::rt
