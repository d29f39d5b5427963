// SPDX-License-Identifier: Apache-2.0
// Structs as ROS 2 messages: one description of a struct's fields gives its schema (ros2msg), its
// bytes (CDR, little-endian, bit-exact), the way back, and the name of any byte. So schema and
// bytes cannot part. Foxglove, PlotJuggler and rosbag2 read both.
//
// A struct T is described by a specialisation
//   template <> struct Description<T> {
//     static constexpr std::string_view kName = "package/Name";
//     template <typename Archive, typename Value>         // Value: T or const T
//     static void fields(Archive& archive, Value& v) {    // bind every member: a new one that is
//       auto& [a, b] = v;                                 // not described does not compile
//       archive("a", a); archive("b", b);
//     }
//   };
// an enum E whose constants the schema should name by EnumNames<E>::list(), and a type that travels
// as a number by Wire<T>.
#pragma once

#include <array>
#include <bit>
#include <chrono>
#include <cstdint>
#include <cstring>
#include <optional>
#include <string>
#include <string_view>
#include <type_traits>
#include <utility>
#include <vector>

#include <Eigen/Geometry>

namespace holdfast::bridge::ros2 {

template <typename T>
struct Description;
template <typename E>
struct EnumNames {
  static std::vector<std::pair<std::string, unsigned>> list() { return {}; }
};
template <typename T>
struct Wire;
template <>
struct Wire<std::chrono::nanoseconds> {
  using Type = std::int64_t;
  static Type to(std::chrono::nanoseconds value) { return value.count(); }
  static std::chrono::nanoseconds from(Type value) { return std::chrono::nanoseconds{value}; }
};
template <typename E>
requires std::is_enum_v<E>
struct Wire<E> {
  using Type = std::underlying_type_t<E>;
  static Type to(E value) { return static_cast<Type>(value); }
  static E from(Type value) { return static_cast<E>(value); }
};
template <typename T>
requires std::is_arithmetic_v<T>
struct Wire<T> {
  using Type = T;
  static Type to(T value) { return value; }
  static T from(Type value) { return value; }
};

template <typename T>
concept Scalar = requires {
  typename Wire<T>::Type;
};
template <typename T>
concept Described = requires {
  Description<T>::kName;
};

template <typename W>
constexpr const char* primitive_name() {
  if constexpr (std::is_same_v<W, bool>)
    return "bool";
  else if constexpr (std::is_same_v<W, std::uint8_t>)
    return "uint8";
  else if constexpr (std::is_same_v<W, std::int32_t>)
    return "int32";
  else if constexpr (std::is_same_v<W, std::uint32_t>)
    return "uint32";
  else if constexpr (std::is_same_v<W, std::int64_t>)
    return "int64";
  else if constexpr (std::is_same_v<W, std::uint64_t>)
    return "uint64";
  else {
    static_assert(std::is_same_v<W, double>);
    return "float64";
  }
}

/// The schema of T: its definition, then those of the messages within it.
template <Described T>
[[nodiscard]] std::string schema_text();
/// "package/msg/Name", as MCAP names a ROS 2 schema.
template <Described T>
[[nodiscard]] std::string schema_name() {
  const std::string name{Description<T>::kName};
  const std::size_t slash = name.find('/');
  return name.substr(0, slash) + "/msg" + name.substr(slash);
}

class SchemaWriter {
 public:
  template <Described T>
  void define() {
    const T value{};
    Description<T>::fields(*this, value);
  }

  template <Scalar T>
  void operator()(std::string_view name, const T& /*value*/) {
    using W = typename Wire<T>::Type;
    if constexpr (std::is_enum_v<T>) {
      for (const auto& [constant, code] : EnumNames<T>::list())
        text_ +=
            std::string(primitive_name<W>()) + " " + constant + "=" + std::to_string(code) + "\n";
    }
    line(primitive_name<W>(), name);
  }
  void operator()(std::string_view name, const std::string& /*value*/) { line("string", name); }
  template <int Rows, int Cols>
  void operator()(std::string_view name, const Eigen::Matrix<double, Rows, Cols>& /*value*/) {
    line("float64[" + std::to_string(Rows * Cols) + "]", name);
  }
  void operator()(std::string_view name, const Eigen::Isometry3d& /*value*/) {
    line("float64[16]", name);
  }
  template <Described T>
  void operator()(std::string_view name, const T& /*value*/) {
    line(std::string(Description<T>::kName), name);
    need<T>();
  }
  template <Described T>
  void operator()(std::string_view name, const std::optional<T>& /*value*/) {
    line(std::string(Description<T>::kName) + "[<=1]", name);
    need<T>();
  }
  template <Described T, std::size_t N>
  void list(std::string_view name, const std::array<T, N>& /*value*/, std::size_t /*count*/) {
    line(std::string(Description<T>::kName) + "[<=" + std::to_string(N) + "]", name);
    need<T>();
  }

  [[nodiscard]] std::string text() const {
    std::string all = text_;
    for (const auto& [name, definition] : nested_)
      all += std::string(80, '=') + "\nMSG: " + name + "\n" + definition;
    return all;
  }

 private:
  void line(const std::string& type, std::string_view name) {
    text_ += type + " " + std::string(name) + "\n";
  }
  template <Described T>
  void need() {
    const std::string name{Description<T>::kName};
    for (const auto& known : nested_)
      if (known.first == name) return;
    SchemaWriter writer;
    writer.define<T>();
    nested_.emplace_back(name, writer.text_);
    for (auto& inner : writer.nested_) {
      bool is_known = false;
      for (const auto& known : nested_) is_known |= known.first == inner.first;
      if (!is_known) nested_.push_back(std::move(inner));
    }
  }
  std::string text_;
  std::vector<std::pair<std::string, std::string>> nested_;  // name, definition
};

template <Described T>
std::string schema_text() {
  SchemaWriter writer;
  writer.define<T>();
  return writer.text();
}

/// Where a field lies in the bytes, for messages about a difference.
struct FieldPlace {
  std::string name;  ///< "decision.approved.covariance[3]"
  std::size_t offset = 0, size = 0;
  const char* type = "";
};

class CdrWriter {
 public:
  /// Replaces the content of `out`, keeping its memory. Notes every field's place where asked.
  explicit CdrWriter(std::string& out, std::vector<FieldPlace>* places = nullptr)
      : out_(out), places_(places) {
    out_.assign("\0\1\0\0", kHeadBytes);  // CDR, little-endian
  }
  static constexpr std::size_t kHeadBytes = 4;

  template <Scalar T>
  void operator()(std::string_view name, const T& value) {
    put(name, Wire<T>::to(value));
  }
  void operator()(std::string_view name, const std::string& value) {
    put(name, static_cast<std::uint32_t>(value.size() + 1));
    out_.append(value.c_str(), value.size() + 1);
  }
  template <int Rows, int Cols>
  void operator()(std::string_view name, const Eigen::Matrix<double, Rows, Cols>& value) {
    for (int row = 0; row < Rows; ++row)
      for (int col = 0; col < Cols; ++col) put(name, value(row, col), row * Cols + col);
  }
  void operator()(std::string_view name, const Eigen::Isometry3d& value) {
    (*this)(name, value.matrix());
  }
  template <Described T>
  void operator()(std::string_view name, const T& value) {
    const std::size_t outer = path_.size();
    if (places_ != nullptr) path_.append(name).append(".");
    Description<T>::fields(*this, value);
    path_.resize(outer);
  }
  template <Described T>
  void operator()(std::string_view name, const std::optional<T>& value) {
    put(name, static_cast<std::uint32_t>(value ? 1 : 0));
    if (value) (*this)(name, *value);
  }
  template <Described T, std::size_t N>
  void list(std::string_view name, const std::array<T, N>& value, std::size_t count) {
    put(name, static_cast<std::uint32_t>(count < N ? count : N));
    for (std::size_t i = 0; i < N && i < count; ++i) (*this)(name, value[i]);
  }

 private:
  template <typename W>
  void put(std::string_view name, W value, int index = -1) {
    constexpr std::size_t kSize = sizeof(W);
    const std::size_t offset = kHeadBytes + (out_.size() - kHeadBytes + kSize - 1) / kSize * kSize;
    out_.resize(offset + kSize);
    std::memcpy(out_.data() + offset, &value, kSize);
    if (places_ == nullptr) return;
    std::string full = path_ + std::string(name);
    if (index >= 0) full += "[" + std::to_string(index) + "]";
    places_->push_back({std::move(full), offset, kSize, primitive_name<W>()});
  }

  std::string& out_;
  std::vector<FieldPlace>* places_;
  std::string path_;
};

class CdrReader {
 public:
  explicit CdrReader(std::string_view bytes) : bytes_(bytes) {
    is_valid_ =
        bytes.size() >= CdrWriter::kHeadBytes && bytes.substr(0, 2) == std::string_view("\0\1", 2);
  }
  /// All bytes were taken, and none was missing or impossible.
  [[nodiscard]] bool is_complete() const { return is_valid_ && offset_ == bytes_.size(); }

  template <Scalar T>
  void operator()(std::string_view /*name*/, T& value) {
    using W = typename Wire<T>::Type;
    if constexpr (std::is_same_v<W, bool>) {
      const auto byte = get<std::uint8_t>();
      is_valid_ = is_valid_ && byte <= 1;
      value = Wire<T>::from(byte == 1);
    } else {
      value = Wire<T>::from(get<W>());
    }
    // No sum of a few instants and durations overflows.
    if constexpr (std::is_same_v<T, std::chrono::nanoseconds>)
      is_valid_ = is_valid_ && value <= kDurationMax && value >= -kDurationMax;
  }
  void operator()(std::string_view /*name*/, std::string& value) {
    const auto size = get<std::uint32_t>();
    if (!is_valid_ || size == 0 || size > bytes_.size() - offset_) {
      is_valid_ = false;
      return;
    }
    value = bytes_.substr(offset_, size - 1);
    offset_ += size;
  }
  template <int Rows, int Cols>
  void operator()(std::string_view /*name*/, Eigen::Matrix<double, Rows, Cols>& value) {
    for (int row = 0; row < Rows; ++row)
      for (int col = 0; col < Cols; ++col) value(row, col) = get<double>();
  }
  void operator()(std::string_view name, Eigen::Isometry3d& value) {
    (*this)(name, value.matrix());
  }
  template <Described T>
  void operator()(std::string_view /*name*/, T& value) {
    Description<T>::fields(*this, value);
  }
  template <Described T>
  void operator()(std::string_view name, std::optional<T>& value) {
    const auto count = get<std::uint32_t>();
    is_valid_ = is_valid_ && count <= 1;
    value.reset();
    if (is_valid_ && count == 1) (*this)(name, value.emplace());
  }
  template <Described T, std::size_t N>
  void list(std::string_view name, std::array<T, N>& value, std::size_t& count) {
    count = get<std::uint32_t>();
    is_valid_ = is_valid_ && count <= N;
    if (!is_valid_) count = 0;
    for (std::size_t i = 0; i < count; ++i) (*this)(name, value[i]);
  }

 private:
  static constexpr std::chrono::nanoseconds kDurationMax{std::int64_t{1} << 60U};  // 36 years
  template <typename W>
  [[nodiscard]] W get() {
    constexpr std::size_t kHead = CdrWriter::kHeadBytes;
    constexpr std::size_t kSize = sizeof(W);
    W value{};
    const std::size_t offset = kHead + (offset_ - kHead + kSize - 1) / kSize * kSize;
    is_valid_ = is_valid_ && offset + kSize <= bytes_.size();
    if (!is_valid_) return value;
    std::memcpy(&value, bytes_.data() + offset, kSize);
    offset_ = offset + kSize;
    return value;
  }

  std::string_view bytes_;
  std::size_t offset_ = CdrWriter::kHeadBytes;
  bool is_valid_ = true;
};

/// Reads all of `value`; false when the bytes are too short, too long or impossible.
template <Described T>
[[nodiscard]] bool from_cdr(std::string_view bytes, T& value) {
  CdrReader reader(bytes);
  Description<T>::fields(reader, value);
  return reader.is_complete();
}
template <Described T>
void to_cdr(const T& value, std::string& out, std::vector<FieldPlace>* places = nullptr) {
  CdrWriter writer(out, places);
  Description<T>::fields(writer, value);
}

}  // namespace holdfast::bridge::ros2
