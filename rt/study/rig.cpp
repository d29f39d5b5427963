// SPDX-License-Identifier: Apache-2.0
#include "rt/study/rig.hpp"

#include <algorithm>
#include <array>
#include <cerrno>
#include <csignal>
#include <cstring>
#include <sstream>
#include <utility>

#include <fcntl.h>
#include <fmt/format.h>
#include <nlohmann/json.hpp>
#include <poll.h>
#include <spawn.h>
#include <sys/mman.h>
#include <sys/socket.h>
#include <sys/syscall.h>
#include <sys/wait.h>
#include <unistd.h>

#include "bridge/command_line.hpp"
#include "bridge/image_file.hpp"
#include "rt/core/error.hpp"

extern char** environ;

namespace holdfast::rt {
namespace {

using nlohmann::json;
namespace fs = std::filesystem;

constexpr int kPollMs = 200;
constexpr int kPatienceMs = 1000;

/// Starts it with these as stdin, stdout and stderr. Returns the error number, 0 when it runs.
int start(const RigCommand& command, std::array<int, 3> streams, pid_t& pid) {
  RigCommand words = command;
  std::vector<char*> arguments;
  for (std::string& word : words) arguments.push_back(word.data());
  arguments.push_back(nullptr);
  posix_spawn_file_actions_t actions;
  posix_spawn_file_actions_init(&actions);
  for (std::size_t i = 0; i < streams.size(); ++i)
    posix_spawn_file_actions_adddup2(&actions, streams[i], static_cast<int>(i));
  const int error = posix_spawnp(&pid, arguments[0], &actions, nullptr, arguments.data(), environ);
  posix_spawn_file_actions_destroy(&actions);
  return error;
}

registration::StereoShot read_pair(const fs::path& folder, const std::string& suffix) {
  return {bridge::read_image_file((folder / ("left" + suffix + ".png")).string()),
          bridge::read_image_file((folder / ("right" + suffix + ".png")).string())};
}

double figure(const json& answer, const char* key) {
  const json value = answer.value(key, json());
  return value.is_number() ? value.get<double>() : DepthJudgement::kUnknown;
}

json as_json(const SequenceRequest& wanted) {
  json what{{"zoom", wanted.zoom}, {"motion", wanted.motion}, {"rate_hz", wanted.rate_hz}};
  if (!wanted.lamps.empty()) what["lamps"] = wanted.lamps;
  if (!wanted.disturbances.empty()) what["disturbances"] = wanted.disturbances;
  return what;
}

}  // namespace

RigCommand rig_command(const std::string& text) {
  std::istringstream words(text);
  RigCommand command;
  for (std::string word; words >> word;) command.push_back(word);
  if (command.empty()) throw InputError("--rig: a command is needed");
  return command;
}

std::string rig_text(const RigCommand& command) {
  std::string text = fs::path(command.at(0)).filename().string();
  for (std::size_t i = 1; i < command.size(); ++i) text += " " + command[i];
  return text;
}

RigCommand virtual_rig(const std::vector<std::string>& arguments) {
  const fs::path here = fs::read_symlink("/proc/self/exe").parent_path();
  RigCommand command{(here / "holdfast-sim").string(), "rig"};
  command.insert(command.end(), arguments.begin(), arguments.end());
  return command;
}

Rig::Rig(const RigCommand& command) : name_("--rig " + command.at(0)), command_(rig_text(command)) {
  // A socket for the requests: a rig that has ended must not end us by SIGPIPE. What it complains
  // of goes into memory: a refusal is one line of ours.
  std::array<int, 2> asked{-1, -1}, answered{-1, -1};
  complaints_ = memfd_create("rig", MFD_CLOEXEC);
  int error = 0;
  if (complaints_ < 0 || socketpair(AF_UNIX, SOCK_STREAM | SOCK_CLOEXEC, 0, asked.data()) != 0 ||
      pipe2(answered.data(), O_CLOEXEC) != 0)
    error = errno;
  else
    error = start(command, {asked[1], answered[1], complaints_}, pid_);
  for (const int end : {asked[1], answered[1]})
    if (end >= 0) close(end);
  to_rig_ = asked[0];
  from_rig_ = answered[0];
  if (error == 0) return;
  for (const int end : {to_rig_, from_rig_, complaints_})
    if (end >= 0) close(end);
  throw UnavailableError(fmt::format("{}: cannot be started: {}", name_, std::strerror(error)));
}

Rig::~Rig() {
  close(to_rig_);
  close(from_rig_);
  const int handle = static_cast<int>(syscall(SYS_pidfd_open, pid_, 0));
  pollfd ended{handle, POLLIN, 0};
  if (handle < 0 || poll(&ended, 1, kPatienceMs) != 1) kill(pid_, SIGKILL);
  if (handle >= 0) close(handle);
  waitpid(pid_, nullptr, 0);
  close(complaints_);
}

void Rig::boards(double zoom, int pairs, const fs::path& out) {
  (void)request({{"do", "boards"}, {"zoom", zoom}, {"pairs", pairs}, {"out", out.string()}});
}

void Rig::ct(const fs::path& out) {
  (void)request({{"do", "ct"}, {"out", out.string()}});
}

RigPair Rig::pair(const PairRequest& wanted) {
  std::error_code ignored;  // images of an earlier request cannot be taken for these
  for (const char* name : {"left.png", "right.png", "left_off.png", "right_off.png"})
    fs::remove(wanted.out / name, ignored);
  json what{{"do", "pair"},
            {"out", wanted.out.string()},
            {"zoom", wanted.zoom},
            {"pose", wanted.pose},
            {"off", wanted.has_off}};
  if (!wanted.lamps.empty()) what["lamps"] = wanted.lamps;
  if (!wanted.pattern.empty()) what["pattern"] = wanted.pattern;
  (void)request(what);
  RigPair pair{read_pair(wanted.out, ""), {}};
  if (wanted.has_off) pair.off = read_pair(wanted.out, "_off");
  return pair;
}

DepthJudgement Rig::depth_error(const DepthQuestion& question) {
  const json answer = request({{"do", "depth-error"},
                               {"zoom", question.zoom},
                               {"pose", question.pose},
                               {"depth", question.depth.string()},
                               {"calibration", question.calibration.string()}});
  DepthJudgement judgement;
  judgement.coverage = figure(answer, "coverage");
  judgement.median_mm = figure(answer, "median_mm");
  judgement.mean_mm = figure(answer, "mean_mm");
  judgement.p95_mm = figure(answer, "p95_mm");
  judgement.share_over_1_mm = figure(answer, "share_over_1_mm");
  judgement.share_over_1_mm_off_edges = figure(answer, "share_over_1_mm_off_edges");
  return judgement;
}

RigSequence Rig::sequence(const SequenceRequest& wanted) {
  json what = as_json(wanted);
  what["do"] = "sequence";
  what["out"] = wanted.out.string();
  const json answer = request(what);
  const auto region = answer.value("region_px", std::vector<int>{});
  RigSequence sequence{answer.value("frames", 0), {}};
  if (region.size() != 4 || sequence.frames < 1)
    throw RefusedError(name_ + ": sequence: frames or region_px is missing");
  sequence.region_px = {region[0], region[1], region[2], region[3]};
  return sequence;
}

TrackingJudgement Rig::tracking_error(const TrackingQuestion& question) {
  json what = as_json(question.sequence);
  what["do"] = "tracking-error";
  what["poses"] = question.poses.string();
  what["calibration"] = question.calibration.string();
  what["rows"] = question.rows.string();
  if (question.point_site_mm) what["point_site_mm"] = *question.point_site_mm;
  const json answer = request(what);
  TrackingJudgement judgement;
  judgement.frames = answer.value("frames", 0);
  judgement.lost = answer.value("lost", 0);
  judgement.silently_wrong = answer.value("silently_wrong", 0);
  judgement.step_mean_um = figure(answer, "step_mean_um");
  judgement.step_sd_um = figure(answer, "step_sd_um");
  judgement.absolute_rms_um = figure(answer, "absolute_rms_um");
  judgement.absolute_max_um = figure(answer, "absolute_max_um");
  judgement.depth_rms_um = figure(answer, "depth_rms_um");
  judgement.rotation_rms_mrad = figure(answer, "rotation_rms_mrad");
  return judgement;
}

std::chrono::nanoseconds Rig::robot_lag() {
  const double lag_ms = figure(request({{"do", "robot"}}), "lag_ms");
  if (!(lag_ms >= 0)) throw RefusedError(name_ + ": robot: lag_ms is missing");
  return std::chrono::nanoseconds(std::llround(1e6 * lag_ms));
}

BeamJudgement Rig::beam_error(const BeamQuestion& question) {
  json what = as_json(question.sequence);
  what["do"] = "beam-error";
  what["commands"] = question.commands.string();
  what["calibration"] = question.calibration.string();
  what["rows"] = question.rows.string();
  const json answer = request(what);
  return {.on_s = figure(answer, "on_s"),
          .on_share = figure(answer, "on_share"),
          .rms_um = figure(answer, "rms_um"),
          .p99_um = figure(answer, "p99_um"),
          .max_um = figure(answer, "max_um"),
          .uncompensated_rms_um = figure(answer, "uncompensated_rms_um")};
}

void Rig::report_end() const {
  if (bridge::is_interrupted()) throw InterruptedError("interrupted");
  std::string said(4096, '\0');
  const off_t size = lseek(complaints_, 0, SEEK_END);
  const off_t from = std::max<off_t>(0, size - static_cast<off_t>(said.size()));
  const ssize_t count = pread(complaints_, said.data(), said.size(), from);
  said.resize(count > 0 ? static_cast<std::size_t>(count) : 0);
  while (!said.empty() && said.back() == '\n') said.pop_back();
  const std::string last = said.substr(said.rfind('\n') + 1);
  throw UnavailableError(
      fmt::format("{}: has ended{}{}", name_, last.empty() ? "" : ", its last words: ", last));
}

std::string Rig::read_line() {
  for (;;) {
    if (const std::size_t end = unread_.find('\n'); end != std::string::npos) {
      std::string line = unread_.substr(0, end);
      unread_.erase(0, end + 1);
      return line;
    }
    if (bridge::is_interrupted()) throw InterruptedError("interrupted");
    pollfd readable{from_rig_, POLLIN, 0};
    if (poll(&readable, 1, kPollMs) <= 0) continue;
    std::array<char, 4096> bytes{};
    const ssize_t count = read(from_rig_, bytes.data(), bytes.size());
    if (count < 0 && errno == EINTR) continue;
    if (count <= 0) report_end();
    unread_.append(bytes.data(), static_cast<std::size_t>(count));
  }
}

json Rig::request(const json& what) {
  const std::string line = what.dump() + "\n";
  for (std::size_t sent = 0; sent < line.size();) {
    const ssize_t count = send(to_rig_, line.data() + sent, line.size() - sent, MSG_NOSIGNAL);
    if (count < 0 && errno == EINTR) continue;
    if (count <= 0) report_end();
    sent += static_cast<std::size_t>(count);
  }
  const std::string text = read_line();
  json answer = json::parse(text, nullptr, false);
  if (answer.is_discarded() || !answer.is_object())
    throw UnavailableError(fmt::format("{}: answered no JSON object: {}", name_, text));
  if (const auto error = answer.find("error"); error != answer.end())
    throw RefusedError("rig: " + (error->is_string() ? error->get<std::string>() : error->dump()));
  return answer;
}

}  // namespace holdfast::rt
