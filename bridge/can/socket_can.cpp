// SPDX-License-Identifier: Apache-2.0
#include "bridge/can/socket_can.hpp"

#include <algorithm>
#include <cerrno>
#include <cstring>
#include <utility>

#include <fcntl.h>
#include <linux/can.h>
#include <linux/can/error.h>
#include <linux/can/netlink.h>
#include <linux/can/raw.h>
#include <linux/if_link.h>
#include <linux/rtnetlink.h>
#include <net/if.h>
#include <sys/ioctl.h>
#include <sys/socket.h>
#include <unistd.h>

#include "rt/core/error.hpp"

namespace holdfast::bridge::can {
namespace {

constexpr int kReceiveBytes = 1 << 20;  // the default holds fewer than 300 frames

class Descriptor {
 public:
  explicit Descriptor(int fd) noexcept : fd_(fd) {}
  ~Descriptor() {
    if (fd_ >= 0) close(fd_);
  }
  Descriptor(const Descriptor&) = delete;
  Descriptor& operator=(const Descriptor&) = delete;
  [[nodiscard]] int get() const noexcept { return fd_; }
  [[nodiscard]] int release() noexcept { return std::exchange(fd_, -1); }

 private:
  int fd_;
};

[[noreturn]] void refuse(const std::string& interface, const char* what) {
  throw UnavailableError("can: " + interface + ": cannot " + what + ": " + std::strerror(errno) +
                         "; bring it up with: ip link set " + interface +
                         " up type can bitrate 1000000 (a virtual one: ip link add " + interface +
                         " type vcan)");
}

template <class T>
bool set(int socket, int level, int option, const T& value) noexcept {
  return setsockopt(socket, level, option, &value, sizeof(value)) == 0;
}

/// One netlink request: RTM_NEWLINK { LINKINFO { KIND "can", DATA { CAN_RESTART 1 } } }.
class RestartRequest {
 public:
  explicit RestartRequest(unsigned index) noexcept {
    header_.n.nlmsg_len = NLMSG_LENGTH(sizeof(ifinfomsg));
    header_.n.nlmsg_type = RTM_NEWLINK;
    header_.n.nlmsg_flags = NLM_F_REQUEST | NLM_F_ACK;
    header_.i.ifi_family = AF_UNSPEC;
    header_.i.ifi_index = static_cast<int>(index);
    rtattr* info = begin(IFLA_LINKINFO);
    constexpr char kKind[] = "can";
    add(IFLA_INFO_KIND, kKind, sizeof(kKind));
    rtattr* data = begin(IFLA_INFO_DATA);
    const std::uint32_t one = 1;
    add(IFLA_CAN_RESTART, &one, sizeof(one));
    end(data);
    end(info);
  }
  [[nodiscard]] const void* data() const noexcept { return &header_; }
  [[nodiscard]] std::size_t size() const noexcept { return header_.n.nlmsg_len; }

 private:
  rtattr* begin(unsigned short type) noexcept { return add(type, nullptr, 0); }
  void end(rtattr* attribute) noexcept {
    const char* tail = reinterpret_cast<const char*>(&header_) + NLMSG_ALIGN(header_.n.nlmsg_len);
    attribute->rta_len =
        static_cast<unsigned short>(tail - reinterpret_cast<const char*>(attribute));
  }
  rtattr* add(unsigned short type, const void* value, std::size_t bytes) noexcept {
    auto* attribute = reinterpret_cast<rtattr*>(reinterpret_cast<char*>(&header_) +
                                                NLMSG_ALIGN(header_.n.nlmsg_len));
    attribute->rta_type = type;
    attribute->rta_len = static_cast<unsigned short>(RTA_LENGTH(bytes));
    if (bytes > 0) std::memcpy(RTA_DATA(attribute), value, bytes);
    header_.n.nlmsg_len = static_cast<std::uint32_t>(NLMSG_ALIGN(header_.n.nlmsg_len) +
                                                     RTA_ALIGN(attribute->rta_len));
    return attribute;
  }
  struct {
    nlmsghdr n;
    ifinfomsg i;
    char attributes[128];
  } header_{};
};

}  // namespace

SocketCan::SocketCan(const std::string& interface) {
  Descriptor socket(::socket(PF_CAN, SOCK_RAW | SOCK_NONBLOCK | SOCK_CLOEXEC, CAN_RAW));
  if (socket.get() < 0) refuse(interface, "open a CAN socket");
  index_ = if_nametoindex(interface.c_str());
  if (index_ == 0) refuse(interface, "find the interface");
  // All but lost arbitration, which is no fault.
  const can_err_mask_t errors = CAN_ERR_MASK & ~CAN_ERR_LOSTARB;
  if (!set(socket.get(), SOL_CAN_RAW, CAN_RAW_FD_FRAMES, 1) ||
      !set(socket.get(), SOL_CAN_RAW, CAN_RAW_ERR_FILTER, errors) ||
      !set(socket.get(), SOL_SOCKET, SO_RXQ_OVFL, 1))
    refuse(interface, "set the socket's options");
  if (!set(socket.get(), SOL_SOCKET, SO_RCVBUFFORCE, kReceiveBytes))
    (void)set(socket.get(), SOL_SOCKET, SO_RCVBUF, kReceiveBytes);  // as much as we may
  sockaddr_can address{};
  address.can_family = AF_CAN;
  address.can_ifindex = static_cast<int>(index_);
  if (bind(socket.get(), reinterpret_cast<const sockaddr*>(&address), sizeof(address)) != 0)
    refuse(interface, "bind");
  socket_ = socket.release();
}

SocketCan::~SocketCan() {
  close(socket_);
}

SendResult SocketCan::send(const Frame& frame) noexcept {
  canfd_frame raw{};
  raw.can_id = frame.id & CAN_SFF_MASK;
  raw.len = std::min<std::uint8_t>(frame.size, frame.is_fd ? CANFD_MAX_DLEN : CAN_MAX_DLEN);
  raw.flags = frame.is_fd ? CANFD_BRS : 0;
  std::copy_n(frame.data.begin(), raw.len, raw.data);
  const std::size_t bytes = frame.is_fd ? CANFD_MTU : CAN_MTU;
  if (write(socket_, &raw, bytes) == static_cast<ssize_t>(bytes)) return SendResult::sent;
  return errno == ENOBUFS || errno == EAGAIN ? SendResult::queue_full : SendResult::down;
}

bool SocketCan::receive(Frame& frame) noexcept {
  canfd_frame raw{};
  iovec part{&raw, sizeof(raw)};
  alignas(cmsghdr) char control[CMSG_SPACE(sizeof(std::uint32_t))];
  msghdr message{};
  message.msg_iov = &part;
  message.msg_iovlen = 1;
  message.msg_control = control;
  message.msg_controllen = sizeof(control);
  const ssize_t bytes = recvmsg(socket_, &message, 0);
  for (cmsghdr* c = CMSG_FIRSTHDR(&message); bytes > 0 && c != nullptr;
       c = CMSG_NXTHDR(&message, c)) {
    if (c->cmsg_level != SOL_SOCKET || c->cmsg_type != SO_RXQ_OVFL) continue;
    std::uint32_t total = 0;  // since the socket was made
    std::memcpy(&total, CMSG_DATA(c), sizeof(total));
    dropped_ = total;
  }
  if (bytes != CAN_MTU && bytes != CANFD_MTU) return false;
  frame.is_fd = bytes == CANFD_MTU;
  frame.is_error = (raw.can_id & CAN_ERR_FLAG) != 0;
  // An extended identifier keeps its flag and so is none of ours.
  frame.id = frame.is_error ? raw.can_id & CAN_ERR_MASK : raw.can_id;
  frame.size = std::min<std::uint8_t>(raw.len, frame.is_fd ? CANFD_MAX_DLEN : CAN_MAX_DLEN);
  frame.data = {};
  std::copy_n(raw.data, frame.size, frame.data.begin());
  return true;
}

bool SocketCan::is_up() noexcept {
  ifreq request{};
  if (if_indextoname(index_, request.ifr_name) == nullptr) return false;
  return ioctl(socket_, SIOCGIFFLAGS, &request) == 0 && (request.ifr_flags & IFF_UP) != 0;
}

bool SocketCan::restart() noexcept {
  const Descriptor netlink(socket(AF_NETLINK, SOCK_RAW | SOCK_CLOEXEC, NETLINK_ROUTE));
  const RestartRequest request(index_);
  if (netlink.get() < 0 || ::send(netlink.get(), request.data(), request.size(), 0) !=
                               static_cast<ssize_t>(request.size()))
    return false;
  struct {
    nlmsghdr header;
    nlmsgerr error;
    char rest[256];
  } answer{};
  const ssize_t bytes = recv(netlink.get(), &answer, sizeof(answer), 0);
  return bytes >= static_cast<ssize_t>(NLMSG_LENGTH(sizeof(nlmsgerr))) &&
         answer.header.nlmsg_type == NLMSG_ERROR && answer.error.error == 0;
}

}  // namespace holdfast::bridge::can
