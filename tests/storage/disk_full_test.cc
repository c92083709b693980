#include <gtest/gtest.h>
#include <sys/mount.h>

#include <filesystem>
#include <fstream>
#include <random>

#include "absl/strings/str_cat.h"
#include "storage/frame_sequence.h"
#include "storage/store.h"

namespace soundmap::storage {
namespace {

// A file system of its own, 160 MiB small. The parameter: how much of it is kept free.
class DiskFull : public ::testing::TestWithParam<std::int64_t> {
 protected:
  void SetUp() override {
    folder_ = EmptyFolder("full");
    options_.session_log.min_free_bytes = GetParam();
    if (::mount("none", folder_.c_str(), "tmpfs", 0, "size=160m") != 0) {
      folder_.clear();
      GTEST_SKIP() << "a small file system cannot be mounted without privileges";
    }
  }
  void TearDown() override {
    if (!folder_.empty()) ::umount2(folder_.c_str(), MNT_DETACH);
  }

  std::string filler() const { return folder_ + "/filler"; }

  // Takes all the space there is.
  void Fill() const {
    std::ofstream file(filler(), std::ios::binary);
    for (int bytes : {1 << 20, 4096, 1}) {
      const std::string zeros(static_cast<std::size_t>(bytes), '\0');
      while (file.write(zeros.data(), bytes).flush()) {
      }
      file.clear();
    }
  }
  void Free() const { std::remove(filler().c_str()); }

  std::string folder_;
  StoreOptions options_;
};

INSTANTIATE_TEST_SUITE_P(KeptFree, DiskFull,
                         ::testing::Values(0, SessionLogOptions{}.min_free_bytes));

void ExpectFrames(const SessionLog& log, std::int64_t count) {
  EXPECT_EQ(log.durable(), count);
  auto reader = log.Read(0).value();
  std::int64_t offset = 0;
  for (auto frame = reader->Next().value(); frame; frame = reader->Next().value(), ++offset) {
    ASSERT_EQ(frame->data, FrameAt(offset).data);
  }
  EXPECT_EQ(offset, count);
}

TEST_P(DiskFull, StopsTheLogAndPasses) {
  const std::string folder = folder_ + "/log";
  auto log = SessionLog::Open(folder, options_.session_log).value();
  const auto append = [&log](std::int64_t end) {
    while (log->received() < end) ASSERT_TRUE(log->Append(FrameAt(log->received())).ok());
  };
  append(100);
  ASSERT_EQ(log->Sync().value(), 100);
  for (std::int64_t durable = 100; durable < 700; durable += 200) {
    append(durable + 200);
    Fill();
    for (int attempt = 0; attempt < 3; ++attempt) {
      const auto full = log->Sync();
      ASSERT_TRUE(absl::IsResourceExhausted(full.status())) << full.status();
      EXPECT_NE(full.status().message().find(folder), absl::string_view::npos);
    }
    EXPECT_TRUE(absl::IsResourceExhausted(log->Append(FrameAt(durable + 200)).status()));
    EXPECT_EQ(log->received(), durable + 200);
    ExpectFrames(*log, durable);
    Free();
    ASSERT_EQ(log->Sync().value(), durable + 200);
    ExpectFrames(*log, durable + 200);
  }
  log.reset();
  ExpectFrames(*SessionLog::Open(folder, options_.session_log, 700).value(), 700);
}

// The space ends at once, or while the database writes its tables too.
TEST_P(DiskFull, StopsTheDatabaseAndPasses) {
  const SessionId id{"hall", "drive"};
  auto store = Store::Open(folder_ + "/data", options_).value();
  auto log = store->OpenSession(id).value();
  for (std::int64_t offset = 0; offset < 100; ++offset) {
    ASSERT_TRUE(log->Append(FrameAt(offset)).ok());
  }
  ASSERT_EQ(log->Sync().value(), 100);
  Commit commit{"hall", "drive", 100, 100, {EntryAt(3)}, {}, StateAt(100)};
  ASSERT_TRUE(store->CommitBatch(commit).ok());
  ASSERT_TRUE(store->PutRecord(Table::kSite, "hall", "before").ok());

  std::mt19937_64 random(1);
  std::string noise(200'000, '\0');
  for (char& byte : noise) byte = static_cast<char>(random());
  int round = 0;
  for (const std::size_t left_bytes : {0u, 20u << 20, 3u << 20}) {
    Fill();
    std::filesystem::resize_file(filler(), std::filesystem::file_size(filler()) - left_bytes);
    absl::Status put;
    for (int record = 0; record < 1000 && put.ok(); ++record) {
      put = store->PutRecord(Table::kServer, std::to_string(record), noise);
    }
    EXPECT_TRUE(absl::IsResourceExhausted(put)) << put;
    EXPECT_EQ(store->GetRecord(Table::kSite, "hall").value(), "before");
    EXPECT_EQ(store->ProcessedOffset(id).value(), 100);

    Free();
    const auto after = store->PutRecord(Table::kRobot, absl::StrCat("r", ++round), "after");
    ASSERT_TRUE(after.ok()) << after;
    const auto records = store->ListRecords(Table::kServer, "").value();
    for (const Record& record : records) {
      ASSERT_EQ(record.bytes, noise);
      ASSERT_TRUE(store->DeleteRecord(Table::kServer, record.key).ok());
    }
  }
  log.reset();
  store.reset();

  auto again = Store::Open(folder_ + "/data", options_);
  ASSERT_TRUE(again.ok()) << again.status();
  ExpectFrames(*(*again)->OpenSession(id).value(), 100);
  EXPECT_EQ((*again)->GetRecord(Table::kSite, "hall").value(), "before");
  EXPECT_EQ((*again)->ListRecords(Table::kRobot, "").value().size(), 3u);
  EXPECT_EQ((*again)->LastSequence("hall").value(), 1u);
  EXPECT_EQ((*again)->LatestState(id).value()->offset, 100);
}

// Killed while the disk was full: the copy is what the next start finds.
TEST_P(DiskFull, LeavesADurablePrefixBehind) {
  const std::string folder = folder_ + "/log";
  auto log = SessionLog::Open(folder, options_.session_log).value();
  for (std::int64_t offset = 0; offset < 50; ++offset) {
    ASSERT_TRUE(log->Append(FrameAt(offset)).ok());
  }
  ASSERT_TRUE(log->Sync().ok());
  for (std::int64_t offset = 50; offset < 20'000; ++offset) {
    ASSERT_TRUE(log->Append(FrameAt(offset)).ok());
  }
  Fill();
  ASSERT_TRUE(absl::IsResourceExhausted(log->Sync().status()));
  const std::string copy = EmptyFolder("full_copy");
  for (const std::string& path : FilesUnder(folder, ".mcap")) {
    WriteWholeFile(copy + path.substr(path.rfind('/')), ReadWholeFile(path));
  }
  Free();
  auto recovered = SessionLog::Open(copy, {}, /*known_durable=*/50);
  ASSERT_TRUE(recovered.ok()) << recovered.status();
  ExpectFrames(**recovered, (*recovered)->durable());
  ASSERT_EQ(log->Sync().value(), 20'000);
}

TEST_P(DiskFull, DeletingIsStillPossibleWhenLittleIsLeft) {
  if (GetParam() == 0) GTEST_SKIP() << "nothing is kept free";
  auto store = Store::Open(folder_ + "/data", options_).value();
  auto log = store->OpenSession({"hall", "drive"}).value();
  ASSERT_TRUE(log->Append(FrameAt(0)).ok());
  ASSERT_TRUE(log->Sync().ok());
  ASSERT_TRUE(store->PutRecord(Table::kSite, "hall", "x").ok());
  ASSERT_TRUE(log->Append(FrameAt(1)).ok());
  {
    std::ofstream file(filler(), std::ios::binary);
    file << std::string(90 << 20, '\0');
  }
  EXPECT_TRUE(absl::IsResourceExhausted(store->PutRecord(Table::kSite, "other", "x")));
  EXPECT_TRUE(absl::IsResourceExhausted(log->Sync().status()));
  EXPECT_EQ(log->durable(), 1);
  EXPECT_TRUE(store->DeleteRecord(Table::kSite, "hall").ok());
  EXPECT_TRUE(store->DeleteSite("hall").ok());
}

}  // namespace
}  // namespace soundmap::storage
