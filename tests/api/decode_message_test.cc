#include "api/decode_message.h"

#include <gtest/gtest.h>

#include "foxglove/KeyValuePair.pb.h"
#include "recording/foxglove_messages.h"

namespace soundmap::api {
namespace {

absl::StatusOr<pipeline::Session::Decoded> DecodePair(const std::string& key,
                                                      const std::string& value) {
  foxglove::KeyValuePair pair;
  pair.set_key(key);
  pair.set_value(value);
  recording::Message message;
  message.schema = "foxglove.KeyValuePair";
  message.data = pair.SerializeAsString();
  return DecodeMessage(message, {});
}

TEST(DecodeMessage, AGapIsWhatTheRobotSaysThatItLost) {
  const auto decoded =
      DecodePair("gap", R"({"frames":7,"from_ns":10,"to_ns":0,"reason":"full","more":1})");
  ASSERT_TRUE(decoded.ok()) << decoded.status();
  EXPECT_EQ(std::get<pipeline::Gap>(*decoded), (pipeline::Gap{0, 7, 10, 0, "full"}));
}

TEST(DecodeMessage, ARecordOfAGapThatSaysSomethingElseIsRefused) {
  const std::string good = R"({"frames":7,"from_ns":10,"to_ns":20,"reason":"full"})";
  EXPECT_TRUE(DecodePair("gap", good).ok());
  EXPECT_EQ(DecodePair("end", good).status().code(), absl::StatusCode::kInvalidArgument);
  for (const std::string& value :
       {std::string(), std::string("7"), std::string("[7]"), std::string("{"),
        std::string(R"({"frames":0,"from_ns":1,"to_ns":2,"reason":"full"})"),
        std::string(R"({"frames":-7,"from_ns":1,"to_ns":2,"reason":"full"})"),
        std::string(R"({"frames":1e300,"from_ns":1,"to_ns":2,"reason":"full"})"),
        std::string(R"({"frames":18446744073709551615,"from_ns":1,"to_ns":2,"reason":"full"})"),
        std::string(R"({"frames":7,"from_ns":-1,"to_ns":2,"reason":"full"})"),
        std::string(R"({"frames":7,"from_ns":1,"to_ns":"2","reason":"full"})"),
        std::string(R"({"frames":7,"from_ns":1,"to_ns":2,"reason":3})"),
        std::string(R"({"frames":7,"from_ns":1,"to_ns":2})"),
        std::string("{\"frames\":7,\"from_ns\":1,\"to_ns\":2,\"reason\":\"\xff\"}"),
        std::string(5000, '['),
        R"({"frames":7,"from_ns":1,"to_ns":2,"reason":")" + std::string(2000, 'x') + "\"}"}) {
    const auto decoded = DecodePair("gap", value);
    EXPECT_EQ(decoded.status().code(), absl::StatusCode::kInvalidArgument) << value;
  }
}

TEST(DecodeMessage, AnythingElseIsASensorsFrame) {
  recording::Message message;
  message.schema = "foxglove.Unknown";
  EXPECT_FALSE(DecodeMessage(message, {}).ok());
  message.schema = "foxglove.Odometry";
  foxglove::Odometry odometry;
  odometry.mutable_timestamp()->set_seconds(5);
  odometry.mutable_pose()->mutable_orientation()->set_w(1.0);
  message.data = odometry.SerializeAsString();
  const auto decoded = DecodeMessage(message, {});
  ASSERT_TRUE(decoded.ok()) << decoded.status();
  EXPECT_EQ(frames::StampOf(std::get<frames::Frame>(*decoded)), 5'000'000'000);
}

}  // namespace
}  // namespace soundmap::api
