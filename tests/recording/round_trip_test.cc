#include <gmock/gmock.h>
#include <google/protobuf/descriptor.pb.h>
#include <google/protobuf/dynamic_message.h>
#include <gtest/gtest.h>
#include <sys/resource.h>

#include <csignal>
#include <filesystem>
#include <memory>
#include <string>
#include <tuple>
#include <vector>

#include "recording/reader.h"
#include "recording/schemas.h"
#include "recording/wire.h"
#include "recording/writer.h"
#include "tests/recording/recording_files.h"

namespace soundmap::recording {
namespace {

using testing::ElementsAreArray;
using testing::HasSubstr;

absl::Status WriteTo(Writer& writer, const Message& message) {
  return writer.Write(message.topic, message.schema, message.log_time_ns, message.sequence,
                      message.data);
}

class RoundTrip : public testing::TestWithParam<std::tuple<Compression, bool, bool, int>> {
 protected:
  WriterOptions options() const {
    WriterOptions options;
    std::tie(options.compression, options.chunked, options.summary, options.chunk_bytes) =
        GetParam();
    return options;
  }
};

TEST_P(RoundTrip, EveryMessageComesBackInOrder) {
  const std::vector<Message> messages = SomeMessages(200);
  const std::string path = FreshPath("mcap");
  auto writer = Writer::Create(path, options());
  ASSERT_TRUE(writer.ok()) << writer.status();
  for (const Message& message : messages) ASSERT_TRUE(WriteTo(**writer, message).ok());
  ASSERT_TRUE((*writer)->Close().ok());
  EXPECT_EQ((*writer)->size_bytes(), static_cast<std::int64_t>(FileBytes(path).size()));

  const Delivered delivered = ReadAll(path);
  EXPECT_TRUE(delivered.status.ok()) << delivered.status;
  EXPECT_THAT(delivered.messages, ElementsAreArray(messages));
}

TEST_P(RoundTrip, AFileWithoutMessagesIsWhole) {
  const std::string path = FreshPath("mcap");
  ASSERT_TRUE(Writer::Create(path, options()).value()->Close().ok());
  const Delivered delivered = ReadAll(path);
  EXPECT_TRUE(delivered.status.ok()) << delivered.status;
  EXPECT_TRUE(delivered.messages.empty());
}

INSTANTIATE_TEST_SUITE_P(
    Layouts, RoundTrip,
    testing::Combine(testing::Values(Compression::kNone, Compression::kLz4, Compression::kZstd),
                     testing::Bool(), testing::Bool(), testing::Values(1, 700, 1 << 20)));

TEST(Writer, FlushedMessagesAreReadableWithoutClose) {
  const std::vector<Message> messages = SomeMessages(10);
  const std::string path = FreshPath("mcap");
  auto writer = Writer::Create(path, {}).value();
  for (int i = 0; i < 6; ++i) ASSERT_TRUE(WriteTo(*writer, messages[i]).ok());
  ASSERT_TRUE(writer->Flush(/*sync=*/true).ok());
  for (int i = 6; i < 10; ++i) ASSERT_TRUE(WriteTo(*writer, messages[i]).ok());

  const auto first_six = std::vector<Message>(messages.begin(), messages.begin() + 6);
  for (const bool writer_lives : {true, false}) {
    if (!writer_lives) writer.reset();
    const Delivered delivered = ReadAll(path);
    EXPECT_EQ(delivered.status.code(), absl::StatusCode::kDataLoss);
    EXPECT_THAT(std::string(delivered.status.message()), HasSubstr("without being closed"));
    EXPECT_THAT(delivered.messages, ElementsAreArray(first_six));
  }
}

TEST(Writer, RefusesWhatItCannotWriteAndGoesOn) {
  const std::string path = FreshPath("mcap");
  auto writer = Writer::Create(path, {}).value();
  ASSERT_TRUE(writer->Write("/audio", "foxglove.RawAudio", 5, 0, "a").ok());
  EXPECT_EQ(writer->Write("/x", "foxglove.Nothing", 5, 0, "").code(),
            absl::StatusCode::kInvalidArgument);
  EXPECT_EQ(writer->Write("/audio", "foxglove.LaserScan", 5, 0, "").code(),
            absl::StatusCode::kInvalidArgument);
  EXPECT_EQ(writer->Write("/audio", "foxglove.RawAudio", -1, 0, "").code(),
            absl::StatusCode::kInvalidArgument);
  ASSERT_TRUE(writer->Write("/audio", "foxglove.RawAudio", 6, 1, "b").ok());
  ASSERT_TRUE(writer->Close().ok());
  EXPECT_EQ(writer->Write("/audio", "foxglove.RawAudio", 7, 2, "c").code(),
            absl::StatusCode::kFailedPrecondition);
  EXPECT_EQ(writer->Close().code(), absl::StatusCode::kFailedPrecondition);
  const Delivered delivered = ReadAll(path);
  EXPECT_TRUE(delivered.status.ok());
  EXPECT_EQ(delivered.messages.size(), 2u);
}

TEST(Writer, DoesNotOverwrite) {
  const std::string path = FreshPath("mcap");
  WriteFileBytes(path, "precious");
  EXPECT_EQ(Writer::Create(path, {}).status().code(), absl::StatusCode::kFailedPrecondition);
  EXPECT_EQ(FileBytes(path), "precious");
  EXPECT_EQ(Writer::Create(path + ".d/none", {}).status().code(), absl::StatusCode::kNotFound);
}

TEST(Writer, AFullDiskIsResourceExhausted) {
  if (!std::filesystem::exists("/dev/full")) GTEST_SKIP() << "there is no /dev/full";
  const absl::Status status = Writer::Create("/dev/full", {}).status();
  EXPECT_EQ(status.code(), absl::StatusCode::kResourceExhausted);
  EXPECT_THAT(std::string(status.message()), HasSubstr("/dev/full"));
}

// A limit on the file's size makes write() stop in the middle of a chunk, as a full disk does.
TEST(Writer, AFailedWriteLeavesWholeChunks) {
  const std::string path = FreshPath("mcap");
  WriterOptions options;
  options.compression = Compression::kNone;
  auto writer = Writer::Create(path, options).value();
  const std::string data(1000, 'x');
  for (int chunk = 0; chunk < 3; ++chunk) {
    ASSERT_TRUE(writer->Write("/audio", "foxglove.RawAudio", chunk, 0, data).ok());
    ASSERT_TRUE(writer->Flush(false).ok());
  }
  const std::int64_t whole_bytes = writer->size_bytes();
  ASSERT_TRUE(writer->Write("/audio", "foxglove.RawAudio", 3, 0, data).ok());

  rlimit before;
  ASSERT_EQ(getrlimit(RLIMIT_FSIZE, &before), 0);
  const auto handler = std::signal(SIGXFSZ, SIG_IGN);
  const rlimit tight{static_cast<rlim_t>(whole_bytes) + 500, before.rlim_max};
  ASSERT_EQ(setrlimit(RLIMIT_FSIZE, &tight), 0);
  const absl::Status status = writer->Flush(false);
  setrlimit(RLIMIT_FSIZE, &before);
  std::signal(SIGXFSZ, handler);

  EXPECT_FALSE(status.ok());
  EXPECT_EQ(writer->Write("/audio", "foxglove.RawAudio", 4, 0, data), status);
  EXPECT_EQ(writer->Close(), status);
  EXPECT_EQ(static_cast<std::int64_t>(FileBytes(path).size()), whole_bytes);
  EXPECT_EQ(ReadAll(path).messages.size(), 3u);
}

// The declarations in a file suffice to decode its messages, without any of this program's.
TEST(Schemas, DecodeTheirMessages) {
  google::protobuf::FileDescriptorSet set;
  ASSERT_TRUE(set.ParseFromString(DescriptorSetOf("foxglove.PointCloud").value()));
  google::protobuf::DescriptorPool pool;
  for (const auto& file : set.file()) ASSERT_NE(pool.BuildFile(file), nullptr) << file.name();
  const auto* descriptor = pool.FindMessageTypeByName("foxglove.PointCloud");
  ASSERT_NE(descriptor, nullptr);
  google::protobuf::DynamicMessageFactory factory(&pool);
  const std::unique_ptr<google::protobuf::Message> cloud(factory.GetPrototype(descriptor)->New());
  // Field 2 (frame_id) "lidar", field 4 (point_stride, fixed32) 12.
  ASSERT_TRUE(cloud->ParseFromString(std::string("\x12\x05lidar\x25\x0c\0\0\0", 12)));
  EXPECT_EQ(cloud->GetReflection()->GetString(*cloud, descriptor->FindFieldByName("frame_id")),
            "lidar");
  EXPECT_EQ(cloud->GetReflection()->GetUInt32(*cloud, descriptor->FindFieldByName("point_stride")),
            12u);
}

TEST(Schemas, OnlyThoseOfTheFormat) {
  EXPECT_FALSE(DescriptorSetOf("foxglove.SceneUpdate").has_value());
  EXPECT_FALSE(DescriptorSetOf("").has_value());
}

TEST(Wire, CrcIsZlibs) {
  EXPECT_EQ(ExtendCrc32(0, "123456789"), 0xcbf43926u);  // the check value of CRC-32/ISO-HDLC
  EXPECT_EQ(ExtendCrc32(ExtendCrc32(0, "1234"), "56789"), 0xcbf43926u);
}

}  // namespace
}  // namespace soundmap::recording
