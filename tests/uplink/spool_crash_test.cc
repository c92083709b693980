#include <gtest/gtest.h>
#include <signal.h>
#include <sys/wait.h>
#include <unistd.h>

#include <fstream>

#include "tests/uplink/spooled_frames.h"

namespace soundmap::spool {
namespace {

std::filesystem::path Folder() {
  return std::filesystem::path(::testing::TempDir()) /
         ::testing::UnitTest::GetInstance()->current_test_info()->name();
}

// The spool's frames are those of the drive up to where it is to go on; that position.
std::int64_t CheckAndCount(Spool& spool) {
  const std::int64_t position = spool.Begin(RequestFor("d"))->position;
  const auto source = spool.Read("d");
  EXPECT_TRUE(source->Seek(0).ok());
  for (std::int64_t i = 0; i < position; ++i) {
    const auto frame = source->Next();
    EXPECT_TRUE(frame.ok() && *frame && Same(**frame, FrameAt(i))) << i << " of " << position;
    if (!frame.ok() || !*frame || !Same(**frame, FrameAt(i))) return -1;
  }
  EXPECT_FALSE(source->Next()->has_value());
  return position;
}

// As the kernel may leave a file at a power failure: cut anywhere.
TEST(SpoolCrash, ASegmentThatIsCutGoesOnWhereItEnds) {
  const std::filesystem::path folder = Folder();
  std::filesystem::remove_all(folder);
  constexpr int kFrames = 6;
  {
    SpoolOptions options = SmallSegments();
    options.sync_bytes = 1;  // a chunk a frame
    const auto spool = Reopen(folder, options);
    ASSERT_TRUE(spool->Begin(RequestFor("d")).ok());
    const auto source = spool->Read("d");
    ASSERT_TRUE(source->Seek(0).ok());
    for (int i = 0; i < kFrames; ++i) {
      ASSERT_TRUE(spool->Append(FrameAt(i)).ok());
      while (!source->Next()->has_value()) {
      }
    }
  }
  const std::filesystem::path segment = folder / "d" / "00000000000000000000.mcap";
  std::string whole(std::filesystem::file_size(segment), '\0');
  std::ifstream(segment, std::ios::binary).read(whole.data(), static_cast<long>(whole.size()));
  std::int64_t last = 0;
  std::filesystem::create_directories(folder / "x" / "d");
  for (std::size_t cut = 0; cut < whole.size(); cut += 5) {
    std::filesystem::copy(folder / "d" / "session.json", folder / "x" / "d" / "session.json",
                          std::filesystem::copy_options::overwrite_existing);
    for (const auto& entry : std::filesystem::directory_iterator(folder / "x" / "d")) {
      if (entry.path().extension() == ".mcap") std::filesystem::remove(entry.path());
    }
    std::ofstream(folder / "x" / "d" / segment.filename(), std::ios::binary)
        .write(whole.data(), static_cast<long>(cut));
    const auto spool = Reopen(folder / "x", SmallSegments());
    const std::int64_t count = CheckAndCount(*spool);
    ASSERT_GE(count, last) << cut;
    last = count;
    if (cut % 485 == 0) {
      for (std::int64_t i = count; i < 20; ++i) ASSERT_TRUE(spool->Append(FrameAt(i)).ok());
      ASSERT_TRUE(spool->End().ok());
      const auto source = spool->Read("d");
      ASSERT_TRUE(source->Seek(0).ok());
      for (int i = 0; i < 20; ++i) ASSERT_TRUE(Same(**source->Next(), FrameAt(i))) << cut;
    }
  }
  EXPECT_GE(last, kFrames - 1);
  std::filesystem::remove_all(folder);
}

TEST(SpoolCrash, KilledAtRandomMomentsItKeepsWhatItHasDelivered) {
  const std::filesystem::path folder = Folder();
  std::filesystem::remove_all(folder);
  std::mt19937 random(4);
  std::int64_t position = 0;
  for (int run = 0; run < 20; ++run) {
    int delivered[2];
    ASSERT_EQ(pipe(delivered), 0);
    const pid_t agent = fork();
    ASSERT_GE(agent, 0);
    if (agent == 0) {
      const auto spool = Reopen(folder, SmallSegments());
      std::int64_t next = spool->Begin(RequestFor("d"))->position;
      const auto source = spool->Read("d");
      source->Seek(next).IgnoreError();
      std::int64_t seen = next;
      while (true) {
        spool->Append(FrameAt(next++)).IgnoreError();
        const auto frame = source->Next();
        if (!frame.ok() || !*frame) continue;
        if (write(delivered[1], &++seen, sizeof(seen)) != sizeof(seen)) _exit(1);
      }
    }
    close(delivered[1]);
    std::int64_t seen = position;
    const unsigned wait_for = 1 + random() % 300;
    for (unsigned i = 0; i < wait_for; ++i) {
      ASSERT_EQ(read(delivered[0], &seen, sizeof(seen)), static_cast<ssize_t>(sizeof(seen)));
    }
    kill(agent, SIGKILL);
    while (read(delivered[0], &seen, sizeof(seen)) == static_cast<ssize_t>(sizeof(seen))) {
    }
    close(delivered[0]);
    waitpid(agent, nullptr, 0);
    const auto spool = Reopen(folder, SmallSegments());
    position = CheckAndCount(*spool);
    ASSERT_GE(position, seen);
  }
  std::filesystem::remove_all(folder);
}

}  // namespace
}  // namespace soundmap::spool
