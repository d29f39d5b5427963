// SPDX-License-Identifier: Apache-2.0
#include "tests/bridge/packet_capture.hpp"

#include <algorithm>
#include <array>
#include <cerrno>
#include <cstring>

#include <arpa/inet.h>
#include <fmt/format.h>
#include <linux/if_packet.h>
#include <net/ethernet.h>
#include <net/if.h>
#include <netinet/ip.h>
#include <netinet/udp.h>
#include <sys/socket.h>
#include <unistd.h>

#include "rt/core/error.hpp"

namespace holdfast::bridge::test {
namespace {

constexpr int kBufferBytes = 64 << 20;

[[noreturn]] void fail(const char* what) {
  throw UnavailableError(fmt::format("packet capture: {}: {}", what, std::strerror(errno)));
}

}  // namespace

PacketCapture::PacketCapture() {
  listening_ = socket(AF_PACKET, SOCK_DGRAM | SOCK_NONBLOCK | SOCK_CLOEXEC, htons(ETH_P_IP));
  if (listening_ < 0) fail("AF_PACKET");
  if (setsockopt(listening_, SOL_SOCKET, SO_RCVBUFFORCE, &kBufferBytes, sizeof kBufferBytes) != 0 &&
      setsockopt(listening_, SOL_SOCKET, SO_RCVBUF, &kBufferBytes, sizeof kBufferBytes) != 0)
    fail("SO_RCVBUF");
  sockaddr_ll address{};
  address.sll_family = AF_PACKET;
  address.sll_protocol = htons(ETH_P_IP);
  address.sll_ifindex = static_cast<int>(if_nametoindex("lo"));
  if (bind(listening_, reinterpret_cast<const sockaddr*>(&address), sizeof address) != 0)
    fail("lo");
  sending_ = socket(AF_INET, SOCK_RAW | SOCK_CLOEXEC, IPPROTO_RAW);  // with headers of our own
  if (sending_ < 0) fail("raw socket");
}

PacketCapture::~PacketCapture() {
  close(listening_);
  close(sending_);
}

std::vector<Datagram> PacketCapture::take() {
  std::vector<Datagram> heard;
  std::array<std::uint8_t, 65536> bytes{};
  for (;;) {
    sockaddr_ll from{};
    socklen_t length = sizeof from;
    const ssize_t size = recvfrom(listening_, bytes.data(), bytes.size(), 0,
                                  reinterpret_cast<sockaddr*>(&from), &length);
    if (size < 0) break;
    if (from.sll_pkttype == PACKET_OUTGOING) continue;  // loopback shows each twice
    iphdr ip{};
    udphdr udp{};
    if (static_cast<std::size_t>(size) < sizeof ip) continue;
    std::memcpy(&ip, bytes.data(), sizeof ip);
    const std::size_t at = 4U * ip.ihl;
    if (ip.protocol != IPPROTO_UDP || static_cast<std::size_t>(size) < at + sizeof udp) continue;
    if ((ntohs(ip.frag_off) & (IP_MF | IP_OFFMASK)) != 0)
      throw UnavailableError("packet capture: a fragment; loopback should not make any");
    std::memcpy(&udp, bytes.data() + at, sizeof udp);
    heard.push_back(
        {ntohs(udp.source),
         ntohs(udp.dest),
         {bytes.begin() + static_cast<std::ptrdiff_t>(at + sizeof udp), bytes.begin() + size}});
  }
  tpacket_stats lost{};
  socklen_t length = sizeof lost;
  if (getsockopt(listening_, SOL_PACKET, PACKET_STATISTICS, &lost, &length) != 0)
    fail("PACKET_STATISTICS");
  if (lost.tp_drops > 0)
    throw UnavailableError(fmt::format("packet capture: {} packets were lost", lost.tp_drops));
  return heard;
}

void PacketCapture::send_again(const Datagram& datagram) {
  iphdr ip{};
  udphdr udp{};
  const std::size_t size = sizeof ip + sizeof udp + datagram.payload.size();
  ip.version = 4;
  ip.ihl = 5;
  ip.ttl = 64;
  ip.protocol = IPPROTO_UDP;
  ip.tot_len = htons(static_cast<std::uint16_t>(size));
  ip.saddr = ip.daddr = htonl(INADDR_LOOPBACK);
  udp.source = htons(datagram.source_port);
  udp.dest = htons(datagram.destination_port);
  udp.len = htons(static_cast<std::uint16_t>(size - sizeof ip));  // no checksum: allowed in IPv4
  std::vector<std::uint8_t> bytes;
  bytes.reserve(size);
  const auto append = [&bytes](const void* begin, std::size_t length) {
    const auto* first = static_cast<const std::uint8_t*>(begin);
    bytes.insert(bytes.end(), first, first + length);
  };
  append(&ip, sizeof ip);
  append(&udp, sizeof udp);
  append(datagram.payload.data(), datagram.payload.size());
  sockaddr_in to{};
  to.sin_family = AF_INET;
  to.sin_addr.s_addr = htonl(INADDR_LOOPBACK);
  if (sendto(sending_, bytes.data(), bytes.size(), 0, reinterpret_cast<const sockaddr*>(&to),
             sizeof to) < 0)
    fail("send again");
}

bool contains(std::span<const std::uint8_t> bytes, std::span<const std::uint8_t> part) {
  return std::search(bytes.begin(), bytes.end(), part.begin(), part.end()) != bytes.end();
}

}  // namespace holdfast::bridge::test
