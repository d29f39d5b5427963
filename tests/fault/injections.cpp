// SPDX-License-Identifier: Apache-2.0
#include "tests/fault/injections.hpp"

#include <algorithm>
#include <chrono>
#include <cmath>
#include <cstring>
#include <random>
#include <span>
#include <type_traits>

#include "bridge/dds/message_protection.hpp"
#include "bridge/dds/topics.hpp"

namespace holdfast::fault {
namespace {

using bridge::dds::Clocks;
using safety::Verdict;
using std::chrono::milliseconds;
using std::chrono::nanoseconds;

constexpr std::uint32_t kSource = 7;
constexpr nanoseconds kUtcAhead = std::chrono::hours(400'000);

/// A stream of one message and its receiver, which takes every good one.
template <msg::Message M>
class Stream {
 public:
  Stream(std::uint64_t seed, Weakness weakness) : random_(seed), weakness_(weakness) {
    safety::ReceiverParameters parameters;
    if (weakness == Weakness::loss_tolerated) parameters.max_counter_step = 5000;
    if (weakness == Weakness::age_not_limited) parameters.max_validity = std::chrono::hours(1);
    if (weakness == Weakness::future_tolerated)
      parameters.future_tolerance = std::chrono::seconds(1);
    if (weakness == Weakness::sources_take_turns) parameters.source_timeout = nanoseconds(0);
    validity_ = weakness == Weakness::age_not_limited
                    ? nanoseconds(std::chrono::hours(1))
                    : std::min<nanoseconds>(bridge::dds::Topic<M>::policy().validity,
                                            parameters.max_validity);
    future_tolerance_ = safety::ReceiverParameters{}.future_tolerance;
    receiver_ = safety::Receiver(bridge::dds::Topic<M>::policy().data_id, parameters);
    parameters.clock = safety::ClockRelation::synchronised_utc;
    far_receiver_ = safety::Receiver(bridge::dds::Topic<M>::policy().data_id, parameters);
    fill();
    for (std::size_t i = 0; i < history_.size(); ++i) step();
  }

  /// The next message: as sent, and spoilt.
  void attack(Injection injection, InjectionResult& result) {
    now_ += milliseconds(1);
    if (++counter_ % 64 == 0) fill();
    const M good = sent(counter_, now_);
    const auto kind = static_cast<std::size_t>(injection);
    ++result.injected[kind];
    if (is_accepted(good, injection)) ++result.accepted[kind];
    ++result.good;
    const bool is_taken = take(good, receiver_, clocks(now_)) == Verdict::accepted &&
                          take(good, far_receiver_, clocks(now_)) == Verdict::accepted;
    if (!is_taken) ++result.good_refused;
    history_[counter_ % history_.size()] = good;
  }

 private:
  static Clocks clocks(nanoseconds now) { return {now, now + kUtcAhead}; }
  std::uint64_t up_to(std::uint64_t most) {  // 1 to most
    return std::uniform_int_distribution<std::uint64_t>(1, most)(random_);
  }
  /// From a nanosecond on, every order of magnitude alike.
  nanoseconds span_up_to(nanoseconds most) {
    const double orders = std::log10(static_cast<double>(most.count()));
    return nanoseconds(
        std::llround(std::pow(10.0, std::uniform_real_distribution<double>(0, orders)(random_))));
  }

  void fill() {
    msg::for_each_field(message_, [this](auto& field) {
      using Field = std::remove_reference_t<decltype(field)>;
      if constexpr (std::is_same_v<Field, bool>) {
        field = random_() % 2 == 0;
      } else if constexpr (std::is_array_v<Field>) {  // a string
        std::memset(&field, 0, sizeof(field));
        for (std::size_t i = 0; i < std::min<std::size_t>(sizeof(field) - 1, 20); ++i)
          field[i] = static_cast<char>('a' + random_() % 26);
      } else {
        const std::uint64_t bits = random_();
        std::memcpy(&field, &bits, sizeof(field));
      }
    });
  }
  M sent(std::uint32_t counter, nanoseconds at, std::uint32_t source = kSource) {
    M message = message_;
    protect(message, source, counter, validity_, clocks(at));
    return message;
  }
  void step() {
    now_ += milliseconds(1);
    const M message = sent(++counter_, now_);
    (void)take(message, receiver_, clocks(now_));
    (void)take(message, far_receiver_, clocks(now_));
    history_[counter_ % history_.size()] = message;
  }
  Verdict take(const M& message, safety::Receiver& receiver, Clocks now) const {
    const std::uint32_t crc = weakness_ == Weakness::crc_believed
                                  ? message.protection.crc32c
                                  : bridge::dds::canonical_crc(message);
    return receiver.check(bridge::dds::received(message.protection), crc, now.monotonic, now.utc);
  }
  [[nodiscard]] bool is_taken(const M& message) const {
    safety::Receiver receiver = receiver_;  // what it remembers of this does not last
    return take(message, receiver, clocks(now_)) == Verdict::accepted;
  }

  /// Until what is protected has changed: some bytes of the struct are padding.
  template <typename Spoil>
  M spoilt(const M& good, const Spoil& spoil) {
    const std::uint32_t crc = bridge::dds::canonical_crc(good);
    for (;;) {
      M bad = good;
      spoil(std::as_writable_bytes(std::span(&bad, 1)));
      const bool is_same =
          bridge::dds::canonical_crc(bad) == crc && bad.protection.crc32c == good.protection.crc32c;
      if (!is_same) return bad;
    }
  }
  static void flip(std::span<std::byte> bytes, std::size_t bit) {
    bytes[bit / 8] ^= std::byte{1} << (bit % 8);
  }
  M with_protection(const M& good, const auto& change) {
    M bad = good;
    change(bad.protection);
    bad.protection.crc32c = bridge::dds::canonical_crc(bad);
    return bad;
  }

  bool is_accepted(const M& good, Injection injection) {
    constexpr std::size_t kBits = 8 * sizeof(M);
    switch (injection) {
      case Injection::bits:
        return is_taken(spoilt(good, [&](std::span<std::byte> bytes) {
          for (std::uint64_t n = up_to(8); n > 0; --n) flip(bytes, random_() % kBits);
        }));
      case Injection::burst:
        return is_taken(spoilt(good, [&](std::span<std::byte> bytes) {
          const std::size_t length = up_to(32), from = random_() % (kBits - length);
          flip(bytes, from);
          for (std::size_t i = 1; i < length; ++i)
            if (random_() % 2 == 0) flip(bytes, from + i);
        }));
      case Injection::truncation:
        return is_taken(spoilt(good, [&](std::span<std::byte> bytes) {
          std::ranges::fill(bytes.subspan(random_() % bytes.size()), std::byte{0});
        }));
      case Injection::random_bytes:
        return is_taken(spoilt(good, [&](std::span<std::byte> bytes) {
          for (std::byte& byte : bytes.subspan(sizeof(msg::Protection)))
            byte = static_cast<std::byte>(random_());
        }));
      case Injection::repetition:
        return is_taken(history_[(counter_ - 1) % history_.size()]);
      case Injection::old_message:
        return is_taken(history_[(counter_ - 1 - up_to(history_.size() - 2)) % history_.size()]);
      case Injection::loss:
        return is_taken(sent(counter_ + static_cast<std::uint32_t>(up_to(1000)), now_));
      case Injection::reordering: {
        safety::Receiver receiver = receiver_;
        const M next = sent(counter_ + 1, now_);
        return take(next, receiver, clocks(now_)) == Verdict::accepted ||
               take(good, receiver, clocks(now_)) == Verdict::accepted;
      }
      case Injection::delay: {
        safety::Receiver receiver = receiver_;
        const nanoseconds late = limit() + span_up_to(std::chrono::seconds(10));
        return take(good, receiver, clocks(now_ + late)) == Verdict::accepted;
      }
      case Injection::future:
        return is_taken(
            sent(counter_, now_ + future_tolerance_ + span_up_to(std::chrono::hours(24))));
      case Injection::time_reversal:
        return is_taken(sent(counter_, now_ - milliseconds(1) - span_up_to(milliseconds(9))));
      case Injection::utc_step: {
        safety::Receiver receiver = far_receiver_;
        const nanoseconds step =
            std::max(limit(), future_tolerance_) + span_up_to(std::chrono::hours(24));
        Clocks parted = clocks(now_);
        parted.utc += random_() % 2 == 0 ? step : -step;
        return take(good, receiver, parted) == Verdict::accepted;
      }
      case Injection::masquerade:
        return is_taken(
            sent(counter_, now_, kSource + static_cast<std::uint32_t>(up_to(1'000'000))));
      case Injection::other_topic:
        return is_taken(with_protection(good, [&](msg::Protection& p) {
          p.data_id = static_cast<std::uint8_t>(p.data_id + up_to(255));
        }));
      case Injection::other_version:
        return is_taken(with_protection(good, [&](msg::Protection& p) {
          p.version = static_cast<std::uint8_t>(p.version + up_to(255));
        }));
      case Injection::no_source:
        return is_taken(with_protection(good, [](msg::Protection& p) { p.source = 0; }));
    }
    return true;
  }

  /// After which a message counts as late, whatever the receiver has been told.
  [[nodiscard]] nanoseconds limit() const {
    return std::min<nanoseconds>(bridge::dds::Topic<M>::policy().validity,
                                 safety::ReceiverParameters{}.max_validity);
  }

  std::mt19937_64 random_;
  Weakness weakness_;
  nanoseconds validity_{}, future_tolerance_{};
  safety::Receiver receiver_{{}, {}}, far_receiver_{{}, {}};
  M message_{};
  std::uint32_t counter_ = 0;
  nanoseconds now_ = std::chrono::seconds(1000);
  std::array<M, 16> history_{};
};

template <msg::Message M>
void attack(std::uint64_t count, std::uint64_t seed, Weakness weakness, InjectionResult& result) {
  Stream<M> stream(seed, weakness);
  for (std::uint64_t i = 0; i < count; ++i)
    stream.attack(static_cast<Injection>(i % kInjectionCount), result);
}

template <msg::Message... All>
InjectionResult attack_each(std::uint64_t count, std::uint64_t seed, Weakness weakness) {
  InjectionResult result;
  std::uint64_t rest = count, left = sizeof...(All);
  const auto share = [&] {
    const std::uint64_t part = rest / left--;
    rest -= part;
    return part;
  };
  (attack<All>(share(), seed++, weakness, result), ...);
  return result;
}

}  // namespace

const char* name(Injection injection) noexcept {
  constexpr std::array<const char*, kInjectionCount> kNames{
      "bits",       "burst",       "truncation",    "random_bytes", "repetition",    "old_message",
      "loss",       "reordering",  "delay",         "future",       "time_reversal", "utc_step",
      "masquerade", "other_topic", "other_version", "no_source"};
  return kNames[static_cast<std::size_t>(injection)];
}

const char* name(Weakness weakness) noexcept {
  constexpr std::array<const char*, kWeaknessCount + 1> kNames{"none",
                                                               "crc_believed",
                                                               "loss_tolerated",
                                                               "age_not_limited",
                                                               "future_tolerated",
                                                               "sources_take_turns"};
  return kNames[static_cast<std::size_t>(weakness)];
}

InjectionResult inject(std::uint64_t count, std::uint64_t seed, Weakness weakness) {
  return attack_each<msg::CompensatedPose, msg::MotionStop, msg::TrackingHealth,
                     msg::RegistrationInfo, msg::RobotStatus, msg::OperatorCommand,
                     msg::GuardPermission>(count, seed, weakness);
}

}  // namespace holdfast::fault
