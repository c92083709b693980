// Runs the program `soundmap` itself against a fake server.
#include <fcntl.h>
#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <signal.h>
#include <spawn.h>
#include <sys/wait.h>

#include <cmath>
#include <filesystem>
#include <fstream>
#include <nlohmann/json.hpp>
#include <numbers>

#include "fake_server.h"
#include "recording/foxglove_messages.h"
#include "recording/writer.h"
#include "soundmap/resources.h"

extern char** environ;

namespace soundmap {
namespace {

namespace fs = std::filesystem;
using ::testing::AllOf;
using ::testing::ElementsAre;
using testing::FakeServer;
using testing::FakeState;
using ::testing::HasSubstr;
using ::testing::IsEmpty;
using ::testing::StartsWith;

std::string ReadFile(const fs::path& path) {
  std::ifstream file(path, std::ios::binary);
  return std::string(std::istreambuf_iterator<char>(file), {});
}

struct Result {
  int exit_status = -1;
  std::string out;
  std::string err;
};

// The running program.
class Program {
 public:
  Program(const fs::path& directory, std::vector<std::string> arguments) : directory_(directory) {
    arguments.insert(arguments.begin(), SOUNDMAP_BIN_DIR "/soundmap");
    std::vector<char*> argv;
    for (std::string& argument : arguments) argv.push_back(argument.data());
    argv.push_back(nullptr);
    posix_spawn_file_actions_t actions;
    posix_spawn_file_actions_init(&actions);
    const int flags = O_WRONLY | O_CREAT | O_TRUNC;
    posix_spawn_file_actions_addopen(&actions, 1, (directory_ / "out").c_str(), flags, 0600);
    posix_spawn_file_actions_addopen(&actions, 2, (directory_ / "err").c_str(), flags, 0600);
    EXPECT_EQ(posix_spawn(&pid_, argv[0], &actions, nullptr, argv.data(), environ), 0) << argv[0];
    posix_spawn_file_actions_destroy(&actions);
  }
  void Interrupt() const { kill(pid_, SIGINT); }
  Result Wait() const {
    int status = 0;
    waitpid(pid_, &status, 0);
    return {WIFEXITED(status) ? WEXITSTATUS(status) : 1000 + WTERMSIG(status),
            ReadFile(directory_ / "out"), ReadFile(directory_ / "err")};
  }

 private:
  fs::path directory_;
  pid_t pid_ = 0;
};

class CliTest : public ::testing::Test {
 protected:
  CliTest() {
    directory_ =
        fs::path(::testing::TempDir()) /
        (std::string("cli_") + ::testing::UnitTest::GetInstance()->current_test_info()->name());
    fs::remove_all(directory_);
    fs::create_directories(directory_);
    unsetenv("SOUNDMAP_SERVER");
  }
  // With --server of the fake server.
  Result Run(std::vector<std::string> arguments) {
    arguments.insert(arguments.end(), {"--server", server_.address()});
    return Program(directory_, arguments).Wait();
  }
  std::string Write(const std::string& name, const std::string& text) const {
    std::ofstream(directory_ / name, std::ios::binary) << text;
    return (directory_ / name).string();
  }
  FakeState& state() { return server_.state(); }

  FakeServer server_;
  fs::path directory_;
};

// One line, a sentence that begins with the program's name.
void ExpectOneSentence(const Result& result) {
  EXPECT_THAT(result.err, StartsWith("soundmap: "));
  EXPECT_EQ(std::count(result.err.begin(), result.err.end(), '\n'), 1) << result.err;
}

TEST_F(CliTest, WrongUsageExitsWith2) {
  const std::vector<std::vector<std::string>> lines = {
      {},
      {"bogus"},
      {"site"},
      {"site", "create"},
      {"site", "create", "a", "--profile", "x"},
      {"site", "create", "a", "--band", "hiss"},
      {"site", "create", "a", "--band", "hiss=4000"},
      {"site", "create", "a", "--band", "hiss=low-high"},
      {"site", "create", "a", "--band", "hiss=4000-8000-9000"},
      {"sources", "a", "--band"},
      {"map", "build"},
      {"map", "export", "a", "--what", "smell", "--format", "ot", "-o", "f"},
      {"map", "export", "a", "--what", "sound", "--format", "exe", "-o", "f"},
      {"map", "export", "a", "--what", "sound", "--format", "ot"},
      {"sources"},
      {"sources", "a", "b"},
      {"sources", "a", "--format", "xml"},
      {"sources", "a", "--min-probability", "1.5"},
      {"sources", "a", "--since", "yesterday"},
      {"sources", "a", "--unknown"},
      {"sources", "a", "--server", "nowhere"},
      {"voxels", "a"},
      {"voxels", "a", "--box", "1,2,3"},
      {"voxels", "a", "--box", "1,0,0,0,1,1"},
      {"voxels", "a", "--box", "0,0,0,1,1,nan"},
      {"voxels", "a", "--box", "0,0,0,1,1,1", "--min-updates", "-1"},
      {"watch"},
      {"watch", "a", "--count", "0"},
      {"robots", "a", "--format", "csv"},
      {"robots", "a", "--session", "s"},
      {"robots", "a", "--path", "--format", "table"},
      {"evaluate", "a"},
  };
  for (const auto& line : lines) {
    const Result result = Program(directory_, line).Wait();
    EXPECT_EQ(result.exit_status, 2) << ::testing::PrintToString(line) << result.err;
    EXPECT_THAT(result.out, IsEmpty());
    ExpectOneSentence(result);
  }
}

TEST_F(CliTest, HelpIsNoError) {
  for (const char* command : {"", "site", "map", "sources", "voxels", "watch", "robots", "sessions",
                              "operations", "evaluate"}) {
    std::vector<std::string> line = {"--help"};
    if (*command != '\0') line.insert(line.begin(), command);
    const Result result = Program(directory_, line).Wait();
    EXPECT_EQ(result.exit_status, 0) << command;
    EXPECT_THAT(result.out, HasSubstr("Usage: soundmap"));
  }
}

TEST_F(CliTest, AnUnreachableServerIsOneSentence) {
  std::string address;
  {
    const FakeServer gone;
    address = gone.address();
  }
  for (const std::vector<std::string>& line : std::vector<std::vector<std::string>>{
           {"site", "list"}, {"sources", "a"}, {"watch", "a"}, {"map", "build", "a"}}) {
    std::vector<std::string> arguments = line;
    arguments.insert(arguments.begin(), {"--server", address});
    const Result result = Program(directory_, arguments).Wait();
    EXPECT_EQ(result.exit_status, 1);
    EXPECT_EQ(result.err,
              "soundmap: cannot reach the server at " + address + ": connection refused\n");
    EXPECT_THAT(result.out, IsEmpty());
  }
}

TEST_F(CliTest, TakesTheServerFromTheEnvironment) {
  setenv("SOUNDMAP_SERVER", server_.address().c_str(), 1);
  const Result result = Program(directory_, {"site", "list", "--format", "json"}).Wait();
  unsetenv("SOUNDMAP_SERVER");
  EXPECT_EQ(result.exit_status, 0) << result.err;
  EXPECT_EQ(result.out, "{\"sites\":[]}\n");
}

TEST_F(CliTest, AServersErrorIsItsSentence) {
  const Result result = Run({"site", "show", "hall"});
  EXPECT_EQ(result.exit_status, 1);
  EXPECT_EQ(result.err, "soundmap: there is no sites/hall\n");
}

// Of nobody, valid for 100 years; its key was thrown away.
constexpr char kCertificate[] =
    "-----BEGIN CERTIFICATE-----\n"
    "MIIBdjCCARugAwIBAgIUBiACJVVJ93ONq96Jqbse+8aMJncwCgYIKoZIzj0EAwIw\n"
    "DzENMAsGA1UEAwwEdGVzdDAgFw0yNjExMjIwMjM5NTZaGA8yMTI2MTAyOTAyMzk1\n"
    "NlowDzENMAsGA1UEAwwEdGVzdDBZMBMGByqGSM49AgEGCCqGSM49AwEHA0IABPKS\n"
    "NBPKT6Y6tT+lw0W3an8dHDKRr52ULLnu81LgbqMjSB68vCaUae09IbvtmQvz45HX\n"
    "1WonE2wNuQJnAXoQB6KjUzBRMB0GA1UdDgQWBBTEs5w/IzKShaitA2eGm08bYUKZ\n"
    "UzAfBgNVHSMEGDAWgBTEs5w/IzKShaitA2eGm08bYUKZUzAPBgNVHRMBAf8EBTAD\n"
    "AQH/MAoGCCqGSM49BAMCA0kAMEYCIQCTq9MDasx8M73lyvzz2dWWUnQf3SqP9PIi\n"
    "krvPEzW80AIhAIhc7yh1YUby8sngK0TdrytR0jU31DwlJDrJEAHJyQ/S\n"
    "-----END CERTIFICATE-----\n";

TEST_F(CliTest, ATlsHandshakeThatFailsIsOneSentence) {
  // The fake server speaks plain text.
  const Result result = Run({"site", "list", "--tls-ca", Write("ca.pem", kCertificate)});
  EXPECT_EQ(result.exit_status, 1);
  EXPECT_EQ(result.err,
            "soundmap: the TLS handshake with the server at " + server_.address() + " failed\n");
}

TEST_F(CliTest, ACertificateThatIsNoneIsNamed) {
  for (const char* text :
       {"", "junk", "-----BEGIN CERTIFICATE-----\nMIIB\n-----END CERTIFICATE-----\n"}) {
    const std::string file = Write("ca.pem", text);
    const Result result = Run({"site", "list", "--tls-ca", file});
    EXPECT_EQ(result.exit_status, 1);
    EXPECT_EQ(result.err, "soundmap: " + file + " holds no certificate in PEM form\n");
  }
}

TEST_F(CliTest, AMissingFileIsNamed) {
  for (const std::vector<std::string>& line : std::vector<std::vector<std::string>>{
           {"site", "list", "--token-file", "/no/such"},
           {"site", "list", "--tls-ca", "/no/such"},
           {"map", "build", "a", "--poses", "/no/such"},
           {"evaluate", "a", "--truth", "/no/such"},
           {"evaluate", "a", "--drive", "/no/such"},
           {"evaluate", "a", "--poses", "/no/such"},
           {"evaluate", "a", "--relations", "/no/such"},
       }) {
    const Result result = Run(line);
    EXPECT_EQ(result.exit_status, 1);
    EXPECT_THAT(result.err, HasSubstr("/no/such"));
    ExpectOneSentence(result);
  }
}

TEST_F(CliTest, CreatesASiteWithAMap) {
  const Result result = Run({"site", "create", "hall", "--map", Write("hall.bt", "tree"),
                             "--profile", "paper", "--format", "json"});
  ASSERT_EQ(result.exit_status, 0) << result.err;
  const auto json = nlohmann::json::parse(result.out);
  EXPECT_EQ(json["id"], "hall");
  EXPECT_EQ(json["profile"], "paper");
  EXPECT_EQ(state().imported_data, "tree");
  EXPECT_THAT(Run({"site", "list"}).out, HasSubstr("hall  paper"));
  EXPECT_EQ(Run({"site", "delete", "hall"}).exit_status, 0);
  EXPECT_TRUE(state().sites.empty());
}

TEST_F(CliTest, CreatesASiteWithBands) {
  const Result created =
      Run({"site", "create", "--band", "hiss-high=4000-8000", "hall", "--band", "hum=62.5-500"});
  ASSERT_EQ(created.exit_status, 0) << created.err;
  EXPECT_THAT(created.out,
              HasSubstr("band hiss-high: 4000 to 8000 Hz\nband hum: 62.5 to 500 Hz\n"));
  const v1::Site& site = state().sites["sites/hall"];
  ASSERT_EQ(site.bands_size(), 2);
  EXPECT_EQ(site.bands(0).name(), "hiss-high");
  EXPECT_EQ(site.bands(0).min_frequency_hz(), 4000.0);
  EXPECT_EQ(site.bands(0).max_frequency_hz(), 8000.0);
  EXPECT_EQ(site.bands(1).min_frequency_hz(), 62.5);
  EXPECT_THAT(Run({"site", "show", "hall"}).out, HasSubstr("band hum: 62.5 to 500 Hz\n"));
  EXPECT_THAT(Run({"site", "show", "hall", "--format", "json"}).out,
              HasSubstr(R"("bands":[{"name":"hiss-high","min_frequency_hz":4000.0,)"
                        R"("max_frequency_hz":8000.0},{"name":"hum",)"));
  ASSERT_EQ(Run({"site", "create", "plain"}).exit_status, 0);
  for (const char* format : {"table", "json"}) {
    const std::string out = Run({"site", "show", "plain", "--format", format}).out;
    EXPECT_EQ(out.find("band"), std::string::npos) << out;
  }
}

TEST_F(CliTest, SetsHowLongFramesAreKept) {
  ASSERT_EQ(Run({"site", "create", "hall"}).exit_status, 0);
  EXPECT_THAT(Run({"site", "list"}).out, HasSubstr("for ever"));
  for (const auto& [given, seconds, told] : {std::tuple("30d", 2592000, "30 d"),
                                             {"12h", 43200, "12 h"},
                                             {"90min", 5400, "90 min"},
                                             {"45s", 45, "45 s"},
                                             {"0s", 0, "for ever"}}) {
    const Result result = Run({"site", "set", "hall", "--keep-frames", given});
    EXPECT_EQ(result.exit_status, 0) << result.err;
    EXPECT_THAT(result.out, HasSubstr(told));
    EXPECT_EQ(state().sites["sites/hall"].keep_frames_s(), seconds);
  }
  for (const char* wrong : {"7", "x", "1 year", "99999999999999999999d"}) {
    EXPECT_EQ(Run({"site", "set", "hall", "--keep-frames", wrong}).exit_status, 2) << wrong;
  }
}

TEST_F(CliTest, ASiteWhoseMapIsRefusedIsNotLeftBehind) {
  state().operation.set_error_code(3);
  state().operation.set_error_message("this is not an OctoMap file");
  const Result result = Run({"site", "create", "hall", "--map", Write("hall.bt", "junk")});
  EXPECT_EQ(result.exit_status, 1);
  EXPECT_EQ(result.err, "soundmap: this is not an OctoMap file\n");
  EXPECT_TRUE(state().sites.empty());
}

TEST_F(CliTest, InterruptCancelsTheBuild) {
  state().waits_until_done = -1;
  const Program program(directory_, {"map", "build", "hall", "--server", server_.address()});
  server_.WaitFor([&] { return state().calls["WaitOperation"] > 0; });
  program.Interrupt();
  const Result result = program.Wait();
  EXPECT_EQ(result.exit_status, 1);
  EXPECT_EQ(result.err, "soundmap: the operation was cancelled\n");
  EXPECT_EQ(state().calls["CancelOperation"], 1);
}

TEST_F(CliTest, BuildsFromSurveyedPoses) {
  const Result result = Run({"map", "build", "hall", "--from-session", "m1", "--from-session", "m2",
                             "--extend", "--poses", Write("p.csv", "1,2,3,0.5\n2,2,3,0.5\n")});
  ASSERT_EQ(result.exit_status, 0) << result.err;
  EXPECT_THAT(state().last_build_request.sessions(),
              ElementsAre("sites/hall/sessions/m1", "sites/hall/sessions/m2"));
  EXPECT_TRUE(state().last_build_request.extend());
  EXPECT_EQ(state().last_build_request.surveyed_poses_size(), 2);
}

TEST_F(CliTest, ExportsAFloorPlan) {
  v1::ExportMapResponse yaml, pgm;
  yaml.set_file_suffix(".yaml");
  yaml.set_data("image: x.pgm\n");
  pgm.set_file_suffix(".pgm");
  pgm.set_data("P5");
  state().export_chunks = {yaml, pgm};
  const Result result = Run({"map", "export", "hall", "--what", "floor-plan", "--format", "yaml",
                             "-o", (directory_ / "plan.yaml").string()});
  ASSERT_EQ(result.exit_status, 0) << result.err;
  EXPECT_EQ(ReadFile(directory_ / "plan.yaml"), "image: plan.pgm\n");
  EXPECT_EQ(ReadFile(directory_ / "plan.pgm"), "P5");
  EXPECT_EQ(state().last_export_request.what(), v1::EXPORT_WHAT_FLOOR_PLAN);
}

v1::SoundSource Source(const std::string& id, double x, double y, double z, double probability) {
  v1::SoundSource source;
  source.set_name("sites/hall/soundSources/" + id);
  source.mutable_position_m()->set_x(x);
  source.mutable_position_m()->set_y(y);
  source.mutable_position_m()->set_z(z);
  source.set_probability(probability);
  source.set_extent_m(0.5);
  source.set_evidence_count(40);
  source.set_first_heard_ns(1'000'000'000'000);
  source.set_last_heard_ns(1'060'250'000'000);
  source.set_peak_log_odds(3.5);
  source.set_voxel_count(9);
  source.set_state(v1::SOUND_SOURCE_STATE_ACTIVE);
  return source;
}

TEST_F(CliTest, AsksForTheMapOfABand) {
  v1::SoundSource hiss = Source("hiss-s1", 2, 1.6, 2.7, 0.75);
  hiss.set_band("hiss");
  state().sources = {hiss, Source("s1", 2, 1.6, 2.7, 0.5)};
  const Result sources = Run({"sources", "hall", "--band", "hiss", "--format", "json"});
  ASSERT_EQ(sources.exit_status, 0) << sources.err;
  EXPECT_EQ(state().last_sources_request.band(), "hiss");
  const auto listed = nlohmann::json::parse(sources.out)["sources"];
  EXPECT_EQ(listed[0]["id"], "hiss-s1");
  EXPECT_EQ(listed[0]["band"], "hiss");
  EXPECT_FALSE(listed[1].contains("band"));
  EXPECT_THAT(Run({"sources", "hall"}).out, HasSubstr("hiss-s1"));
  EXPECT_EQ(state().last_sources_request.band(), "");

  const Result voxels = Run({"voxels", "hall", "--band", "hiss", "--box", "0,0,0,1,1,1"});
  ASSERT_EQ(voxels.exit_status, 0) << voxels.err;
  EXPECT_EQ(state().last_voxels_request.band(), "hiss");
  EXPECT_THAT(voxels.out, StartsWith(R"({"site":"hall","band":"hiss","revision":)"));
  EXPECT_THAT(Run({"voxels", "hall", "--box", "0,0,0,1,1,1"}).out,
              StartsWith(R"({"site":"hall","revision":)"));

  v1::ExportMapResponse file;
  file.set_file_suffix(".ply");
  file.set_data("ply");
  state().export_chunks = {file};
  EXPECT_EQ(Run({"map", "export", "hall", "--what", "sound", "--format", "ply", "--band", "hiss",
                 "-o", (directory_ / "hiss.ply").string()})
                .exit_status,
            0);
  EXPECT_EQ(state().last_export_request.band(), "hiss");

  v1::WatchEvent heard;
  *heard.mutable_sound_source() = hiss;
  v1::WatchEvent scan;
  scan.mutable_audio_scan()->set_band("hiss");
  v1::WatchEvent of_main;
  of_main.mutable_audio_scan()->set_time_ns(5);
  state().watch_script = {{.events = {heard, scan, of_main}, .stays_open = true}};
  const Result watched =
      Run({"watch", "hall", "--sources", "--scans", "--band", "hiss", "--count", "3"});
  EXPECT_EQ(state().watch_requests.back().band(), "hiss");
  EXPECT_EQ(std::count(watched.out.begin(), watched.out.end(), '\n'), 3);
  const auto second = watched.out.find("audio_scan");
  EXPECT_THAT(watched.out.substr(0, second), HasSubstr(R"("band":"hiss")"));
  const auto third = watched.out.find("audio_scan", second + 1);
  EXPECT_THAT(watched.out.substr(second, third - second), HasSubstr(R"("band":"hiss")"));
  EXPECT_EQ(watched.out.substr(third).find("band"), std::string::npos);
}

TEST_F(CliTest, PrintsSources) {
  v1::SoundSource silent = Source("s2", 0.1, -5.4, 2.7, 0.9);
  silent.set_state(v1::SOUND_SOURCE_STATE_SILENT);
  for (const double value : {1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 2.5}) {
    silent.add_position_covariance_m2(value);
  }
  silent.set_view_point_count(3);
  silent.add_robots("robots/r1");
  silent.add_robots("robots/r2");
  silent.set_last_listened_ns(1'070'000'000'000);
  v1::HeardPeriod* period = silent.add_heard_periods();
  period->set_start_ns(1'000'000'000'000);
  period->set_end_ns(1'060'250'000'000);
  silent.set_level_db(-12.5);
  silent.set_spl_db(110.5);
  v1::OctaveBandLevel* band = silent.add_spectrum();
  band->set_centre_hz(500.0);
  band->set_level_db(-14.0);
  band->set_spl_db(109.0);
  state().sources = {Source("s1", 2, 1.6, 2.7, 0.75), silent};
  const std::vector<std::string> line = {"sources",           "hall", "--format", "json",
                                         "--min-probability", "0.5",  "--since",  "10.5"};
  const Result json = Run(line);
  ASSERT_EQ(json.exit_status, 0) << json.err;
  EXPECT_EQ(json.out,
            R"({"site":"hall","revision":12,"as_of_ns":1000000000000,"sources":[)"
            R"({"id":"s2","position_m":[0.1,-5.4,2.7],"extent_m":0.5,"probability":0.9,)"
            R"("evidence_count":40,"first_heard_ns":1000000000000,"last_heard_ns":1060250000000,)"
            R"("peak_log_odds":3.5,"voxel_count":9,"state":"silent",)"
            R"("position_covariance_m2":[1.0,0.0,0.0,0.0,1.0,0.0,0.0,0.0,2.5],)"
            R"("view_point_count":3,"robots":["r1","r2"],"last_listened_ns":1070000000000,)"
            R"("heard_periods_ns":[[1000000000000,1060250000000]],"level_db":-12.5,)"
            R"("spl_db":110.5,"spectrum":[{"centre_hz":500.0,"level_db":-14.0,"spl_db":109.0}]},)"
            R"({"id":"s1","position_m":[2.0,1.6,2.7],"extent_m":0.5,"probability":0.75,)"
            R"("evidence_count":40,"first_heard_ns":1000000000000,"last_heard_ns":1060250000000,)"
            R"("peak_log_odds":3.5,"voxel_count":9,"state":"active","view_point_count":0,)"
            R"("robots":[],"last_listened_ns":0}]})"
            "\n");
  EXPECT_EQ(state().last_sources_request.since_ns(), 10'500'000'000);
  EXPECT_EQ(state().last_sources_request.min_probability(), 0.5);
  std::swap(state().sources[0], state().sources[1]);
  EXPECT_EQ(Run(line).out, json.out);
  EXPECT_EQ(
      Run({"sources", "hall"}).out,
      "SOURCE  X [m]  Y [m]  Z [m]  EXTENT [m]  PROBABILITY  STATE   LEVEL [dB]  SPL [dB]  VIEWS  "
      "EVIDENCE  FIRST HEARD "
      "              LAST HEARD\n"
      "s2       0.10  -5.40   2.70        0.50        0.900  silent       -12.5     110.5      3   "
      "     40  "
      "1970-01-01T00:16:40.000Z  1970-01-01T00:17:40.250Z\n"
      "s1       2.00   1.60   2.70        0.50        0.750  active           -         -      0   "
      "     40  "
      "1970-01-01T00:16:40.000Z  1970-01-01T00:17:40.250Z\n");
}

TEST_F(CliTest, TellsWhereASourceMayBeInstead) {
  state().sources = {Source("s1", 2, 1.6, 2.5, 0.9), Source("s2", 0.1, -5.4, 2.5, 0.8)};
  v1::Vector3& mirror = *state().sources[0].mutable_mirror_position_m();
  mirror.set_x(2);
  mirror.set_y(1.6);
  mirror.set_z(-0.125);
  const auto json = nlohmann::json::parse(Run({"sources", "hall", "--format", "json"}).out);
  EXPECT_EQ(json["sources"][0]["mirror_position_m"], nlohmann::json::parse("[2.0, 1.6, -0.125]"));
  EXPECT_FALSE(json["sources"][1].contains("mirror_position_m"));
  const std::string table = Run({"sources", "hall"}).out;
  EXPECT_THAT(table, HasSubstr("s2       0.10  -5.40   2.50"));
  EXPECT_THAT(table,
              ::testing::EndsWith("Z\ns1 may be at 2.00 1.60 -0.12 instead: the array cannot "
                                  "tell above from below.\n"));
}

TEST_F(CliTest, TellsWhatAGhostIsOf) {
  state().sources = {Source("s1", 2, 1.6, 2.5, 0.9), Source("s2", 0.1, -5.4, 2.5, 0.2)};
  state().sources[1].set_explained_by("sites/hall/soundSources/s1");
  const auto json = nlohmann::json::parse(Run({"sources", "hall", "--format", "json"}).out);
  EXPECT_FALSE(json["sources"][0].contains("explained_by"));
  EXPECT_EQ(json["sources"][1]["explained_by"], "s1");
  EXPECT_THAT(
      Run({"sources", "hall"}).out,
      ::testing::EndsWith("Z\ns2 may be a ghost of s1, heard in its direction or mirrored.\n"));
}

TEST_F(CliTest, AsksForATimeWindowAndForStates) {
  ASSERT_EQ(Run({"sources", "hall", "--since", "100", "--until", "200", "--state", "active",
                 "--state", "gone"})
                .exit_status,
            0);
  const v1::ListSoundSourcesRequest& request = state().last_sources_request;
  EXPECT_EQ(request.start_ns(), 100'000'000'000);
  EXPECT_EQ(request.end_ns(), 200'000'000'000);
  EXPECT_EQ(request.since_ns(), 0);
  ASSERT_EQ(request.states_size(), 2);
  EXPECT_EQ(request.states(0), v1::SOUND_SOURCE_STATE_ACTIVE);
  EXPECT_EQ(request.states(1), v1::SOUND_SOURCE_STATE_GONE);
  EXPECT_EQ(Run({"sources", "hall", "--state", "loud"}).exit_status, 2);
}

TEST_F(CliTest, PrintsVoxels) {
  v1::VoxelChunk chunk;
  chunk.set_voxel_size_m(0.05);
  chunk.set_revision(3);
  for (const std::uint32_t key : {32808u, 32768u}) {  // not in order
    chunk.add_x_key(key);
    chunk.add_y_key(32767);
    chunk.add_z_key(32768);
    chunk.add_log_odds(0.9f);
    chunk.add_update_count(4);
    chunk.add_last_update_ns(1'000'000'000'123);
  }
  state().voxel_chunks = {chunk};
  const Result csv = Run({"voxels", "hall", "--box", "-1,-1,-1,3,1,1", "--format", "csv"});
  ASSERT_EQ(csv.exit_status, 0) << csv.err;
  EXPECT_EQ(csv.out,
            "x_m,y_m,z_m,log_odds,update_count,last_update_ns\n"
            "0.025,-0.025,0.025,0.9,4,1000000000123\n"
            "2.025,-0.025,0.025,0.9,4,1000000000123\n");
  EXPECT_EQ(state().last_voxels_request.box().min_m().x(), -1.0);
  EXPECT_EQ(state().last_voxels_request.box().max_m().x(), 3.0);
  const Result json = Run({"voxels", "hall", "--box", "-1,-1,-1,3,1,1"});
  EXPECT_EQ(json.out, R"({"site":"hall","revision":3,"as_of_ns":0,"voxel_size_m":0.05,"voxels":[)"
                      R"({"x_m":0.025,"y_m":-0.025,"z_m":0.025,"log_odds":0.9,"update_count":4,)"
                      R"("last_update_ns":1000000000123},)"
                      R"({"x_m":2.025,"y_m":-0.025,"z_m":0.025,"log_odds":0.9,"update_count":4,)"
                      R"("last_update_ns":1000000000123}]})"
                      "\n");
}

TEST_F(CliTest, WatchTellsWhatHappenedToASource) {
  v1::WatchEvent event;
  event.set_revision(8);
  event.set_resume_token("t8");
  v1::SoundSourceEvent& happened = *event.mutable_sound_source_event();
  happened.set_kind(v1::SoundSourceEvent::KIND_MOVED);
  happened.set_time_ns(1'000'000'000'001);
  *happened.mutable_sound_source() = Source("s1", 2, 1.6, 2.7, 0.75);
  happened.set_other_sound_source("sites/hall/soundSources/s2");
  happened.mutable_from_m()->set_x(1.5);
  state().watch_script = {{{event}, grpc::Status::OK}};
  const Result result = Run({"watch", "hall", "--sources", "--count", "1"});
  ASSERT_EQ(result.exit_status, 0) << result.err;
  EXPECT_THAT(result.out, StartsWith(R"({"event":"source_moved","time_ns":1000000000001,)"
                                     R"("sound_source":{"id":"s1","position_m":[2.0,1.6,2.7],)"));
  EXPECT_THAT(
      result.out,
      HasSubstr(R"("other":"s2","from_m":[1.5,0.0,0.0],"revision":8,"resume_token":"t8"})"));
}

TEST_F(CliTest, WatchesScansInDegrees) {
  v1::WatchEvent event;
  event.set_revision(8);
  event.set_resume_token("t8");
  v1::AudioScan& scan = *event.mutable_audio_scan();
  scan.set_robot("robots/r1");
  scan.set_session("sites/hall/sessions/s1");
  scan.set_time_ns(5);
  scan.set_noise_floor(3.25);
  scan.mutable_pose()->mutable_map_from_base()->set_x_m(1.5);
  scan.mutable_pose()->set_state(v1::LOCALIZATION_STATE_TRACKING);
  auto& peak = *scan.add_peaks();
  peak.set_azimuth_rad(std::acos(-1.0) / 2);
  peak.set_elevation_rad(-std::acos(-1.0) / 4);
  peak.set_power(17.5);
  state().watch_script = {{.events = {event}, .stays_open = true}};
  const Result result = Run({"watch", "hall", "--scans", "--count", "1"});
  ASSERT_EQ(result.exit_status, 0) << result.err;
  EXPECT_EQ(result.out,
            R"({"event":"audio_scan","time_ns":5,"robot":"r1","session":"s1",)"
            R"("pose":{"time_ns":0,"x_m":1.5,"y_m":0.0,"yaw_rad":0.0,"state":"tracking"},)"
            R"("noise_floor":3.25,"peaks":[{"azimuth_deg":90.0,"elevation_deg":-45.0,)"
            R"("power":17.5}],"end_point_count":0,"revision":8,"resume_token":"t8"})"
            "\n");
  EXPECT_TRUE(state().watch_requests[0].audio_scans());
  EXPECT_FALSE(state().watch_requests[0].sound_sources());
}

v1::PoseEstimate Pose(std::int64_t time_ns, double x, double y) {
  v1::PoseEstimate pose;
  pose.set_time_ns(time_ns);
  pose.mutable_map_from_base()->set_x_m(x);
  pose.mutable_map_from_base()->set_y_m(y);
  pose.set_state(v1::LOCALIZATION_STATE_TRACKING);
  return pose;
}

v1::Session ListeningSession(const std::string& id, std::int64_t create_time_ns) {
  v1::Session session;
  session.set_name("sites/hall/sessions/" + id);
  session.set_robot("robots/r1");
  session.set_purpose(v1::PURPOSE_LISTENING);
  session.set_create_time_ns(create_time_ns);
  return session;
}

TEST_F(CliTest, PrintsThePathOfTheNewestSession) {
  state().sessions = {ListeningSession("old", 1), ListeningSession("new", 3),
                      ListeningSession("mid", 2)};
  state().paths["sites/hall/sessions/new"] = {Pose(1'000'250'000'000, 1.5, -2)};
  const Result csv = Run({"robots", "hall", "--path"});
  ASSERT_EQ(csv.exit_status, 0) << csv.err;
  EXPECT_EQ(csv.out, "# timestamp_s,x,y,yaw\n1000.250000000,1.500000,-2.000000,0.000000\n");
  EXPECT_EQ(Run({"robots", "hall", "--path", "--format", "tum", "--session", "new"}).out,
            "# timestamp x y z qx qy qz qw\n"
            "1000.250000000 1.500000 -2.000000 0 0 0 0.000000000 1.000000000\n");
}

TEST_F(CliTest, TellsWhereARobotIsLiveAndHowFarItsClockIsOff) {
  v1::ClockOffset offset;
  offset.set_server_minus_robot_ns(-3'214'400);
  offset.set_uncertainty_ns(402'000);
  offset.set_time_ns(9);
  offset.set_drift_ppm(100.0);
  v1::LiveView live;
  live.set_session("sites/hall/sessions/s2");
  live.set_age_ns(250'000'000);
  live.set_drive_state(v1::DRIVE_STATE_RECORDING);
  live.set_recorded_frames(70);
  live.set_odometry_time_ns(8);
  live.mutable_odom_from_base()->set_x_m(1.0);
  live.mutable_map_from_base()->set_x_m(8.214);
  live.mutable_map_from_base()->set_yaw_rad(std::numbers::pi / 2.0);
  live.set_localized_time_ns(7);
  live.mutable_laser()->add_range_m(0.1f);
  v1::Robot robot;
  robot.set_name("robots/r1");
  robot.set_site("sites/hall");
  *robot.mutable_live() = live;
  *robot.mutable_clock_offset() = offset;
  state().robots = {robot};
  const Result table = Run({"robots", "hall"});
  EXPECT_THAT(table.out, AllOf(HasSubstr("-3.214 +-0.402"),
                               HasSubstr("recording at 8.21, 0.00, 90; 0.2 s ago")));
  const std::string live_json =
      R"({"session":"s2","age_ns":250000000,"recording":true,"recorded_frames":70,)"
      R"("odometry_time_ns":8,"odom_from_base":{"x_m":1.0,"y_m":0.0,"yaw_rad":0.0},)"
      R"("map_from_base":{"x_m":8.214,"y_m":0.0,"yaw_rad":1.5707963267948966},)"
      R"("localized_time_ns":7,"laser":{"time_ns":0,"start_angle_rad":0.0,)"
      R"("angle_increment_rad":0.0,"range_m":[0.1]}})";
  const std::string offset_json =
      R"({"server_minus_robot_ns":-3214400,"uncertainty_ns":402000,"time_ns":9,)"
      R"("drift_ppm":100.0})";
  EXPECT_THAT(Run({"robots", "hall", "--format", "json"}).out,
              AllOf(HasSubstr("\"live\":" + live_json), HasSubstr(offset_json)));
  v1::Session session = ListeningSession("s", 1);
  *session.add_clock_offsets() = offset;
  state().sessions = {session};
  EXPECT_THAT(Run({"sessions", "hall"}).out, HasSubstr("-3.214 +-0.402"));
  EXPECT_THAT(Run({"sessions", "hall", "--format", "json"}).out,
              HasSubstr("\"clock_offsets\":[" + offset_json + "]"));
  v1::WatchEvent event;
  event.mutable_live_robot()->set_robot("robots/r1");
  *event.mutable_live_robot()->mutable_live() = live;
  v1::WatchEvent gone;
  gone.mutable_live_robot()->set_robot("robots/r1");
  state().watch_script = {{.events = {event, gone}, .stays_open = true}};
  EXPECT_THAT(Run({"watch", "hall", "--robots", "--count", "2"}).out,
              AllOf(HasSubstr(R"({"event":"live_robot","robot":"r1","live":)" + live_json),
                    HasSubstr(R"({"event":"live_robot","robot":"r1","live":null)")));
  // A day of 100 ppm.
  const ClockOffset known{0, 402'000, 9, 100.0};
  EXPECT_EQ(known.UncertaintyAt(9 + 86'400'000'000'000), 8'640'402'000);
}

TEST_F(CliTest, Evaluates) {
  v1::Site site;
  site.set_name("sites/hall");
  site.set_max_range_m(10.0);
  state().sites["sites/hall"] = site;
  state().sources = {Source("s1", 2, 1, 2.5, 0.9), Source("s2", 2.25, 1, 2.5, 0.8),
                     Source("s3", 8, 8, 0, 0.7), Source("s4", 8, 8, 0, 0.3)};
  state().sessions = {ListeningSession("s", 1)};
  state().paths["sites/hall/sessions/s"] = {Pose(0, 0, 0.25), Pose(1'000'000'000, 1, 0.25)};
  const std::string truth = Write("t.truth.json", R"({"sources": [{"position": [2, 1, 2.75]}]})");
  const std::string poses = Write("p.csv", "0,0,0,0\n1,1,0,0\n");
  const std::string relations = Write("r.txt", "0 1 0.5 0 0 0 0 0\n");
  const Result result = Run({"evaluate", "hall", "--truth", truth, "--poses", poses, "--relations",
                             relations, "--format", "json"});
  ASSERT_EQ(result.exit_status, 0) << result.err;
  EXPECT_EQ(result.out,
            R"({"sources":{"true":1,"detected":1,"out_of_view":0,"error_mean_m":0.25,)"
            R"("error_std_m":0.0,"false":1,"double":1},)"
            R"("pose":{"error_mean_m":0.25,"error_p95_m":0.25,"yaw_error_mean_deg":0.0,)"
            R"("lost_fraction":0.0},)"
            R"("relations":{"trans_mean_m":0.5,"trans_std_m":0.0,"rot_mean_deg":0.0}})"
            "\n");
  EXPECT_THAT(result.err, IsEmpty());
  const Result other = Run({"evaluate", "hall", "--poses", poses, "--robot", "r2"});
  EXPECT_EQ(other.exit_status, 1);
  EXPECT_EQ(other.err, "soundmap: the site hall has no session of the robot r2\n");
}

// The recording of a robot that goes along x at 1 m/s for 10 s; its array is at (0, 0, 1) above it.
std::string WriteDrive(const fs::path& path, bool with_truth) {
  constexpr std::int64_t kStepNs = 100'000'000;
  auto writer = recording::Writer::Create(path.string(), {}).value();
  foxglove::FrameTransforms transforms;
  Eigen::Isometry3d base_from_array = Eigen::Isometry3d::Identity();
  base_from_array.translation().z() = 1.0;
  *transforms.add_transforms() =
      recording::MakeFrameTransform(kStepNs, "base_link", "mic_array", base_from_array);
  EXPECT_TRUE(
      recording::WriteMessage(*writer, recording::kTransformsTopic, kStepNs, 0, transforms).ok());
  for (int i = 1; with_truth && i <= 101; ++i) {
    Eigen::Isometry3d pose = Eigen::Isometry3d::Identity();
    pose.translation().x() = 0.1 * (i - 1);
    EXPECT_TRUE(recording::WriteMessage(*writer, recording::kGroundTruthTopic, i * kStepNs, i,
                                        recording::MakePoseInFrame(i * kStepNs, "map", pose))
                    .ok());
  }
  EXPECT_TRUE(writer->Close().ok());
  return path.string();
}

TEST_F(CliTest, EvaluatesADrive) {
  v1::Site site;
  site.set_name("sites/hall");
  site.set_max_range_m(4.0);
  state().sites["sites/hall"] = site;
  state().sources = {Source("s1", 5, 3, 1.5, 0.9)};
  state().sessions = {ListeningSession("s", 1)};
  state().paths["sites/hall/sessions/s"] = {Pose(1'000'000'000, 0.9, 0.5),
                                            Pose(5'050'000'000, 4.95, 0.5)};
  // Within 4 m of the first source for sqrt(16 - 9) * 2 = 5.3 s, of the second for sqrt(16 - 10.89)
  // * 2 = 4.5 s.
  const std::string truth = Write(
      "t.truth.json", R"({"sources": [{"position": [5, 3, 1.0]}, {"position": [5, -3.3, 1.0]}]})");
  const std::string drive = WriteDrive(directory_ / "d.mcap", true);
  const Result result = Run({"evaluate", "hall", "--truth", truth, "--drive", drive});
  ASSERT_EQ(result.exit_status, 0) << result.err;
  const auto json = nlohmann::json::parse(result.out);
  EXPECT_EQ(json["sources"]["true"], 1);
  EXPECT_EQ(json["sources"]["detected"], 1);
  EXPECT_EQ(json["sources"]["out_of_view"], 1);
  EXPECT_NEAR(json["pose"]["error_mean_m"], 0.5, 1e-9);
  EXPECT_FALSE(json.contains("relations"));

  const std::string blind = WriteDrive(directory_ / "blind.mcap", false);
  const Result refused = Run({"evaluate", "hall", "--truth", truth, "--drive", blind});
  EXPECT_EQ(refused.exit_status, 1);
  EXPECT_EQ(refused.err, "soundmap: " + blind + " has no /ground_truth/pose to compare with\n");
}

TEST_F(CliTest, TunesOnDrivesWithTruth) {
  v1::Site site;
  site.set_name("sites/hall");
  site.set_max_range_m(4.0);
  state().sites["sites/hall"] = site;
  state().trials_json = R"({"trials": [
    {"audio_scans": 9, "sources": [{"position_m": [5, 3.1, 1], "probability": 0.9}]},
    {"audio_scans": 9, "sources": [{"position_m": [0, 0, 1], "probability": 0.7}]}]})";
  const std::string truth = Write("t.truth.json", R"({"sources": [{"position": [5, 3, 1.0]}]})");
  const std::string drive = WriteDrive(directory_ / "d.mcap", true);
  const std::vector<std::string> command{"tune",     "--case", "hall",
                                         truth,      drive,    "--profiles",
                                         "paper",    "--vary", "paper.acoustics.t1=8,9",
                                         "--format", "json"};
  const Result result = Run(command);
  ASSERT_EQ(result.exit_status, 0) << result.err;
  EXPECT_EQ(state().last_try_request.site(), "sites/hall");
  ASSERT_EQ(state().last_try_request.parameters_toml_size(), 2);
  EXPECT_EQ(state().last_try_request.parameters_toml(1), "profile = 'paper'\nacoustics.t1 = 9\n");
  const auto sets = nlohmann::json::parse(result.out)["sets"];
  ASSERT_EQ(sets.size(), 2u);
  EXPECT_EQ(sets[0]["sources"]["detected"], 1);
  EXPECT_NEAR(sets[0]["sources"]["error_mean_m"], 0.1, 1e-9);
  EXPECT_EQ(sets[1]["sources"]["detected"], 0);
  EXPECT_EQ(sets[1]["sources"]["false"], 1);
  EXPECT_EQ(sets[1]["parameters"]["acoustics.t1"], "9");
  EXPECT_NEAR(sets[1]["calibration"]["brier"], 0.49, 1e-9);

  // A report that does not fit, of whatever kind, is said to be one.
  for (const char* report : {"", "{}", "7", R"({"trials": [{"sources": []}]})",
                             R"({"trials": [{"sources": [{"position_m": [1]}]}, {}]})"}) {
    state().trials_json = report;
    const Result refused = Run(command);
    EXPECT_EQ(refused.exit_status, 1) << report;
    EXPECT_THAT(refused.err, HasSubstr("the server")) << report;
  }
}

TEST_F(CliTest, SaysThatOutputCannotBeWritten) {
  const std::string command = std::string(SOUNDMAP_BIN_DIR "/soundmap site list --server ") +
                              server_.address() + " >/dev/full 2>" + (directory_ / "err").string();
  EXPECT_EQ(WEXITSTATUS(std::system(command.c_str())), 1);
  EXPECT_EQ(ReadFile(directory_ / "err"), "soundmap: cannot write to standard output\n");
}

}  // namespace
}  // namespace soundmap
