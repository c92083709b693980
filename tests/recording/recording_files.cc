#include "tests/recording/recording_files.h"

#include <gtest/gtest.h>

#include <filesystem>
#include <fstream>
#include <iterator>
#include <ostream>
#include <random>
#include <tuple>

namespace soundmap::recording {

bool operator==(const Message& a, const Message& b) {
  const auto fields = [](const Message& m) {
    return std::tie(m.topic, m.schema, m.encoding, m.log_time_ns, m.publish_time_ns, m.sequence,
                    m.data);
  };
  return fields(a) == fields(b);
}

std::ostream& operator<<(std::ostream& out, const Message& message) {
  return out << message.topic << " " << message.schema << " #" << message.sequence << " at "
             << message.log_time_ns << ", " << message.data.size() << " bytes";
}

std::string FreshPath(const std::string& name) {
  const testing::TestInfo& test = *testing::UnitTest::GetInstance()->current_test_info();
  std::string stem = std::string(test.test_suite_name()) + "." + test.name() + "." + name;
  for (char& c : stem) c = c == '/' ? '_' : c;
  const std::string path = testing::TempDir() + stem;
  std::filesystem::remove(path);
  return path;
}

std::string FileBytes(const std::string& path) {
  std::ifstream file(path, std::ios::binary);
  return {std::istreambuf_iterator<char>(file), std::istreambuf_iterator<char>()};
}

void WriteFileBytes(const std::string& path, std::string_view bytes) {
  std::ofstream file(path, std::ios::binary | std::ios::trunc);
  file.write(bytes.data(), static_cast<std::streamsize>(bytes.size()));
}

Delivered ReadAll(const std::string& path, const ReaderLimits& limits) {
  Delivered delivered;
  auto reader = Reader::Open(path, limits);
  if (!reader.ok()) {
    delivered.status = reader.status();
    return delivered;
  }
  while (true) {
    auto message = (*reader)->Next();
    if (!message.ok()) {
      delivered.status = message.status();
      EXPECT_EQ((*reader)->Next().status(), delivered.status) << "the status must stay";
      return delivered;
    }
    if (!*message) {
      EXPECT_EQ((*reader)->position_bytes(), (*reader)->size_bytes());
      return delivered;
    }
    delivered.messages.push_back(**message);
  }
}

std::vector<Message> SomeMessages(int count) {
  std::mt19937 random(7);
  const std::pair<const char*, const char*> kinds[] = {{"/audio", "foxglove.RawAudio"},
                                                       {"/scan", "foxglove.LaserScan"},
                                                       {"/front/audio", "foxglove.RawAudio"}};
  std::vector<Message> messages;
  for (int i = 0; i < count; ++i) {
    Message message;
    std::tie(message.topic, message.schema) = kinds[random() % 3];
    message.encoding = "protobuf";
    message.log_time_ns = 1'700'000'000'000'000'000 + static_cast<std::int64_t>(random() % 1000);
    message.publish_time_ns = message.log_time_ns;
    message.sequence = static_cast<std::uint32_t>(random());
    const std::size_t bytes = i == 1 ? 0 : 1 + random() % 40;
    for (std::size_t b = 0; b < bytes; ++b) message.data.push_back(static_cast<char>(random()));
    messages.push_back(message);
  }
  return messages;
}

}  // namespace soundmap::recording
