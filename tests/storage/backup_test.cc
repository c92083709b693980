#include "storage/backup.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <atomic>
#include <filesystem>
#include <thread>

#include "absl/strings/str_cat.h"
#include "absl/strings/str_format.h"
#include "storage/check.h"
#include "storage/crc32c.h"
#include "storage/frame_sequence.h"

namespace soundmap::storage {
namespace {

using ::testing::HasSubstr;
using ::testing::IsEmpty;

const SessionId kDrive{"hall", "drive"};

bool GoOn(double) { return true; }

void Begin(Store& store) {
  ASSERT_TRUE(store.PutRecord(Table::kSite, "hall", "a site").ok());
  ASSERT_TRUE(store.PutRecord(Table::kSession, "hall/drive", "a session").ok());
}

// Appends and processes ten frames.
void Drive(Store& store) {
  auto log = store.OpenSession(kDrive).value();
  const std::int64_t begin = log->received();
  for (std::int64_t offset = begin; offset < begin + 10; ++offset) {
    ASSERT_TRUE(log->Append(FrameAt(offset)).ok());
  }
  ASSERT_TRUE(log->Sync().ok());
  const auto committed = store.CommitBatch(
      {"hall", "drive", begin + 10, begin + 10, {EntryAt(begin)}, {}, StateAt(begin + 10)});
  ASSERT_TRUE(committed.ok()) << committed.status();
}

// What a backup holds must be what the store held at some moment: every frame and entry up to
// there.
std::int64_t ProcessedIn(const std::string& folder) {
  const auto check = CheckData(folder, {});
  EXPECT_TRUE(check.ok()) << check.status();
  if (!check.ok()) return -1;
  EXPECT_THAT(check->faults, IsEmpty());
  const auto store = Store::Open(folder).value();
  auto log = store->OpenSession(kDrive).value();
  const std::int64_t processed = store->ProcessedOffset(kDrive).value();
  EXPECT_GE(log->durable(), processed);
  auto reader = log->Read(0).value();
  for (std::int64_t offset = 0; offset < processed; ++offset) {
    const auto frame = reader->Next();
    EXPECT_TRUE(frame.ok() && frame->has_value());
    EXPECT_EQ((*frame)->data, FrameAt(offset).data);
  }
  std::int64_t entries = 0;
  EXPECT_TRUE(store
                  ->ReadJournal("hall", 1,
                                [&](const JournalRecord& record) {
                                  EXPECT_EQ(record.entry.evidence,
                                            EntryAt(10 * entries++).evidence);
                                  return absl::OkStatus();
                                })
                  .ok());
  EXPECT_EQ(10 * entries, processed);
  return processed;
}

TEST(Backup, IsTheStoreOfItsMoment) {
  const std::string data = EmptyFolder("backup_data");
  const std::string folder = EmptyFolder("backup_to");
  StoreOptions options;
  options.session_log.segment_bytes = 4 << 10;
  auto store = Store::Open(data, options).value();
  Begin(*store);
  for (int i = 0; i < 10; ++i) Drive(*store);
  const std::vector<Tile> tiles = {{{1, 2, 3}, "main"}, {{1, 2, 3, 1}, "hiss"}};
  ASSERT_TRUE(store->PutCheckpoint("hall", tiles, 10, "registers").ok());
  double last_share = -1.0;
  const auto size = BackUp(*store, folder + "/one", [&](double share) {
    EXPECT_GE(share, last_share);
    last_share = share;
    return share <= 1.0;
  });
  ASSERT_TRUE(size.ok()) << size.status();
  EXPECT_GT(size->files, 3);
  Drive(*store);  // the store goes on

  const auto restored = Restore(folder + "/one", folder + "/restored", GoOn);
  ASSERT_TRUE(restored.ok()) << restored.status();
  EXPECT_EQ(restored->files, size->files);
  EXPECT_EQ(restored->bytes, size->bytes);
  EXPECT_FALSE(std::filesystem::exists(folder + "/restored/MANIFEST"));
  EXPECT_EQ(ProcessedIn(folder + "/restored"), 100);
  store = Store::Open(folder + "/restored").value();
  std::size_t next = 0;
  EXPECT_EQ(store
                ->ReadTiles("hall",
                            [&](const Tile& tile) {
                              EXPECT_LT(next, tiles.size());
                              EXPECT_EQ(tile.key, tiles[next].key);
                              EXPECT_EQ(tile.bytes, tiles[next++].bytes);
                              return absl::OkStatus();
                            })
                .value(),
            10u);
  EXPECT_EQ(next, tiles.size());
  store.reset();
  EXPECT_EQ(ProcessedIn(data), 110);
}

TEST(Backup, WhileRobotsStream) {
  const std::string data = EmptyFolder("backup_busy");
  const std::string folder = EmptyFolder("backup_busy_to");
  auto store = Store::Open(data).value();
  Begin(*store);
  Drive(*store);
  std::atomic<bool> stop = false;
  std::atomic<int> driven = 1;
  std::thread robot([&] {
    while (!stop && !::testing::Test::HasFatalFailure()) {
      Drive(*store);
      ++driven;
    }
  });
  for (int i = 0; i < 5; ++i) {
    const int before = driven;
    const std::string name = absl::StrCat(folder, "/", i);
    const auto size = BackUp(*store, name, GoOn);
    EXPECT_TRUE(size.ok()) << size.status();
    const int after = driven + 1;
    const std::int64_t processed = ProcessedIn(name);
    EXPECT_GE(processed, 10 * before);
    EXPECT_LE(processed, 10 * after);
  }
  stop = true;
  robot.join();
}

TEST(Backup, AppearsAsAWholeOrNotAtAll) {
  const std::string data = EmptyFolder("backup_whole");
  const std::string folder = EmptyFolder("backup_whole_to") + "/copy";
  auto store = Store::Open(data).value();
  Begin(*store);
  Drive(*store);
  EXPECT_TRUE(absl::IsCancelled(BackUp(*store, folder, [](double) { return false; }).status()));
  EXPECT_FALSE(std::filesystem::exists(folder));
  EXPECT_FALSE(std::filesystem::exists(folder + ".part"));
  // What a crash has left there is in nobody's way.
  std::filesystem::create_directories(folder + ".part/db");
  ASSERT_TRUE(BackUp(*store, folder, GoOn).ok());
  EXPECT_FALSE(std::filesystem::exists(folder + ".part"));
  EXPECT_TRUE(absl::IsAlreadyExists(BackUp(*store, folder, GoOn).status()));
  EXPECT_TRUE(absl::IsNotFound(BackUp(*store, "/no/such/folder", GoOn).status()));
}

TEST(Restore, NamesWhatIsNotAsItWas) {
  const std::string data = EmptyFolder("restore_data");
  const std::string folder = EmptyFolder("restore_from");
  auto store = Store::Open(data).value();
  Begin(*store);
  Drive(*store);
  const std::string backup = folder + "/copy";
  ASSERT_TRUE(BackUp(*store, backup, GoOn).ok());
  const std::string target = folder + "/restored";
  for (const std::string& path : FilesUnder(backup, "")) {
    if (std::filesystem::is_directory(path)) continue;
    const std::string name = std::filesystem::path(path).filename();
    const std::string bytes = ReadWholeFile(path);
    if (bytes.empty()) continue;
    for (const std::string& damaged :
         {bytes.substr(0, bytes.size() - 1), bytes + "x",
          bytes.substr(0, bytes.size() / 2) + static_cast<char>(bytes[bytes.size() / 2] ^ 1) +
              bytes.substr(bytes.size() / 2 + 1)}) {
      WriteWholeFile(path, damaged);
      const auto restored = Restore(backup, target, GoOn);
      EXPECT_FALSE(restored.ok()) << path;
      EXPECT_THAT(std::string(restored.status().message()), HasSubstr(backup));
      EXPECT_FALSE(std::filesystem::exists(target));
    }
    std::filesystem::remove(path);
    EXPECT_FALSE(Restore(backup, target, GoOn).ok()) << path;
    WriteWholeFile(path, bytes);
  }
  EXPECT_TRUE(absl::IsAlreadyExists(Restore(backup, folder, GoOn).status()));
  EXPECT_TRUE(absl::IsNotFound(Restore(folder, target, GoOn).status()));
  ASSERT_TRUE(Restore(backup, target, GoOn).ok());
  EXPECT_EQ(ProcessedIn(target), 10);
}

// A manifest whose checksum is right may still not name files beside the backup.
TEST(Restore, TakesNothingFromElsewhere) {
  const std::string data = EmptyFolder("restore_elsewhere");
  const std::string folder = EmptyFolder("restore_elsewhere_from");
  auto store = Store::Open(data).value();
  Begin(*store);
  Drive(*store);
  const std::string backup = folder + "/copy";
  ASSERT_TRUE(BackUp(*store, backup, GoOn).ok());
  std::filesystem::create_directories(folder + "/deep");
  WriteWholeFile(folder + "/outside", "x");
  for (const std::string& path : {std::string("../outside"), std::string("db/../../outside"),
                                  std::filesystem::absolute(folder + "/outside").string()}) {
    const std::string line = absl::StrFormat("%08x 1 %s\n", Crc32c("x"), path);
    WriteWholeFile(backup + "/MANIFEST", line + absl::StrFormat("%08x\n", Crc32c(line)));
    const auto restored = Restore(backup, folder + "/deep/restored", GoOn);
    EXPECT_TRUE(absl::IsDataLoss(restored.status())) << path;
    EXPECT_FALSE(std::filesystem::exists(folder + "/deep/outside"));
  }
}

TEST(Restore, LeavesNothingWhenItIsCancelled) {
  const std::string data = EmptyFolder("restore_cancelled");
  const std::string folder = EmptyFolder("restore_cancelled_from");
  auto store = Store::Open(data).value();
  Begin(*store);
  Drive(*store);
  ASSERT_TRUE(BackUp(*store, folder + "/copy", GoOn).ok());
  int calls = 0;
  const auto restored =
      Restore(folder + "/copy", folder + "/restored", [&](double) { return ++calls < 3; });
  EXPECT_TRUE(absl::IsCancelled(restored.status()));
  EXPECT_FALSE(std::filesystem::exists(folder + "/restored"));
  EXPECT_FALSE(std::filesystem::exists(folder + "/restored.part"));
}

}  // namespace
}  // namespace soundmap::storage
