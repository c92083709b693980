#include <archive.h>
#include <archive_entry.h>
#include <gtest/gtest.h>

#include "sources/convert/compressed_lines.h"
#include "sources/convert/convert.h"
#include "tests/convert/carmen_logs.h"

namespace soundmap::convert {
namespace {

std::string Log(int scans) {
  std::string log = "# made for this test\n";
  for (int i = 0; i < scans; ++i) {
    const double stamp_s = 1.0 + 0.1 * i;
    log += OdometryLine(0.01 * i, 0.003 * i * i, 0.1, stamp_s);
    std::vector<std::string> ranges;
    for (int beam = 0; beam < 90; ++beam) {
      ranges.push_back(std::to_string(1.0 + 0.013 * ((i * 37 + beam * 11) % 100)));
    }
    log += LaserLine(ranges, stamp_s + 0.05);
  }
  return log;
}

std::string Compressed(const std::string& text, int filter) {
  const std::string path = FreshPath("compressed");
  archive* file = archive_write_new();
  EXPECT_EQ(archive_write_set_format_raw(file), ARCHIVE_OK);
  EXPECT_EQ(archive_write_add_filter(file, filter), ARCHIVE_OK);
  EXPECT_EQ(archive_write_open_filename(file, path.c_str()), ARCHIVE_OK);
  archive_entry* entry = archive_entry_new();
  archive_entry_set_filetype(entry, AE_IFREG);
  EXPECT_EQ(archive_write_header(file, entry), ARCHIVE_OK);
  EXPECT_EQ(archive_write_data(file, text.data(), text.size()),
            static_cast<la_ssize_t>(text.size()));
  archive_entry_free(entry);
  archive_write_free(file);
  return ReadBytes(path);
}

TEST(CompressedLogs, EveryCompressionGivesTheSameRecording) {
  const std::string log = Log(200);
  const std::string plain = FreshPath("drive.log"), expected = FreshPath("plain.mcap");
  WriteBytes(plain, log);
  ASSERT_TRUE(Convert(plain, expected).ok());
  for (const int filter :
       {ARCHIVE_FILTER_BZIP2, ARCHIVE_FILTER_GZIP, ARCHIVE_FILTER_XZ, ARCHIVE_FILTER_ZSTD}) {
    const std::string in = FreshPath("drive.anything"), out = FreshPath("compressed.mcap");
    WriteBytes(in, Compressed(log, filter));
    ASSERT_LT(ReadBytes(in).size(), log.size());
    const auto result = Convert(in, out);
    ASSERT_TRUE(result.ok()) << result.status();
    EXPECT_EQ(result->scans, 200);
    EXPECT_EQ(ReadBytes(out), ReadBytes(expected)) << filter;
  }
}

TEST(CompressedLogs, ACutLogGivesWhatStandsBeforeTheCut) {
  const std::string log = Log(3000);
  const std::string whole = Compressed(log, ARCHIVE_FILTER_BZIP2);
  const std::string in = FreshPath("cut.clf.bz2"), out = FreshPath("cut.mcap");
  WriteBytes(in, whole.substr(0, whole.size() / 2 + whole.size() / 4));
  const auto result = Convert(in, out);
  ASSERT_TRUE(result.ok()) << result.status();
  EXPECT_TRUE(absl::IsDataLoss(result->damage)) << result->damage;
  EXPECT_GT(result->scans, 500);
  EXPECT_LT(result->scans, 3000);
  const Recorded recorded = ReadRecording(out);
  EXPECT_EQ(static_cast<std::int64_t>(recorded.scans.size()), result->scans);

  // Nothing before the cut: nothing to write.
  WriteBytes(in, whole.substr(0, 100));
  const std::string nothing = FreshPath("nothing.mcap");
  EXPECT_TRUE(absl::IsDataLoss(Convert(in, nothing).status()));
}

TEST(CompressedLogs, LinesComeWholeWithTheirNumbers) {
  std::string text;
  for (int i = 1; i <= 5000; ++i)
    text += std::to_string(i) + " " + std::string(i % 300, 'x') + "\n";
  text += "last without an end";
  const std::string path = FreshPath("lines");
  WriteBytes(path, text);
  std::string joined;
  int count = 0;
  ASSERT_TRUE(ForEachLine(path, [&](std::string_view line, int number) {
                EXPECT_EQ(number, ++count);
                joined.append(line);
                if (number <= 5000) joined.push_back('\n');
              }).ok());
  EXPECT_EQ(count, 5001);
  EXPECT_EQ(joined, text);
}

TEST(CompressedLogs, AnEndlessLineIsRefused) {
  const std::string path = FreshPath("endless");
  WriteBytes(path, std::string(17 << 20, '1'));
  EXPECT_FALSE(ForEachLine(path, [](std::string_view, int) {}).ok());
}

}  // namespace
}  // namespace soundmap::convert
