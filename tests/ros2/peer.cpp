// Independent DDS peer (Fast DDS): prints what it discovers and receives.
//   peer DOMAIN TOPIC TYPE MODE ...     MODE: sensor, event, latched; ends with its stdin
// stdout: JSON lines.
#include <chrono>
#include <cstring>
#include <functional>
#include <iostream>
#include <memory>
#include <mutex>
#include <string>
#include <vector>

#include <fastdds/dds/domain/DomainParticipant.hpp>
#include <fastdds/dds/domain/DomainParticipantFactory.hpp>
#include <fastdds/dds/domain/DomainParticipantListener.hpp>
#include <fastdds/dds/subscriber/DataReader.hpp>
#include <fastdds/dds/subscriber/DataReaderListener.hpp>
#include <fastdds/dds/subscriber/SampleInfo.hpp>
#include <fastdds/dds/subscriber/Subscriber.hpp>
#include <fastdds/dds/topic/TopicDataType.hpp>
#include <fastdds/rtps/transport/UDPv4TransportDescriptor.h>

using namespace eprosima::fastdds::dds;
namespace rtps = eprosima::fastrtps::rtps;
using Bytes = std::vector<unsigned char>;

std::mutex printing;

std::string hex(const unsigned char* data, size_t size) {
    static const char digits[] = "0123456789abcdef";
    std::string text;
    for (size_t i = 0; i < size; ++i) (text += digits[data[i] >> 4]) += digits[data[i] & 15];
    return text;
}

std::string hex(const rtps::GUID_t& guid) {
    return hex(guid.guidPrefix.value, 12) + hex(guid.entityId.value, 4);
}

void print(const std::string& line) {
    std::lock_guard<std::mutex> lock(printing);
    std::cout << line << std::endl;
}

std::string now() {  // epoch seconds
    using std::chrono::duration;
    return std::to_string(duration<double>(std::chrono::system_clock::now().time_since_epoch()).count());
}

// Any type of a given name, as bytes.
class RawType : public TopicDataType {
public:
    explicit RawType(const std::string& name) {
        setName(name.c_str());
        m_typeSize = 65536;
        m_isGetKeyDefined = false;
        auto_fill_type_object(false);
        auto_fill_type_information(false);
    }
    bool serialize(void* data, rtps::SerializedPayload_t* payload) override {
        const Bytes& bytes = *static_cast<Bytes*>(data);
        std::memcpy(payload->data, bytes.data(), bytes.size());
        payload->length = bytes.size();
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

class Discovered : public DomainParticipantListener {
    template <class Info> void found(const char* what, const Info& info) {
        const auto& user = info.m_qos.m_userData;
        print(std::string("{\"what\": \"") + what + "\", \"topic\": \"" + info.topicName().c_str() + "\", \"type\": \"" +
              info.typeName().c_str() + "\", \"guid\": \"" + hex(info.guid()) + "\", \"user\": \"" +
              std::string(user.begin(), user.end()) + "\", \"reliable\": " +
              (info.m_qos.m_reliability.kind == RELIABLE_RELIABILITY_QOS ? "true" : "false") + ", \"latched\": " +
              (info.m_qos.m_durability.kind == TRANSIENT_LOCAL_DURABILITY_QOS ? "true" : "false") + "}");
    }
    void on_publisher_discovery(DomainParticipant*, rtps::WriterDiscoveryInfo&& info) override {
        if (info.status == rtps::WriterDiscoveryInfo::DISCOVERED_WRITER) found("writer", info.info);
    }
    void on_subscriber_discovery(DomainParticipant*, rtps::ReaderDiscoveryInfo&& info) override {
        if (info.status == rtps::ReaderDiscoveryInfo::DISCOVERED_READER) found("reader", info.info);
    }
    void on_participant_discovery(DomainParticipant*, rtps::ParticipantDiscoveryInfo&& info) override {
        if (info.status == rtps::ParticipantDiscoveryInfo::DISCOVERED_PARTICIPANT) {
            const auto& user = info.info.m_userData;
            print("{\"what\": \"participant\", \"guid\": \"" + hex(info.info.m_guid) + "\", \"user\": \"" +
                  std::string(user.begin(), user.end()) + "\"}");
        }
    }
};

class Received : public DataReaderListener {
    void on_data_available(DataReader* reader) override {
        Bytes bytes;
        SampleInfo info;
        while (reader->take_next_sample(&bytes, &info) == ReturnCode_t::RETCODE_OK)
            if (info.valid_data)
                print("{\"what\": \"message\", \"at\": " + now() + ", \"topic\": \"" +
                      reader->get_topicdescription()->get_name() + "\", \"data\": \"" +
                      hex(bytes.data(), bytes.size()) + "\"}");
    }
};

int main(int n, char** words) {
    DomainParticipantQos qos;
    auto udp = std::make_shared<eprosima::fastdds::rtps::UDPv4TransportDescriptor>();
    udp->interfaceWhiteList.push_back("127.0.0.1");
    qos.transport().use_builtin_transports = false;
    qos.transport().user_transports.push_back(udp);
    rtps::Locator_t peer;
    rtps::IPLocator::setIPv4(peer, 127, 0, 0, 1);
    qos.wire_protocol().builtin.initialPeersList.push_back(peer);
    Discovered discovered;
    Received received;
    auto* participant = DomainParticipantFactory::get_instance()->create_participant(
        std::stoi(words[1]), qos, &discovered, StatusMask::none());
    auto* subscriber = participant->create_subscriber(SUBSCRIBER_QOS_DEFAULT);
    for (int i = 2; i + 2 < n; i += 3) {
        const std::string mode = words[i + 2];
        TypeSupport type(new RawType(words[i + 1]));
        type.register_type(participant);
        auto* topic = participant->create_topic(words[i], words[i + 1], TOPIC_QOS_DEFAULT);
        DataReaderQos reader;
        reader.reliability().kind = mode == "sensor" ? BEST_EFFORT_RELIABILITY_QOS : RELIABLE_RELIABILITY_QOS;
        reader.durability().kind = mode == "latched" ? TRANSIENT_LOCAL_DURABILITY_QOS : VOLATILE_DURABILITY_QOS;
        reader.history().depth = 100;
        subscriber->create_datareader(topic, reader, &received);
    }
    print("{\"what\": \"ready\"}");
    std::string line;
    while (std::getline(std::cin, line)) {
    }
    participant->delete_contained_entities();
    DomainParticipantFactory::get_instance()->delete_participant(participant);
}
