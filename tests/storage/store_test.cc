#include "storage/store.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <filesystem>
#include <fstream>

#include "absl/strings/str_cat.h"
#include "storage/frame_sequence.h"
#include "storage/keys.h"
#include "storage/names.h"

namespace soundmap::storage {
namespace {

using ::testing::HasSubstr;

std::unique_ptr<Store> OpenStore(const std::string& folder) {
  auto store = Store::Open(folder);
  EXPECT_TRUE(store.ok()) << store.status();
  return *std::move(store);
}

// Appends frames up to `end`, syncs them and commits their processing with an entry, a pose and a
// state each ten frames.
void Drive(Store* store, const SessionId& id, std::int64_t end) {
  auto log = store->OpenSession(id).value();
  for (std::int64_t offset = log->received(); offset < end; ++offset) {
    ASSERT_TRUE(log->Append(FrameAt(offset)).ok());
  }
  ASSERT_TRUE(log->Sync().ok());
  Commit commit{id.site, id.session, end, end, {}, {}, StateAt(end)};
  for (std::int64_t offset = store->ProcessedOffset(id).value(); offset < end; ++offset) {
    if (offset % 10 != 0) continue;
    commit.journal.push_back(EntryAt(offset));
    commit.trajectory.push_back({offset, absl::StrCat("pose ", offset)});
  }
  const auto committed = store->CommitBatch(commit);
  ASSERT_TRUE(committed.ok()) << committed.status();
}

std::vector<std::int64_t> JournalOffsets(const Store& store, const std::string& site) {
  std::vector<std::int64_t> offsets;
  const absl::Status read =
      store.ReadJournal(site, 1, [&](const JournalRecord& record) -> absl::Status {
        EXPECT_EQ(record.sequence, offsets.size() + 1);
        EXPECT_EQ(record.entry.evidence, EntryAt(record.entry.offset).evidence);
        offsets.push_back(record.entry.offset);
        return absl::OkStatus();
      });
  EXPECT_TRUE(read.ok()) << read;
  return offsets;
}

TEST(Store, ASecondProcessIsRefused) {
  const std::string folder = EmptyFolder("two_stores");
  auto store = OpenStore(folder);
  const auto second = Store::Open(folder);
  EXPECT_TRUE(absl::IsFailedPrecondition(second.status())) << second.status();
  EXPECT_THAT(std::string(second.status().message()), HasSubstr("is in use by another process"));
  EXPECT_THAT(std::string(second.status().message()), HasSubstr(folder));
  store.reset();
  EXPECT_TRUE(Store::Open(folder).ok());
}

TEST(Store, ANewerFormatIsRefused) {
  const std::string folder = EmptyFolder("newer");
  OpenStore(folder).reset();
  const std::string path = folder + "/FORMAT";
  ASSERT_EQ(ReadWholeFile(path), "soundmap data 1\n");
  WriteWholeFile(path, "soundmap data 2\n");
  const auto newer = Store::Open(folder).status();
  EXPECT_TRUE(absl::IsFailedPrecondition(newer)) << newer;
  EXPECT_THAT(std::string(newer.message()), HasSubstr("newer version"));
  for (const char* const damaged : {"", "soundmap data", "soundmap data x\n", "soundmap data 0\n",
                                    "soundmap data 1", "something else\n"}) {
    WriteWholeFile(path, damaged);
    EXPECT_TRUE(absl::IsDataLoss(Store::Open(folder).status())) << damaged;
  }
  WriteWholeFile(path, "soundmap data 1\n");
  EXPECT_TRUE(Store::Open(folder).ok());
}

TEST(Store, AForeignFolderIsLeftAlone) {
  const std::string folder = EmptyFolder("foreign");
  WriteWholeFile(folder + "/holiday.jpg", "x");
  const auto foreign = Store::Open(folder).status();
  EXPECT_TRUE(absl::IsFailedPrecondition(foreign)) << foreign;
  EXPECT_FALSE(std::filesystem::exists(folder + "/db"));
  const auto file = Store::Open(folder + "/holiday.jpg").status();
  EXPECT_TRUE(absl::IsFailedPrecondition(file)) << file;
  EXPECT_TRUE(absl::IsNotFound(Store::Open(folder + "/no/such/place").status()));
  EXPECT_TRUE(absl::IsInvalidArgument(Store::Open("").status()));
}

TEST(Store, NamesFromOutsideAreChecked) {
  const std::string folder = EmptyFolder("names");
  auto store = OpenStore(folder);
  for (const std::string& name :
       {std::string("a"), std::string("0"), std::string("grill-room_2"), std::string(63, 'z')}) {
    EXPECT_TRUE(ValidateName("site", name).ok()) << name;
  }
  for (const std::string& name :
       {std::string(""), std::string(".."), std::string("a/b"), std::string("-a"),
        std::string("_a"), std::string("A"), std::string("a b"), std::string("a.b"),
        std::string("a\0b", 3), std::string("\xc3\xa4"), std::string(64, 'z')}) {
    EXPECT_TRUE(absl::IsInvalidArgument(ValidateName("site", name))) << name;
    EXPECT_TRUE(absl::IsInvalidArgument(store->OpenSession({name, "s"}).status()));
    EXPECT_TRUE(absl::IsInvalidArgument(store->OpenSession({"s", name}).status()));
    EXPECT_TRUE(absl::IsInvalidArgument(store->CommitBatch({name, "s"}).status()));
    EXPECT_TRUE(absl::IsInvalidArgument(store->CommitBatch({"s", name}).status()));
    EXPECT_TRUE(absl::IsInvalidArgument(store->PutCheckpoint(name, {}, 0)));
    EXPECT_TRUE(absl::IsInvalidArgument(store->DeleteSite(name)));
    EXPECT_TRUE(absl::IsInvalidArgument(store->LastSequence(name).status()));
    if (name != "a/b") {
      EXPECT_TRUE(absl::IsInvalidArgument(store->PutRecord(Table::kSite, name, "x")));
      EXPECT_TRUE(
          absl::IsInvalidArgument(store->PutRecord(Table::kSite, absl::StrCat("a/", name), "x")));
    }
  }
  EXPECT_TRUE(store->PutRecord(Table::kBuilding, "a/1/octree", "x").ok());
  EXPECT_TRUE(absl::IsInvalidArgument(store->PutRecord(Table::kSite, "a/b/c/d/e", "x")));
  EXPECT_TRUE(std::filesystem::is_empty(folder + "/sessions"));
}

TEST(Store, RecordsAreListedInOrderByPrefix) {
  const std::string folder = EmptyFolder("records");
  {
    auto store = OpenStore(folder);
    for (const char* const key : {"b/2", "a/1", "a/3", "a-b/1", "ab/1"}) {
      ASSERT_TRUE(store->PutRecord(Table::kSession, key, std::string("of ") + key).ok());
    }
    ASSERT_TRUE(store->PutRecord(Table::kSite, "a", "site").ok());
    ASSERT_TRUE(store->PutRecord(Table::kBuilding, "a/1", std::string(3 << 20, 'b')).ok());
    ASSERT_TRUE(store->PutRecord(Table::kSession, "a/3", "").ok());
  }
  auto store = OpenStore(folder);
  std::vector<std::string> keys;
  const auto records = store->ListRecords(Table::kSession, "a/").value();
  for (const Record& record : records) {
    keys.push_back(record.key);
  }
  EXPECT_THAT(keys, ::testing::ElementsAre("a/1", "a/3"));
  EXPECT_EQ(store->ListRecords(Table::kSession, "").value().size(), 5u);
  EXPECT_EQ(store->ListRecords(Table::kRobot, "").value().size(), 0u);
  EXPECT_EQ(store->GetRecord(Table::kSession, "a/3").value(), "");
  EXPECT_EQ(store->GetRecord(Table::kSession, "a/4").value(), std::nullopt);
  EXPECT_EQ(store->GetRecord(Table::kBuilding, "a/1").value()->size(), 3u << 20);
  ASSERT_TRUE(store->DeleteRecord(Table::kSession, "a/3").ok());
  EXPECT_EQ(store->GetRecord(Table::kSession, "a/3").value(), std::nullopt);
  EXPECT_EQ(store->GetRecord(Table::kSite, "a").value(), "site");
}

TEST(Store, CommitsCountOnce) {
  const std::string folder = EmptyFolder("once");
  auto store = OpenStore(folder);
  const SessionId id{"hall", "drive"};
  const auto early = store->CommitBatch({"hall", "drive", 1, 1, {}, {}, {}});
  EXPECT_TRUE(absl::IsFailedPrecondition(early.status())) << "nothing is durable";
  Drive(store.get(), id, 30);
  EXPECT_EQ(JournalOffsets(*store, "hall"), (std::vector<std::int64_t>{0, 10, 20}));

  const auto refused = [&](const Commit& commit) {
    EXPECT_TRUE(absl::IsFailedPrecondition(store->CommitBatch(commit).status()));
  };
  refused({"hall", "drive", 29, 29, {}, {}, {}});
  refused({"hall", "drive", 31, 31, {}, {}, {}});
  refused({"hall", "drive", 30, 30, {EntryAt(20)}, {}, {}});
  auto log = store->OpenSession(id).value();
  for (std::int64_t offset = 30; offset < 40; ++offset) {
    ASSERT_TRUE(log->Append(FrameAt(offset)).ok());
  }
  refused({"hall", "drive", 40, 40, {}, {}, {}});
  ASSERT_TRUE(log->Sync().ok());
  refused({"hall", "drive", 40, 40, {EntryAt(29)}, {}, {}});
  refused({"hall", "drive", 40, 40, {EntryAt(40)}, {}, {}});
  EXPECT_TRUE(absl::IsInvalidArgument(
      store->CommitBatch({"hall", "drive", 40, 40, {}, {}, StateAt(41)}).status()));
  EXPECT_EQ(store->LastSequence("hall").value(), 3u);
  EXPECT_EQ(store->ProcessedOffset(id).value(), 30);

  EXPECT_EQ(store->CommitBatch({"hall", "drive", 40, 40, {EntryAt(39)}, {}, {}}).value(), 4u);
  ASSERT_TRUE(store->CloseSession(id).ok());
  EXPECT_EQ(store->CommitBatch({"hall", "drive", 40, 40, {}, {}, StateAt(40)}).value(), 4u);
  refused({"hall", "drive", 41, 41, {}, {}, {}});
}

TEST(Store, WhatALostRobotHeardIsCountedLater) {
  auto store = OpenStore(EmptyFolder("later"));
  const SessionId id{"hall", "drive"};
  Drive(store.get(), id, 10);
  auto log = store->OpenSession(id).value();
  for (std::int64_t offset = 10; offset < 50; ++offset) {
    ASSERT_TRUE(log->Append(FrameAt(offset)).ok());
  }
  ASSERT_TRUE(log->Sync().ok());
  const auto refused = [&](const Commit& commit) {
    EXPECT_TRUE(absl::IsFailedPrecondition(store->CommitBatch(commit).status()));
  };
  ASSERT_TRUE(store->CommitBatch({"hall", "drive", 50, 10, {}, {}, {}}).ok());
  EXPECT_EQ(store->ProcessedOffset(id).value(), 50);
  EXPECT_EQ(store->HeardOffset(id).value(), 10);
  refused({"hall", "drive", 50, 9, {}, {}, {}});
  refused({"hall", "drive", 50, 51, {}, {}, {}});
  refused({"hall", "drive", 50, 30, {EntryAt(30)}, {}, {}});
  refused({"hall", "drive", 50, 30, {EntryAt(9)}, {}, {}});
  ASSERT_TRUE(store->CommitBatch({"hall", "drive", 50, 30, {EntryAt(10)}, {}, {}}).ok());
  ASSERT_TRUE(store->CommitBatch({"hall", "drive", 50, 50, {EntryAt(30)}, {}, {}}).ok());
  EXPECT_EQ(JournalOffsets(*store, "hall"), (std::vector<std::int64_t>{0, 10, 30}));
}

TEST(Store, TheJournalIsReadByTimeToo) {
  auto store = OpenStore(EmptyFolder("time"));
  const SessionId id{"hall", "drive"};
  Drive(store.get(), id, 1);
  auto log = store->OpenSession(id).value();
  for (std::int64_t offset = 1; offset < 8; ++offset) {
    ASSERT_TRUE(log->Append(FrameAt(offset)).ok());
  }
  ASSERT_TRUE(log->Sync().ok());
  Commit commit{"hall", "drive", 8, 8, {}, {}, {}};
  // An older recording may follow a newer one, and times may lie before 1970.
  const std::vector<std::int64_t> stamps = {50, -30, 20, 50, 10, 60, -30};
  for (std::size_t i = 0; i < stamps.size(); ++i) {
    JournalEntry entry;
    entry.offset = static_cast<std::int64_t>(i) + 1;
    entry.evidence.stamp_ns = stamps[i];
    commit.journal.push_back(entry);
  }
  ASSERT_TRUE(store->CommitBatch(commit).ok());
  const auto sequences = [&](std::int64_t from_ns, std::int64_t to_ns) {
    std::vector<std::uint64_t> found;
    EXPECT_TRUE(store
                    ->ReadJournalRange("hall", from_ns, to_ns,
                                       [&](const JournalRecord& record) {
                                         found.push_back(record.sequence - 1);
                                         return absl::OkStatus();
                                       })
                    .ok());
    return found;
  };
  using Sequences = std::vector<std::uint64_t>;
  EXPECT_EQ(sequences(-100, 100), (Sequences{2, 7, 5, 3, 1, 4, 6}));
  EXPECT_EQ(sequences(-30, 50), (Sequences{2, 7, 5, 3}));
  EXPECT_EQ(sequences(50, 51), (Sequences{1, 4}));
  EXPECT_EQ(sequences(50, 50), Sequences{});
  EXPECT_EQ(sequences(60, 50), Sequences{});
}

TEST(Store, ACallbackEndsTheReading) {
  auto store = OpenStore(EmptyFolder("callback"));
  Drive(store.get(), {"hall", "drive"}, 50);
  int calls = 0;
  const absl::Status read = store->ReadJournal("hall", 2, [&](const JournalRecord& record) {
    EXPECT_EQ(record.sequence, 2u + static_cast<unsigned>(calls));
    return ++calls == 2 ? absl::AbortedError("enough") : absl::OkStatus();
  });
  EXPECT_EQ(read, absl::AbortedError("enough"));
  EXPECT_EQ(calls, 2);
}

TEST(Store, SitesDoNotSeeEachOtherAndGoAlone) {
  const std::string folder = EmptyFolder("sites");
  const std::vector<std::string> sites = {"hal", "hall", "hall-2", "hall_2", "hall0"};
  {
    auto store = OpenStore(folder);
    for (const std::string& site : sites) {
      Drive(store.get(), {site, "drive"}, 20);
      ASSERT_TRUE(
          store->PutCheckpoint(site, {{{1, 2, 3}, site}, {{65535, 0, 65535}, "far"}}, 1).ok());
      ASSERT_TRUE(store->PutRecord(Table::kSite, site, site).ok());
      ASSERT_TRUE(store->PutRecord(Table::kSession, site + "/drive", site).ok());
    }
    ASSERT_TRUE(store->PutRecord(Table::kRobot, "hall", "a robot of the same name").ok());
    auto log = store->OpenSession({"hall", "drive"}).value();
    ASSERT_TRUE(log->Append(FrameAt(20)).ok());
    ASSERT_TRUE(store->DeleteSite("hall").ok());
    EXPECT_TRUE(absl::IsFailedPrecondition(log->Append(FrameAt(21)).status()));
    EXPECT_TRUE(absl::IsFailedPrecondition(
        store->CommitBatch({"hall", "drive", 20, 20, {}, {}, {}}).status()));
  }
  auto store = OpenStore(folder);
  for (const std::string& site : sites) {
    const bool there = site != "hall";
    EXPECT_EQ(JournalOffsets(*store, site).size(), there ? 2u : 0u) << site;
    EXPECT_EQ(store->ProcessedOffset({site, "drive"}).value(), there ? 20 : 0);
    EXPECT_EQ(store->LatestState({site, "drive"}).value().has_value(), there);
    EXPECT_EQ(store->GetRecord(Table::kSite, site).value().has_value(), there);
    EXPECT_EQ(store->ListRecords(Table::kSession, site + "/").value().size(), there ? 1u : 0u);
    int poses = 0;
    EXPECT_TRUE(store
                    ->ReadTrajectory({site, "drive"}, 0, 1000,
                                     [&](const TrajectoryEntry& entry) {
                                       EXPECT_EQ(entry.pose, absl::StrCat("pose ", entry.time_ns));
                                       ++poses;
                                       return absl::OkStatus();
                                     })
                    .ok());
    EXPECT_EQ(poses, there ? 2 : 0);
    std::vector<std::string> tiles;
    EXPECT_EQ(store
                  ->ReadTiles(site,
                              [&](const Tile& tile) {
                                tiles.push_back(tile.bytes);
                                return absl::OkStatus();
                              })
                  .value(),
              there ? 1u : 0u);
    EXPECT_EQ(tiles, there ? (std::vector<std::string>{site, "far"}) : std::vector<std::string>{});
    EXPECT_EQ(store->OpenSession({site, "drive"}).value()->durable(), there ? 20 : 0);
  }
  EXPECT_EQ(store->GetRecord(Table::kRobot, "hall").value(), "a robot of the same name");
  Drive(store.get(), {"hall", "drive"}, 10);  // a new site of the same name begins at nothing
  EXPECT_EQ(JournalOffsets(*store, "hall"), (std::vector<std::int64_t>{0}));
}

TEST(Store, CheckpointsReplaceAndRemoveTilesAndNeverGoBack) {
  const std::string folder = EmptyFolder("checkpoints");
  auto store = OpenStore(folder);
  Drive(store.get(), {"hall", "drive"}, 50);
  EXPECT_EQ(store->CheckpointSequence("hall").value(), 0u);
  ASSERT_TRUE(store->PutCheckpoint("hall", {{{1, 1, 1}, "a"}, {{1, 1, 2}, "b"}}, 2).ok());
  ASSERT_TRUE(store->PutCheckpoint("hall", {{{1, 1, 1}, ""}, {{0, 9, 0}, "c"}}, 4).ok());
  EXPECT_TRUE(absl::IsFailedPrecondition(store->PutCheckpoint("hall", {{{1, 1, 2}, "x"}}, 3)));
  EXPECT_TRUE(absl::IsFailedPrecondition(store->PutCheckpoint("hall", {{{1, 1, 2}, "x"}}, 6)));
  store.reset();
  store = OpenStore(folder);
  std::vector<std::pair<TileKey, std::string>> tiles;
  const auto sequence = store->ReadTiles("hall", [&](const Tile& tile) {
    tiles.emplace_back(tile.key, tile.bytes);
    return absl::OkStatus();
  });
  EXPECT_EQ(sequence.value(), 4u);
  EXPECT_EQ(store->CheckpointSequence("hall").value(), 4u);
  EXPECT_EQ(tiles,
            (std::vector<std::pair<TileKey, std::string>>{{{0, 9, 0}, "c"}, {{1, 1, 2}, "b"}}));
  EXPECT_EQ(JournalOffsets(*store, "hall").size(), 5u);  // what is behind the checkpoint stays
}

TEST(Store, TilesOfTheMainMapKeepTheKeysThatTheyHadBeforeThereWereBands) {
  using namespace std::string_literals;
  EXPECT_EQ(TileKeyBytes("hall", {0x0102, 0x0304, 0x07ff}), "hall\0\x01\x02\x03\x04\x07\xff"s);
  EXPECT_EQ(TileKeyBytes("hall", {0x0102, 0x0304, 0x07ff, 1}),
            "hall\0\x81\x01\x02\x03\x04\x07\xff"s);
  // Each is read back as what it was, and sorts as it does.
  std::string before;
  TileKey last;
  for (const int band : {0, 1, 2, 8, 127}) {
    for (const TileKey tile : {TileKey{0, 0, 1}, TileKey{0, 7, 0}, TileKey{2047, 2047, 2047}}) {
      TileKey key = tile;
      key.band = static_cast<std::uint8_t>(band);
      const std::string bytes = TileKeyBytes("hall", key);
      EXPECT_EQ(TileKeyFromBytes(bytes.substr(5)), key);
      EXPECT_LT(before, bytes);
      EXPECT_LT(last, key);
      before = bytes;
      last = key;
    }
  }
  EXPECT_LT(before, EndOfPrefix(SiteKey("hall")));
  for (const std::string& none : {""s, "12345"s, "12345678"s,
                                  "\x80"
                                  "123456"s,
                                  "\x01"
                                  "123456"s}) {
    EXPECT_EQ(TileKeyFromBytes(none), std::nullopt) << none;
  }
}

TEST(Store, TilesOfBandsAreApartAndGoWithTheirSite) {
  const std::string folder = EmptyFolder("bands");
  auto store = OpenStore(folder);
  Drive(store.get(), {"hall", "drive"}, 50);
  ASSERT_TRUE(
      store
          ->PutCheckpoint("hall",
                          {{{1, 1, 1, 8}, "hum"}, {{9, 1, 1}, "main"}, {{1, 1, 1, 1}, "hiss"}}, 2)
          .ok());
  ASSERT_TRUE(store->PutCheckpoint("hall", {{{9, 1, 1, 1}, "more"}, {{1, 1, 1, 8}, ""}}, 3).ok());
  EXPECT_TRUE(absl::IsInvalidArgument(store->PutCheckpoint("hall", {{{1, 1, 1, 128}, "x"}}, 4)));
  store.reset();
  store = OpenStore(folder);
  const auto tiles = [&store] {
    std::vector<std::pair<TileKey, std::string>> tiles;
    EXPECT_TRUE(store
                    ->ReadTiles("hall",
                                [&tiles](const Tile& tile) {
                                  tiles.emplace_back(tile.key, tile.bytes);
                                  return absl::OkStatus();
                                })
                    .ok());
    return tiles;
  };
  EXPECT_EQ(tiles(), (std::vector<std::pair<TileKey, std::string>>{
                         {{9, 1, 1}, "main"}, {{1, 1, 1, 1}, "hiss"}, {{9, 1, 1, 1}, "more"}}));
  ASSERT_TRUE(store->DeleteSite("hall").ok());
  EXPECT_TRUE(tiles().empty());
}

TEST(Store, LostFramesOfASessionAreDataLossForItAlone) {
  const std::string folder = EmptyFolder("lost");
  {
    auto store = OpenStore(folder);
    Drive(store.get(), {"hall", "a"}, 20);
    Drive(store.get(), {"hall", "b"}, 20);
  }
  const std::string segment = FilesUnder(folder + "/sessions/hall/a", ".mcap").at(0);
  std::filesystem::resize_file(segment, std::filesystem::file_size(segment) / 2);
  auto store = OpenStore(folder);
  const absl::Status lost = store->OpenSession({"hall", "a"}).status();
  EXPECT_TRUE(absl::IsDataLoss(lost)) << lost;
  EXPECT_THAT(std::string(lost.message()), HasSubstr(segment));
  EXPECT_EQ(store->OpenSession({"hall", "b"}).value()->durable(), 20);
  EXPECT_EQ(JournalOffsets(*store, "hall").size(), 4u);
}

TEST(Store, DroppedFramesGoAndAllElseStays) {
  const std::string folder = EmptyFolder("dropped");
  const SessionId a{"hall", "a"};
  {
    auto store = OpenStore(folder);
    Drive(store.get(), a, 20);
    Drive(store.get(), {"hall", "b"}, 20);
    EXPECT_TRUE(absl::IsFailedPrecondition(store->DropFrames(a))) << "its log is open";
    ASSERT_TRUE(store->CloseSession(a).ok());
    {
      const auto held = store->HoldFrames();
      EXPECT_TRUE(absl::IsFailedPrecondition(store->DropFrames(a))) << "frames are held";
    }
    ASSERT_EQ(store->OpenSession(a).value()->durable(), 20) << "a refusal changes nothing";
    ASSERT_TRUE(store->CloseSession(a).ok());
    ASSERT_TRUE(store->LatestState(a).value().has_value());
    ASSERT_TRUE(store->DropState(a).ok());
    EXPECT_FALSE(store->LatestState(a).value().has_value());
    ASSERT_TRUE(store->DropFrames(a).ok());
    ASSERT_TRUE(store->DropFrames(a).ok()) << "after a crash in between it is called again";
  }
  EXPECT_FALSE(std::filesystem::exists(folder + "/sessions/hall/a"));
  auto store = OpenStore(folder);
  const absl::Status gone = store->OpenSession(a).status();
  EXPECT_TRUE(absl::IsFailedPrecondition(gone)) << gone;
  EXPECT_THAT(std::string(gone.message()), HasSubstr("frames of session a of site hall"));
  EXPECT_EQ(store->OpenSession({"hall", "b"}).value()->durable(), 20);
  EXPECT_EQ(JournalOffsets(*store, "hall").size(), 4u);
  EXPECT_EQ(store->ProcessedOffset(a).value(), 20);
}

TEST(Store, DamageInTheDatabaseIsDataLossAndNeverOtherData) {
  const std::string folder = EmptyFolder("damaged_db");
  {
    auto store = OpenStore(folder);
    Drive(store.get(), {"hall", "drive"}, 400);
    ASSERT_TRUE(store->PutRecord(Table::kSite, "hall", "the hall").ok());
  }
  OpenStore(folder).reset();  // what the log held is now in tables
  int losses = 0;
  for (const std::string& path : FilesUnder(folder + "/db", ".sst")) {
    const std::string whole = ReadWholeFile(path);
    for (std::size_t i = 0; i < 12; ++i) {
      const std::size_t byte = (2 * i + 1) * whole.size() / 24;
      std::string flipped = whole;
      flipped[byte] = static_cast<char>(flipped[byte] ^ 0x10);
      WriteWholeFile(path, flipped);
      auto store = Store::Open(folder);
      absl::Status found = store.status();
      if (store.ok()) {
        std::int64_t offset = 0;
        found = (*store)->ReadJournal("hall", 1, [&](const JournalRecord& record) {
          EXPECT_EQ(record.entry.offset, offset);
          EXPECT_EQ(record.entry.evidence, EntryAt(offset).evidence);
          offset += 10;
          return absl::OkStatus();
        });
        EXPECT_TRUE(offset == 400 || !found.ok());
        const auto record = (*store)->GetRecord(Table::kSite, "hall");
        EXPECT_TRUE(!record.ok() || *record == "the hall");
        found.Update(record.status());
      }
      if (!found.ok()) {
        ++losses;
        EXPECT_TRUE(absl::IsDataLoss(found)) << found;
        EXPECT_THAT(std::string(found.message()), HasSubstr(folder));
      }
    }
    WriteWholeFile(path, whole);
  }
  EXPECT_GT(losses, 10);
}

}  // namespace
}  // namespace soundmap::storage
