// SPDX-License-Identifier: Apache-2.0
// `holdfast-bench-camera`: what arrives from the virtual camera (a process of its own) through the
// network stack and CameraSource, and how long it takes, at several sizes, formats and rates.
#include <algorithm>
#include <chrono>
#include <condition_variable>
#include <cstdio>
#include <ctime>
#include <filesystem>
#include <mutex>
#include <string>
#include <vector>

#include <CLI/CLI.hpp>
#include <fmt/core.h>
#include <nlohmann/json.hpp>
#include <opencv2/core/utility.hpp>
#include <signal.h>
#include <sys/wait.h>
#include <unistd.h>

#include "bridge/atomic_file.hpp"
#include "bridge/camera_source.hpp"
#include "bridge/command_line.hpp"
#include "bridge/pixel_conversion.hpp"
#include "rt/core/error.hpp"
#include "tests/sim/private_network.hpp"

namespace holdfast::bridge {
namespace {

using std::chrono::nanoseconds;

struct Options {
  std::string json;
  double seconds = 6;
  int packet_size_bytes = 8192;
};

struct Case {
  int width_px, height_px;
  PixelFormat format;
  double frame_rate_hz;
};

constexpr int kWarmUpFrames = 15;

// The simulator, ended with the object.
class Simulator {
 public:
  Simulator(const std::filesystem::path& program, const Case& the_case) {
    const std::vector<std::string> words{program.string(),
                                         "camera",
                                         "--motion",
                                         "linear:0.3",
                                         "--loop",
                                         "--width",
                                         std::to_string(the_case.width_px),
                                         "--height",
                                         std::to_string(the_case.height_px),
                                         "--margin-mm",
                                         "4"};
    std::vector<char*> arguments;
    for (const std::string& word : words) arguments.push_back(const_cast<char*>(word.c_str()));
    arguments.push_back(nullptr);
    int ready[2] = {-1, -1};
    if (pipe(ready) != 0) throw UnavailableError("simulator: no pipe");
    child_ = fork();
    if (child_ == 0) {
      dup2(ready[1], STDERR_FILENO);
      dup2(ready[1], STDOUT_FILENO);
      execv(arguments[0], arguments.data());
      _exit(127);
    }
    close(ready[1]);
    char byte = 0;
    std::string line;
    while (read(ready[0], &byte, 1) == 1 && byte != '\n') line += byte;
    output_ = ready[0];
    if (line.find("ready") == std::string::npos)
      throw UnavailableError(fmt::format("simulator: {}", line));
  }
  ~Simulator() {
    kill(child_, SIGTERM);
    waitpid(child_, nullptr, 0);
    close(output_);
  }
  Simulator(const Simulator&) = delete;
  Simulator& operator=(const Simulator&) = delete;

 private:
  pid_t child_ = -1;
  int output_ = -1;
};

struct Tally {
  std::mutex mutex;
  std::condition_variable done;
  int seen = 0, frames = 0;
  std::uint64_t incomplete = 0, missing = 0;
  nanoseconds t_first{}, t_last{};
  std::vector<double> latency_ms;  // end of exposure -> callback
};

nanoseconds monotonic_now() {
  timespec t{};
  clock_gettime(CLOCK_MONOTONIC, &t);
  return std::chrono::seconds(t.tv_sec) + nanoseconds(t.tv_nsec);
}

void count(Tally& tally, const CameraReport& report, nanoseconds half_exposure) {
  const nanoseconds now = monotonic_now();
  const std::lock_guard lock(tally.mutex);
  if (report.event == CameraEvent::frame) ++tally.seen;
  if (tally.seen <= kWarmUpFrames) return;
  if (report.event == CameraEvent::incomplete) ++tally.incomplete;
  if (report.event == CameraEvent::gap) tally.missing += report.frames_missing;
  if (report.event != CameraEvent::frame) return;
  if (tally.frames++ == 0) tally.t_first = now;
  tally.t_last = now;
  tally.latency_ms.push_back(
      std::chrono::duration<double, std::milli>(now - report.t_exposure - half_exposure).count());
}

double quantile(std::vector<double>& values, double q) {
  if (values.empty()) return 0;
  const auto at =
      values.begin() + static_cast<std::ptrdiff_t>(q * static_cast<double>(values.size() - 1));
  std::nth_element(values.begin(), at, values.end());
  return *at;
}

nlohmann::json measure(const Options& options, const std::filesystem::path& simulator,
                       const Case& the_case) {
  const Simulator running(simulator, the_case);
  CameraParameters parameters;
  parameters.id = "127.0.0.1";
  parameters.pixel_format = the_case.format;
  parameters.width_px = the_case.width_px;
  parameters.height_px = the_case.height_px;
  parameters.frame_rate_hz = the_case.frame_rate_hz;
  parameters.packet_size_bytes = options.packet_size_bytes;
  const auto half_exposure = nanoseconds(static_cast<std::int64_t>(parameters.exposure_us * 500));
  Tally tally;
  {
    CameraSource source(parameters, [&tally, half_exposure](const CameraReport& report) {
      count(tally, report, half_exposure);
    });
    std::unique_lock lock(tally.mutex);
    tally.done.wait_for(lock, std::chrono::duration<double>(options.seconds), [] { return false; });
  }
  const double span_s = std::chrono::duration<double>(tally.t_last - tally.t_first).count();
  const double rate_hz = span_s > 0 ? (tally.frames - 1) / span_s : 0;
  return {{"name", fmt::format("camera {}x{} {} at {} Hz", the_case.width_px, the_case.height_px,
                               genicam_name(the_case.format), the_case.frame_rate_hz)},
          {"frames", tally.frames},
          {"rate_hz", rate_hz},
          {"incomplete", tally.incomplete},
          {"missing", tally.missing},
          {"median", quantile(tally.latency_ms, 0.5)},
          {"p99", quantile(tally.latency_ms, 0.99)},
          {"unit", "ms"}};
}

void run(const Options& options) {
  sim::enter_private_network();
  cv::setNumThreads(1);
  const auto simulator =
      std::filesystem::read_symlink("/proc/self/exe").parent_path() / "holdfast-sim";
  std::vector<Case> cases;
  for (const auto& [width, height] : {std::pair{1920, 1080}, std::pair{2456, 2054}})
    for (const PixelFormat format : {PixelFormat::mono8, PixelFormat::bayer_rg8, PixelFormat::bgr8})
      for (const double rate : {30.0, 60.0}) cases.push_back({width, height, format, rate});
  nlohmann::json results = nlohmann::json::array();
  std::printf("%-36s %9s %8s %10s %7s %10s %10s\n", "end of exposure -> callback", "frames/s",
              "frames", "incomplete", "missing", "p50 ms", "p99 ms");
  for (const Case& the_case : cases) {
    const nlohmann::json result = measure(options, simulator, the_case);
    std::printf("%-36s %9.2f %8d %10d %7d %10.2f %10.2f\n",
                result["name"].get<std::string>().c_str(), result["rate_hz"].get<double>(),
                result["frames"].get<int>(), result["incomplete"].get<int>(),
                result["missing"].get<int>(), result["median"].get<double>(),
                result["p99"].get<double>());
    std::fflush(stdout);
    results.push_back(result);
  }
  if (options.json.empty()) return;
  bridge::write_file_atomically(options.json, results.dump(2) + "\n");
}

}  // namespace
}  // namespace holdfast::bridge

int main(int argc, char** argv) {
  using namespace holdfast::bridge;  // NOLINT(google-build-using-namespace): main of one program
  CLI::App app{
      "Frames from the virtual camera through the network stack.\n"
      "Example: holdfast-bench-camera --json camera.json",
      "holdfast-bench-camera"};
  Options options;
  app.add_option("--json", options.json, "results as a JSON list");
  app.add_option("--seconds", options.seconds, "for each case")->capture_default_str();
  app.add_option("--packet-size", options.packet_size_bytes, "bytes")->capture_default_str();
  app.callback([&options] { run(options); });
  return run_command_line(app, argc, argv);
}
