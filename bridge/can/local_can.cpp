// SPDX-License-Identifier: Apache-2.0
#include "bridge/can/local_can.hpp"

#include <cerrno>
#include <cstring>
#include <type_traits>
#include <utility>

#include <sys/socket.h>
#include <sys/un.h>
#include <unistd.h>

#include "rt/core/error.hpp"

namespace holdfast::bridge::can {
namespace {

constexpr int kType = SOCK_SEQPACKET | SOCK_NONBLOCK | SOCK_CLOEXEC;
static_assert(std::is_trivially_copyable_v<Frame>);  // both ends are the same program's source

[[noreturn]] void refuse(const std::string& path) {
  throw UnavailableError("can: " + path + ": " + std::strerror(errno));
}

sockaddr_un address_of(const std::string& path) {
  sockaddr_un address{};
  address.sun_family = AF_UNIX;
  if (path.empty() || path.size() >= sizeof(address.sun_path))
    throw InputError("can: path '" + path + "' must have 1 to " +
                     std::to_string(sizeof(address.sun_path) - 1) + " characters");
  std::memcpy(address.sun_path, path.c_str(), path.size() + 1);
  return address;
}

}  // namespace

LocalCan::LocalCan(Role role, int socket, std::string path) : role_(role), path_(std::move(path)) {
  (role == Role::listener ? listener_ : peer_) = socket;
}

LocalCan::~LocalCan() {
  drop_peer();
  if (listener_ >= 0) {
    close(listener_);
    unlink(path_.c_str());
  }
}

std::pair<std::unique_ptr<LocalCan>, std::unique_ptr<LocalCan>> LocalCan::make_pair() {
  int ends[2];
  if (socketpair(AF_UNIX, kType, 0, ends) != 0) refuse("socket pair");
  return {std::unique_ptr<LocalCan>(new LocalCan(Role::pair, ends[0], {})),
          std::unique_ptr<LocalCan>(new LocalCan(Role::pair, ends[1], {}))};
}

std::unique_ptr<LocalCan> LocalCan::listen(const std::string& path) {
  const sockaddr_un address = address_of(path);
  const int fd = socket(AF_UNIX, kType, 0);
  if (fd < 0) refuse(path);
  std::unique_ptr<LocalCan> node(new LocalCan(Role::listener, fd, path));
  unlink(path.c_str());  // a predecessor's that died
  if (bind(fd, reinterpret_cast<const sockaddr*>(&address), sizeof(address)) != 0 ||
      ::listen(fd, 1) != 0)
    refuse(path);
  return node;
}

std::unique_ptr<LocalCan> LocalCan::connect(const std::string& path) {
  (void)address_of(path);
  std::unique_ptr<LocalCan> end(new LocalCan(Role::caller, -1, path));
  end->seek_peer();
  return end;
}

void LocalCan::seek_peer() noexcept {
  if (peer_ >= 0) return;
  if (role_ == Role::listener)
    peer_ = accept4(listener_, nullptr, nullptr, SOCK_NONBLOCK | SOCK_CLOEXEC);
  if (role_ != Role::caller) return;
  sockaddr_un address{};
  address.sun_family = AF_UNIX;
  std::memcpy(address.sun_path, path_.c_str(), path_.size() + 1);
  const int fd = socket(AF_UNIX, kType, 0);
  if (fd >= 0 && ::connect(fd, reinterpret_cast<const sockaddr*>(&address), sizeof(address)) == 0)
    peer_ = fd;
  else if (fd >= 0)
    close(fd);
}

void LocalCan::drop_peer() noexcept {
  if (peer_ >= 0) close(std::exchange(peer_, -1));
}

SendResult LocalCan::send(const Frame& frame) noexcept {
  seek_peer();
  // Alone on the bus: nobody takes the frame, and it stays in the queue.
  if (peer_ < 0) return SendResult::queue_full;
  if (::send(peer_, &frame, sizeof(frame), MSG_NOSIGNAL) == static_cast<ssize_t>(sizeof(frame)))
    return SendResult::sent;
  if (errno != EAGAIN) drop_peer();
  return SendResult::queue_full;
}

bool LocalCan::receive(Frame& frame) noexcept {
  seek_peer();
  if (peer_ < 0) return false;
  Frame received;
  const ssize_t bytes = recv(peer_, &received, sizeof(received), 0);
  if (bytes == 0 || (bytes < 0 && errno != EAGAIN)) drop_peer();
  if (bytes != static_cast<ssize_t>(sizeof(received)) || received.size > received.data.size())
    return false;
  frame = received;
  return true;
}

}  // namespace holdfast::bridge::can
