#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <filesystem>
#include <fstream>
#include <thread>

#include "absl/strings/match.h"
#include "fake_server.h"
#include "soundmap/client.h"

namespace soundmap {
namespace {

namespace fs = std::filesystem;
using ::testing::ElementsAre;
using testing::FakeServer;
using testing::FakeState;
using ::testing::HasSubstr;
using ::testing::IsEmpty;

ClientOptions Options(const std::string& server) {
  ClientOptions options{.server = server};
  options.retry.initial_backoff = std::chrono::milliseconds(1);
  options.retry.max_backoff = std::chrono::milliseconds(2);
  return options;
}

class ClientTest : public ::testing::Test {
 protected:
  ClientTest() : client_(Client::Connect(Options(server_.address())).value()) {
    directory_ = fs::path(::testing::TempDir()) /
                 ::testing::UnitTest::GetInstance()->current_test_info()->name();
    fs::remove_all(directory_);
    fs::create_directories(directory_);
  }
  std::string Path(const std::string& name) const { return (directory_ / name).string(); }
  std::string Write(const std::string& name, const std::string& bytes) const {
    std::ofstream(Path(name), std::ios::binary) << bytes;
    return Path(name);
  }
  static std::string Read(const std::string& path) {
    std::ifstream file(path, std::ios::binary);
    return std::string(std::istreambuf_iterator<char>(file), {});
  }
  std::vector<std::string> Files() const {
    std::vector<std::string> names;
    for (const auto& entry : fs::directory_iterator(directory_)) {
      names.push_back(entry.path().filename().string());
    }
    std::sort(names.begin(), names.end());
    return names;
  }
  FakeState& state() { return server_.state(); }

  FakeServer server_;
  Client client_;
  fs::path directory_;
};

TEST(ClientConnect, RefusesWhatIsNoAddress) {
  for (const char* server : {"", "host", "host:", ":7443", "host:0", "host:70000", "host:x",
                             "a b:1", "http://host:1", "::1:80"}) {
    const auto client = Client::Connect({.server = server});
    EXPECT_EQ(client.status().code(), absl::StatusCode::kInvalidArgument) << server;
  }
  for (const char* server : {"host:1", "127.0.0.1:65535", "[::1]:7443", "a.b-c.example:80"}) {
    EXPECT_TRUE(Client::Connect({.server = server}).ok()) << server;
  }
}

TEST(ClientConnect, KeepsTokensFromTravellingInPlainText) {
  EXPECT_TRUE(Client::Connect({.server = "127.0.0.1:1", .token = "t"}).ok());
  EXPECT_FALSE(Client::Connect({.server = "10.0.0.1:1", .token = "t"}).ok());
  EXPECT_FALSE(Client::Connect({.server = "127.0.0.1:1", .token = "a\nb"}).ok());
}

TEST(ClientConnect, SaysThatTheServerIsAway) {
  std::string address;
  {
    const FakeServer gone;
    address = gone.address();
  }
  auto client = Client::Connect(Options(address)).value();
  const absl::Status status = client.ListSites().status();
  EXPECT_EQ(status.code(), absl::StatusCode::kUnavailable);
  EXPECT_EQ(status.message(), "cannot reach the server at " + address + ": connection refused");
}

TEST_F(ClientTest, CreatesGetsListsAndDeletesSites) {
  for (const char* id : {"a", "b", "c", "d", "e"}) {
    const auto site = client_.CreateSite(id, "paper");
    ASSERT_TRUE(site.ok()) << site.status();
    EXPECT_EQ(site->id, id);
    EXPECT_EQ(site->profile, "paper");
  }
  EXPECT_EQ(client_.CreateSite("a").status().code(), absl::StatusCode::kAlreadyExists);
  EXPECT_EQ(client_.GetSite("c")->max_range_m, 10.0);
  EXPECT_EQ(client_.ListSites()->size(), 5u);  // three pages of two
  EXPECT_EQ(client_.KeepFrames("d", 86400)->keep_frames_s, 86400);
  EXPECT_EQ(client_.GetSite("d")->keep_frames_s, 86400);
  EXPECT_EQ(client_.GetSite("d")->max_range_m, 10.0);
  EXPECT_TRUE(client_.DeleteSite("c").ok());
  const absl::Status missing = client_.GetSite("c").status();
  EXPECT_EQ(missing.code(), absl::StatusCode::kNotFound);
  EXPECT_EQ(missing.message(), "there is no sites/c");  // the server's own sentence
}

TEST_F(ClientTest, SendsTheToken) {
  ClientOptions options = Options(server_.address());
  options.token = "secret";
  ASSERT_TRUE(Client::Connect(options)->ListSites().ok());
  EXPECT_EQ(state().authorization, "Bearer secret");
  ASSERT_TRUE(client_.ListSites().ok());
  EXPECT_EQ(state().authorization, "");
}

TEST_F(ClientTest, TriesReadsAgainWhenUnavailable) {
  state().failures = 4;
  EXPECT_TRUE(client_.ListSites().ok());
  EXPECT_EQ(state().calls["ListSites"], 5);
  state().failures = 5;
  const absl::Status status = client_.ListSites().status();
  EXPECT_EQ(status.code(), absl::StatusCode::kUnavailable);
  EXPECT_EQ(status.message(), "the server is starting");
  EXPECT_EQ(state().calls["ListSites"], 10);
}

TEST_F(ClientTest, SendsChangesOnce) {
  state().failures = 1;
  EXPECT_EQ(client_.DeleteSite("a").code(), absl::StatusCode::kUnavailable);
  EXPECT_EQ(state().calls["DeleteSite"], 1);
}

TEST_F(ClientTest, DoesNotRepeatOtherErrors) {
  state().failures = 1;
  state().failure = {grpc::StatusCode::INTERNAL, "broken"};
  EXPECT_EQ(client_.ListSites().status().code(), absl::StatusCode::kInternal);
  EXPECT_EQ(state().calls["ListSites"], 1);
}

TEST_F(ClientTest, GivesUpAtTheDeadline) {
  ClientOptions options = Options(server_.address());
  options.call_timeout = std::chrono::milliseconds(50);
  state().waits_until_done = -1;
  state().operation.set_name("operations/7");
  auto client = Client::Connect(options).value();
  const std::unique_lock lock(state().mutex);  // the server is stuck
  const absl::Status status = client.ListSites().status();
  EXPECT_EQ(status.code(), absl::StatusCode::kDeadlineExceeded);
  EXPECT_EQ(status.message(), "the server at " + server_.address() + " did not answer in time");
}

TEST_F(ClientTest, ListsSourcesMostProbableFirst) {
  const auto add = [&](const char* id, double probability) {
    v1::SoundSource source;
    source.set_name(std::string("sites/hall/soundSources/") + id);
    source.set_probability(probability);
    source.mutable_position_m()->set_z(2.7);
    state().sources.push_back(source);
  };
  add("s2", 0.7);
  add("s1", 0.7);
  add("s3", 0.9);
  state().sources.back().mutable_mirror_position_m()->set_z(-0.5);
  state().sources.front().set_explained_by("sites/hall/soundSources/s3");
  const auto list =
      client_.ListSoundSources({.site = "hall", .min_probability = 0.5, .since_ns = 42});
  ASSERT_TRUE(list.ok()) << list.status();
  std::vector<std::string> ids;
  for (const SoundSource& source : list->sources) ids.push_back(source.id);
  EXPECT_THAT(ids, ElementsAre("s3", "s1", "s2"));
  EXPECT_EQ(list->sources[0].site, "hall");
  EXPECT_EQ(list->sources[0].position_in_map_m.z, 2.7);
  ASSERT_TRUE(list->sources[0].mirror_in_map_m);
  EXPECT_EQ(list->sources[0].mirror_in_map_m->z, -0.5);
  EXPECT_FALSE(list->sources[1].mirror_in_map_m);
  EXPECT_EQ(list->sources[0].explained_by, "");
  EXPECT_EQ(list->sources[2].explained_by, "s3");
  EXPECT_EQ(list->revision, 12);
  EXPECT_EQ(list->as_of_ns, 1'000'000'000'000);
  EXPECT_EQ(state().last_sources_request.site(), "sites/hall");
  EXPECT_EQ(state().last_sources_request.min_probability(), 0.5);
  EXPECT_EQ(state().last_sources_request.since_ns(), 42);
}

v1::VoxelChunk Chunk(std::initializer_list<std::uint32_t> keys) {
  v1::VoxelChunk chunk;
  chunk.set_voxel_size_m(0.05);
  for (const std::uint32_t key : keys) {
    chunk.add_x_key(32768 + key);
    chunk.add_y_key(32768);
    chunk.add_z_key(32767);
    chunk.add_log_odds(1.5f);
    chunk.add_update_count(3);
    chunk.add_last_update_ns(key);
  }
  return chunk;
}

TEST_F(ClientTest, StreamsVoxels) {
  state().voxel_chunks = {Chunk({0, 1}), Chunk({2})};
  std::vector<double> x_m;
  const absl::Status status = client_.QueryVoxels(
      {.site = "hall", .box_in_map = Box{{0, 0, -1}, {1, 1, 1}}, .min_updates = 2},
      [&](const VoxelColumns& columns) {
        for (std::size_t i = 0; i < columns.size(); ++i) {
          x_m.push_back(columns.CenterInMap(i).x);
          EXPECT_NEAR(columns.CenterInMap(i).z, -0.025, 1e-12);
        }
        return true;
      });
  ASSERT_TRUE(status.ok()) << status;
  ASSERT_EQ(x_m.size(), 3u);
  EXPECT_NEAR(x_m[2], 0.125, 1e-12);
  EXPECT_EQ(state().last_voxels_request.box().min_m().z(), -1);
  EXPECT_EQ(state().last_voxels_request.min_updates(), 2);
}

TEST_F(ClientTest, StopsStreamingWhenTheCallerHasEnough) {
  state().voxel_chunks = {Chunk({0}), Chunk({1}), Chunk({2})};
  int chunks = 0;
  EXPECT_TRUE(
      client_.QueryVoxels({.site = "hall"}, [&](const VoxelColumns&) { return ++chunks < 2; })
          .ok());
  EXPECT_EQ(chunks, 2);
}

TEST_F(ClientTest, RefusesColumnsOfUnequalLength) {
  state().voxel_chunks = {Chunk({0, 1})};
  state().voxel_chunks[0].mutable_log_odds()->RemoveLast();
  EXPECT_EQ(client_.QueryVoxels({.site = "hall"}, [](const VoxelColumns&) { return true; }).code(),
            absl::StatusCode::kInternal);
}

TEST_F(ClientTest, TriesAStreamAgainUntilItBegins) {
  state().voxel_chunks = {Chunk({0})};
  state().failures = 2;
  int chunks = 0;
  EXPECT_TRUE(
      client_.QueryVoxels({.site = "hall"}, [&](const VoxelColumns&) { return ++chunks > 0; })
          .ok());
  EXPECT_EQ(chunks, 1);
  EXPECT_EQ(state().calls["QueryVoxels"], 3);
}

TEST_F(ClientTest, ReadsSessionsRobotsScansAndPaths) {
  v1::Session session;
  session.set_name("sites/hall/sessions/s1");
  session.set_robot("robots/r1");
  session.set_purpose(v1::PURPOSE_LISTENING);
  session.set_state(v1::SESSION_STATE_COMPLETE);
  session.add_warnings("the drive has no audio");
  state().sessions = {session, session, session};
  EXPECT_EQ(client_.ListSessions("hall")->size(), 3u);
  EXPECT_THAT(*client_.ListSessions("hall", "r2"), IsEmpty());
  const auto s1 = client_.GetSession("hall", "s1");
  ASSERT_TRUE(s1.ok()) << s1.status();
  EXPECT_EQ(s1->id, "s1");
  EXPECT_EQ(s1->site, "hall");
  EXPECT_EQ(s1->robot, "r1");
  EXPECT_EQ(s1->purpose, Purpose::kListening);
  EXPECT_EQ(s1->state, SessionState::kComplete);
  EXPECT_THAT(s1->warnings, ElementsAre("the drive has no audio"));

  v1::PoseEstimate pose;
  pose.set_time_ns(5);
  pose.mutable_map_from_base()->set_yaw_rad(0.5);
  pose.set_state(v1::LOCALIZATION_STATE_LOST);
  for (int i = 0; i < 9; ++i) pose.add_covariance(i);
  state().paths["sites/hall/sessions/s1"] = {pose, pose};
  const auto path = client_.GetTrajectory("hall", "s1");
  ASSERT_TRUE(path.ok()) << path.status();
  ASSERT_EQ(path->size(), 2u);
  EXPECT_EQ((*path)[0].map_from_base.yaw_rad, 0.5);
  EXPECT_EQ((*path)[0].state, LocalizationState::kLost);
  EXPECT_EQ((*path)[0].covariance->at(8), 8.0);

  v1::Robot robot;
  robot.set_name("robots/r1");
  robot.set_session("sites/hall/sessions/s1");
  *robot.mutable_pose() = pose;
  state().robots = {robot};
  const auto robots = client_.ListRobots("hall");
  ASSERT_TRUE(robots.ok()) << robots.status();
  EXPECT_EQ(robots->at(0).session, "s1");
  EXPECT_TRUE(robots->at(0).pose.has_value());

  v1::AudioScan scan;
  scan.set_session("sites/hall/sessions/s1");
  scan.set_robot("robots/r1");
  scan.add_peaks()->set_power(17.0);
  state().scans = {scan, scan, scan};
  const auto scans = client_.ListAudioScans({.site = "hall"});
  ASSERT_TRUE(scans.ok()) << scans.status();
  ASSERT_EQ(scans->size(), 3u);
  EXPECT_EQ(scans->at(0).robot, "r1");
  EXPECT_EQ(scans->at(0).peaks.at(0).power, 17.0);
  EXPECT_FALSE(scans->at(0).pose.has_value());
}

TEST_F(ClientTest, BuildsAMapWithProgress) {
  state().waits_until_done = 3;
  state().operation.set_report_json("{\"residual_m\":0.01}");
  std::vector<double> progress;
  const auto operation =
      client_.BuildMap({.site = "hall", .sessions = {"m1"}, .surveyed_poses = {{7, {1, 2, 3}}}},
                       [&](const Operation& state) {
                         progress.push_back(state.progress);
                         return true;
                       });
  ASSERT_TRUE(operation.ok()) << operation.status();
  EXPECT_EQ(operation->report_json, "{\"residual_m\":0.01}");
  EXPECT_THAT(progress, ElementsAre(0.5, 0.5, 1.0));
  EXPECT_THAT(state().last_build_request.sessions(), ElementsAre("sites/hall/sessions/m1"));
  ASSERT_EQ(state().last_build_request.surveyed_poses_size(), 1);
  EXPECT_EQ(state().last_build_request.surveyed_poses(0).time_ns(), 7);
  EXPECT_EQ(state().last_build_request.surveyed_poses(0).map_from_base().yaw_rad(), 3);
}

TEST_F(ClientTest, CancelsAnOperation) {
  state().waits_until_done = -1;
  const auto operation = client_.BuildMap({.site = "hall"}, [](const Operation&) { return false; });
  EXPECT_EQ(operation.status().code(), absl::StatusCode::kCancelled);
  EXPECT_EQ(state().calls["CancelOperation"], 1);
  EXPECT_THAT(state().last_build_request.sessions(), IsEmpty());
}

TEST_F(ClientTest, AFailedOperationIsAnError) {
  state().operation.set_error_code(static_cast<int>(grpc::StatusCode::FAILED_PRECONDITION));
  state().operation.set_error_message("the session m1 has no LIDAR scans");
  const auto operation = client_.BuildMap({.site = "hall"});
  EXPECT_EQ(operation.status().code(), absl::StatusCode::kFailedPrecondition);
  EXPECT_EQ(operation.status().message(), "the session m1 has no LIDAR scans");
}

TEST_F(ClientTest, ImportsAMap) {
  std::string bytes(700'000, 'x');  // three chunks
  bytes.back() = 'y';
  const auto operation = client_.ImportMap("hall", Write("hall.BT", bytes));
  ASSERT_TRUE(operation.ok()) << operation.status();
  EXPECT_EQ(state().imported_data, bytes);
  EXPECT_EQ(state().last_import_header.format(), "bt");
  EXPECT_EQ(state().last_import_header.site(), "sites/hall");
}

TEST_F(ClientTest, ImportsARosMapWithItsImage) {
  fs::create_directories(directory_ / "images");
  Write("images/plan.pgm", "P5 1 1 255 x");
  const std::string yaml = "resolution: 0.05\nimage: \"images/plan.pgm\"\n";
  ASSERT_TRUE(client_.ImportMap("hall", Write("plan.yaml", yaml)).ok());
  EXPECT_EQ(state().imported_data, yaml + "P5 1 1 255 x");
  EXPECT_EQ(state().last_import_header.format(), "yaml");
  EXPECT_EQ(state().last_import_header.image_offset(), static_cast<std::int64_t>(yaml.size()));
}

TEST_F(ClientTest, NamesTheFileThatCannotBeImported) {
  const auto fails = [&](const std::string& path, const std::string& sentence) {
    const absl::Status status = client_.ImportMap("hall", path).status();
    EXPECT_FALSE(status.ok());
    EXPECT_THAT(std::string(status.message()), HasSubstr(sentence));
  };
  fails(Path("no.bt"), "cannot read " + Path("no.bt"));
  fails(Path("no.xyz"), "no.xyz is not a .bt");
  fails(Write("a.yaml", "resolution: 1\n"), "a.yaml names no image");
  fails(Write("b.yaml", "image: gone.pgm\n"), "cannot read " + Path("gone.pgm"));
  fs::create_directories(directory_ / "folder.bt");
  fails(Path("folder.bt"), "is not a file");
  EXPECT_EQ(state().calls["ImportMap"], 0);
}

v1::ExportMapResponse ExportChunk(const std::string& suffix, const std::string& data) {
  v1::ExportMapResponse chunk;
  chunk.set_file_suffix(suffix);
  chunk.set_data(data);
  chunk.set_revision(3);
  return chunk;
}

TEST_F(ClientTest, ExportsAMap) {
  state().export_chunks = {ExportChunk(".ot", "abc"), ExportChunk("", "def")};
  const auto exported = client_.ExportMap(
      {.site = "hall", .what = ExportWhat::kSound, .format = "ot", .full = true, .min_updates = 5},
      Path("sound.ot"));
  ASSERT_TRUE(exported.ok()) << exported.status();
  EXPECT_EQ(Read(Path("sound.ot")), "abcdef");
  EXPECT_THAT(Files(), ElementsAre("sound.ot"));
  EXPECT_EQ(exported->bytes, 6);
  EXPECT_EQ(exported->revision, 3);
  EXPECT_EQ(state().last_export_request.what(), v1::EXPORT_WHAT_SOUND);
  EXPECT_TRUE(state().last_export_request.full());
  EXPECT_EQ(state().last_export_request.min_updates(), 5);
}

TEST_F(ClientTest, ExportsYamlAndItsImageBesideEachOther) {
  state().export_chunks = {ExportChunk(".yaml", "image: map.pgm\nresolution: 0.05\n"),
                           ExportChunk(".pgm", "P5")};
  const auto exported = client_.ExportMap(
      {.site = "hall", .what = ExportWhat::kFloorPlan, .format = "yaml"}, Path("plan.yaml"));
  ASSERT_TRUE(exported.ok()) << exported.status();
  EXPECT_THAT(Files(), ElementsAre("plan.pgm", "plan.yaml"));
  EXPECT_EQ(Read(Path("plan.yaml")), "image: plan.pgm\nresolution: 0.05\n");
  EXPECT_EQ(Read(Path("plan.pgm")), "P5");
  EXPECT_THAT(exported->files, ElementsAre(Path("plan.yaml"), Path("plan.pgm")));
}

TEST_F(ClientTest, AFailedExportLeavesNothingAndOverwritesNothing) {
  Write("sound.ot", "old");
  state().export_chunks = {ExportChunk(".ot", "abc")};
  state().export_status = {grpc::StatusCode::INTERNAL, "the disk broke"};
  const auto exported = client_.ExportMap({.site = "hall", .format = "ot"}, Path("sound.ot"));
  EXPECT_EQ(exported.status().message(), "the disk broke");
  EXPECT_THAT(Files(), ElementsAre("sound.ot"));
  EXPECT_EQ(Read(Path("sound.ot")), "old");
}

TEST_F(ClientTest, DoesNotFollowTheServerElsewhere) {
  for (const char* suffix : {"/../../x", ".", "ot", "./x", ".a b", ".aaaaaaaaaaaa"}) {
    state().export_chunks = {ExportChunk(suffix, "abc")};
    EXPECT_FALSE(client_.ExportMap({.site = "hall", .format = "ot"}, Path("a.ot")).ok()) << suffix;
  }
  EXPECT_THAT(Files(), IsEmpty());
  state().export_chunks = {ExportChunk("", "abc")};
  const absl::Status status =
      client_.ExportMap({.site = "hall", .format = "ot"}, Path("no/such/folder/a.ot")).status();
  EXPECT_THAT(std::string(status.message()), HasSubstr("cannot write " + Path("no/such/folder")));
}

v1::WatchEvent SourceEvent(const char* id, const char* token) {
  v1::WatchEvent event;
  event.set_resume_token(token);
  event.mutable_sound_source()->set_name(std::string("sites/hall/soundSources/") + id);
  return event;
}

v1::WatchEvent ResyncEvent() {
  v1::WatchEvent event;
  event.mutable_resync();
  return event;
}

// What a watch told, in a word each.
std::string WordOf(const WatchEvent& event) {
  if (const auto* source = std::get_if<SoundSource>(&event.event)) return source->id;
  if (std::holds_alternative<Resync>(event.event)) return "resync";
  if (std::holds_alternative<SnapshotComplete>(event.event)) return "complete";
  if (std::holds_alternative<Heartbeat>(event.event)) return "heartbeat";
  return "other";
}

class WatchTest : public ClientTest {
 protected:
  // Watches until so many events are told.
  absl::Status Watch(std::size_t count,
                     const WatchRequest& request = {.site = "hall", .sound_sources = true}) {
    return client_.Watch(request, [&](const WatchEvent& event) {
      told_.push_back(WordOf(event));
      return told_.size() < count;
    });
  }
  std::vector<std::string> Tokens() {
    std::vector<std::string> tokens;
    for (const auto& request : state().watch_requests) tokens.push_back(request.resume_token());
    return tokens;
  }
  std::vector<std::string> told_;
};

TEST_F(WatchTest, ConnectsAgainAndGoesOnWhereItStopped) {
  v1::WatchEvent complete;
  complete.mutable_snapshot_complete();  // without a token: the last one stays
  state().watch_script = {{{SourceEvent("s1", "t1"), SourceEvent("s2", "t2"), complete},
                           {grpc::StatusCode::UNAVAILABLE, "going down"}},
                          {{}, grpc::Status::OK},  // ends without a word
                          {{SourceEvent("s3", "t3")}, {grpc::StatusCode::CANCELLED, "shutdown"}},
                          {{SourceEvent("s4", "t4")}, grpc::Status::OK}};
  const absl::Status status = Watch(5);
  ASSERT_TRUE(status.ok()) << status;
  EXPECT_THAT(told_, ElementsAre("s1", "s2", "complete", "s3", "s4"));
  EXPECT_THAT(Tokens(), ElementsAre("", "t2", "t2", "t3"));
  EXPECT_EQ(state().watch_requests[3].site(), "sites/hall");
  EXPECT_TRUE(state().watch_requests[3].sound_sources());
  EXPECT_FALSE(state().watch_requests[3].robots());
}

TEST_F(WatchTest, ResumesFromTheCallersToken) {
  state().watch_script = {{{SourceEvent("s9", "t9")}, grpc::Status::OK}};
  ASSERT_TRUE(Watch(1, {.site = "hall", .sound_sources = true, .resume_token = "t8"}).ok());
  EXPECT_THAT(Tokens(), ElementsAre("t8"));
}

TEST_F(WatchTest, ResyncStartsAnew) {
  state().watch_script = {{{SourceEvent("s1", "t1"), ResyncEvent()}, grpc::Status::OK},
                          {{SourceEvent("s2", "t2")}, grpc::Status::OK}};
  ASSERT_TRUE(Watch(3).ok());
  EXPECT_THAT(told_, ElementsAre("s1", "resync", "s2"));
  EXPECT_THAT(Tokens(), ElementsAre("", ""));
}

TEST_F(WatchTest, AForgottenTokenStartsAnew) {
  state().watch_script = {{{SourceEvent("s1", "t1")}, {grpc::StatusCode::UNAVAILABLE, "restart"}},
                          {{}, {grpc::StatusCode::OUT_OF_RANGE, "the token t1 is not known"}},
                          {{SourceEvent("s2", "t2")}, grpc::Status::OK}};
  ASSERT_TRUE(Watch(3).ok());
  EXPECT_THAT(told_, ElementsAre("s1", "resync", "s2"));
  EXPECT_THAT(Tokens(), ElementsAre("", "t1", ""));
}

TEST_F(WatchTest, OtherErrorsEndIt) {
  state().watch_script = {{{SourceEvent("s1", "t1")}, {grpc::StatusCode::NOT_FOUND, "no hall"}}};
  const absl::Status status = Watch(9);
  EXPECT_EQ(status.code(), absl::StatusCode::kNotFound);
  EXPECT_EQ(status.message(), "no hall");
  EXPECT_EQ(state().watch_requests.size(), 1u);
}

TEST_F(WatchTest, GivesUpOnAServerThatNeverTellsAnything) {
  state().watch_script = {{{}, {grpc::StatusCode::UNAVAILABLE, "no"}}};
  EXPECT_EQ(Watch(1).code(), absl::StatusCode::kUnavailable);
  EXPECT_EQ(state().watch_requests.size(), 5u);  // retry.max_attempts
}

TEST_F(WatchTest, EndsWhenStopIsRequested) {
  state().watch_script = {{.stays_open = true}};
  std::stop_source stop;
  absl::Status status = absl::UnknownError("");
  std::thread watcher([&] {
    status = client_.Watch(
        {.site = "hall"}, [](const WatchEvent&) { return true; }, stop.get_token());
  });
  server_.WaitFor([&] { return !state().watch_requests.empty(); });
  stop.request_stop();
  watcher.join();
  EXPECT_TRUE(status.ok()) << status;
  server_.WaitFor([&] { return state().cancelled_watches == 1; });
}

}  // namespace
}  // namespace soundmap
