// SPDX-License-Identifier: Apache-2.0
// What another DDS implementation (eProsima Fast DDS, which most ROS 2 installations run on) hears
// of topics, or says on them, with the names, types and QoS that ROS 2's own subscriptions have:
//   holdfast-fastdds-peer DOMAIN (TOPIC TYPE reliable|best_effort transient|volatile)...
// prints "TOPIC HEX" for each sample, HEX being its serialised payload with the encapsulation
// header, until a signal ends it. On loopback only, without multicast. Nothing of ours is linked.
#include <algorithm>
#include <csignal>
#include <cstdio>
#include <cstdlib>
#include <cstring>
#include <memory>
#include <string>
#include <vector>

#include <fastdds/dds/domain/DomainParticipant.hpp>
#include <fastdds/dds/domain/DomainParticipantFactory.hpp>
#include <fastdds/dds/publisher/DataWriter.hpp>
#include <fastdds/dds/publisher/Publisher.hpp>
#include <fastdds/dds/subscriber/DataReader.hpp>
#include <fastdds/dds/subscriber/SampleInfo.hpp>
#include <fastdds/dds/subscriber/Subscriber.hpp>
#include <fastdds/dds/topic/TopicDataType.hpp>
#include <fastdds/dds/topic/TypeSupport.hpp>
#include <fastdds/rtps/transport/UDPv4TransportDescriptor.h>
#include <fastrtps/utils/IPLocator.h>

namespace {

namespace fdds = eprosima::fastdds::dds;
namespace rtps = eprosima::fastrtps::rtps;
using Bytes = std::vector<unsigned char>;

/// A type known by its name alone: its samples stay the bytes that they came as.
class RawType : public fdds::TopicDataType {
 public:
  explicit RawType(const std::string& name) {
    setName(name.c_str());
    m_typeSize = 64 * 1024;
    m_isGetKeyDefined = false;
    auto_fill_type_object(false);
    auto_fill_type_information(false);
  }
  bool serialize(void* data, rtps::SerializedPayload_t* payload) override {
    const Bytes& bytes = *static_cast<Bytes*>(data);
    if (bytes.size() > payload->max_size) return false;
    std::copy(bytes.begin(), bytes.end(), payload->data);
    payload->length = static_cast<uint32_t>(bytes.size());
    payload->encapsulation = CDR_LE;
    return true;
  }
  bool deserialize(rtps::SerializedPayload_t* payload, void* data) override {
    static_cast<Bytes*>(data)->assign(payload->data, payload->data + payload->length);
    return true;
  }
  std::function<uint32_t()> getSerializedSizeProvider(void* data) override {
    return [data] { return static_cast<uint32_t>(static_cast<Bytes*>(data)->size()); };
  }
  void* createData() override { return new Bytes; }
  void deleteData(void* data) override { delete static_cast<Bytes*>(data); }
  bool getKey(void*, rtps::InstanceHandle_t*, bool) override { return false; }
};

fdds::DomainParticipant* join(unsigned domain) {
  fdds::DomainParticipantQos qos;
  const auto udp = std::make_shared<eprosima::fastdds::rtps::UDPv4TransportDescriptor>();
  udp->interfaceWhiteList.emplace_back("127.0.0.1");
  qos.transport().use_builtin_transports = false;
  qos.transport().user_transports.push_back(udp);
  auto& discovery = qos.wire_protocol().builtin;
  discovery.avoid_builtin_multicast = true;
  for (unsigned participant = 0; participant < 20; ++participant) {
    rtps::Locator_t locator;  // DDSI-RTPS 9.6.1: 7400 + 250 d + 10 + 2 p
    rtps::IPLocator::setIPv4(locator, "127.0.0.1");
    locator.port = 7400 + 250 * domain + 10 + 2 * participant;
    discovery.initialPeersList.push_back(locator);
  }
  discovery.discovery_config.leaseDuration_announcementperiod = eprosima::fastrtps::Duration_t(0.2);
  return fdds::DomainParticipantFactory::get_instance()->create_participant(domain, qos);
}

class Printer : public fdds::DataReaderListener {
 public:
  explicit Printer(std::string topic) : topic_(std::move(topic)) {}
  void on_data_available(fdds::DataReader* reader) override {
    Bytes bytes;
    fdds::SampleInfo info;
    while (reader->take_next_sample(&bytes, &info) == ReturnCode_t::RETCODE_OK) {
      if (!info.valid_data) continue;
      std::string line = topic_ + " ";
      for (const unsigned char byte : bytes) {
        char hex[3];
        std::snprintf(hex, sizeof hex, "%02x", byte);
        line += hex;
      }
      std::puts(line.c_str());
      std::fflush(stdout);
    }
  }

 private:
  std::string topic_;
};

bool hear(fdds::DomainParticipant* participant, char** words) {
  const std::string name = words[0];
  fdds::TypeSupport type(new RawType(words[1]));
  if (type.register_type(participant) != ReturnCode_t::RETCODE_OK) return false;
  auto* topic = participant->create_topic(name, words[1], fdds::TOPIC_QOS_DEFAULT);
  auto* subscriber = participant->create_subscriber(fdds::SUBSCRIBER_QOS_DEFAULT);
  fdds::DataReaderQos qos = fdds::DATAREADER_QOS_DEFAULT;
  qos.reliability().kind = std::strcmp(words[2], "reliable") == 0
                               ? fdds::RELIABLE_RELIABILITY_QOS
                               : fdds::BEST_EFFORT_RELIABILITY_QOS;
  qos.durability().kind = std::strcmp(words[3], "transient") == 0
                              ? fdds::TRANSIENT_LOCAL_DURABILITY_QOS
                              : fdds::VOLATILE_DURABILITY_QOS;
  qos.history().kind = fdds::KEEP_LAST_HISTORY_QOS;
  qos.history().depth = 100;
  qos.endpoint().history_memory_policy = rtps::PREALLOCATED_WITH_REALLOC_MEMORY_MODE;
  qos.data_sharing().off();
  // The printer lives as long as the process.
  return subscriber->create_datareader(topic, qos, new Printer(name)) != nullptr;
}

struct Voice {
  fdds::DataWriter* writer;
  Bytes payload;
};

Bytes bytes_of(const char* hex) {
  Bytes bytes;
  for (unsigned byte = 0; std::sscanf(hex, "%2x", &byte) == 1; hex += 2)
    bytes.push_back(static_cast<unsigned char>(byte));
  return bytes;
}

Voice speak(fdds::DomainParticipant* participant, char** words) {
  fdds::TypeSupport type(new RawType(words[1]));
  type.register_type(participant);
  auto* topic = participant->create_topic(words[0], words[1], fdds::TOPIC_QOS_DEFAULT);
  auto* publisher = participant->create_publisher(fdds::PUBLISHER_QOS_DEFAULT);
  fdds::DataWriterQos qos = fdds::DATAWRITER_QOS_DEFAULT;
  qos.reliability().kind = fdds::RELIABLE_RELIABILITY_QOS;
  qos.durability().kind = fdds::TRANSIENT_LOCAL_DURABILITY_QOS;
  qos.deadline().period = eprosima::fastrtps::Duration_t(0.01);
  qos.liveliness().kind = fdds::MANUAL_BY_TOPIC_LIVELINESS_QOS;
  qos.liveliness().lease_duration = eprosima::fastrtps::Duration_t(0.05);
  qos.liveliness().announcement_period = eprosima::fastrtps::Duration_t(0.02);
  qos.endpoint().history_memory_policy = rtps::PREALLOCATED_WITH_REALLOC_MEMORY_MODE;
  qos.data_sharing().off();
  return {publisher->create_datawriter(topic, qos), bytes_of(words[3] + 1)};
}

}  // namespace

int main(int argc, char** argv) {
  if (argc < 6 || (argc - 2) % 4 != 0) return 2;
  sigset_t ends;
  sigemptyset(&ends);
  sigaddset(&ends, SIGTERM);
  sigaddset(&ends, SIGINT);
  sigprocmask(SIG_BLOCK, &ends, nullptr);  // before the middleware's threads are made
  fdds::DomainParticipant* participant = join(static_cast<unsigned>(std::atoi(argv[1])));
  if (participant == nullptr) return 3;
  std::vector<Voice> voices;
  for (int i = 2; i < argc; i += 4) {
    if (argv[i + 3][0] == '=') {
      voices.push_back(speak(participant, argv + i));
      if (voices.back().writer == nullptr) return 3;
    } else if (!hear(participant, argv + i)) {
      return 3;
    }
  }
  std::puts("ready");
  std::fflush(stdout);
  const timespec period{0, 100'000'000};
  while (sigtimedwait(&ends, nullptr, &period) < 0)
    for (Voice& voice : voices) voice.writer->write(&voice.payload);
  std::_Exit(0);  // the middleware's own leave-taking is not what is tested
}
