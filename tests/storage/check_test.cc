#include "storage/check.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <filesystem>
#include <random>

#include "absl/strings/str_cat.h"
#include "storage/database.h"
#include "storage/frame_sequence.h"
#include "storage/keys.h"

namespace soundmap::storage {
namespace {

using ::testing::AllOf;
using ::testing::Contains;
using ::testing::ElementsAre;
using ::testing::HasSubstr;
using ::testing::IsEmpty;

const SessionId kDrive{"hall", "drive"};
constexpr std::int64_t kFrames = 100;

// A site with a drive whose log has several segments, a journal, poses, a state, two tiles and one
// of another band.
std::string MakeData(const std::string& name) {
  const std::string folder = EmptyFolder(name);
  StoreOptions options;
  options.session_log.segment_bytes = 4 << 10;
  auto store = Store::Open(folder, options).value();
  EXPECT_TRUE(store->PutRecord(Table::kSite, "hall", "a site").ok());
  EXPECT_TRUE(store->PutRecord(Table::kSession, "hall/drive", "a session").ok());
  auto log = store->OpenSession(kDrive).value();
  Commit commit{"hall", "drive", kFrames, kFrames, {}, {}, StateAt(kFrames)};
  for (std::int64_t offset = 0; offset < kFrames; ++offset) {
    EXPECT_TRUE(log->Append(FrameAt(offset)).ok());
    EXPECT_TRUE(log->Sync().ok());
    if (offset % 10 != 0) continue;
    commit.journal.push_back(EntryAt(offset));
    commit.trajectory.push_back({offset, absl::StrCat("pose ", offset)});
  }
  EXPECT_TRUE(store->CommitBatch(commit).ok());
  EXPECT_TRUE(
      store
          ->PutCheckpoint(
              "hall",
              {{{1, 2, 3}, "tile one"}, {{4, 5, 6}, "tile two"}, {{4, 5, 6, 2}, "tile of the hum"}},
              10, "register")
          .ok());
  return folder;
}

std::vector<std::string> Faults(const std::string& folder, const ContentCheck& content = {}) {
  const auto check = CheckData(folder, content);
  EXPECT_TRUE(check.ok()) << check.status();
  return check.ok() ? check->faults : std::vector<std::string>();
}

// Changes the database as no store would.
void Change(const std::string& folder, const Batch& batch) {
  DatabaseOptions options{.write_buffer_bytes = 1 << 20, .max_open_files = 16};
  ASSERT_TRUE(Database::Open(folder + "/db", options).value()->Write(batch, /*sync=*/true).ok());
}

void Flip(const std::string& path, std::size_t byte) {
  std::string bytes = ReadWholeFile(path);
  bytes.at(byte) = static_cast<char>(bytes[byte] ^ 0x10);
  WriteWholeFile(path, bytes);
}

TEST(CheckData, FindsNoFaultWhereThereIsNone) {
  const std::string folder = MakeData("check_good");
  const auto check = CheckData(folder, {});
  ASSERT_TRUE(check.ok()) << check.status();
  EXPECT_THAT(check->faults, IsEmpty());
  EXPECT_THAT(check->remarks, IsEmpty());
  EXPECT_EQ(check->sites, 1);
  EXPECT_EQ(check->sessions, 1);
  EXPECT_GT(check->segments, 2);
  EXPECT_EQ(check->frames, kFrames);
  EXPECT_EQ(check->journal_entries, 10);
  EXPECT_EQ(check->tiles, 3);
}

TEST(CheckData, FramesThatAreNotKeptAreNoFault) {
  const std::string folder = MakeData("check_dropped");
  ASSERT_TRUE(Store::Open(folder).value()->DropFrames(kDrive).ok());
  const auto check = CheckData(folder, {});
  ASSERT_TRUE(check.ok()) << check.status();
  EXPECT_THAT(check->faults, IsEmpty());
  EXPECT_THAT(check->remarks, IsEmpty());
  EXPECT_EQ(check->segments, 0);
  EXPECT_EQ(check->journal_entries, 10);
  // A crash after the mark leaves the folder.
  std::filesystem::create_directories(folder + "/sessions/hall/drive");
  EXPECT_THAT(CheckData(folder, {})->remarks, ElementsAre(HasSubstr("is still to be removed")));
}

TEST(CheckData, ChangesNothing) {
  const std::string folder = MakeData("check_only");
  const auto all = [&] {
    std::vector<std::string> bytes;
    for (const std::string& path : FilesUnder(folder, "")) {
      if (!std::filesystem::is_directory(path)) bytes.push_back(path + ReadWholeFile(path));
    }
    return bytes;
  };
  const auto before = all();
  EXPECT_THAT(Faults(folder), IsEmpty());
  EXPECT_EQ(all(), before);
}

TEST(CheckData, IsOfADataFolderThatNobodyUses) {
  const std::string folder = MakeData("check_busy");
  const auto store = Store::Open(folder).value();
  EXPECT_THAT(std::string(CheckData(folder, {}).status().message()), HasSubstr("is in use"));
  EXPECT_THAT(std::string(CheckData(EmptyFolder("check_none"), {}).status().message()),
              HasSubstr("is not a data folder"));
}

TEST(CheckData, AFlippedBitOfASegmentIsFound) {
  const std::string folder = MakeData("check_flip");
  const auto segments = FilesUnder(folder, ".mcap");
  ASSERT_GT(segments.size(), 2u);
  std::mt19937 random(3);
  int faults = 0;
  for (int i = 0; i < 60; ++i) {
    const std::string& path = segments[random() % segments.size()];
    const std::string bytes = ReadWholeFile(path);
    // In the frames; what follows them, the summary, is not needed.
    const std::size_t data_end = bytes.size() / 2;
    const std::size_t byte = random() % data_end;
    Flip(path, byte);
    const auto check = CheckData(folder, {});
    ASSERT_TRUE(check.ok()) << check.status();
    // What belongs to no frame, such as an index, is no loss and is said.
    auto said = check->faults;
    said.insert(said.end(), check->remarks.begin(), check->remarks.end());
    EXPECT_THAT(said, Contains(HasSubstr(path))) << byte;
    faults += check->faults.empty() ? 0 : 1;
    WriteWholeFile(path, bytes);
  }
  EXPECT_GT(faults, 30);
  EXPECT_THAT(Faults(folder), IsEmpty());
}

TEST(CheckData, AMissingOrShortSegmentIsFound) {
  const std::string folder = MakeData("check_missing");
  const auto segments = FilesUnder(folder, ".mcap");
  for (const std::string& path : segments) {
    const std::string bytes = ReadWholeFile(path);
    std::filesystem::remove(path);
    EXPECT_THAT(Faults(folder), Contains(HasSubstr("/hall/drive"))) << path;
    WriteWholeFile(path, bytes.substr(0, bytes.size() / 3));
    EXPECT_THAT(Faults(folder), Contains(HasSubstr(path)));
    WriteWholeFile(path, bytes);
  }
  EXPECT_THAT(Faults(folder), IsEmpty());
}

TEST(CheckData, ATailThatACrashHasCutIsARemark) {
  const std::string folder = MakeData("check_tail");
  const std::string next = FilesUnder(folder, ".mcap").back();
  std::string torn = ReadWholeFile(next);
  const std::string path = absl::StrCat(folder, "/sessions/hall/drive/00000000000000000100.mcap");
  WriteWholeFile(path, torn.substr(0, torn.size() / 3));
  const auto check = CheckData(folder, {});
  ASSERT_TRUE(check.ok());
  EXPECT_THAT(check->faults, IsEmpty());
  EXPECT_THAT(check->remarks, ElementsAre(HasSubstr(path)));
}

TEST(CheckData, AFlippedBitOfTheDatabaseIsFoundOrHarmless) {
  const std::string folder = MakeData("check_database");
  // Flushes, so that there are tables.
  { const auto store = Store::Open(folder).value(); }
  const auto tables = FilesUnder(folder, ".sst");
  ASSERT_FALSE(tables.empty());
  for (const std::string& path : tables) {
    const std::string bytes = ReadWholeFile(path);
    Flip(path, bytes.size() / 4);
    const auto check = CheckData(folder, {});
    // It opens and the check names the file, or it does not open.
    if (check.ok()) {
      EXPECT_THAT(check->faults, Contains(HasSubstr(std::filesystem::path(path).filename())));
    } else {
      EXPECT_TRUE(absl::IsDataLoss(check.status())) << check.status();
    }
    WriteWholeFile(path, bytes);
  }
  EXPECT_THAT(Faults(folder), IsEmpty());
}

TEST(CheckData, WhatDoesNotFitTogetherIsNamed) {
  const struct {
    const char* what;
    std::function<void(Batch&)> change;
    const char* says;
  } cases[] = {
      {"entry gone", [](Batch& b) { b.Delete(Family::kJournal, EntryKey("hall", 5)); },
       "entry 5 should stand"},
      {"last entry gone", [](Batch& b) { b.Delete(Family::kJournal, EntryKey("hall", 10)); },
       "ends with entry 9, not with 10"},
      {"entry damaged", [](Batch& b) { b.Put(Family::kJournal, EntryKey("hall", 5), "\1junk"); },
       "entry 5 of site hall"},
      {"time gone",
       [](Batch& b) {
         b.Delete(Family::kJournal, TimeKey("hall", EntryAt(40).evidence.stamp_ns) + Number(5));
       },
       "entry 5 of site hall is not listed by its time"},
      {"time without entry",
       [](Batch& b) { b.Put(Family::kJournal, TimeKey("hall", 7) + Number(99), ""); },
       "entry 99 of site hall is listed by time and is missing"},
      {"tiles of the future",
       [](Batch& b) { b.Put(Family::kState, CheckpointKey("hall"), Number(11)); },
       "the tiles are of entry 11"},
      {"more processed than there is",
       [](Batch& b) { b.Put(Family::kState, ProcessedKey(kDrive), Number(kFrames + 1)); },
       "where 101 were durable"},
      {"more heard than processed",
       [](Batch& b) { b.Put(Family::kState, HeardKey(kDrive), Number(kFrames + 1)); }, "heard 101"},
      {"fewer heard than in the journal",
       [](Batch& b) { b.Put(Family::kState, HeardKey(kDrive), Number(90)); },
       "frame 90 of session drive, of which 90 frames were heard"},
      {"short number", [](Batch& b) { b.Put(Family::kState, HeardKey(kDrive), "12"); },
       "has 2 bytes"},
      {"site gone", [](Batch& b) { b.Delete(Family::kMeta, RecordKey(Table::kSite, "hall")); },
       "belongs to no site"},
      {"session gone",
       [](Batch& b) { b.Delete(Family::kMeta, RecordKey(Table::kSession, "hall/drive")); },
       "of session hall/drive, which is not known"},
      {"a key of no kind",
       [](Batch& b) { b.Put(Family::kState, SiteKey("hall") + "x", Number(1)); },
       "of no kind that is known"},
      {"a record of no table", [](Batch& b) { b.Put(Family::kMeta, "\x09hall", ""); },
       "is of no table"},
      {"a tile without a place",
       [](Batch& b) { b.Put(Family::kTiles, SiteKey("hall") + "12345", "t"); }, "key of 5 bytes"},
      {"a tile of the main map with a band",
       [](Batch& b) {
         b.Put(Family::kTiles,
               SiteKey("hall") +
                   "\x80"
                   "123456",
               "t");
       },
       "key of 7 bytes that is none"},
      {"a tile without a band",
       [](Batch& b) {
         b.Put(Family::kTiles,
               SiteKey("hall") +
                   "\x01"
                   "123456",
               "t");
       },
       "key of 7 bytes that is none"},
  };
  for (const auto& c : cases) {
    SCOPED_TRACE(c.what);
    const std::string folder = MakeData("check_cross");
    Batch batch;
    c.change(batch);
    Change(folder, batch);
    EXPECT_THAT(Faults(folder), Contains(HasSubstr(c.says)));
  }
}

TEST(CheckData, TooManyFaultsAreCounted) {
  const std::string folder = MakeData("check_many");
  Batch batch;
  for (std::uint64_t i = 0; i < 150; ++i) {
    batch.Put(Family::kTiles, SiteKey("hall") + absl::StrCat("tile number ", i), "");
  }
  Change(folder, batch);
  const auto faults = Faults(folder);
  EXPECT_EQ(faults.size(), 101u);
  EXPECT_EQ(faults.back(), "there are 50 more faults");
}

TEST(CheckData, TheCallersLookAtTheirBytes) {
  const std::string folder = MakeData("check_content");
  ContentCheck content;
  const auto refuse = [](const std::string& bytes) { return absl::DataLossError("no " + bytes); };
  content.record = [&](Table, const std::string&, const std::string& bytes) {
    return refuse(bytes);
  };
  content.pose = refuse;
  content.summary = [&](const std::string& site, const std::string& summary) {
    return refuse(site + summary);
  };
  content.tile = [&](const std::string& site, const Tile& tile) {
    return refuse(site + tile.bytes);
  };
  const auto faults = Faults(folder, content);
  EXPECT_THAT(faults, Contains("the record hall: no a site"));
  EXPECT_THAT(faults, Contains("the record hall/drive: no a session"));
  EXPECT_THAT(faults, Contains("a pose of session hall/drive: no pose 20"));
  EXPECT_THAT(faults, Contains("tile 4 5 6 of site hall: no halltile two"));
  EXPECT_THAT(faults, Contains("tile 4 5 6 of band 2 of site hall: no halltile of the hum"));
  EXPECT_THAT(faults, Contains(HasSubstr("of site hall: no hall" + EntryAt(20).summary)));
  EXPECT_EQ(faults.size(), 2u + 10u + 10u + 3u);
}

}  // namespace
}  // namespace soundmap::storage
