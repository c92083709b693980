#include <gmock/gmock.h>
#include <grpcpp/grpcpp.h>
#include <gtest/gtest.h>

#include <chrono>
#include <cmath>
#include <filesystem>
#include <optional>
#include <set>
#include <tuple>
#include <vector>

#include "pipeline/archive.h"
#include "soundmap/v1/map_service.grpc.pb.h"
#include "soundmap/v1/site_service.grpc.pb.h"
#include "soundmap/v1/sound_map_service.grpc.pb.h"
#include "soundmap/v1/watch_service.grpc.pb.h"
#include "tests/api/test_server.h"

// A whole gRPC server, and a site that has heard one thing in each band.
namespace soundmap::api {
namespace {

using ::testing::StartsWith;

constexpr frames::TimeNs kStart_ns = 1'700'000'000'000'000'000;
constexpr int kScans = 60;  // of each band
// Where the source of each band is, along the ceiling.
constexpr double kSource_m[] = {0.8, 2.2, 3.4};
const char* const kBands[] = {"", "hiss-high", "hum"};

sound_map::EvidenceScan ScanOf(std::uint8_t band, int k) {
  sound_map::EvidenceScan scan;
  scan.stamp_ns = kStart_ns + 125'000'000LL * k;
  for (double x = 0.025; x < 4.0; x += 0.05) {
    for (double y = 0.025; y < 2.0; y += 0.05) {
      const bool sounds = std::hypot(x - kSource_m[band], y - 1.0) < 0.1;
      scan.end_points.push_back({*geometry::KeyFromPoint({x, y, 2.7}, 0.05), sounds ? 0.9f : 0.4f});
    }
  }
  return scan;
}

class BandsTest : public ::testing::Test {
 protected:
  void SetUp() override {
    std::filesystem::remove_all(folder_);
    server_.emplace(TestServer::Options{.folder = folder_.string()});
    const auto channel = server_->Channel();
    site_service_ = v1::SiteService::NewStub(channel);
    maps_ = v1::SoundMapService::NewStub(channel);
    files_ = v1::MapService::NewStub(channel);
    watches_ = v1::WatchService::NewStub(channel);
  }
  void TearDown() override {
    server_.reset();
    std::filesystem::remove_all(folder_);
  }

  static v1::CreateSiteRequest SiteRequest() {
    v1::CreateSiteRequest request;
    request.set_site_id("hall");
    request.set_request_id("request");
    for (const auto& [name, min_hz, max_hz] :
         {std::tuple(kBands[1], 4000.0, 8000.0), {kBands[2], 100.0, 500.0}}) {
      v1::Band& band = *request.add_bands();
      band.set_name(name);
      band.set_min_frequency_hz(min_hz);
      band.set_max_frequency_hz(max_hz);
    }
    return request;
  }
  grpc::Status Create(const v1::CreateSiteRequest& request, v1::Site* site = nullptr) {
    grpc::ClientContext context;
    v1::Site response;
    return site_service_->CreateSite(&context, request, site == nullptr ? &response : site);
  }
  // All bands in turns, as they come from a robot.
  void Hear(int first_scan, int end_scan) {
    const auto site = server_->sites().Get("hall").value();
    auto log = server_->store().OpenSession({"hall", "drive"}).value();
    storage::Commit commit{"hall", "drive"};
    for (int k = first_scan; k < end_scan; ++k) {
      recording::Message frame;
      frame.topic = "/odom";
      frame.schema = "foxglove.Odometry";
      ASSERT_TRUE(log->Append(std::move(frame)).ok());
      for (std::uint8_t band = 0; band < 3; ++band) {
        pipeline::AudioScanInfo scan;
        scan.robot = "r1";
        scan.pose.map_from_base = {0.05 * k, 1.0, 0.0};
        scan.end_points = 3200;
        scan.band = band;
        commit.journal.push_back({k, pipeline::EncodeAudioScan(scan), ScanOf(band, k)});
      }
    }
    ASSERT_TRUE(log->Sync().ok());
    commit.processed_offset = commit.heard_offset = end_scan;
    pipeline::StageClock clock(nullptr);
    clock.Start();
    ASSERT_TRUE(site->region().Commit(commit, clock).ok());
    site->region().FindSources();
  }
  void MakeHall() {
    ASSERT_TRUE(Create(SiteRequest()).ok());
    Hear(0, kScans);
  }

  grpc::Status List(const std::string& band, v1::ListSoundSourcesResponse* response) {
    grpc::ClientContext context;
    v1::ListSoundSourcesRequest request;
    request.set_site("sites/hall");
    request.set_band(band);
    request.set_min_probability(0.5);
    return maps_->ListSoundSources(&context, request, response);
  }
  grpc::Status Get(const std::string& name, v1::SoundSource* source) {
    grpc::ClientContext context;
    v1::GetSoundSourceRequest request;
    request.set_name(name);
    return maps_->GetSoundSource(&context, request, source);
  }
  void ExpectUnknown(const grpc::Status& status) {
    EXPECT_EQ(status.error_code(), grpc::StatusCode::NOT_FOUND);
    EXPECT_EQ(status.error_message(), "site 'hall' has no band 'hiss'; it has hiss-high, hum");
  }

  const std::filesystem::path folder_ =
      std::filesystem::path(::testing::TempDir()) /
      ::testing::UnitTest::GetInstance()->current_test_info()->name();
  std::optional<TestServer> server_;
  std::unique_ptr<v1::SiteService::Stub> site_service_;
  std::unique_ptr<v1::SoundMapService::Stub> maps_;
  std::unique_ptr<v1::MapService::Stub> files_;
  std::unique_ptr<v1::WatchService::Stub> watches_;
};

TEST_F(BandsTest, ASiteHasTheBandsThatItWasCreatedWith) {
  v1::Site site;
  ASSERT_TRUE(Create(SiteRequest(), &site).ok());
  ASSERT_EQ(site.bands_size(), 2);
  EXPECT_EQ(site.bands(0).name(), "hiss-high");
  EXPECT_EQ(site.bands(0).min_frequency_hz(), 4000.0);
  EXPECT_EQ(site.bands(0).max_frequency_hz(), 8000.0);
  EXPECT_EQ(site.bands(1).name(), "hum");
  EXPECT_TRUE(Create(SiteRequest()).ok()) << "the same request again";
  v1::CreateSiteRequest other = SiteRequest();
  other.mutable_bands(1)->set_max_frequency_hz(600.0);
  EXPECT_EQ(Create(other).error_code(), grpc::StatusCode::ALREADY_EXISTS);
  other.set_site_id("yard");
  other.mutable_bands(1)->set_max_frequency_hz(50.0);
  const grpc::Status refused = Create(other);
  EXPECT_EQ(refused.error_code(), grpc::StatusCode::INVALID_ARGUMENT);
  EXPECT_THAT(refused.error_message(), StartsWith("the band 'hum' cannot be heard: "));
}

TEST_F(BandsTest, TheSourcesOfABandAreListedAndNamedAfterIt) {
  MakeHall();
  for (int band = 0; band < 3; ++band) {
    v1::ListSoundSourcesResponse list;
    ASSERT_TRUE(List(kBands[band], &list).ok());
    ASSERT_EQ(list.sound_sources_size(), 1) << kBands[band];
    const v1::SoundSource& source = list.sound_sources(0);
    EXPECT_NEAR(source.position_m().x(), kSource_m[band], 0.05);
    EXPECT_EQ(source.band(), kBands[band]);
    const std::string id = source.name().substr(std::string("sites/hall/soundSources/").size());
    EXPECT_EQ(id.size(), 16 + (band == 0 ? 0 : std::string(kBands[band]).size() + 1)) << id;
    EXPECT_THAT(id, StartsWith(kBands[band]));
    EXPECT_EQ(list.revision(), 3 * kScans);
    EXPECT_EQ(list.as_of_ns(), ScanOf(0, kScans - 1).stamp_ns);
    v1::SoundSource found;
    ASSERT_TRUE(Get(source.name(), &found).ok());
    EXPECT_EQ(found.name(), source.name());
    EXPECT_EQ(found.band(), kBands[band]);
    // No band has the source of another one.
    const std::string hex = id.substr(id.size() - 16);
    for (int other = 0; other < 3; ++other) {
      const std::string name =
          "sites/hall/soundSources/" + (other == 0 ? hex : kBands[other] + ("-" + hex));
      EXPECT_EQ(Get(name, &found).ok(), other == band) << name;
    }
  }
  v1::ListSoundSourcesResponse list;
  ExpectUnknown(List("hiss", &list));
  v1::SoundSource found;
  const grpc::Status missing = Get("sites/hall/soundSources/hiss-0000000000000001", &found);
  EXPECT_EQ(missing.error_code(), grpc::StatusCode::NOT_FOUND);
  EXPECT_EQ(missing.error_message(),
            "sound source 'hiss-0000000000000001' does not exist at site 'hall'");
}

TEST_F(BandsTest, VoxelsAndFilesAreOfTheBandThatIsAskedFor) {
  MakeHall();
  std::set<std::string> files;
  for (int band = 0; band < 3; ++band) {
    grpc::ClientContext context;
    v1::QueryVoxelsRequest request;
    request.set_site("sites/hall");
    request.set_min_probability(0.9);
    request.set_band(kBands[band]);
    const auto stream = maps_->QueryVoxels(&context, request);
    v1::VoxelChunk chunk;
    int voxels = 0;
    while (stream->Read(&chunk)) {
      EXPECT_EQ(chunk.revision(), 3 * kScans);
      for (const auto key : chunk.x_key()) {
        EXPECT_NEAR((key - 32768 + 0.5) * chunk.voxel_size_m(), kSource_m[band], 0.11);
        ++voxels;
      }
    }
    EXPECT_TRUE(stream->Finish().ok());
    EXPECT_GT(voxels, 5);

    grpc::ClientContext export_context;
    v1::ExportMapRequest export_request;
    export_request.set_site("sites/hall");
    export_request.set_what(v1::EXPORT_WHAT_SOUND);
    export_request.set_format("ply");
    export_request.set_band(kBands[band]);
    const auto file = files_->ExportMap(&export_context, export_request);
    v1::ExportMapResponse part;
    std::string bytes;
    while (file->Read(&part)) bytes += part.data();
    EXPECT_TRUE(file->Finish().ok());
    files.insert(bytes);
  }
  EXPECT_EQ(files.size(), 3u);

  const auto refused = [this](const std::string& band, v1::ExportWhat what) {
    grpc::ClientContext context;
    v1::ExportMapRequest request;
    request.set_site("sites/hall");
    request.set_what(what);
    request.set_format("png");
    request.set_band(band);
    const auto file = files_->ExportMap(&context, request);
    v1::ExportMapResponse part;
    EXPECT_FALSE(file->Read(&part));
    return file->Finish();
  };
  ExpectUnknown(refused("hiss", v1::EXPORT_WHAT_SOUND));
  EXPECT_EQ(refused("hum", v1::EXPORT_WHAT_FLOOR_PLAN).error_message(),
            "only the sound map has bands");
  grpc::ClientContext context;
  v1::QueryVoxelsRequest request;
  request.set_site("sites/hall");
  request.set_band("hiss");
  const auto stream = maps_->QueryVoxels(&context, request);
  v1::VoxelChunk chunk;
  EXPECT_FALSE(stream->Read(&chunk));
  ExpectUnknown(stream->Finish());
}

TEST_F(BandsTest, AudioScansAreListedByBandAndPage) {
  MakeHall();
  for (const char* band : kBands) {
    v1::ListAudioScansRequest request;
    request.set_site("sites/hall");
    request.set_band(band);
    request.set_page_size(25);
    std::vector<std::int64_t> times_ns;
    int pages = 0;
    do {
      grpc::ClientContext context;
      v1::ListAudioScansResponse response;
      ASSERT_TRUE(maps_->ListAudioScans(&context, request, &response).ok());
      for (const v1::AudioScan& scan : response.audio_scans()) {
        EXPECT_EQ(scan.band(), band);
        times_ns.push_back(scan.time_ns());
      }
      request.set_page_token(response.next_page_token());
      ++pages;
    } while (!request.page_token().empty());
    EXPECT_EQ(pages, 3);
    ASSERT_EQ(times_ns.size(), static_cast<std::size_t>(kScans));
    for (int k = 0; k < kScans; ++k) EXPECT_EQ(times_ns[k], ScanOf(0, k).stamp_ns);
  }
  grpc::ClientContext context;
  v1::ListAudioScansRequest request;
  request.set_site("sites/hall");
  request.set_band("hiss");
  v1::ListAudioScansResponse response;
  ExpectUnknown(maps_->ListAudioScans(&context, request, &response));
}

TEST_F(BandsTest, AWatcherIsToldOfItsBandAlone) {
  ASSERT_TRUE(Create(SiteRequest()).ok());
  Hear(0, 1);
  const auto deadline = std::chrono::system_clock::now() + std::chrono::seconds(30);
  // Where all of them begin.
  std::string token;
  {
    grpc::ClientContext context;
    context.set_deadline(deadline);
    v1::WatchRequest request;
    request.set_site("sites/hall");
    request.set_band("hum");
    const auto watch = watches_->Watch(&context, request);
    v1::WatchEvent event;
    while (watch->Read(&event) && !event.has_snapshot_complete()) {
      ASSERT_TRUE(event.has_sound_source());
      EXPECT_EQ(event.sound_source().band(), "hum");
    }
    ASSERT_TRUE(event.has_snapshot_complete());
    token = event.resume_token();
    context.TryCancel();
  }
  Hear(1, kScans);
  for (int number = 0; number < 3; ++number) {
    const std::string band = kBands[number];
    SCOPED_TRACE(band);
    const auto expect_own = [&](const v1::SoundSource& source) {
      EXPECT_EQ(source.band(), band);
      EXPECT_NEAR(source.position_m().x(), kSource_m[number], 0.05);
    };
    grpc::ClientContext context;
    context.set_deadline(deadline);
    v1::WatchRequest request;
    request.set_site("sites/hall");
    request.set_band(band);
    request.set_resume_token(token);
    const auto watch = watches_->Watch(&context, request);
    v1::WatchEvent event;
    int scans = 0;
    bool changed = false;
    bool appeared = false;
    while ((scans < kScans - 1 || !changed || !appeared) && watch->Read(&event)) {
      if (event.has_audio_scan()) {
        EXPECT_EQ(event.audio_scan().band(), band);
        EXPECT_EQ(event.audio_scan().time_ns(), ScanOf(0, ++scans).stamp_ns);
      }
      if (event.has_sound_source()) {
        expect_own(event.sound_source());
        changed = true;
      }
      if (event.has_sound_source_event()) {
        expect_own(event.sound_source_event().sound_source());
        appeared = true;
      }
    }
    EXPECT_EQ(scans, kScans - 1);
    EXPECT_TRUE(changed);
    EXPECT_TRUE(appeared);
    context.TryCancel();
  }
  grpc::ClientContext context;
  v1::WatchRequest request;
  request.set_site("sites/hall");
  request.set_band("hiss");
  const auto watch = watches_->Watch(&context, request);
  v1::WatchEvent event;
  EXPECT_FALSE(watch->Read(&event));
  ExpectUnknown(watch->Finish());
}

}  // namespace
}  // namespace soundmap::api
