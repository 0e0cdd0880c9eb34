// A program on eProsima Fast DDS, which Jazzy's default RMW is made of, under ROS 2's names: hears
// joint and operating states, and sends one move. Bytes are CDR, in and out.
//
// fast_peer DOMAIN SECONDS ORDER: ORDER is a sensor_msgs/JointState in hexadecimal digits.
#include <fastdds/dds/domain/DomainParticipantFactory.hpp>
#include <fastdds/dds/domain/DomainParticipant.hpp>
#include <fastdds/dds/publisher/Publisher.hpp>
#include <fastdds/dds/publisher/DataWriter.hpp>
#include <fastdds/dds/subscriber/Subscriber.hpp>
#include <fastdds/dds/subscriber/DataReader.hpp>
#include <fastdds/dds/subscriber/SampleInfo.hpp>
#include <fastdds/dds/topic/TopicDataType.hpp>
#include <fastdds/dds/topic/TypeSupport.hpp>
#include <unistd.h>
#include <chrono>
#include <cstdio>
#include <cstdlib>
#include <cstring>
#include <functional>
#include <thread>
#include <vector>
using namespace eprosima::fastdds::dds;
using eprosima::fastrtps::rtps::SerializedPayload_t;
using eprosima::fastrtps::rtps::InstanceHandle_t;
typedef std::vector<unsigned char> Bytes;
class Raw : public TopicDataType {
 public:
  explicit Raw(const char* name) { setName(name); m_typeSize = 65000; m_isGetKeyDefined = false;
    auto_fill_type_object(false); auto_fill_type_information(false); }
  bool serialize(void* d, SerializedPayload_t* p) override { auto& b = *static_cast<Bytes*>(d);
    memcpy(p->data, b.data(), b.size()); p->length = b.size(); p->encapsulation = CDR_LE; return true; }
  bool deserialize(SerializedPayload_t* p, void* d) override {
    static_cast<Bytes*>(d)->assign(p->data, p->data + p->length); return true; }
  std::function<uint32_t()> getSerializedSizeProvider(void* d) override {
    return [d] { return static_cast<uint32_t>(static_cast<Bytes*>(d)->size()); }; }
  void* createData() override { return new Bytes; }
  void deleteData(void* d) override { delete static_cast<Bytes*>(d); }
  bool getKey(void*, InstanceHandle_t*, bool) override { return false; }
};

int main(int, char** argv) {
  printf("{\"ready\": true}\n");
  fflush(stdout);
  auto* p = DomainParticipantFactory::get_instance()->create_participant(atoi(argv[1]), PARTICIPANT_QOS_DEFAULT);
  TypeSupport js(new Raw("sensor_msgs::msg::dds_::JointState_")), os(new Raw("crtk_msgs::msg::dds_::OperatingState_"));
  js.register_type(p); os.register_type(p);
  auto topic = [&](const char* n, TypeSupport& t) { return p->create_topic(n, t.get_type_name(), TOPIC_QOS_DEFAULT); };
  auto* sub = p->create_subscriber(SUBSCRIBER_QOS_DEFAULT);
  auto* pub = p->create_publisher(PUBLISHER_QOS_DEFAULT);
  DataReaderQos q = DATAREADER_QOS_DEFAULT; q.reliability().kind = RELIABLE_RELIABILITY_QOS; q.history().depth = 1000;
  auto* joints = sub->create_datareader(topic("rt/PSM1/measured_js", js), q);
  DataReaderQos l = q; l.durability().kind = TRANSIENT_LOCAL_DURABILITY_QOS;
  auto* state = sub->create_datareader(topic("rt/PSM1/operating_state", os), l);
  DataWriterQos w = DATAWRITER_QOS_DEFAULT; w.reliability().kind = RELIABLE_RELIABILITY_QOS;
  auto* move = pub->create_datawriter(topic("rt/PSM1/move_jp", js), w);
  Bytes order; for (const char* c = argv[3]; *c && c[1]; c += 2) { unsigned v; sscanf(c, "%2x", &v); order.push_back(v); }
  int n = 0, s = 0, matched = 0; bool sent = false; Bytes first, last, b; SampleInfo info;
  auto t0 = std::chrono::steady_clock::now();
  while (std::chrono::steady_clock::now() - t0 < std::chrono::seconds(atoi(argv[2]))) {
    while (joints->take_next_sample(&b, &info) == ReturnCode_t::RETCODE_OK) if (info.valid_data) { if (!n++) first = b; last = b; }
    while (state->take_next_sample(&b, &info) == ReturnCode_t::RETCODE_OK) if (info.valid_data) s++;
    PublicationMatchedStatus m; move->get_publication_matched_status(m);
    matched += m.current_count > 0;
    if (!sent && matched == 200) { move->write(&order); sent = true; }  // both sides know by then
    std::this_thread::sleep_for(std::chrono::milliseconds(5));
  }
  auto hex = [](const Bytes& v) { for (auto c : v) printf("%02x", c); };
  printf("{\"joints\": %d, \"states\": %d, \"sent\": %s, \"first\": \"", n, s, sent ? "true" : "false"); hex(first);
  printf("\", \"last\": \""); hex(last); printf("\"}\n");
  fflush(stdout); _exit(0);
}
