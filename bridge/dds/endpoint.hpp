// SPDX-License-Identifier: Apache-2.0
// Typed writers and readers of the topics. After construction neither writing nor taking waits, and
// taking does not allocate. Writing does not either for messages up to 256 bytes; for larger ones
// (poses, health, registration) Cyclone 0.10.2 calls malloc twice, since it pools no larger
// buffers. Cyclone takes its own mutexes, without priority inheritance: none of this is for the
// control loop's thread. Each object belongs to one thread.
#pragma once

#include <array>
#include <cstdint>
#include <memory>
#include <span>

#include "bridge/dds/message_protection.hpp"
#include "bridge/dds/participant.hpp"
#include "bridge/dds/topics.hpp"

namespace holdfast::bridge::dds {

struct EndpointRecord;  // what a listener needs to know; endpoint.cpp

/// Counts of matched peers and of what the middleware noticed; diagnostics, never an authority.
struct EndpointStatus {
  std::uint32_t matched = 0;           ///< peers of this endpoint now
  std::uint32_t deadlines_missed = 0;  ///< since start
  std::uint32_t incompatible = 0;      ///< peers with incompatible QoS since start
  std::uint32_t alive = 0;             ///< readers only: matched writers that are alive now
};

class Endpoint {
 public:
  [[nodiscard]] EndpointStatus status() const noexcept;
  /// Writers: waits until every matched reliable reader has what was written; false on timeout. For
  /// programs about to end.
  [[nodiscard]] bool wait_for_acknowledgements(std::chrono::nanoseconds timeout) const noexcept;
  [[nodiscard]] std::int32_t handle() const noexcept { return entity_.handle(); }
  ~Endpoint();
  Endpoint(const Endpoint&) = delete;
  Endpoint& operator=(const Endpoint&) = delete;

 protected:
  enum class Direction : std::uint8_t { writer, reader };
  Endpoint(const Participant& participant, Direction direction, const TopicPolicy& policy,
           const dds_topic_descriptor_t& descriptor);
  /// All samples of a topic are one instance (no keys): registered once, so that writes need no
  /// look-up and no memory.
  void register_instance(const void* sample);
  [[nodiscard]] bool write(const void* sample) const noexcept;
  /// Takes up to samples.size(); returns how many hold data, moved to the front. Negative: error.
  [[nodiscard]] int take(std::span<void*> samples) const noexcept;

 private:
  Direction direction_;
  std::unique_ptr<EndpointRecord> record_;  // outlives entity_, whose listener points to it
  Entity topic_;
  Entity entity_;
};

class PosePublisher;  // bridge/dds/messages.hpp

/// What it takes to construct a writer of poses. Only PosePublisher has it, and that publishes
/// nothing but safety::ApprovedPose: the one exit. Tests that play a hostile or broken sender name
/// themselves PoseForger; no other code may.
class PoseWriterKey {
  friend class PosePublisher;
  friend struct PoseForger;
  PoseWriterKey() = default;
};

template <msg::Message M>
class Writer : public Endpoint {
 public:
  /// Throws UnavailableError.
  explicit Writer(const Participant& participant) requires(!std::same_as<M, msg::CompensatedPose>)
      : Writer(participant, 0) {}
  Writer(const Participant& participant,
         PoseWriterKey /*key*/) requires(std::same_as<M, msg::CompensatedPose>)
      : Writer(participant, 0) {}

  /// False when the middleware did not take it (receivers will see the counter skip).
  [[nodiscard]] bool write(const M& message) const noexcept { return Endpoint::write(&message); }

 private:
  Writer(const Participant& participant, int /*any*/)
      : Endpoint(participant, Direction::writer, Topic<M>::policy(), Topic<M>::descriptor()) {
    const M any{};
    register_instance(&any);
  }
};

/// A writer that protects each message as it goes out: identity, counter, time, CRC.
template <msg::Message M>
class ProtectedWriter {
 public:
  /// `source`: random_source() of this process, the same for all its topics.
  template <class... Key>
  ProtectedWriter(const Participant& participant, std::uint32_t source, Key... key)
      : writer_(participant, key...), source_(source) {}

  /// Stamps `message` with now and writes it. `validity` zero: the topic's default.
  [[nodiscard]] bool publish(M& message, std::chrono::nanoseconds validity = {}) noexcept {
    const auto v = validity.count() > 0 ? validity : Topic<M>::policy().validity;
    protect(message, source_, ++counter_, v, read_clocks());
    return writer_.write(message);
  }
  [[nodiscard]] EndpointStatus status() const noexcept { return writer_.status(); }
  [[nodiscard]] std::uint32_t counter() const noexcept { return counter_; }  ///< newest sent
  [[nodiscard]] const Writer<M>& writer() const noexcept { return writer_; }

 private:
  Writer<M> writer_;
  std::uint32_t source_;
  std::uint32_t counter_ = 0;
};

template <msg::Message M>
class Reader : public Endpoint {
 public:
  static constexpr std::size_t kBatch = 16;

  /// Throws UnavailableError.
  explicit Reader(const Participant& participant)
      : Endpoint(participant, Direction::reader, Topic<M>::policy(), Topic<M>::descriptor()) {
    for (std::size_t i = 0; i < kBatch; ++i) pointers_[i] = &samples_[i];
  }

  /// Up to kBatch messages that have arrived, oldest first; empty when there are none left. Valid
  /// until the next call.
  [[nodiscard]] std::span<const M> take() noexcept {
    const int n = Endpoint::take(pointers_);
    if (n <= 0) return {};
    return std::span<const M>(samples_).first(static_cast<std::size_t>(n));
  }

  /// Calls f(message, clocks at reception) for each message that has arrived, oldest first. What a
  /// flood leaves over is for the next call: it must not keep the caller here.
  template <class F>
  void drain(F&& f) {
    for (int batch = 0; batch < kMaxBatches; ++batch) {
      const auto messages = take();
      if (messages.empty()) return;
      const Clocks now = read_clocks();  // after the reception: before it, all came from the future
      for (const M& message : messages) f(message, now);
    }
  }

 private:
  static constexpr int kMaxBatches = 16;
  std::array<M, kBatch> samples_{};
  std::array<void*, kBatch> pointers_{};
};

/// A reader that checks each message as it comes in.
template <msg::Message M>
class ProtectedReader {
 public:
  ProtectedReader(const Participant& participant, const safety::ReceiverParameters& parameters)
      : reader_(participant), receiver_(Topic<M>::policy().data_id, parameters) {}

  /// Calls f(message, verdict, clocks at reception) for each message that has arrived, oldest
  /// first. On any verdict but `accepted` its content must not be used.
  template <class F>
  void take(F&& f) {
    reader_.drain(
        [&](const M& message, Clocks now) { f(message, check(message, receiver_, now), now); });
  }
  [[nodiscard]] const safety::Receiver& receiver() const noexcept { return receiver_; }
  [[nodiscard]] const Reader<M>& reader() const noexcept { return reader_; }

 private:
  Reader<M> reader_;
  safety::Receiver receiver_;
};

}  // namespace holdfast::bridge::dds
