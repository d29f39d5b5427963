// SPDX-License-Identifier: Apache-2.0
#include "bridge/dds/message_protection.hpp"

#include <array>
#include <cstdio>
#include <map>
#include <memory>
#include <sstream>
#include <string>
#include <vector>

#include <gtest/gtest.h>

#include "tests/bridge/golden_messages.hpp"

namespace holdfast::bridge::dds {
namespace {

using std::chrono::milliseconds;
using std::chrono::nanoseconds;
using namespace std::chrono_literals;

template <class M>
class MessageProtection : public testing::Test {
 public:
  static constexpr Clocks kNow{.monotonic = 100s, .utc = 1'700'000'000s};
  static safety::Receiver receiver() { return {Topic<M>::policy().data_id, {}}; }
  static M protected_message() {
    M message = numbered<M>();
    protect(message, 7, 1, milliseconds(10), kNow);
    return message;
  }
};

using Messages = testing::Types<msg::CompensatedPose, msg::MotionStop, msg::TrackingHealth,
                                msg::RegistrationInfo, msg::RobotStatus, msg::OperatorCommand,
                                msg::GuardPermission>;
TYPED_TEST_SUITE(MessageProtection, Messages, TypeNames);

TYPED_TEST(MessageProtection, CoversEveryFieldInOrder) {
  this->RecordProperty("requirement", "SR-48");
  TypeParam message{};
  const auto* const base = reinterpret_cast<const std::byte*>(&message);
  const auto aligned = [](std::size_t offset, std::size_t to) {
    return (offset + to - 1) / to * to;
  };
  std::size_t end = 0;
  msg::for_each_field(message, [&](auto& field) {
    using Scalar = std::remove_all_extents_t<std::remove_reference_t<decltype(field)>>;
    const auto begin = static_cast<std::size_t>(reinterpret_cast<const std::byte*>(&field) - base);
    if (begin == sizeof(msg::Protection)) end = begin;  // the CRC lies between
    EXPECT_EQ(begin, aligned(end, alignof(Scalar)));    // nothing but padding is left out
    end = begin + sizeof field;
  });
  EXPECT_EQ(sizeof message, aligned(end, alignof(TypeParam)));
}

TYPED_TEST(MessageProtection, BytesAndCrcAreThoseOfTheIdl) {
  const TypeParam message = numbered<TypeParam>();
  const auto expected = golden().find(TypeNames::GetName<TypeParam>(0));
  ASSERT_NE(expected, golden().end()) << "message_golden.py did not run";
  EXPECT_EQ(hex(CanonicalBytes<TypeParam>(message).bytes()), expected->second.bytes);
  std::array<char, 9> crc{};
  std::snprintf(crc.data(), crc.size(), "%08x", canonical_crc(message));
  EXPECT_EQ(std::string(crc.data()), expected->second.crc);
}

TYPED_TEST(MessageProtection, ProtectedMessageIsAccepted) {
  auto receiver = this->receiver();
  EXPECT_EQ(check(this->protected_message(), receiver, this->kNow), safety::Verdict::accepted);
}

TYPED_TEST(MessageProtection, EverySingleBitFlipIsRefused) {
  this->RecordProperty("requirement", "SR-48");
  TypeParam message = this->protected_message();
  int flips = 0;
  const auto flip_all = [&](void* field, std::size_t size) {
    for (std::size_t bit = 0; bit < 8 * size; ++bit, ++flips) {
      auto* const byte = static_cast<unsigned char*>(field) + bit / 8;
      const auto original = *byte;
      *byte = static_cast<unsigned char>(original ^ (1U << bit % 8));
      auto receiver = this->receiver();
      EXPECT_NE(check(message, receiver, this->kNow), safety::Verdict::accepted)
          << "flip " << flips;
      *byte = original;
    }
  };
  msg::for_each_field(message, [&](auto& field) {
    using Field = std::remove_reference_t<decltype(field)>;
    // What follows a string's terminator is not part of the message.
    if constexpr (std::is_array_v<Field>)
      flip_all(&field, std::string_view(field).size());
    else
      flip_all(&field, sizeof field);
  });
  flip_all(&message.protection.crc32c, sizeof message.protection.crc32c);
  EXPECT_GT(flips, 8 * 38);  // Protection alone has 38 bytes
}

TYPED_TEST(MessageProtection, AnotherTopicsMessageIsRefused) {
  TypeParam message = this->protected_message();
  message.protection.data_id = static_cast<std::uint8_t>(message.protection.data_id % 7 + 1);
  message.protection.crc32c = canonical_crc(message);
  auto receiver = this->receiver();
  EXPECT_EQ(check(message, receiver, this->kNow), safety::Verdict::bad_data_id);
}

TEST(RandomSource, IsNeverZeroAndDiffers) {
  const auto a = random_source();
  const auto b = random_source();
  EXPECT_NE(a, 0U);
  EXPECT_NE(a, b);  // fails once in 2^32 runs
}

TEST(Protect, CutsAValidityThatDoesNotFit) {
  msg::MotionStop message{};
  protect(message, 1, 1, std::chrono::hours(24 * 365), {});
  EXPECT_EQ(message.protection.validity_us, 0xFFFF'FFFFU);
  protect(message, 1, 1, nanoseconds(-1), {});
  EXPECT_EQ(message.protection.validity_us, 0U);
}

}  // namespace
}  // namespace holdfast::bridge::dds
