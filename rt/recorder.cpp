// SPDX-License-Identifier: Apache-2.0
#include "rt/recorder.hpp"

#include <algorithm>
#include <atomic>
#include <cerrno>
#include <condition_variable>
#include <csignal>
#include <cstring>
#include <ctime>
#include <mutex>
#include <optional>
#include <thread>

#include <fmt/chrono.h>

#include "rt/core/clock.hpp"
#include "rt/core/error.hpp"
#include "rt/recording_file.hpp"

namespace holdfast::rt {
namespace {

using namespace std::chrono_literals;

constexpr auto kLookPeriod = 10ms;    // how often the tape is emptied
constexpr auto kChunkPeriod = 250ms;  // what a killed process can lose
constexpr auto kSyncPeriod = 500ms;   // with it, what a loss of power can
constexpr std::size_t kChunkBytes = std::size_t{512} << 10U;
constexpr std::uint64_t kParts = 8;  // the folder's bound holds so many files
constexpr std::uint64_t kPartBytesMax = std::uint64_t{256} << 20U;

bool is_full(int error) {
  return error == ENOSPC || error == EDQUOT || error == EFBIG;
}

std::string file_name(std::uint64_t run_ns, std::uint64_t part) {
  const std::chrono::nanoseconds utc{static_cast<std::int64_t>(run_ns)};
  const auto whole = std::chrono::floor<std::chrono::seconds>(utc);
  return fmt::format("{:%Y%m%dT%H%M%S}.{:03}Z-{:05}", fmt::gmtime(whole.count()),
                     (utc - whole) / 1ms, part);
}

template <typename Matrix>
bool is_same_bits(const Matrix& a, const Matrix& b) {
  return std::memcmp(a.data(), b.data(), sizeof(double) * static_cast<std::size_t>(a.size())) == 0;
}

bool is_same(const safety::RegistrationInput& a, const safety::RegistrationInput& b) {
  const auto& [is_loaded, id, T_site_ct, covariance, p_target, zoom, focus_mm] = a;
  return is_loaded == b.is_loaded && id == b.id && zoom == b.zoom && focus_mm == b.focus_mm &&
         is_same_bits(T_site_ct.matrix(), b.T_site_ct.matrix()) &&
         is_same_bits(covariance, b.covariance) && is_same_bits(p_target, b.p_target_site_mm);
}

}  // namespace

std::string_view name(RecorderCondition condition) noexcept {
  switch (condition) {
    case RecorderCondition::recording:
      return "recording";
    case RecorderCondition::disk_full:
      return "disk_full";
    case RecorderCondition::write_failed:
      return "write_failed";
  }
  return "unknown";
}

class Recorder::Thread {
 public:
  Thread(const RecorderConfig& config, const RecordedSession& session,
         bridge::SegmentFolder::Write write);
  ~Thread();
  Thread(const Thread&) = delete;
  Thread& operator=(const Thread&) = delete;

  [[nodiscard]] CycleTape& tape() noexcept { return tape_; }
  [[nodiscard]] RecorderStatus status() const noexcept;

 private:
  void run();
  void take_tape();
  void take_states(std::uint64_t before_cycle);
  void take(const TapedState& state);
  void take(const TapedCycle& cycle);
  [[nodiscard]] bool begin_part(safety::Timestamp t);
  void end_part();
  [[nodiscard]] bool write_chunk();
  void fail();

  CycleTape tape_;
  RecordedSession session_;
  bridge::SegmentFolder folder_;
  std::uint64_t part_bytes_;
  std::optional<RecordingFile> file_;  // absent while the disk refuses
  std::optional<RecordedRegistration> registration_;
  std::optional<TapedState> next_state_;  // popped, and of a cycle that is not yet
  TapedCycle cycle_;
  TapedState state_;
  std::uint64_t next_cycle_ = 0;   // the one that should be recorded next
  std::uint64_t chunk_first_ = 0;  // what next_cycle_ was at the chunk's start
  std::uint64_t cycles_in_chunk_ = 0;
  safety::Timestamp t_chunk_{}, t_sync_{};

  std::atomic<RecorderCondition> condition_{RecorderCondition::recording};
  std::atomic<int> error_{0};
  std::atomic<std::uint64_t> end_of_tape_{0}, recorded_{0}, lost_{0};

  std::mutex mutex_;  // guards is_ending_; the control thread never takes it
  std::condition_variable wake_;
  bool is_ending_ = false;
  std::thread thread_;
};

Recorder::Thread::Thread(const RecorderConfig& config, const RecordedSession& session,
                         bridge::SegmentFolder::Write write)
    : session_(session),
      folder_(config.folder, config.size_max_bytes, write),
      part_bytes_(std::min(config.size_max_bytes / kParts, kPartBytesMax)) {
  if (!begin_part(monotonic_now()))
    throw InputError(fmt::format("{}: cannot be written: {}", config.folder.string(),
                                 std::strerror(folder_.error())));
  thread_ = std::thread([this] { run(); });
}

Recorder::Thread::~Thread() {
  {
    const std::lock_guard lock(mutex_);
    is_ending_ = true;
  }
  wake_.notify_one();
  thread_.join();
}

RecorderStatus Recorder::Thread::status() const noexcept {
  return {condition_.load(std::memory_order_relaxed), error_.load(std::memory_order_relaxed),
          end_of_tape_.load(std::memory_order_relaxed), recorded_.load(std::memory_order_relaxed),
          lost_.load(std::memory_order_relaxed)};
}

void Recorder::Thread::run() {
  sigset_t all;
  sigfillset(&all);  // also SIGXFSZ: a file that may not grow is a failed write, no more
  pthread_sigmask(SIG_SETMASK, &all, nullptr);
  std::unique_lock lock(mutex_);
  while (!is_ending_) {
    lock.unlock();
    take_tape();
    lock.lock();
    wake_.wait_for(lock, kLookPeriod, [this] { return is_ending_; });
  }
  take_tape();
  end_part();
}

void Recorder::Thread::take_tape() {
  while (tape_.try_pop(cycle_)) {
    take_states(cycle_.info.index);
    take(cycle_);
    lost_ = cycle_.info.index + 1 - recorded_ - cycles_in_chunk_;
    end_of_tape_ = cycle_.info.index + 1;
  }
  const safety::Timestamp now = monotonic_now();
  if (file_ && now - t_chunk_ >= kChunkPeriod && !write_chunk()) return;
  if (!file_ || now - t_sync_ < kSyncPeriod) return;
  t_sync_ = now;
  if (!folder_.sync()) fail();
}

/// The states that cycles before this one have left.
void Recorder::Thread::take_states(std::uint64_t before_cycle) {
  while (true) {
    if (!next_state_) {
      if (!tape_.try_pop(state_)) return;
      next_state_ = state_;
    }
    if (next_state_->after >= before_cycle) return;
    take(*next_state_);
    next_state_.reset();
  }
}

/// A file begins with a state, so that it can be replayed alone, and recording resumes with one.
void Recorder::Thread::take(const TapedState& state) {
  if (file_ && folder_.open_bytes() >= part_bytes_ / 4 * 3) end_part();
  if (!file_ && !begin_part(cycle_.t_decided)) return fail();
  file_->add(state, cycle_.t_decided);
}

void Recorder::Thread::take(const TapedCycle& cycle) {
  const std::uint64_t index = cycle.info.index;
  const safety::Timestamp t = cycle.t_decided;
  if (!registration_ || !is_same(registration_->registration, cycle.readings.registration)) {
    registration_ = {index, cycle.readings.registration};
    if (file_) file_->add(*registration_, t);
  }
  if (!file_) return;
  if (index != next_cycle_) file_->add(RecordedGap{next_cycle_, index - next_cycle_}, t);
  file_->add(cycle);
  next_cycle_ = index + 1;
  ++cycles_in_chunk_;
  if (file_->mcap().chunk_bytes() >= kChunkBytes) (void)write_chunk();
}

bool Recorder::Thread::begin_part(safety::Timestamp t) {
  session_.t_begun = t;
  file_.emplace(session_, registration_);
  file_->mcap().end_chunk();
  if (!folder_.open(file_name(session_.run, session_.part)) ||
      !folder_.append(file_->mcap().pending())) {
    folder_.discard();
    file_.reset();
    return false;
  }
  file_->mcap().clear_pending();
  ++session_.part;
  t_chunk_ = t_sync_ = t;
  condition_ = RecorderCondition::recording;
  return true;
}

void Recorder::Thread::end_part() {
  if (!file_) return;
  if (end_of_tape_ == 0) return folder_.discard();  // the daemon did not come to its first cycle
  if (!write_chunk()) return;
  file_->mcap().finish();
  // Without its end the file is still whole: no index, that is all.
  if (folder_.append(file_->mcap().pending())) (void)folder_.sync();
  folder_.close();
  file_.reset();
}

bool Recorder::Thread::write_chunk() {
  file_->mcap().end_chunk();
  if (!folder_.append(file_->mcap().pending())) {
    fail();
    return false;
  }
  file_->mcap().clear_pending();
  recorded_ += cycles_in_chunk_;
  cycles_in_chunk_ = 0;
  chunk_first_ = next_cycle_;
  t_chunk_ = monotonic_now();
  return true;
}

/// What was not written is lost; the next state tries anew.
void Recorder::Thread::fail() {
  const int error = folder_.error();
  error_ = error;
  condition_ = is_full(error) ? RecorderCondition::disk_full : RecorderCondition::write_failed;
  folder_.close();
  file_.reset();
  next_cycle_ = chunk_first_;
  cycles_in_chunk_ = 0;
}

Recorder::Recorder(const RecorderConfig& config, const RecordedSession& session,
                   bridge::SegmentFolder::Write write)
    : thread_(std::make_unique<Thread>(config, session, write)) {}
Recorder::~Recorder() = default;
CycleTape& Recorder::tape() noexcept {
  return thread_->tape();
}
RecorderStatus Recorder::status() const noexcept {
  return thread_->status();
}

}  // namespace holdfast::rt
