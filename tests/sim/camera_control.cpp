// SPDX-License-Identifier: Apache-2.0
#include "tests/sim/camera_control.hpp"

#include <cerrno>
#include <charconv>
#include <cmath>
#include <cstring>
#include <ctime>

#include <fmt/core.h>
#include <poll.h>
#include <sys/socket.h>
#include <sys/un.h>
#include <unistd.h>

#include "rt/core/error.hpp"

namespace holdfast::sim {
namespace {

using std::chrono::nanoseconds;

nanoseconds monotonic_now() {
  timespec t{};
  clock_gettime(CLOCK_MONOTONIC, &t);
  return std::chrono::seconds(t.tv_sec) + nanoseconds(t.tv_nsec);
}

std::string_view trimmed(std::string_view text) {
  const std::size_t begin = text.find_first_not_of(" \t\r\n");
  if (begin == std::string_view::npos) return {};
  return text.substr(begin, text.find_last_not_of(" \t\r\n") - begin + 1);
}

int whole_number(std::string_view text, int lowest, int highest, std::string_view line) {
  int value = 0;
  const auto [end, error] = std::from_chars(text.data(), text.data() + text.size(), value);
  if (error != std::errc{} || end != text.data() + text.size() || value < lowest || value > highest)
    throw InputError(
        fmt::format("\"{}\": expected a whole number in {}..{}", line, lowest, highest));
  return value;
}

bool is_on(std::string_view text, std::string_view line) {
  if (text == "on") return true;
  if (text == "off") return false;
  throw InputError(fmt::format("\"{}\": expected on or off", line));
}

}  // namespace

CameraControl::CameraControl(VirtualCamera& camera, MovingSite* site, OnEvent on_event)
    : camera_(camera), site_(site), on_event_(std::move(on_event)) {}

nanoseconds CameraControl::run(std::string_view line) {
  line = trimmed(line);
  const std::size_t space = line.find(' ');
  const std::string_view command = line.substr(0, space);
  const std::string_view value =
      space == std::string_view::npos ? std::string_view() : trimmed(line.substr(space));
  nanoseconds t{};
  if (command == "freeze")
    t = camera_.freeze(is_on(value, line));
  else if (command == "black")
    t = camera_.black(is_on(value, line));
  else if (command == "occlude")
    t = camera_.occlude(is_on(value, line));
  else if (command == "drop" && (value == "on" || value == "off"))
    t = camera_.drop(value == "on");
  else if (command == "drop")
    t = camera_.drop_next(whole_number(value, 1, 100'000, line));
  else if (command == "corrupt")
    t = camera_.corrupt_next(whole_number(value, 1, 100'000, line));
  else if (command == "delay")
    t = camera_.delay(std::chrono::milliseconds(whole_number(value, 0, 10'000, line)));
  else if (command == "disconnect")
    t = camera_.disconnect();
  else if (command == "reconnect")
    t = camera_.reconnect();
  else if (command == "status")
    return monotonic_now();
  else if (command == "motion" && site_ != nullptr) {
    site_->set_program(value, monotonic_now());
    t = camera_.source_changed();
  } else if (command == "motion")
    throw InputError("\"motion\": the images come from files");
  else
    throw InputError(fmt::format(
        "\"{}\" is not one of freeze, black, occlude, drop, corrupt, delay, disconnect, reconnect, "
        "motion, status",
        command));
  on_event_(t, std::string(command), std::string(value));
  return t;
}

std::vector<ScriptedCommand> parse_fault_script(std::string_view script) {
  std::vector<ScriptedCommand> commands;
  for (std::size_t begin = 0; begin < script.size();) {
    const std::size_t end = std::min(script.find(';', begin), script.size());
    const std::string_view item = trimmed(script.substr(begin, end - begin));
    begin = end + 1;
    if (item.empty()) continue;
    const std::size_t colon = item.find(':');
    double seconds = 0;
    const std::string_view time = trimmed(item.substr(0, colon));
    const auto [stop, error] = std::from_chars(time.data(), time.data() + time.size(), seconds);
    if (colon == std::string_view::npos || error != std::errc{} ||
        stop != time.data() + time.size() || !(seconds >= 0 && seconds < 1e6))
      throw InputError(fmt::format("fault script: \"{}\": expected SECONDS:COMMAND", item));
    const nanoseconds t(std::llround(seconds * 1e9));
    if (!commands.empty() && t < commands.back().t)
      throw InputError(fmt::format("fault script: \"{}\": earlier than the one before", item));
    commands.push_back({t, std::string(trimmed(item.substr(colon + 1)))});
  }
  return commands;
}

namespace {

sockaddr_un unix_address(const std::string& path) {
  sockaddr_un address{};
  address.sun_family = AF_UNIX;
  if (path.size() >= sizeof address.sun_path)
    throw InputError(fmt::format("control socket {}: longer than {} characters", path,
                                 sizeof address.sun_path - 1));
  path.copy(address.sun_path, path.size());
  return address;
}

const sockaddr* generic(const sockaddr_un& address) {
  return reinterpret_cast<const sockaddr*>(&address);  // NOLINT: what the socket interface asks for
}

bool is_answered(const sockaddr_un& address) {
  const int probe = socket(AF_UNIX, SOCK_STREAM | SOCK_CLOEXEC, 0);
  const bool is_live = probe >= 0 && connect(probe, generic(address), sizeof address) == 0;
  if (probe >= 0) close(probe);
  return is_live;
}

}  // namespace

ControlSocket::ControlSocket(std::string path, Answer answer)
    : path_(std::move(path)), answer_(std::move(answer)) {
  const sockaddr_un address = unix_address(path_);
  if (is_answered(address)) throw UnavailableError(fmt::format("control socket {}: in use", path_));
  unlink(path_.c_str());
  listener_ = socket(AF_UNIX, SOCK_STREAM | SOCK_CLOEXEC | SOCK_NONBLOCK, 0);
  if (listener_ < 0 || bind(listener_, generic(address), sizeof address) != 0 ||
      listen(listener_, 4) != 0) {
    const std::string reason = std::strerror(errno);
    if (listener_ >= 0) close(listener_);
    throw UnavailableError(fmt::format("control socket {}: {}", path_, reason));
  }
}

ControlSocket::~ControlSocket() {
  for (const Client& client : clients_) close(client.descriptor);
  close(listener_);
  unlink(path_.c_str());
}

void ControlSocket::serve(std::chrono::milliseconds timeout) {
  std::vector<pollfd> waiting{{listener_, POLLIN, 0}};
  for (const Client& client : clients_) waiting.push_back({client.descriptor, POLLIN, 0});
  if (poll(waiting.data(), waiting.size(), static_cast<int>(timeout.count())) <= 0) return;
  std::vector<Client> staying;
  for (std::size_t i = 0; i < clients_.size(); ++i) {
    if (waiting[i + 1].revents == 0 || read_from(clients_[i]))
      staying.push_back(std::move(clients_[i]));
    else
      close(clients_[i].descriptor);
  }
  clients_ = std::move(staying);
  if (waiting[0].revents != 0) accept_client();
}

void ControlSocket::accept_client() {
  const int descriptor = accept4(listener_, nullptr, nullptr, SOCK_CLOEXEC);
  if (descriptor >= 0) clients_.push_back({descriptor, {}});
}

// False when the client has gone.
bool ControlSocket::read_from(Client& client) {
  char bytes[512];
  const ssize_t n = recv(client.descriptor, bytes, sizeof bytes, 0);
  if (n <= 0 || client.received.size() > 65536) return false;
  client.received.append(bytes, static_cast<std::size_t>(n));
  for (std::size_t end = client.received.find('\n'); end != std::string::npos;
       end = client.received.find('\n')) {
    const std::string line = client.received.substr(0, end);
    client.received.erase(0, end + 1);
    std::string reply;
    try {
      reply = fmt::format("ok {}\n", answer_(line).count());
    } catch (const Error& e) {
      reply = fmt::format("error {}\n", e.what());
    }
    if (send(client.descriptor, reply.data(), reply.size(), MSG_NOSIGNAL) < 0) return false;
  }
  return true;
}

}  // namespace holdfast::sim
