#include <gtest/gtest.h>
#include <signal.h>
#include <sys/wait.h>
#include <unistd.h>

#include <atomic>
#include <random>

#include "storage/frame_sequence.h"
#include "storage/store.h"
#include "storage/synced_files.h"

namespace soundmap::storage {
namespace {

struct Told {
  std::int64_t durable = 0;
  std::int64_t processed = 0;
  std::uint64_t records = 0;
};

// Starts the writer, kills it after `numbers` numbers and then `spins` turns of a loop, and takes
// in all that it had told. What it synced goes to `table`, if that is a path.
void RunAndKill(const std::string& folder, const std::string& table, int numbers, int spins,
                Told* told) {
  int ends[2];
  ASSERT_EQ(::pipe(ends), 0);
  const pid_t child = ::fork();
  ASSERT_GE(child, 0);
  if (child == 0) {
    ::dup2(ends[1], STDOUT_FILENO);
    ::close(ends[0]);
    ::close(ends[1]);
    if (!table.empty()) ::setenv("SOUNDMAP_SYNCED_FILES", table.c_str(), /*overwrite=*/1);
    ::execl(SOUNDMAP_BIN_DIR "/storage_crash_writer", "storage_crash_writer", folder.c_str(),
            static_cast<char*>(nullptr));
    ::_exit(127);
  }
  ::close(ends[1]);
  std::uint64_t number = 0;
  for (int count = 0; ::read(ends[0], &number, sizeof(number)) == sizeof(number); ++count) {
    if ((number >> 63) != 0) {
      told->processed = static_cast<std::int64_t>(number & ~(std::uint64_t{1} << 63));
    } else if ((number >> 62) != 0) {
      told->records = number & ~(std::uint64_t{1} << 62);
    } else {
      told->durable = static_cast<std::int64_t>(number);
    }
    if (count != numbers) continue;
    std::atomic<int> spin = 0;
    while (spin.fetch_add(1) < spins) {
    }
    ::kill(child, SIGKILL);
  }
  ::close(ends[0]);
  int status = 0;
  ASSERT_EQ(::waitpid(child, &status, 0), child);
  ASSERT_TRUE(WIFSIGNALED(status)) << "the writer ended by itself with " << status;
}

// Checks what is there after a crash; `power_failed`: what was not synced is gone.
void ExpectWhatWasTold(const std::string& folder, const Told& told, bool power_failed) {
  auto store = Store::Open(folder);
  ASSERT_TRUE(store.ok()) << store.status();
  const SessionId id{"hall", "drive"};
  auto log = (*store)->OpenSession(id);
  ASSERT_TRUE(log.ok()) << log.status();
  const std::int64_t durable = (*log)->durable();
  EXPECT_GE(durable, told.durable);
  std::int64_t offset = 0;
  auto reader = (*log)->Read(0).value();
  while (true) {
    const auto frame = reader->Next();
    ASSERT_TRUE(frame.ok()) << frame.status();
    if (!frame->has_value()) break;
    ASSERT_EQ((*frame)->data, FrameAt(offset).data) << offset;
    ASSERT_EQ((*frame)->topic, FrameAt(offset).topic);
    ++offset;
  }
  EXPECT_EQ(offset, durable);

  // A killed process has lost no write that returned. The commit is whole, also where it is made
  // again because the disk did not have it yet.
  const std::int64_t processed = (*store)->ProcessedOffset(id).value();
  if (!power_failed) {
    EXPECT_GE(processed, told.processed);
  }
  EXPECT_LE(processed, durable);
  std::int64_t next = 0;
  const absl::Status read = (*store)->ReadJournal("hall", 1, [&](const JournalRecord& record) {
    EXPECT_EQ(record.entry.offset, next);
    EXPECT_EQ(record.entry.evidence, EntryAt(next).evidence);
    next += 3;
    return absl::OkStatus();
  });
  EXPECT_TRUE(read.ok()) << read;
  EXPECT_EQ(next, (processed + 2) / 3 * 3);
  if (processed > 0) {
    EXPECT_EQ((*store)->LatestState(id).value()->offset, processed);
  }
  EXPECT_GE((*store)->ListRecords(Table::kServer, "").value().size(), told.records);
}

TEST(Crash, WhatWasAcknowledgedSurvivesKill) {
  const std::string folder = EmptyFolder("crash");
  std::mt19937 random(23);
  Told told;
  for (int kill = 0; kill < 20; ++kill) {
    const int spins = static_cast<int>(random() % 2'000'000);
    RunAndKill(folder, "", static_cast<int>(random() % 60), spins, &told);
    if (HasFatalFailure()) return;
    ExpectWhatWasTold(folder, told, /*power_failed=*/false);
    if (HasFatalFailure()) return;
  }
  EXPECT_GT(told.durable, 500);
  EXPECT_GT(told.records, 20u);
}

TEST(Crash, WhatWasDurableSurvivesAPowerFailure) {
  const std::string folder = EmptyFolder("power_failure");
  const std::string table = folder + ".synced";
  std::mt19937 random(24);
  Told told;
  std::int64_t lost = 0;
  for (int kill = 0; kill < 20; ++kill) {
    const SyncedFiles synced(table, folder);
    const int spins = static_cast<int>(random() % 2'000'000);
    RunAndKill(folder, table, static_cast<int>(random() % 60), spins, &told);
    if (HasFatalFailure()) return;
    lost += synced.Drop(folder);
    ExpectWhatWasTold(folder, told, /*power_failed=*/true);
    if (HasFatalFailure()) return;
  }
  EXPECT_GT(told.durable, 500);
  EXPECT_GT(told.records, 20u);
  EXPECT_GT(lost, 10'000);
}

}  // namespace
}  // namespace soundmap::storage
