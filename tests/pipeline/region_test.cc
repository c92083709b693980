#include "pipeline/region.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <algorithm>
#include <cstdlib>
#include <filesystem>
#include <map>
#include <random>

#include "absl/strings/str_cat.h"
#include "pipeline/archive.h"
#include "pipeline/content_check.h"
#include "pipeline/records.h"
#include "pipeline/serialization.h"
#include "storage/check.h"

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

TEST(Archive, EntriesFromBeforeThereWereBandsAreOfTheMainMap) {
  AudioScanInfo scan;
  scan.robot = "r1";
  scan.end_points = 12;
  scan.heard = {{Eigen::Vector3d(1.0, 2.0, 3.0), {0.5f, 0.25f}}};
  scan.array_plane = {{1.0, 2.0, 3.0}, Eigen::Vector3d::UnitX()};
  scan.band = 2;
  scan.heard[0].ripple = {0.125, 3, {1, -2, 127, -127}};
  const std::string bytes = EncodeAudioScan(scan);
  EXPECT_EQ(DecodeAudioScan(bytes)->band, 2);
  EXPECT_EQ(DecodeAudioScan(bytes)->heard, scan.heard);
  // Version 5 ended before the ripples (a number of them, its version, and one ripple of a number,
  // a bin, and four values behind their number), version 4 ended before the array and the surfaces
  // (a number of them, its version, and one surface), version 3 before full scale and band, version
  // 2 before the plane.
  std::string without_ripples = bytes.substr(0, bytes.size() - 8 - 4 - 8 - 4 - 8 - 4);
  without_ripples[0] = '\5';
  scan.heard[0].ripple = {};
  const auto recent = DecodeAudioScan(without_ripples);
  ASSERT_TRUE(recent.ok()) << recent.status();
  EXPECT_EQ(recent->heard, scan.heard);
  std::string without_array =
      without_ripples.substr(0, without_ripples.size() - 1 - 3 * 8 - 8 - 4 - 3 * 4);
  without_array[0] = '\4';
  const auto old = DecodeAudioScan(without_array);
  ASSERT_TRUE(old.ok()) << old.status();
  EXPECT_EQ(old->band, 2);
  EXPECT_EQ(old->heard, scan.heard);
  EXPECT_FALSE(old->array_in_map_m);
  std::string without_band = without_array.substr(0, without_array.size() - 1 - 8 - 1);
  without_band[0] = '\3';
  const auto older = DecodeAudioScan(without_band);
  ASSERT_TRUE(older.ok()) << older.status();
  EXPECT_EQ(older->band, kMainBand);
  EXPECT_EQ(older->heard, scan.heard);
  EXPECT_EQ(older->array_plane, scan.array_plane);
  std::string without_plane = without_band.substr(0, without_band.size() - 1 - 6 * 8);
  without_plane[0] = '\2';
  const auto oldest = DecodeAudioScan(without_plane);
  ASSERT_TRUE(oldest.ok()) << oldest.status();
  EXPECT_EQ(oldest->band, kMainBand);
  EXPECT_EQ(oldest->heard, scan.heard);
  EXPECT_FALSE(oldest->array_plane);
  EXPECT_TRUE(absl::IsDataLoss(DecodeAudioScan(bytes.substr(0, bytes.size() - 1)).status()));
}

TEST_F(RegionTest, EventsDoNotDependOnCommitsOrQuestions) {
  const auto events_of = [this](int commit_scans, bool ask) {
    for (int k = 0; k < kScans; k += commit_scans) {
      Commit(k, std::min(k + commit_scans, kScans));
      if (ask) Sources();
    }
    std::vector<std::pair<sound_map::SourceEvent::Kind, frames::TimeNs>> told;
    for (const Event& event : region_->events().Read(0, 100'000).events) {
      if (const auto* happened = std::get_if<SourceHappened>(&event)) {
        told.emplace_back(happened->event.kind, happened->event.time_ns);
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

// The journal of a site: which band heard what.
struct Entry {
  std::uint8_t band = kMainBand;
  sound_map::EvidenceScan evidence;
};

struct VoxelAt {
  geometry::VoxelKey key;
  float log_odds = 0.0f;
  std::uint32_t update_count = 0;
  frames::TimeNs last_update_ns = 0;

  bool operator==(const VoxelAt&) const = default;
};

// A data folder with a site of so many maps.
class Hall {
 public:
  Hall(const std::string& name, std::size_t band_count)
      : folder_(std::filesystem::path(::testing::TempDir()) / name), band_count_(band_count) {
    std::filesystem::remove_all(folder_);
    Open();
    auto log = store_->OpenSession({kSite, kSession}).value();
    for (int k = 0; k < 2 * kScans; ++k) {
      recording::Message frame;
      frame.topic = "/odom";
      frame.schema = "foxglove.Odometry";
      EXPECT_TRUE(log->Append(std::move(frame)).ok());
    }
    EXPECT_TRUE(log->Sync().ok());
  }
  ~Hall() {
    region_.reset();
    store_.reset();
    std::filesystem::remove_all(folder_);
  }

  void Restart() {
    region_.reset();
    store_.reset();
    Open();
  }
  absl::Status Commit(const std::vector<Entry>& entries) {
    storage::Commit commit;
    commit.site = kSite;
    commit.session = kSession;
    for (const Entry& entry : entries) {
      AudioScanInfo scan;
      scan.robot = "r1";
      const auto k = (entry.evidence.stamp_ns / 125'000'000) % 100;
      scan.pose.map_from_base = {0.03 * std::abs(static_cast<double>(k) - 50.0), 1.0, 0.0};
      scan.band = entry.band;
      commit.journal.push_back({next_++, EncodeAudioScan(scan), entry.evidence});
    }
    commit.processed_offset = commit.heard_offset = next_;
    StageClock clock(nullptr);
    clock.Start();
    return region_->Commit(commit, clock);
  }
  std::vector<sound_map::RegisteredSource> Sources(std::uint8_t band) {
    region_->FindSources();
    return region_->sources(band)->sources;
  }
  std::vector<VoxelAt> Voxels(std::uint8_t band) const {
    std::vector<VoxelAt> voxels;
    region_->snapshot(band)->ForEach(
        [&](const geometry::VoxelKey& key, const sound_map::Voxel& voxel) {
          voxels.push_back({key, voxel.log_odds, voxel.update_count, voxel.last_update_ns});
          return true;
        });
    return voxels;
  }
  // As stored.
  std::map<storage::TileKey, std::string> Tiles() const {
    std::map<storage::TileKey, std::string> tiles;
    EXPECT_TRUE(store_
                    ->ReadTiles(kSite,
                                [&tiles](const storage::Tile& tile) {
                                  tiles[tile.key] = tile.bytes;
                                  return absl::OkStatus();
                                })
                    .ok());
    return tiles;
  }
  // Of a band: what happened, and when.
  std::vector<std::pair<sound_map::SourceEvent::Kind, frames::TimeNs>> Events(std::uint8_t band) {
    std::vector<std::pair<sound_map::SourceEvent::Kind, frames::TimeNs>> told;
    for (const Event& event : region_->events().Read(0, 100'000).events) {
      const auto* happened = std::get_if<SourceHappened>(&event);
      if (happened != nullptr && happened->band == band) {
        told.emplace_back(happened->event.kind, happened->event.time_ns);
      }
    }
    return told;
  }
  // The faults in the folder, if the site's record said that it has so many bands.
  std::vector<std::string> FaultsWith(std::size_t bands) {
    SiteRecord site{kSite};
    site.profile = "default";
    site.parameters_toml = ToToml(*ProfileByName("default"));
    for (std::size_t i = 0; i < bands; ++i) {
      site.bands.push_back({std::string(1, static_cast<char>('a' + i)), 100.0, 500.0});
    }
    SessionRecord session{kSite, kSession};
    EXPECT_TRUE(store_->PutRecord(storage::Table::kSite, kSite, ToJson(site)).ok());
    EXPECT_TRUE(store_
                    ->PutRecord(storage::Table::kSession, absl::StrCat(kSite, "/", kSession),
                                ToJson(session))
                    .ok());
    region_.reset();
    store_.reset();
    const auto check = storage::CheckData(folder_.string(), MakeContentCheck());
    EXPECT_TRUE(check.ok()) << check.status();
    Open();
    return check->faults;
  }
  storage::Store& store() { return *store_; }
  Region& region() { return *region_; }

 private:
  void Open() {
    store_ = storage::Store::Open(folder_.string()).value();
    region_ = Region::Open(kSite, store_.get(), sound_map::DefaultConfig(), band_count_).value();
  }

  const std::filesystem::path folder_;
  const std::size_t band_count_;
  std::int64_t next_ = 0;
  std::unique_ptr<storage::Store> store_;
  std::unique_ptr<Region> region_;
};

// Two maps that hear other sources, not in step.
std::vector<Entry> EntriesOfTwoBands() {
  std::vector<Entry> entries;
  const auto scans = Scans();
  for (int k = 0; k < kScans; ++k) {
    if (k % 7 != 3) entries.push_back({kMainBand, scans[k]});
    if (k % 3 == 0) continue;
    Entry& other = entries.emplace_back(Entry{1, scans[k]});
    for (sound_map::EndPoint& end_point : other.evidence.end_points) end_point.key.y += 30;
  }
  return entries;
}

std::vector<Entry> OfBand(std::uint8_t band, const std::vector<Entry>& entries) {
  std::vector<Entry> of_band;
  for (const Entry& entry : entries) {
    if (entry.band == band) of_band.push_back({kMainBand, entry.evidence});
  }
  return of_band;
}

// What a site of one map says that was only told the entries of the band.
void ExpectAsAlone(Hall& hall, std::uint8_t band, const std::vector<Entry>& entries) {
  Hall alone("alone", 1);
  ASSERT_GT(OfBand(band, entries).size(), 100u);
  ASSERT_TRUE(alone.Commit(OfBand(band, entries)).ok());
  EXPECT_TRUE(hall.Voxels(band) == alone.Voxels(kMainBand));
  EXPECT_EQ(hall.Sources(band), alone.Sources(kMainBand));
  EXPECT_EQ(alone.Sources(kMainBand).size(), 2u);
  EXPECT_EQ(hall.region().snapshot(band)->as_of_ns(), alone.region().snapshot()->as_of_ns());
  EXPECT_EQ(hall.region().snapshot(band)->revision(), entries.size());
  EXPECT_EQ(hall.region().sources(band)->revision, entries.size());
}

TEST(RegionOfBands, EachMapIsAsIfThereWereNoOther) {
  const std::vector<Entry> entries = EntriesOfTwoBands();
  Hall hall("bands", 2);
  ASSERT_TRUE(hall.Commit(entries).ok());
  ExpectAsAlone(hall, 0, entries);
  ExpectAsAlone(hall, 1, entries);
  EXPECT_FALSE(hall.Voxels(0) == hall.Voxels(1));
  EXPECT_NE(hall.Sources(0), hall.Sources(1));
  EXPECT_EQ(hall.region().revision(), entries.size());

  for (const std::uint8_t band : {0, 1}) {
    Hall alone("events_alone", 1);
    ASSERT_TRUE(alone.Commit(OfBand(band, entries)).ok());
    EXPECT_GE(hall.Events(band).size(), 2u);
    EXPECT_EQ(hall.Events(band), alone.Events(kMainBand));
  }
}

TEST(RegionOfBands, MapsAndSourcesAreTheSameAfterCrashesAndCheckpoints) {
  const std::vector<Entry> entries = EntriesOfTwoBands();
  Hall hall("bands_disturbed", 2);
  std::size_t next = 0;
  for (const std::size_t until : {9u, 33u, 150u, 151u, 160u, 299u, 455u}) {
    for (; next < until; next += std::min<std::size_t>(5, until - next)) {
      const auto begin = entries.begin() + static_cast<std::ptrdiff_t>(next);
      ASSERT_TRUE(hall.Commit({begin, begin + static_cast<std::ptrdiff_t>(
                                                  std::min<std::size_t>(5, until - next))})
                      .ok());
      if (next % 3 == 0) hall.region().FindSources();
      if (next % 7 == 0) hall.region().PublishSourceChanges();
    }
    if (until % 2 == 1) {
      ASSERT_TRUE(hall.region().Checkpoint().ok());
      EXPECT_EQ(hall.store().CheckpointSequence(kSite).value(), until);
    }
    hall.Restart();
  }
  ASSERT_TRUE(
      hall.Commit({entries.begin() + static_cast<std::ptrdiff_t>(next), entries.end()}).ok());
  hall.Restart();
  ExpectAsAlone(hall, 0, entries);
  ExpectAsAlone(hall, 1, entries);

  // The next checkpoint is that of a run without a crash.
  Hall undisturbed("bands_undisturbed", 2);
  ASSERT_TRUE(undisturbed.Commit(entries).ok());
  for (Hall* of : {&hall, &undisturbed}) {
    ASSERT_TRUE(of->region().Checkpoint().ok());
  }
  EXPECT_EQ(hall.store().ReadSourceRegister(kSite).value(),
            undisturbed.store().ReadSourceRegister(kSite).value());
  EXPECT_TRUE(hall.Tiles() == undisturbed.Tiles());
}

TEST(RegionOfBands, RegistersOfFewerMapsAreMadeAnewFromTheJournal) {
  const std::vector<Entry> entries = EntriesOfTwoBands();
  Hall hall("bands_fewer", 2);
  ASSERT_TRUE(hall.Commit(entries).ok());
  ASSERT_TRUE(hall.region().Checkpoint().ok());
  ASSERT_TRUE(
      hall.store().PutCheckpoint(kSite, {}, entries.size(), EncodeSourceRegisters({{}})).ok());
  hall.Restart();
  ExpectAsAlone(hall, 0, entries);
  ExpectAsAlone(hall, 1, entries);
}

TEST(RegionOfBands, TheCheckOfStoredDataKnowsTheBandsOfTheSite) {
  const auto scans = Scans();
  Hall hall("bands_checked", 3);
  ASSERT_TRUE(hall.Commit({{1, scans[0]}, {2, scans[1]}}).ok());
  ASSERT_TRUE(hall.region().Checkpoint().ok());
  EXPECT_THAT(hall.FaultsWith(2), ::testing::IsEmpty());
  const auto faults = hall.FaultsWith(1);
  EXPECT_THAT(faults, ::testing::Contains("entry 2 of site hall: the site has no band 2"));
  EXPECT_THAT(faults, ::testing::Contains(::testing::ContainsRegex(
                          "tile .* of band 2 of site hall: the site has no band 2")));
}

TEST(RegionOfBands, WhatIsOfABandThatTheSiteDoesNotHaveIsRefused) {
  const auto scans = Scans();
  Hall hall("bands_unknown", 2);
  EXPECT_TRUE(absl::IsInvalidArgument(hall.Commit({{0, scans[0]}, {2, scans[1]}})));
  EXPECT_EQ(hall.store().LastSequence(kSite).value(), 0u) << "nothing took effect";
  EXPECT_EQ(hall.region().revision(), 0u);

  Hall more("bands_more", 3);
  ASSERT_TRUE(more.Commit({{2, scans[0]}}).ok());
  EXPECT_TRUE(
      absl::IsDataLoss(Region::Open(kSite, &more.store(), sound_map::DefaultConfig(), 2).status()));
  ASSERT_TRUE(more.region().Checkpoint().ok());
  EXPECT_TRUE(
      absl::IsDataLoss(Region::Open(kSite, &more.store(), sound_map::DefaultConfig(), 2).status()));
}

}  // namespace
}  // namespace soundmap::pipeline
