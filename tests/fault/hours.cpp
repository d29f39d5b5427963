// SPDX-License-Identifier: Apache-2.0
#include "tests/fault/hours.hpp"

#include <algorithm>
#include <atomic>
#include <cmath>
#include <exception>
#include <filesystem>
#include <fstream>
#include <map>
#include <mutex>
#include <thread>

#include <fmt/format.h>
#include <nlohmann/json.hpp>

#include "bridge/atomic_file.hpp"
#include "bridge/command_line.hpp"
#include "rt/core/error.hpp"
#include "tests/fault/campaign.hpp"
#include "tests/fault/digest.hpp"

namespace holdfast::fault {
namespace {

using Clock = std::chrono::steady_clock;

constexpr double kHourMs = 3.6e6;
constexpr std::size_t kHoursIndex = 1'000'000;  // beside the classes' own, for run_seed
constexpr const char* kSchema = "holdfast-fault-hours-1";

std::string hex(std::uint64_t value) {
  return fmt::format("{:016x}", value);
}

/// Ten virtual seconds: two programs that differ here must not share a results file.
std::string fingerprint(const HoursOptions& options) {
  return hex(run_hour(options.seed, -1, 10'000, options.room).digest);
}

std::map<int, Hour> read_results(const HoursOptions& options, const std::string& fingerprint) {
  std::map<int, Hour> hours;
  if (options.results.empty() || !std::filesystem::exists(options.results)) return hours;
  const auto refuse = [&options](const std::string& why) {
    throw InputError("--results " + options.results + ": " + why);
  };
  std::ifstream file(options.results);
  const nlohmann::json json = nlohmann::json::parse(file, nullptr, false);
  try {
    if (json.at("schema") != kSchema) refuse("not of this program");
    if (json.at("seed") != options.seed) refuse("of another seed");
    if (json.at("fingerprint") != fingerprint) refuse("of a program that decides otherwise");
    for (const nlohmann::json& row : json.at("hours")) {
      const Hour hour{row.at("hour").get<int>(), row.at("ms").get<std::int64_t>(),
                      row.at("stops").get<std::uint64_t>(),
                      row.at("first_stop_ms").get<std::int64_t>(),
                      std::stoull(row.at("digest").get<std::string>(), nullptr, 16)};
      hours[hour.number] = hour;
    }
  } catch (const nlohmann::json::exception& e) {
    refuse(e.what());
  }
  return hours;
}

void write_results(const HoursOptions& options, const std::string& fingerprint,
                   const std::map<int, Hour>& hours) {
  if (options.results.empty()) return;
  nlohmann::ordered_json rows = nlohmann::ordered_json::array();
  for (const auto& [number, hour] : hours)
    rows.push_back({{"hour", number},
                    {"ms", hour.ms},
                    {"stops", hour.stops},
                    {"first_stop_ms", hour.first_stop_ms},
                    {"digest", hex(hour.digest)}});
  const nlohmann::ordered_json json{
      {"schema", kSchema}, {"seed", options.seed}, {"fingerprint", fingerprint}, {"hours", rows}};
  bridge::write_file_atomically(options.results, json.dump(1) + "\n");
}

/// What the threads share.
class Work {
 public:
  explicit Work(const HoursOptions& options)
      : options_(options),
        fingerprint_(fingerprint(options)),
        done_(read_results(options, fingerprint_)) {
    const auto total_ms = static_cast<std::int64_t>(std::llround(options.hours * kHourMs));
    for (std::int64_t from = 0; from < total_ms; from += options.hour_ms) {
      const int number = static_cast<int>(from / options.hour_ms);
      const std::int64_t ms = std::min(options.hour_ms, total_ms - from);
      const auto known = done_.find(number);
      if (known == done_.end() || known->second.ms < ms) missing_.push_back({number, ms});
    }
    already_done_ = done_.size();
  }

  /// One thread's part; keeps the first exception and ends the others.
  void run() noexcept {
    try {
      for (std::size_t i = next_++; i < missing_.size(); i = next_++)
        take(run_hour(options_.seed, missing_[i].number, missing_[i].ms, options_.room));
    } catch (...) {
      next_ = missing_.size();
      const std::scoped_lock lock(mutex_);
      if (!error_) error_ = std::current_exception();
    }
  }

  [[nodiscard]] HoursResult result() const {
    if (error_) std::rethrow_exception(error_);
    HoursResult result;
    Digest digest;
    for (const auto& [number, hour] : done_) {
      result.hours.push_back(hour);
      result.stops += hour.stops;
      result.virtual_hours += static_cast<double>(hour.ms) / kHourMs;
      digest.add(hour.digest);
    }
    result.digest = digest.value();
    if (result.virtual_hours > 0)
      result.rate_upper_95 = poisson_upper_95(result.stops) / result.virtual_hours;
    return result;
  }

 private:
  struct Piece {
    int number = 0;
    std::int64_t ms = 0;
  };

  void take(const Hour& hour) {
    const std::scoped_lock lock(mutex_);
    done_[hour.number] = hour;
    write_results(options_, fingerprint_, done_);
    if (hour.stops > 0)
      fmt::print(stderr, "FALSE STOP: {} in hour {}, the first after {} ms; replay: --hour {}\n",
                 hour.stops, hour.number, hour.first_stop_ms, hour.number);
    if (!options_.is_progress || Clock::now() - t_told_ < std::chrono::seconds(10)) return;
    t_told_ = Clock::now();
    std::uint64_t stops = 0;
    for (const auto& [number, known] : done_) stops += known.stops;
    const double each_s = std::chrono::duration<double>(t_told_ - t_began_).count() /
                          static_cast<double>(done_.size() - already_done_);
    fmt::print(stderr, "{} of {} hours, {} false stops, {:.2f} s an hour\n", done_.size(),
               already_done_ + missing_.size(), stops, each_s);
  }

  const HoursOptions options_;
  const std::string fingerprint_;
  std::map<int, Hour> done_;
  std::size_t already_done_ = 0;
  std::vector<Piece> missing_;
  std::atomic<std::size_t> next_ = 0;
  std::mutex mutex_;  // of done_, error_, t_told_ and stderr
  std::exception_ptr error_;
  const Clock::time_point t_began_ = Clock::now();
  Clock::time_point t_told_ = t_began_;
};

}  // namespace

Hour run_hour(std::uint64_t seed, int number, std::int64_t ms, const WorldOptions& room,
              std::vector<FalseStop>* stops) {
  World world = permitted_world(room, run_seed(seed, kHoursIndex, number));
  Hour hour{.number = number, .ms = ms};
  Digest digest;
  bool was_permitted = true;
  for (std::int64_t i = 1; i <= ms; ++i) {
    if (i % 10'000 == 0 && bridge::is_interrupted()) throw InterruptedError("interrupted");
    const Observation seen = world.step();
    digest.add(seen);
    if (was_permitted && !seen.is_permitted) {
      ++hour.stops;
      if (hour.first_stop_ms < 0) hour.first_stop_ms = i;
      if (stops != nullptr) stops->push_back({i, seen});
    }
    was_permitted = seen.is_permitted;
  }
  hour.digest = digest.value();
  return hour;
}

HoursResult run_hours(const HoursOptions& options) {
  Work work(options);
  std::vector<std::thread> threads;
  for (int i = 1; i < options.jobs; ++i) threads.emplace_back([&work] { work.run(); });
  work.run();
  for (std::thread& thread : threads) thread.join();
  return work.result();
}

double poisson_upper_95(std::uint64_t count) {
  const auto probability_up_to = [count](double mean) {
    double term = std::exp(-mean), sum = term;
    for (std::uint64_t k = 1; k <= count; ++k) sum += term *= mean / static_cast<double>(k);
    return sum;
  };
  double low = 0, high = 3 + 3 * static_cast<double>(count);
  for (int i = 0; i < 60; ++i) {
    const double middle = (low + high) / 2;
    (probability_up_to(middle) > 0.05 ? low : high) = middle;
  }
  return high;
}

}  // namespace holdfast::fault
