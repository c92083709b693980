#include "pipeline/records.h"

#include <gtest/gtest.h>

#include <boost/crc.hpp>

#include "pipeline/archive.h"

namespace soundmap::pipeline {
namespace {

TEST(Records, ASessionIsReadBackBitForBit) {
  SessionRecord record;
  record.site = "hall";
  record.session = "r-1";
  record.robot = "robot";
  record.purpose = Purpose::kMapping;
  record.calibration.base_from_array.rotate(
      Eigen::AngleAxisd(0.1234567890123, Eigen::Vector3d(1, 2, 3).normalized()));
  record.calibration.base_from_array.translation() << 1.0 / 3.0, 1e-300, -7.7;
  record.calibration.mic_in_array_m = {{0.1, 0.2, 1.0 / 7.0}, {0, 0, 0}};
  record.calibration.audio_sample_rate_hz = 48000;
  record.initial_pose = geometry::Pose2{1.0 / 3.0, -2.0, 3.0};
  record.warnings = {"a \"quoted\" warning"};
  record.epoch = 3;
  record.complete = true;
  record.clock_offsets = {{-3'600'000'000'000, 1'000, 5, 0.1}, {1LL << 61, 7, 1LL << 60, 100.0}};
  record.frame_count = 1LL << 40;
  record.last_frame_ns = 1'700'000'000'123'456'789;
  record.frames_dropped = true;
  const auto read = SessionRecordFromJson(ToJson(record));
  ASSERT_TRUE(read.ok()) << read.status();
  EXPECT_EQ(ToJson(*read), ToJson(record));
  EXPECT_EQ(read->calibration.base_from_array.matrix(),
            record.calibration.base_from_array.matrix());
  EXPECT_EQ(read->calibration.mic_in_array_m[0], record.calibration.mic_in_array_m[0]);
  EXPECT_FALSE(read->calibration.full_scale_spl_db);
  record.calibration.full_scale_spl_db = 120.0 + 1.0 / 3.0;
  EXPECT_EQ(SessionRecordFromJson(ToJson(record))->calibration.full_scale_spl_db,
            record.calibration.full_scale_spl_db);
  EXPECT_EQ(*read->initial_pose, *record.initial_pose);
  EXPECT_EQ(read->frame_count, record.frame_count);
  EXPECT_EQ(read->clock_offsets, record.clock_offsets);
  EXPECT_TRUE(read->frames_dropped);
}

TEST(Records, ASiteOfBeforeKeepsItsFrames) {
  SiteRecord record;
  record.site = "hall";
  record.keep_frames_s = 86400;
  const std::string json = ToJson(record);
  EXPECT_EQ(SiteRecordFromJson(json)->keep_frames_s, 86400);
  constexpr char kField[] = "\"keep_frames_s\":86400,";
  const std::size_t field = json.find(kField);
  ASSERT_NE(field, std::string::npos);
  EXPECT_EQ(SiteRecordFromJson(std::string(json).erase(field, sizeof(kField) - 1))->keep_frames_s,
            0);
}

TEST(Records, ASiteOfBeforeHasNoBands) {
  SiteRecord record;
  record.site = "hall";
  const std::string without = ToJson(record);
  EXPECT_EQ(without.find("bands"), std::string::npos);
  EXPECT_TRUE(SiteRecordFromJson(without)->bands.empty());
  record.bands = {{"hiss", 4000.0, 8000.0}, {"hum", 100.1, 500.0 / 3.0}};
  EXPECT_EQ(SiteRecordFromJson(ToJson(record))->bands, record.bands);
  EXPECT_TRUE(absl::IsDataLoss(
      SiteRecordFromJson(std::string(without).insert(1, "\"bands\":[{\"name\":\"x\"}],"))
          .status()));
}

TEST(Records, AnOffsetOfAClockIsReplacedUntilAClockJumps) {
  constexpr std::int64_t kMs_ns = 1'000'000;
  constexpr std::int64_t kHour_ns = 3'600'000 * kMs_ns;
  SessionRecord record;
  EXPECT_FALSE(record.newest_offset());
  // Known to 2 ms, later to 1 ms: 3 ms apart can be the same.
  EXPECT_FALSE(record.Take({0, 2 * kMs_ns, kHour_ns, 100.0}));
  EXPECT_FALSE(record.Take({3 * kMs_ns, kMs_ns, kHour_ns, 100.0}));
  EXPECT_EQ(record.clock_offsets.size(), 1u);
  // An hour of 100 ppm is 360 ms.
  EXPECT_EQ(record.newest_offset()->UncertaintyAt(2 * kHour_ns), 361 * kMs_ns);
  EXPECT_FALSE(record.Take({364 * kMs_ns, kMs_ns, 2 * kHour_ns, 100.0}));
  EXPECT_EQ(record.clock_offsets.size(), 1u);
  EXPECT_TRUE(record.Take({367 * kMs_ns, kMs_ns, 2 * kHour_ns, 100.0}));
  EXPECT_EQ(record.clock_offsets.size(), 2u);
  EXPECT_TRUE(record.Take({kHour_ns, kMs_ns, 2 * kHour_ns, 100.0}));
  EXPECT_EQ(record.clock_offsets.size(), 3u);
  for (int i = 0; i < 100; ++i) {
    EXPECT_TRUE(record.Take({i % 2 * kHour_ns, kMs_ns, 2 * kHour_ns + i, 100.0}));
  }
  EXPECT_EQ(record.clock_offsets.size(), 32u);
  EXPECT_EQ(record.newest_offset()->time_ns, 2 * kHour_ns + 99);
}

// What is written, with one of its numbers in place of another.
std::string With(std::string json, const std::string& key, const std::string& number) {
  const std::size_t begin = json.find("\"" + key + "\":") + key.size() + 3;
  return json.replace(begin, json.find_first_of(",}", begin) - begin, number);
}

TEST(Records, ANumberThatIsNoIntegerOfItsSizeIsDamage) {
  SessionRecord session;
  session.gaps.push_back({7, 3, 20, 50, "full"});
  session.clock_offsets.push_back({1, 2, 3, 4.5});
  const std::string stored = ToJson(session);
  ASSERT_TRUE(SessionRecordFromJson(With(stored, "epoch", "-12")).ok());
  for (const char* key :
       {"epoch", "audio_sample_rate_hz", "frame_count", "offset", "to_ns", "uncertainty_ns"}) {
    for (const char* number : {"1.5", "1e25", "-1e25", "18446744073709551615", "true", "null"}) {
      const std::string damaged = With(stored, key, number);
      EXPECT_TRUE(absl::IsDataLoss(SessionRecordFromJson(damaged).status())) << damaged;
    }
  }
  EXPECT_TRUE(absl::IsDataLoss(
      SessionRecordFromJson(With(stored, "audio_sample_rate_hz", "4294967296")).status()));
  const std::string site = ToJson(SiteRecord());
  ASSERT_TRUE(SiteRecordFromJson(With(site, "keep_frames_s", "3600")).ok());
  EXPECT_TRUE(absl::IsDataLoss(SiteRecordFromJson(With(site, "keep_frames_s", "1e25")).status()));
}

TEST(Records, DamageIsSaid) {
  for (const char* text : {"", "{", "[]", "{\"site\": 5}", "null"}) {
    EXPECT_TRUE(absl::IsDataLoss(SiteRecordFromJson(text).status())) << text;
    EXPECT_TRUE(absl::IsDataLoss(SessionRecordFromJson(text).status())) << text;
  }
}

TEST(Archive, AScanIsReadBackBitForBit) {
  AudioScanInfo scan;
  scan.robot = "robot";
  scan.pose.map_from_base = {1.0 / 3.0, -0.0, 3.0};
  scan.pose.covariance(1, 2) = 1e-7;
  scan.pose.state = localization::State::kLost;
  scan.noise_floor = 3.25;
  scan.peaks = {{Eigen::Vector3d(0, 0, 1), 17.0}, {Eigen::Vector3d(0, 1, 0), 5.0}};
  scan.end_points = 9;
  scan.array_plane = {{1.0, 2.0, 1.0 / 3.0}, Eigen::Vector3d(0.0, 0.6, 0.8)};
  scan.full_scale_spl_db = 120.0 + 1.0 / 3.0;
  scan.array_in_map_m = {1.0, 2.0, 1.0 / 3.0};
  scan.heard = {{{1.0, 2.0, 3.0}, {0.5f, 0.25f}, {0.0f, 0.6f, 0.8f}}, {{4.0, 5.0, 6.0}, {}}};
  const std::string bytes = EncodeAudioScan(scan);
  const auto read = DecodeAudioScan(bytes);
  ASSERT_TRUE(read.ok()) << read.status();
  EXPECT_EQ(read->robot, "robot");
  EXPECT_EQ(read->pose.map_from_base, scan.pose.map_from_base);
  EXPECT_EQ(read->pose.covariance, scan.pose.covariance);
  EXPECT_EQ(read->pose.state, scan.pose.state);
  EXPECT_EQ(read->array_plane, scan.array_plane);
  EXPECT_EQ(read->full_scale_spl_db, scan.full_scale_spl_db);
  EXPECT_EQ(read->array_in_map_m, scan.array_in_map_m);
  EXPECT_EQ(read->heard, scan.heard);
  ASSERT_EQ(read->peaks.size(), 2u);
  EXPECT_EQ(read->peaks[1].direction_in_array, scan.peaks[1].direction_in_array);
  for (std::size_t cut = 0; cut < bytes.size(); ++cut) {
    EXPECT_TRUE(absl::IsDataLoss(DecodeAudioScan(bytes.substr(0, cut)).status())) << cut;
  }
}

// What version 7 of the register's state looks like on disk: the bytes of a state of which every
// part is another number.
TEST(Archive, AStoredRegisterKeepsItsBytes) {
  sound_map::SourceRegister::State state;
  state.tracks.resize(2);
  sound_map::SourceRegister::Track& track = state.tracks[1];
  track.source.found.id = 7;
  track.source.found.position_in_map_m = {1.5, 2.5, 0.5};
  track.source.found.evidence = 150.25;
  track.source.state = sound_map::SourceState::kSilent;
  track.source.robots = {"r1", "r2"};
  track.source.view_points.resize(2);
  track.source.view_points[1].spl_scans = 4;
  track.source.view_points[1].squared_pressure_at_1m[2] = 1.25e12;
  track.source.view_points[1].array_known = true;
  track.source.view_points[1].array_in_map_m = {1.0, 2.0, 1.25};
  track.source.view_points[1].plane_normal_in_map = {0.0, 0.6, 0.8};
  track.source.view_points[1].surface_normal_sum_in_map = {0.0, -3.5, 0.25};
  track.source.heard = {{1, 2}, {3, 4}};
  track.source.explained_by_id = 5;
  track.log_odds_on = 3.5;
  track.announced = true;
  track.views.present = {{"r1", {{1.0, 2.0}, 12, 3}}, {"r2", {{-1.0, 4.0}, 5, 1}}};
  track.views.past = 6.5;
  track.views.past_heard = 2.25;
  track.views.ended = 70.0;
  track.mirrors.scans = 40.0;
  track.mirrors.with = {{3, 20.0}, {9, 1.5}};
  track.echo.scans = 12.0;
  track.echo.at_place[3] = 20.5;
  track.echo.at_image[12] = -4.25;
  track.echo.image_in_map_m = {1.5, 2.5, 2.0};
  state.scans = {{"r1", 3}};
  state.last_ns = 99;
  const std::string bytes = EncodeSourceRegisters({state, {}});
  boost::crc_32_type checksum;
  checksum.process_bytes(bytes.data(), bytes.size());
  EXPECT_EQ(bytes.size(), 2228u);
  EXPECT_EQ(checksum.checksum(), 0x8cbba5a9);
  const auto read = DecodeSourceRegisters(bytes);
  ASSERT_TRUE(read.ok()) << read.status();
  ASSERT_EQ(read->size(), 2u);
  EXPECT_EQ(read->front().last_ns, 99);
  EXPECT_TRUE(read->back().tracks.empty());
  const auto& tracks = read->front().tracks;
  ASSERT_EQ(tracks.size(), 2u);
  EXPECT_EQ(tracks[1].source.view_points, track.source.view_points);
  EXPECT_EQ(tracks[1].views.present, track.views.present);
  EXPECT_EQ(tracks[1].views.past_heard, 2.25);
  EXPECT_EQ(tracks[1].views.ended, 70.0);
  EXPECT_EQ(tracks[1].mirrors.scans, 40.0);
  EXPECT_EQ(tracks[1].mirrors.with, track.mirrors.with);
  EXPECT_EQ(tracks[1].echo, track.echo);

  // Those of another version are made again from the journal.
  const std::string before = std::string("\2\0\0\0", 4) + bytes.substr(4);
  EXPECT_TRUE(absl::IsDataLoss(DecodeSourceRegisters(before).status()));
}

// Damaged sizes and flags are refused: nothing is made room for that the bytes cannot hold.
TEST(Archive, NoDamagedByteIsBelieved) {
  sound_map::SourceRegister::State state;
  state.tracks.resize(2);
  state.tracks[1].source.robots = {"robot"};
  state.tracks[1].source.view_points.resize(2);
  const std::string bytes = EncodeSourceRegisters({state});
  int refused = 0;
  for (std::size_t i = 0; i < bytes.size(); ++i) {
    for (const char value : {'\2', '\x7f', '\xff'}) {
      std::string damaged = bytes;
      damaged[i] = value;
      const auto read = DecodeSourceRegisters(damaged);
      if (read.ok()) continue;
      EXPECT_TRUE(absl::IsDataLoss(read.status())) << i;
      ++refused;
    }
  }
  EXPECT_GT(refused, 3 * 8 * 4);  // the eight bytes of each size, of four or more
}

}  // namespace
}  // namespace soundmap::pipeline
