#include "storage/journal_codec.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <bit>
#include <limits>
#include <random>

#include "storage/frame_sequence.h"

namespace soundmap::storage {
namespace {

using sound_map::EndPoint;

void ExpectSame(const JournalEntry& a, const JournalEntry& b) {
  EXPECT_EQ(a.offset, b.offset);
  EXPECT_EQ(a.summary, b.summary);
  EXPECT_EQ(a.evidence.stamp_ns, b.evidence.stamp_ns);
  EXPECT_EQ(a.evidence.maxima, b.evidence.maxima);
  ASSERT_EQ(a.evidence.end_points.size(), b.evidence.end_points.size());
  for (std::size_t i = 0; i < a.evidence.end_points.size(); ++i) {
    const EndPoint& p = a.evidence.end_points[i];
    const EndPoint& q = b.evidence.end_points[i];
    ASSERT_EQ(p.key, q.key) << i;
    ASSERT_EQ(std::bit_cast<std::uint32_t>(p.likelihood),
              std::bit_cast<std::uint32_t>(q.likelihood))
        << i;
  }
}

JournalEntry RandomEntry(std::mt19937_64* random) {
  std::mt19937_64& r = *random;
  JournalEntry entry;
  entry.offset = static_cast<std::int64_t>(r() >> (r() % 64));
  entry.evidence.stamp_ns = static_cast<std::int64_t>(r());
  entry.summary.assign(r() % 100, static_cast<char>(r()));
  const std::size_t count = r() % 4 == 0 ? r() % 4 : r() % 3000;
  const std::uint64_t spread = std::uint64_t{1} << (r() % 17);
  const std::uint64_t values = r() % 3 == 0 ? 1000 : 1 + r() % 8;
  const bool any_bits = r() % 4 == 0;
  for (std::size_t i = 0; i < count; ++i) {
    const auto axis = [&] { return static_cast<std::uint16_t>(32768 + r() % spread); };
    const std::uint64_t value = r() % values;
    const float likelihood = any_bits ? std::bit_cast<float>(static_cast<std::uint32_t>(r()))
                                      : static_cast<float>(value) / 1000.0f;
    entry.evidence.end_points.push_back({{axis(), axis(), axis()}, likelihood});
  }
  for (std::uint64_t left = r() % 40; left > 0; --left) {
    const auto axis = [&] { return static_cast<std::uint16_t>(r()); };
    entry.evidence.maxima.push_back({axis(), axis(), axis()});
  }
  return entry;
}

TEST(JournalCodec, KeepsEveryBitAndTheOrder) {
  std::mt19937_64 random(7);
  for (int i = 0; i < 300; ++i) {
    const JournalEntry entry = RandomEntry(&random);
    const auto bytes = EncodeJournalEntry("drive-1", entry);
    ASSERT_TRUE(bytes.ok()) << bytes.status();
    JournalRecord record;
    record.sequence = 17;
    const absl::Status decoded = DecodeJournalEntry(*bytes, &record);
    ASSERT_TRUE(decoded.ok()) << decoded;
    EXPECT_EQ(record.sequence, 17u);
    EXPECT_EQ(record.session, "drive-1");
    ExpectSame(record.entry, entry);
  }
}

TEST(JournalCodec, KeepsExtremes) {
  JournalEntry entry;
  entry.offset = std::numeric_limits<std::int64_t>::max();
  entry.evidence.stamp_ns = std::numeric_limits<std::int64_t>::min();
  for (const std::uint16_t axis : {0, 65535, 0, 32768, 65535, 1}) {
    for (const float likelihood :
         {0.0f, -0.0f, 1.0f, std::numeric_limits<float>::quiet_NaN(),
          -std::numeric_limits<float>::infinity(), std::numeric_limits<float>::denorm_min()}) {
      entry.evidence.end_points.push_back(
          {{axis, static_cast<std::uint16_t>(65535 - axis), axis}, likelihood});
    }
  }
  JournalRecord record;
  ASSERT_TRUE(DecodeJournalEntry(EncodeJournalEntry("s", entry).value(), &record).ok());
  ExpectSame(record.entry, entry);
}

// 0.5 bytes is far below what three coordinates carry without prediction; 2 bytes is the aim.
TEST(JournalCodec, TakesLessThanTwoBytesAnEndPoint) {
  std::mt19937_64 random(3);
  std::size_t bytes = 0;
  std::size_t end_points = 0;
  for (int scan = 0; scan < 20; ++scan) {
    JournalEntry entry;
    entry.evidence.end_points = RoomEndPoints(10313, &random);
    bytes += EncodeJournalEntry("s", entry).value().size();
    end_points += entry.evidence.end_points.size();
  }
  const double bytes_per_end_point = static_cast<double>(bytes) / static_cast<double>(end_points);
  RecordProperty("bytes_per_end_point", std::to_string(bytes_per_end_point));
  EXPECT_LT(bytes_per_end_point, 2.0);
  EXPECT_GT(bytes_per_end_point, 0.2);
}

TEST(JournalCodec, RefusesWhatIsTooLarge) {
  JournalEntry entry;
  entry.evidence.end_points.resize((1 << 20) + 1);
  EXPECT_TRUE(absl::IsInvalidArgument(EncodeJournalEntry("s", entry).status()));
  entry.evidence.end_points.resize(1 << 20);
  JournalRecord record;
  EXPECT_TRUE(DecodeJournalEntry(EncodeJournalEntry("s", entry).value(), &record).ok());
  entry.summary.assign((64 << 10) + 1, 'x');
  EXPECT_TRUE(absl::IsInvalidArgument(EncodeJournalEntry("s", entry).status()));
  entry.summary.clear();
  entry.evidence.maxima.resize((1 << 16) + 1);
  EXPECT_TRUE(absl::IsInvalidArgument(EncodeJournalEntry("s", entry).status()));
}

// Version 1 had no maxima: session "s", offset 1, time 2, no summary, no end points.
TEST(JournalCodec, ReadsEntriesFromBeforeMaximaWereKept) {
  JournalRecord record;
  record.entry.evidence.maxima.resize(3);
  ASSERT_TRUE(DecodeJournalEntry(std::string("\1\1s\2\4\0\0", 7), &record).ok());
  EXPECT_EQ(record.session, "s");
  EXPECT_EQ(record.entry.offset, 1);
  EXPECT_EQ(record.entry.evidence.stamp_ns, 2);
  EXPECT_TRUE(record.entry.evidence.maxima.empty());
}

TEST(JournalCodec, EveryCutIsDataLoss) {
  std::mt19937_64 random(5);
  JournalEntry entry = EntryAt(3);
  entry.evidence.maxima = {{1, 2, 3}, {65535, 0, 32768}};
  const std::string bytes = EncodeJournalEntry("s", entry).value();
  for (std::size_t cut = 0; cut < bytes.size(); ++cut) {
    JournalRecord record;
    EXPECT_TRUE(absl::IsDataLoss(DecodeJournalEntry(bytes.substr(0, cut), &record))) << cut;
  }
  JournalRecord record;
  EXPECT_TRUE(absl::IsDataLoss(DecodeJournalEntry(bytes + "x", &record)));
}

// Bytes that nobody has written: either an entry within the limits or DataLoss.
TEST(JournalCodec, HostileBytesStayBounded) {
  std::mt19937_64 random(11);
  const std::string good = EncodeJournalEntry("s", EntryAt(3)).value();
  int refused = 0;
  for (int i = 0; i < 20000; ++i) {
    std::string bytes = good;
    for (std::uint64_t flips = 1 + random() % 4; flips > 0; --flips) {
      bytes[random() % bytes.size()] = static_cast<char>(random());
    }
    JournalRecord record;
    const absl::Status decoded = DecodeJournalEntry(bytes, &record);
    if (!decoded.ok()) {
      ++refused;
      EXPECT_TRUE(absl::IsDataLoss(decoded));
    }
    EXPECT_LE(record.entry.evidence.end_points.size(), std::size_t{1} << 20);
  }
  EXPECT_GT(refused, 1000);
  // 2^16 maxima with nothing behind them, and one more than that.
  for (const char* maxima : {"\x80\x80\4", "\x81\x80\4"}) {
    JournalRecord record;
    EXPECT_TRUE(
        absl::IsDataLoss(DecodeJournalEntry(std::string("\2\0\0\0\0", 5) + maxima, &record)));
  }
  // A count of 2^20 with nothing behind it, and one of 2^63.
  JournalRecord record;
  EXPECT_TRUE(absl::IsDataLoss(
      DecodeJournalEntry(std::string("\1\0\0\0\0\x80\x80\x40\x80\x80\x80\x02", 12), &record)));
  EXPECT_TRUE(absl::IsDataLoss(DecodeJournalEntry(
      std::string("\1\0\0\0\0\xff\xff\xff\xff\xff\xff\xff\xff\x7f\x10", 15), &record)));
  std::string other_version = good;
  other_version[0] = 3;
  EXPECT_TRUE(absl::IsDataLoss(DecodeJournalEntry(other_version, &record)));
}

}  // namespace
}  // namespace soundmap::storage
