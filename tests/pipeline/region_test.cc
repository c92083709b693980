#include "pipeline/region.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <cstdlib>
#include <filesystem>
#include <random>

#include "pipeline/archive.h"
#include "pipeline/serialization.h"

namespace soundmap::pipeline {
namespace {

constexpr char kSite[] = "hall";
constexpr char kSession[] = "drive";
constexpr int kScans = 400;

// A ceiling with two sources, one of which stops in the middle.
std::vector<sound_map::EvidenceScan> Scans() {
  std::mt19937 random(5);
  std::normal_distribution<double> miss_m(0.0, 0.06);
  std::vector<sound_map::EvidenceScan> scans(kScans);
  for (int k = 0; k < kScans; ++k) {
    scans[k].stamp_ns = 1'700'000'000'000'000'000 + 125'000'000LL * k;
    std::vector<Eigen::Vector2d> peaks = {{0.8 + miss_m(random), 0.9 + miss_m(random)}};
    if (k < kScans / 2) peaks.emplace_back(2.2 + miss_m(random), 1.1 + miss_m(random));
    for (double x = 0.025; x < 3.0; x += 0.05) {
      for (double y = 0.025; y < 2.0; y += 0.05) {
        float likelihood = 0.4f;
        for (const Eigen::Vector2d& peak : peaks) {
          if ((Eigen::Vector2d(x, y) - peak).norm() < 0.1) likelihood = 0.9f;
        }
        scans[k].end_points.push_back({*geometry::KeyFromPoint({x, y, 2.7}, 0.05), likelihood});
      }
    }
  }
  return scans;
}

class RegionTest : public ::testing::Test {
 protected:
  void SetUp() override {
    std::filesystem::remove_all(folder_);
    Open();
    auto log = store_->OpenSession({kSite, kSession}).value();
    for (int k = 0; k < kScans; ++k) {
      recording::Message frame;
      frame.topic = "/odom";
      frame.schema = "foxglove.Odometry";
      ASSERT_TRUE(log->Append(std::move(frame)).ok());
    }
    ASSERT_TRUE(log->Sync().ok());
  }
  void TearDown() override {
    Close();
    std::filesystem::remove_all(folder_);
  }
  void Open() {
    store_ = storage::Store::Open(folder_.string()).value();
    region_ = Region::Open(kSite, store_.get(), sound_map::DefaultConfig()).value();
  }
  void Close() {
    region_.reset();
    store_.reset();
  }
  void Commit(int first, int end) {
    storage::Commit commit;
    commit.site = kSite;
    commit.session = kSession;
    commit.processed_offset = commit.heard_offset = end;
    for (int k = first; k < end; ++k) {
      AudioScanInfo scan;
      scan.robot = "r1";
      // Up and down: what has stopped is listened to from where it was heard.
      scan.pose.map_from_base = {0.03 * std::abs(k % 100 - 50), 1.0, 0.0};
      commit.journal.push_back({k, EncodeAudioScan(scan), scans_[k]});
    }
    StageClock clock(nullptr);
    clock.Start();
    ASSERT_TRUE(region_->Commit(commit, clock).ok());
  }
  std::vector<sound_map::RegisteredSource> Sources() {
    region_->FindSources();
    EXPECT_EQ(region_->sources()->revision, region_->snapshot()->revision());
    return region_->sources()->sources;
  }

  const std::filesystem::path folder_ =
      std::filesystem::path(::testing::TempDir()) /
      ::testing::UnitTest::GetInstance()->current_test_info()->name();
  const std::vector<sound_map::EvidenceScan> scans_ = Scans();
  std::unique_ptr<storage::Store> store_;
  std::unique_ptr<Region> region_;
};

// The undisturbed run, in commits of another size, and asked at other times.
TEST_F(RegionTest, SourcesAreAFunctionOfTheJournalWhateverTheRestarts) {
  Commit(0, kScans);
  const auto undisturbed = Sources();
  ASSERT_EQ(undisturbed.size(), 2u);
  EXPECT_EQ(undisturbed[0].heard.size(), 1u);

  TearDown();
  SetUp();
  int next = 0;
  for (const int until : {7, 33, 150, 151, 160, 299, 395, kScans}) {
    for (; next < until; next += std::min(5, until - next)) {
      Commit(next, std::min(next + 5, until));
      if (next % 3 == 0) Sources();
      if (next % 7 == 0) region_->PublishSourceChanges();
    }
    if (until % 2 == 1) {
      ASSERT_TRUE(region_->Checkpoint().ok());
    }
    Close();
    Open();
  }
  EXPECT_EQ(Sources(), undisturbed);
  EXPECT_EQ(std::count_if(undisturbed.begin(), undisturbed.end(),
                          [](const sound_map::RegisteredSource& source) {
                            return source.state == sound_map::SourceState::kSilent;
                          }),
            1);
}

// A data folder of a version that had tiles alone.
TEST_F(RegionTest, WithoutARegisterItIsMadeFromTheJournal) {
  Commit(0, kScans);
  const auto undisturbed = Sources();
  ASSERT_TRUE(region_->Checkpoint().ok());
  ASSERT_TRUE(store_->PutCheckpoint(kSite, {}, kScans).ok());
  ASSERT_EQ(store_->ReadSourceRegister(kSite).value(), "");
  Close();
  Open();
  EXPECT_EQ(Sources(), undisturbed);
  EXPECT_EQ(region_->snapshot()->revision(), static_cast<std::uint64_t>(kScans));
  // And of a later version.
  ASSERT_TRUE(store_->PutCheckpoint(kSite, {}, kScans, "\x07\x00\x00\x00 later").ok());
  Close();
  Open();
  EXPECT_EQ(Sources(), undisturbed);
}

TEST(Archive, ReadsEntriesFromBeforeLevelsWereMeasured) {
  AudioScanInfo scan;
  scan.robot = "r1";
  scan.noise_floor = 1.5;
  scan.peaks = {{Eigen::Vector3d::UnitY(), 7.0}};
  scan.end_points = 12;
  scan.heard = {{Eigen::Vector3d(1.0, 2.0, 3.0), {0.5f, 0.25f}}};
  const auto whole = DecodeAudioScan(EncodeAudioScan(scan));
  ASSERT_TRUE(whole.ok()) << whole.status();
  EXPECT_EQ(whole->heard, scan.heard);
  const auto older = DecodeAudioScan(
      ToBytes(scan.robot, scan.pose, scan.noise_floor, scan.peaks, scan.end_points));
  ASSERT_TRUE(older.ok()) << older.status();
  EXPECT_EQ(older->robot, "r1");
  EXPECT_EQ(older->end_points, 12);
  EXPECT_TRUE(older->heard.empty());
  EXPECT_EQ(DecodeAudioScan("r1").status().code(), absl::StatusCode::kDataLoss);
}

TEST_F(RegionTest, EventsDoNotDependOnCommitsOrQuestions) {
  const auto events_of = [this](int commit_scans, bool ask) {
    for (int k = 0; k < kScans; k += commit_scans) {
      Commit(k, std::min(k + commit_scans, kScans));
      if (ask) Sources();
    }
    std::vector<std::pair<sound_map::SourceEvent::Kind, frames::TimeNs>> told;
    for (const Event& event : region_->events().Read(0, 100'000).events) {
      if (const auto* happened = std::get_if<sound_map::SourceEvent>(&event)) {
        told.emplace_back(happened->kind, happened->time_ns);
      }
    }
    return told;
  };
  const auto all_at_once = events_of(kScans, false);
  TearDown();
  SetUp();
  EXPECT_EQ(events_of(7, true), all_at_once);
  ASSERT_EQ(all_at_once.size(), 3u);
  EXPECT_EQ(all_at_once[2].first, sound_map::SourceEvent::Kind::kFellSilent);
  EXPECT_GT(all_at_once[2].second, scans_[kScans / 2].stamp_ns);
}

}  // namespace
}  // namespace soundmap::pipeline
