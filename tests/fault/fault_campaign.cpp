// SPDX-License-Identifier: Apache-2.0
// holdfast-fault: the fault campaign. Its result is a JSON object as docs/interfaces.md lists it.
#include <algorithm>
#include <map>
#include <string>

#include <CLI/CLI.hpp>
#include <fmt/format.h>
#include <nlohmann/json.hpp>

#include "bridge/atomic_file.hpp"
#include "bridge/command_line.hpp"
#include "rt/core/error.hpp"
#include "tests/fault/campaign.hpp"
#include "tests/fault/digest.hpp"
#include "tests/fault/hours.hpp"
#include "tests/fault/injections.hpp"

namespace holdfast::fault {
namespace {

struct Options {
  int runs = 200;
  std::uint64_t seed = 1;
  double fault_free_hours = 0.5;
  int jobs = 1;
  std::string results;
  bool is_hours_only = false;
  int replay_hour = -1;
  std::string json, xml;
  std::string replay_class;
  std::uint64_t replay_seed = 0;
  bool is_without_guard = false;
  std::uint64_t injections = 0;
};

struct ClassResult {
  int hazards = 0, late = 0, reaction_max_ms = 0, over_limit_max_ms = 0;
  int guarded_reaction_max_ms = 0, withheld_to_off_max_ms = 0;
  double error_max_mm = 0;
  Digest digest;
};

/// Half of the runs with the guard, half without: either must do. The guard's own faults: with it.
ClassResult run_class(const World (&worlds)[2], std::size_t index, const Options& options) {
  const FaultClass& fault = fault_classes()[index];
  ClassResult total;
  for (int run = 0; run < options.runs; ++run) {
    if (bridge::is_interrupted()) throw InterruptedError("interrupted");
    const std::uint64_t seed = run_seed(options.seed, index, run);
    const bool has_guard = fault.is_of_guard || run % 2 == 0;
    const RunResult r = run_fault(worlds[has_guard ? 0 : 1], fault, seed);
    total.digest.add(r.digest);
    total.reaction_max_ms = std::max(total.reaction_max_ms, r.reaction_ms);
    if (has_guard)
      total.guarded_reaction_max_ms = std::max(total.guarded_reaction_max_ms, r.reaction_ms);
    total.withheld_to_off_max_ms = std::max(total.withheld_to_off_max_ms, r.withheld_to_off_ms);
    total.over_limit_max_ms = std::max(total.over_limit_max_ms, r.over_limit_max_ms);
    total.error_max_mm = std::max(total.error_max_mm, r.error_max_mm);
    if (!r.is_hazard(fault) && !r.is_late(fault)) continue;
    total.hazards += r.is_hazard(fault) ? 1 : 0;
    total.late += r.is_late(fault) ? 1 : 0;
    fmt::print(
        stderr,
        "{} {}: over the limit for {} ms (declared {}), off after {} ms (declared {}); replay: "
        "--replay {} --replay-seed {}{}\n",
        r.is_hazard(fault) ? "HAZARD" : "late", fault.name, r.over_limit_max_ms,
        fault.over_limit_max_ms, r.reaction_ms, fault.reaction_max_ms, fault.name, seed,
        has_guard ? "" : " --without-guard");
  }
  return total;
}

int replay(const Options& options) {
  for (const FaultClass& fault : fault_classes()) {
    if (options.replay_class != fault.name) continue;
    WorldOptions world;
    world.has_guard = !options.is_without_guard;
    const RunResult r = run_fault(permitted_world(world), fault, options.replay_seed);
    fmt::print(
        "{{\"class\":\"{}\",\"over_limit_ms\":{},\"error_max_mm\":{:.4f},\"reaction_ms\":{}}}\n",
        fault.name, r.over_limit_max_ms, r.error_max_mm, r.reaction_ms);
    return r.is_hazard(fault) || r.is_late(fault) ? 1 : 0;
  }
  throw InputError("--replay: no fault class '" + options.replay_class + "'");
}

HoursOptions hours_options(const Options& options) {
  return {.seed = options.seed,
          .hours = options.fault_free_hours,
          .jobs = options.jobs,
          .results = options.results,
          .is_progress = options.is_hours_only};
}

/// The fault-free hours alone.
int hours_only(const Options& options) {
  const HoursResult hours = run_hours(hours_options(options));
  const double rate =
      hours.virtual_hours > 0 ? static_cast<double>(hours.stops) / hours.virtual_hours : 0;
  const nlohmann::ordered_json result{
      {"virtual_hours", hours.virtual_hours},
      {"false_stops", hours.stops},
      {"false_stops_an_hour", rate},
      {"false_stops_an_hour_upper_95", hours.rate_upper_95},
      {"virtual_hours_digest", fmt::format("{:016x}", hours.digest)},
      {"seed", options.seed}};
  if (!options.json.empty()) bridge::write_file_atomically(options.json, result.dump(1) + "\n");
  fmt::print("{}\n", result.dump(1));
  return hours.stops == 0 ? 0 : 1;
}

/// Every false stop of one hour, and what each layer said.
int replay_hour(const Options& options) {
  std::vector<FalseStop> stops;
  const Hour hour =
      run_hour(options.seed, options.replay_hour, HoursOptions{}.hour_ms, lively_room(), &stops);
  for (const FalseStop& stop : stops)
    fmt::print("after {} ms: gate {} ({}), robot {}, guard {}\n", stop.ms,
               safety::name(stop.seen.mode), safety::name(stop.seen.cause),
               client::name(stop.seen.refusal), guard::name(stop.seen.guard_cause));
  fmt::print("{{\"hour\":{},\"false_stops\":{},\"digest\":\"{:016x}\"}}\n", hour.number, hour.stops,
             hour.digest);
  return hour.stops == 0 ? 0 : 1;
}

nlohmann::json hunt(const Options& options, int& found) {
  nlohmann::json bugs = nlohmann::json::object();
  for (int i = 1; i <= kBugCount; ++i) {
    const Bug bug = static_cast<Bug>(i);
    std::string by;
    const bool is_found = finds(bug, options.seed, std::min(options.runs, 20), by);
    found += is_found ? 1 : 0;
    bugs[name(bug)] = is_found ? nlohmann::json(by) : nlohmann::json(nullptr);
    if (!is_found) fmt::print(stderr, "seeded bug not found: {}\n", name(bug));
  }
  return bugs;
}

void write_xml(const std::string& file, bool is_good, bool has_found_all) {
  const auto test = [](const char* name, bool is_passed) {
    return fmt::format(
        "<testcase classname=\"FaultCampaign\" name=\"{}\" status=\"run\"><properties><property "
        "name=\"requirement\" value=\"SR-110\"/></properties>{}</testcase>",
        name, is_passed ? "" : "<failure message=\"see the output\"/>");
  };
  bridge::write_file_atomically(
      file, "<testsuite name=\"FaultCampaign\">" + test("EveryClassKeepsItsBounds", is_good) +
                test("FindsEverySeededBug", has_found_all) + "</testsuite>\n");
}

int campaign(const Options& options) {
  WorldOptions without;
  without.has_guard = false;
  const World worlds[2] = {permitted_world({}), permitted_world(without)};
  nlohmann::json worst = nlohmann::json::object(), over = nlohmann::json::object();
  nlohmann::json guarded = nlohmann::json::object(), withheld = nlohmann::json::object();
  ClassResult all;
  for (std::size_t i = 0; i < fault_classes().size(); ++i) {
    const ClassResult r = run_class(worlds, i, options);
    worst[fault_classes()[i].name] = r.reaction_max_ms;
    guarded[fault_classes()[i].name] = r.guarded_reaction_max_ms;
    withheld[fault_classes()[i].name] = r.withheld_to_off_max_ms;
    over[fault_classes()[i].name] = {
        {"over_limit_ms_max", r.over_limit_max_ms},
        {"over_limit_ms_declared", fault_classes()[i].over_limit_max_ms},
        {"error_mm_max", r.error_max_mm},
        {"reaction_ms_declared", fault_classes()[i].reaction_max_ms}};
    all.hazards += r.hazards;
    all.late += r.late;
    all.digest.add(r.digest.value());
  }
  const HoursResult hours = run_hours(hours_options(options));
  int found = 0;
  const nlohmann::json bugs = hunt(options, found);
  const std::size_t classes = fault_classes().size();
  const nlohmann::json result = {{"classes", classes},
                                 {"runs", classes * static_cast<std::size_t>(options.runs)},
                                 {"hazards", all.hazards},
                                 {"late", all.late},
                                 {"digest", fmt::format("{:016x}", all.digest.value())},
                                 {"false_stops", hours.stops},
                                 {"false_stops_an_hour_upper_95", hours.rate_upper_95},
                                 {"virtual_hours", hours.virtual_hours},
                                 {"virtual_hours_digest", fmt::format("{:016x}", hours.digest)},
                                 {"error_limit_mm", kErrorLimitMm},
                                 {"worst_reaction_ms", worst},
                                 {"worst_reaction_with_guard_ms", guarded},
                                 {"worst_withheld_to_off_ms", withheld},
                                 {"per_class", over},
                                 {"seeded_bugs_found", found},
                                 {"seeded_bugs", kBugCount},
                                 {"seeded_bugs_found_by", bugs},
                                 {"seed", options.seed}};
  const bool is_good = all.hazards == 0 && all.late == 0 && hours.stops == 0;
  if (!options.xml.empty()) write_xml(options.xml, is_good, found == kBugCount);
  if (!options.json.empty()) bridge::write_file_atomically(options.json, result.dump(1) + "\n");
  fmt::print("{}\n", result.dump(1));
  if (is_good && found == kBugCount) return 0;
  fmt::print(stderr, "faults: {} hazards, {} late, {} false stops; {} of {} seeded bugs found\n",
             all.hazards, all.late, hours.stops, found, kBugCount);
  return 1;
}

/// Which injection shows this weakness first; empty: none.
std::string shown_by(Weakness weakness, std::uint64_t seed) {
  constexpr std::uint64_t kEnough = 100'000;
  const InjectionResult result = inject(kEnough, seed, weakness);
  for (std::size_t i = 0; i < kInjectionCount; ++i)
    if (result.accepted[i] > 0) return name(static_cast<Injection>(i));
  return {};
}

int attack_messages(const Options& options) {
  const InjectionResult result = inject(options.injections, options.seed);
  nlohmann::ordered_json kinds, weaknesses;
  std::uint64_t injected = 0, accepted = 0;
  for (std::size_t i = 0; i < kInjectionCount; ++i) {
    kinds[name(static_cast<Injection>(i))] = {{"injected", result.injected[i]},
                                              {"accepted", result.accepted[i]}};
    injected += result.injected[i];
    accepted += result.accepted[i];
  }
  int found = 0;
  for (int i = 1; i <= kWeaknessCount; ++i) {
    const std::string by = shown_by(static_cast<Weakness>(i), options.seed);
    found += by.empty() ? 0 : 1;
    weaknesses[name(static_cast<Weakness>(i))] =
        by.empty() ? nlohmann::ordered_json(nullptr) : nlohmann::ordered_json(by);
  }
  const nlohmann::ordered_json json{{"injected", injected}, {"accepted", accepted},
                                    {"good", result.good},  {"good_refused", result.good_refused},
                                    {"kinds", kinds},       {"weaknesses_found_by", weaknesses},
                                    {"seed", options.seed}};
  if (!options.json.empty()) bridge::write_file_atomically(options.json, json.dump(1) + "\n");
  fmt::print("{}\n", json.dump(1));
  if (accepted == 0 && result.good_refused == 0 && found == kWeaknessCount) return 0;
  fmt::print(stderr,
             "faults: {} of {} spoilt messages accepted, {} good ones refused; {} of {} weaknesses "
             "found\n",
             accepted, injected, result.good_refused, found, kWeaknessCount);
  return 1;
}

}  // namespace
}  // namespace holdfast::fault

int main(int argc, char** argv) {
  CLI::App app{
      "The fault campaign: the control side in virtual time under seeded faults. A hazard is\n"
      "permission at the robot while the true error exceeds its limit for longer than declared.",
      "holdfast-fault"};
  app.footer(
      "Example: holdfast-fault --runs 200 --seed 1 --json faults.json\n"
      "False stops alone: holdfast-fault --hours-only --fault-free-hours 1000 --jobs 2 "
      "--results hours.json\n"
      "The end-to-end protection alone: holdfast-fault --injections 10000000\n"
      "Exit codes: 0 no hazard, nothing late, no false stop, every seeded bug found; 1 not so.");
  holdfast::fault::Options options;
  app.add_option("--runs", options.runs, "per fault class")
      ->check(CLI::Range(1, 1'000'000))
      ->capture_default_str();
  app.add_option("--seed", options.seed)->capture_default_str();
  app.add_option("--fault-free-hours", options.fault_free_hours, "virtual, for false stops")
      ->check(CLI::Range(0.0, 1e5))
      ->capture_default_str();
  app.add_flag("--hours-only", options.is_hours_only, "the fault-free hours without the campaign");
  app.add_option("--jobs", options.jobs, "threads for the fault-free hours")
      ->check(CLI::Range(1, 256))
      ->capture_default_str();
  app.add_option("--results", options.results,
                 "file that keeps each fault-free hour; a later run goes on from it");
  app.add_option("--hour", options.replay_hour, "one fault-free hour, with its false stops")
      ->check(CLI::Range(0, 100'000'000));
  app.add_option("--json", options.json, "the result, as printed");
  app.add_option("--xml", options.xml, "as GoogleTest writes it, for the trace");
  app.add_option("--replay", options.replay_class, "one run of this class, by --replay-seed");
  app.add_option("--replay-seed", options.replay_seed);
  app.add_flag("--without-guard", options.is_without_guard, "for --replay");
  app.add_option("--injections", options.injections,
                 "instead of the campaign: so many spoilt messages, none of which may be accepted")
      ->check(CLI::Range(1, 2'000'000'000));
  int code = 0;
  app.callback([&] {
    holdfast::bridge::catch_interrupts();
    if (options.injections > 0) {
      code = holdfast::fault::attack_messages(options);
      return;
    }
    if (options.replay_hour >= 0) {
      code = holdfast::fault::replay_hour(options);
      return;
    }
    if (options.is_hours_only) {
      code = holdfast::fault::hours_only(options);
      return;
    }
    code = options.replay_class.empty() ? holdfast::fault::campaign(options)
                                        : holdfast::fault::replay(options);
  });
  const int usage = holdfast::bridge::run_command_line(app, argc, argv);
  return usage != 0 ? usage : code;
}
