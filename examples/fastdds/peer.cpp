// A node of eProsima's Fast DDS, which ROS 2 speaks by default, with ROS's names of topics and types, and without ROS:
//     peer talk COUNT       publishes odometry on /odom, 100 a second
//     peer listen COUNT     prints the poses of /touchline/pose, and ends after so many
// Build: g++ -O2 -o peer peer.cpp -lfastrtps -lfastcdr     (Debian: apt-get install libfastrtps-dev)
// It stays on this machine (127.0.0.1); ROS_DOMAIN_ID counts.

#include <chrono>
#include <cstdio>
#include <cstdlib>
#include <cstring>
#include <string>
#include <thread>
#include <vector>

#include <fastcdr/Cdr.h>
#include <fastcdr/FastBuffer.h>
#include <fastdds/dds/domain/DomainParticipant.hpp>
#include <fastdds/dds/domain/DomainParticipantFactory.hpp>
#include <fastdds/dds/publisher/DataWriter.hpp>
#include <fastdds/dds/publisher/Publisher.hpp>
#include <fastdds/dds/subscriber/DataReader.hpp>
#include <fastdds/dds/subscriber/SampleInfo.hpp>
#include <fastdds/dds/subscriber/Subscriber.hpp>
#include <fastdds/dds/topic/Topic.hpp>
#include <fastdds/dds/topic/TopicDataType.hpp>
#include <fastdds/rtps/transport/UDPv4TransportDescriptor.h>

using namespace eprosima::fastdds::dds;
using eprosima::fastcdr::Cdr;
using eprosima::fastcdr::FastBuffer;

struct Message {
  int32_t sec = 0;
  uint32_t nanosec = 0;
  std::string frame, child;
  double pose[7] = {0, 0, 0, 0, 0, 0, 1};  // x, y, z and the quaternion x, y, z, w
};

// nav_msgs/Odometry, or geometry_msgs/PoseWithCovarianceStamped: a header, of one of them a frame, a pose, 36 numbers.
class Type : public TopicDataType {
 public:
  Type(const char* name, bool odometry) : odometry_(odometry) {
    setName(name);
    m_typeSize = 2000;
    m_isGetKeyDefined = false;
  }
  bool serialize(void* data, eprosima::fastrtps::rtps::SerializedPayload_t* payload) override {
    auto* m = static_cast<Message*>(data);
    FastBuffer buffer(reinterpret_cast<char*>(payload->data), payload->max_size);
    Cdr cdr(buffer, Cdr::DEFAULT_ENDIAN, Cdr::DDS_CDR);
    cdr.serialize_encapsulation();
    payload->encapsulation = cdr.endianness() == Cdr::BIG_ENDIANNESS ? CDR_BE : CDR_LE;
    cdr << m->sec << m->nanosec << m->frame;
    if (odometry_) cdr << m->child;
    for (double each : m->pose) cdr << each;
    for (int k = 0; k < 36; ++k) cdr << 0.0;
    if (odometry_)
      for (int k = 0; k < 6 + 36; ++k) cdr << 0.0;  // velocities
    payload->length = static_cast<uint32_t>(cdr.getSerializedDataLength());
    return true;
  }
  bool deserialize(eprosima::fastrtps::rtps::SerializedPayload_t* payload, void* data) override {
    auto* m = static_cast<Message*>(data);
    FastBuffer buffer(reinterpret_cast<char*>(payload->data), payload->length);
    Cdr cdr(buffer, Cdr::DEFAULT_ENDIAN, Cdr::DDS_CDR);
    cdr.read_encapsulation();
    cdr >> m->sec >> m->nanosec >> m->frame;
    if (odometry_) cdr >> m->child;
    for (double& each : m->pose) cdr >> each;
    return true;
  }
  std::function<uint32_t()> getSerializedSizeProvider(void*) override {
    return [] { return 2000u; };
  }
  void* createData() override { return new Message; }
  void deleteData(void* data) override { delete static_cast<Message*>(data); }
  bool getKey(void*, eprosima::fastrtps::rtps::InstanceHandle_t*, bool) override { return false; }

 private:
  bool odometry_;
};

int main(int argc, char** argv) {
  if (argc != 3 || (std::strcmp(argv[1], "talk") && std::strcmp(argv[1], "listen"))) {
    std::fprintf(stderr, "peer talk|listen COUNT\n");
    return 2;
  }
  const bool talks = !std::strcmp(argv[1], "talk");
  const int count = std::atoi(argv[2]);
  DomainParticipantQos qos;
  auto loopback = std::make_shared<eprosima::fastdds::rtps::UDPv4TransportDescriptor>();
  loopback->interfaceWhiteList.push_back("127.0.0.1");
  qos.transport().use_builtin_transports = false;
  qos.transport().user_transports.push_back(loopback);
  const char* domain = std::getenv("ROS_DOMAIN_ID");
  auto* factory = DomainParticipantFactory::get_instance();
  auto* participant = factory->create_participant(domain && *domain ? std::atoi(domain) : 0, qos);
  TypeSupport type(talks ? new Type("nav_msgs::msg::dds_::Odometry_", true)
                         : new Type("geometry_msgs::msg::dds_::PoseWithCovarianceStamped_", false));
  if (!participant || type.register_type(participant) != ReturnCode_t::RETCODE_OK) return 1;
  const char* name = talks ? "rt/odom" : "rt/touchline/pose";
  auto* topic = participant->create_topic(name, type.get_type_name(), TOPIC_QOS_DEFAULT);
  Message message;
  if (talks) {
    DataWriterQos how;
    how.reliability().kind = RELIABLE_RELIABILITY_QOS;
    how.history().kind = KEEP_ALL_HISTORY_QOS;
    auto* writer = participant->create_publisher(PUBLISHER_QOS_DEFAULT)->create_datawriter(topic, how);
    PublicationMatchedStatus matched;
    for (int k = 0; k < 2000 && matched.current_count == 0; ++k) {  // until somebody listens
      std::this_thread::sleep_for(std::chrono::milliseconds(10));
      writer->get_publication_matched_status(matched);
    }
    std::this_thread::sleep_for(std::chrono::milliseconds(300));
    message.frame = "odom", message.child = "base_footprint";
    for (int k = 0; k < count; ++k) {
      message.sec = (k + 1) / 100, message.nanosec = (k + 1) % 100 * 10000000u, message.pose[0] = 0.01 * (k + 1);
      writer->write(&message);
      std::this_thread::sleep_for(std::chrono::milliseconds(10));
    }
    writer->wait_for_acknowledgments({5, 0});
  } else {
    DataReaderQos how;
    how.reliability().kind = RELIABLE_RELIABILITY_QOS;
    how.history().kind = KEEP_ALL_HISTORY_QOS;
    auto* reader = participant->create_subscriber(SUBSCRIBER_QOS_DEFAULT)->create_datareader(topic, how);
    std::puts("ready");
    std::fflush(stdout);
    SampleInfo info;
    for (int taken = 0, waited = 0; taken < count && waited < 200;) {
      if (!reader->wait_for_unread_message({0, 100000000})) { ++waited; continue; }
      while (reader->take_next_sample(&message, &info) == ReturnCode_t::RETCODE_OK)
        if (info.valid_data) {
          const Message& m = message;
          std::printf("%d.%09u %.6f %.6f %s\n", m.sec, m.nanosec, m.pose[0], m.pose[1], m.frame.c_str());
          ++taken;
        }
      std::fflush(stdout);
    }
  }
  participant->delete_contained_entities();
  factory->delete_participant(participant);
  return 0;
}
