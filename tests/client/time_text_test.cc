#include "cli/time_text.h"

#include <gtest/gtest.h>

namespace soundmap::cli {
namespace {

// 2024-05-01T12:00:00Z: 19844 days after 1970-01-01 (54 years with 13 leap days, then 121 days) and
// 12 hours.
constexpr std::int64_t kNoonS = 19844LL * 86400 + 43200;
constexpr std::int64_t kNoonNs = kNoonS * 1'000'000'000;

TEST(ParseSince, ReadsIso8601) {
  for (const char* text : {"2024-05-01T12:00:00Z", "2024-05-01T14:00:00+02:00",
                           "2024-05-01T12:00:00", "2024-05-01 12:00", "2024-05-01T12:00Z"}) {
    const auto time_ns = ParseSince(text, 0);
    ASSERT_TRUE(time_ns.ok()) << text;
    EXPECT_EQ(*time_ns, kNoonNs) << text;
  }
  EXPECT_EQ(ParseSince("2024-05-01T12:00:00.25Z", 0).value(), kNoonNs + 250'000'000);
  EXPECT_EQ(ParseSince("2024-05-01", 0).value(), kNoonNs - 43200LL * 1'000'000'000);
}

TEST(ParseSince, ReadsSeconds) {
  EXPECT_EQ(ParseSince("1000.5", kNoonNs).value(), 1'000'500'000'000);
  EXPECT_EQ(ParseSince("0", kNoonNs).value(), 0);
}

TEST(ParseSince, ReadsAges) {
  constexpr std::int64_t kS = 1'000'000'000;
  EXPECT_EQ(ParseSince("90s", kNoonNs).value(), kNoonNs - 90 * kS);
  EXPECT_EQ(ParseSince("10m", kNoonNs).value(), kNoonNs - 600 * kS);
  EXPECT_EQ(ParseSince("2h ago", kNoonNs).value(), kNoonNs - 7200 * kS);
  EXPECT_EQ(ParseSince("1.5d", kNoonNs).value(), kNoonNs - 129600 * kS);
  EXPECT_EQ(ParseSince("1d", 5 * kS).value(), 0);  // before 1970: ever
}

TEST(ParseSince, RefusesEverythingElse) {
  for (const char* text : {"", "banana", "-5", "nan", "inf", "1e300", "-10m", "m", "nanm", "1e300d",
                           "10 parsecs", "2024-13-01", "2024-05-01T25:00:00Z", "9999-01-01",
                           "1600-01-01", "2024-05-01T12:00:00Zx"}) {
    const auto time_ns = ParseSince(text, kNoonNs);
    ASSERT_FALSE(time_ns.ok()) << text;
    EXPECT_NE(time_ns.status().message().find("is not a time"), absl::string_view::npos);
  }
}

TEST(FormatTime, IsUtcToTheMillisecond) {
  EXPECT_EQ(FormatTime(kNoonNs + 250'000'000), "2024-05-01T12:00:00.250Z");
}

TEST(FormatSeconds, IsExact) {
  EXPECT_EQ(FormatSeconds(1'714'564'800'000'000'001), "1714564800.000000001");
  EXPECT_EQ(FormatSeconds(0), "0.000000000");
  EXPECT_EQ(FormatSeconds(-1'500'000'000), "-1.500000000");
  EXPECT_EQ(FormatSeconds(INT64_MIN), "-9223372036.854775808");
}

}  // namespace
}  // namespace soundmap::cli
