// soundmap-robot: what runs on the robot, or plays one.

#include <google/protobuf/stubs/logging.h>
#include <unistd.h>

#include <CLI/CLI.hpp>
#include <chrono>
#include <cmath>
#include <cstdio>
#include <cstdlib>
#include <filesystem>
#include <optional>
#include <random>
#include <string>
#include <utility>
#include <vector>

#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "absl/strings/numbers.h"
#include "absl/strings/str_cat.h"
#include "absl/strings/str_format.h"
#include "absl/time/time.h"
#include "run_agent.h"
#include "server_files.h"
#include "sources/convert/convert.h"
#include "sources/replay/replay.h"
#include "sources/simulation/random_scene.h"
#include "sources/simulation/simulate.h"
#include "sources/snapped_source.h"
#include "spool/spool.h"
#include "uplink/channel.h"
#include "uplink/drive_session.h"
#include "uplink/uploader.h"

namespace soundmap {
namespace {

using Seconds = std::chrono::duration<double>;

// One line on a terminal that is written over and over; nothing elsewhere.
class ProgressLine {
 public:
  void Show(const std::string& text) {
    const auto now = std::chrono::steady_clock::now();
    if (!terminal_ || now - shown_at_ < std::chrono::milliseconds(200)) return;
    shown_at_ = now;
    Draw(text);
  }
  void Clear() {
    if (terminal_ && shown_at_ != std::chrono::steady_clock::time_point()) Draw("");
  }

 private:
  static void Draw(const std::string& text) {
    std::fprintf(stderr, "\r\x1b[K%s", text.c_str());
    std::fflush(stderr);
  }

  const bool terminal_ = isatty(STDERR_FILENO) != 0;
  std::chrono::steady_clock::time_point shown_at_;
};

struct ReplayCommand {
  std::string drive;
  uplink::DriveSession session;
  std::string speed = "1";
  bool new_session = false;
  double lidar_resolution_m = 0.001;
  bool uncoded = false;
  recording::DriveTopics topics;
  ServerFiles server;
  double connect_timeout_s = 60.0;
};

absl::Status RunReplay(const ReplayCommand& command) {
  auto server = ReadServerOptions(command.server);
  if (!server.ok()) return server.status();
  auto channel = uplink::OpenChannel(*server);
  if (!channel.ok()) return channel.status();
  auto replay = sources::Replay::Open(command.drive, command.topics);
  if (!replay.ok()) return replay.status();

  uplink::UploadOptions options;
  options.server = server->address;
  options.token = server->token;
  options.session = uplink::SessionRequest(command.session, **replay);
  if (command.new_session) {
    std::random_device random;
    absl::StrAppendFormat(options.session.mutable_session_id(), "-%08x", random());
  }
  for (const std::string& warning : options.session.warnings()) {
    std::fprintf(stderr, "soundmap-robot: warning: %s\n", warning.c_str());
  }
  if (double speed = 0.0; absl::SimpleAtod(command.speed, &speed)) options.speed = speed;
  options.coded = !command.uncoded;
  options.lidar_resolution_m = command.lidar_resolution_m;
  options.give_up_after =
      std::chrono::milliseconds(static_cast<std::int64_t>(command.connect_timeout_s * 1e3));

  const recording::DriveSurvey& survey = (*replay)->survey();
  const std::int64_t total = survey.sensor_count();
  ProgressLine line;
  std::string trouble;
  const auto show = [&](const uplink::UploadProgress& progress) {
    if (progress.trouble != trouble) {
      trouble = progress.trouble;
      line.Clear();
      if (!trouble.empty()) {
        std::fprintf(stderr, "soundmap-robot: %s; trying again\n", trouble.c_str());
      }
    }
    line.Show(absl::StrFormat(
        "sent %d, processed %d of %d frames (%.0f %%)", progress.next_offset,
        progress.watermarks.processed, total,
        100.0 * static_cast<double>(progress.watermarks.processed) / static_cast<double>(total)));
  };
  uplink::Uploader uploader(*channel, options, &std::chrono::steady_clock::now,
                            std::mt19937_64(std::random_device()()));
  const auto begin = std::chrono::steady_clock::now();
  sources::SnappedSource source(replay->get(), command.lidar_resolution_m);
  const auto result = uploader.Upload(source, show);
  line.Clear();
  if (!result.ok()) return result.status();

  const double elapsed_s = Seconds(std::chrono::steady_clock::now() - begin).count();
  const double drive_s =
      static_cast<double>(survey.last_log_time_ns - survey.first_log_time_ns) * 1e-9;
  if (result->sent_count == 0) {
    std::printf("%s: all %d frames were processed before\n", result->session.c_str(),
                static_cast<int>(result->frame_count));
  } else {
    std::printf(
        "%s: %d frames (%.1f s of driving) processed in %.1f s, %.1f x real time; %.1f MB sent "
        "for %.1f MB\n",
        result->session.c_str(), static_cast<int>(result->frame_count), drive_s, elapsed_s,
        drive_s / elapsed_s, static_cast<double>(result->payload_bytes) * 1e-6,
        static_cast<double>(result->message_bytes) * 1e-6);
  }
  return survey.damage;
}

void AddReplay(CLI::App& app, ReplayCommand& command) {
  CLI::App* replay = app.add_subcommand("replay", "Streams a recorded drive to the server");
  replay->footer(
      "Running the same replay again resumes it and counts nothing twice. Exit status 0: every "
      "frame\n"
      "is durable and processed. A damaged recording is sent up to the damage; once that is\n"
      "processed, the exit status is 1 and the error says where the damage is.");
  replay->add_option("DRIVE", command.drive, "The recording (.mcap)")->required();
  replay->add_option("--site", command.session.site, "The site")->required();
  replay->add_option("--robot", command.session.robot, "The robot's name")->required();
  replay
      ->add_option("--speed", command.speed,
                   "Times real time, or 'max': as fast as the server takes it")
      ->capture_default_str()
      ->check([](const std::string& text) {
        double speed = 0.0;
        const bool valid = text == "max" ||
                           (absl::SimpleAtod(text, &speed) && std::isfinite(speed) && speed > 0.0);
        return valid ? std::string() : "'" + text + "' is neither a positive number nor 'max'";
      });
  replay
      ->add_option("--initial-pose", command.session.initial_pose,
                   "x,y,yaw in the map where the drive starts (metres, radians); for a mapping "
                   "drive it fixes the map, default 0,0,0")
      ->delimiter(',')
      ->expected(3)
      ->type_name("X,Y,YAW")
      ->check([](const std::string& text) {
        double number = 0.0;
        const bool valid = absl::SimpleAtod(text, &number) && std::isfinite(number);
        return valid ? std::string() : "'" + text + "' is not a number";
      });
  replay->add_option("--purpose", command.session.purpose, "What the drive is for")
      ->check(CLI::IsMember({"listening", "mapping"}))
      ->capture_default_str();
  replay->add_flag("--new-session", command.new_session,
                   "Count the drive again even if the server knows it");
  replay
      ->add_option("--laser-time-increment", command.session.laser_time_increment_s,
                   "Seconds between two beams of the LRF; 0: a scan is instantaneous")
      ->check(CLI::Range(0.0, 1.0));
  replay
      ->add_option("--full-scale-spl", command.session.full_scale_spl_db,
                   "Sound pressure level (dB re 20 uPa) of the sine that just reaches full scale "
                   "at the microphones; with it sources have absolute levels")
      ->check(CLI::Range(60.0, 200.0));
  replay
      ->add_option("--lidar-resolution", command.lidar_resolution_m,
                   "Metres on whose multiples LIDAR points are put, so that they travel short; 0: "
                   "they stay as they are")
      ->check(CLI::Range(0.0, 0.1))
      ->capture_default_str();
  replay->add_flag("--uncoded", command.uncoded, "Send audio and points as they are recorded");
  replay->add_option("--audio-topic", command.topics.audio)->capture_default_str();
  replay->add_option("--lidar-topic", command.topics.lidar)->capture_default_str();
  replay->add_option("--laser-topic", command.topics.laser)->capture_default_str();
  replay->add_option("--odometry-topic", command.topics.odometry)->capture_default_str();
  replay->add_option("--transforms-topic", command.topics.transforms)->capture_default_str();
  replay->add_option("--server", command.server.address, "HOST:PORT")
      ->envname("SOUNDMAP_SERVER")
      ->capture_default_str();
  replay->add_option("--token-file", command.server.token_file, "File with a bearer token");
  replay->add_option("--tls-ca", command.server.tls_ca,
                     "Certificates to trust (PEM); without, the connection is plain text");
  replay->add_option("--tls-cert", command.server.tls_cert, "The robot's own certificate (PEM)");
  replay->add_option("--tls-key", command.server.tls_key, "Its private key (PEM)");
  replay
      ->add_option("--connect-timeout", command.connect_timeout_s,
                   "Seconds to go on trying in vain to reach the server")
      ->check(CLI::Range(0.0, 1e6))
      ->capture_default_str();
}

struct SimulateCommand {
  std::string scene;
  std::optional<std::uint32_t> random_seed;
  std::string out;
  bool mapping = false;
  std::optional<double> seconds;
};

absl::Status RunSimulate(const SimulateCommand& command) {
  ProgressLine line;
  simulation::SimulateOptions options;
  options.mapping = command.mapping;
  options.seconds = command.seconds;
  options.progress = [&line](double share) {
    line.Show(absl::StrFormat("simulating: %.0f %%", 100.0 * share));
  };
  std::string scene = command.scene;
  if (command.random_seed) {
    const auto text = simulation::RandomScene(*command.random_seed);
    if (!text.ok()) return text.status();
    scene = std::filesystem::path(command.out).replace_extension(".scene.json").string();
    if (!(std::ofstream(scene, std::ios::trunc) << *text << std::flush)) {
      return absl::UnavailableError(absl::StrCat(scene, ": cannot be written"));
    }
  }
  const auto result = simulation::Simulate(scene, command.out, options);
  line.Clear();
  if (!result.ok()) return result.status();
  std::printf("%s: %.1f s of driving, %d messages; truth in %s\n", command.out.c_str(),
              result->duration_s, static_cast<int>(result->messages), result->truth_path.c_str());
  if (result->clipped_samples > 0) {
    std::fprintf(stderr, "soundmap-robot: warning: %d audio samples are clipped\n",
                 static_cast<int>(result->clipped_samples));
  }
  return absl::OkStatus();
}

void AddSimulate(CLI::App& app, SimulateCommand& command) {
  CLI::App* simulate = app.add_subcommand("simulate", "Makes a drive through a scene, with truth");
  CLI::Option_group* scene = simulate->add_option_group("scene");
  scene->add_option("SCENE", command.scene, "A scene's file, or the name of a shipped scene");
  scene->add_option("--random", command.random_seed,
                    "Instead, a room, array and drive drawn at random with this seed; the scene is "
                    "kept beside the recording (NAME.scene.json)");
  scene->require_option(1);
  simulate->add_option("--out", command.out, "The recording to write (.mcap)")->required();
  simulate->add_flag("--mapping", command.mapping, "A mapping drive: without audio");
  simulate->add_option("--seconds", command.seconds, "End the drive after so long")
      ->check(CLI::PositiveNumber);
}

struct ConvertCommand {
  std::string log;
  std::string out;
  std::string truth_frame = "base_link";
  convert::ConvertOptions options;
};

absl::Status RunConvert(ConvertCommand& command) {
  command.options.truth_is_of_laser = command.truth_frame == "laser";
  const auto result = convert::Convert(command.log, command.out, command.options);
  if (!result.ok()) return result.status();
  for (const std::string& warning : result->warnings) {
    std::fprintf(stderr, "soundmap-robot: warning: %s\n", warning.c_str());
  }
  std::printf(
      "%s: %.1f s, %d scans of %d beams, %d poses of odometry; %d beams without a return (%.2f m "
      "and more)\n",
      command.out.c_str(), result->duration_s, static_cast<int>(result->scans), result->beams,
      static_cast<int>(result->odometry), static_cast<int>(result->no_return_beams),
      result->no_return_from_m);
  return result->damage;
}

void AddConvert(CLI::App& app, ConvertCommand& command) {
  CLI::App* convert =
      app.add_subcommand("convert", "Makes a recording of another log: CARMEN's .clf or .log");
  convert->footer(
      "The log may be compressed (bzip2, gzip, xz, zstd). The front laser becomes /scan, the "
      "odometry\n"
      "/odom. Malformed lines are left out and named. A damaged log is converted up to the damage, "
      "and\n"
      "the exit status is 1.");
  convert->add_option("IN", command.log, "The log")->required();
  convert->add_option("OUT", command.out, "The recording to write (.mcap)")->required();
  convert
      ->add_option("--max-range", command.options.max_range_m,
                   "Metres; ranges from here on are no return (default: told from the log)")
      ->check(CLI::PositiveNumber);
  convert
      ->add_option("--laser-height", command.options.laser_height_m,
                   "Metres from the floor to the LRF")
      ->check(CLI::Range(0.0, 100.0))
      ->capture_default_str();
  convert->add_option("--truth", command.options.truth_path,
                      "Poses timestamp_s,x,y,yaw (CSV) that become /ground_truth/pose");
  convert->add_option("--truth-frame", command.truth_frame, "What these are the poses of")
      ->check(CLI::IsMember({"base_link", "laser"}))
      ->capture_default_str();
}

struct RunCommand {
  std::string config;
};

void AddRun(CLI::App& app, RunCommand& command) {
  CLI::App* run = app.add_subcommand("run", "Records to the spool and delivers, for ever");
  run->footer(
      "Everything goes to the spool first and waits there until the server has it on its disk.\n"
      "Ends with the source, when all is delivered, or on SIGTERM: what is left goes on with the\n"
      "next run.");
  run->add_option("--config", command.config, "See docs/agent.md (.toml)")->required();
}

struct SpoolCommand {
  std::string folder;
  std::string format = "table";
};

void AddSpool(CLI::App& app, SpoolCommand& command) {
  CLI::App* spool = app.add_subcommand("spool", "Shows what waits for the server");
  spool->add_option("--dir", command.folder, "The spool")->required();
  spool->add_option("--format", command.format)
      ->check(CLI::IsMember({"table", "json"}))
      ->capture_default_str();
}

std::string TimeText(std::int64_t time_ns) {
  return absl::FormatTime("%Y-%m-%d %H:%M:%S", absl::FromUnixNanos(time_ns), absl::UTCTimeZone());
}

absl::Status ShowSpool(const SpoolCommand& command) {
  const auto sessions = spool::Inspect(command.folder);
  if (!sessions.ok()) return sessions.status();
  if (command.format == "json") {
    std::puts(spool::ToJson(*sessions).c_str());
    return absl::OkStatus();
  }
  std::printf("%-22s %-20s %-10s %10s %10s %10s  %-19s %s\n", "SESSION", "SITE", "STATE",
              "RECORDED", "WAITING", "MB", "OLDEST (UTC)", "GAPS");
  for (const spool::SessionSummary& session : *sessions) {
    std::int64_t lost = 0;
    for (const spool::Gap& gap : session.gaps) lost += gap.end - gap.first;
    std::printf(
        "%-22s %-20s %-10s %10lld %10lld %10.1f  %-19s %s\n", session.session.c_str(),
        session.site.c_str(),
        session.delivered ? "delivered"
        : session.ended   ? "ended"
                          : "open",
        static_cast<long long>(session.recorded), static_cast<long long>(session.waiting),
        static_cast<double>(session.bytes) * 1e-6,
        session.oldest_ns == 0 ? "-" : TimeText(session.oldest_ns).c_str(),
        lost == 0 ? "-" : absl::StrCat(session.gaps.size(), " (", lost, " frames)").c_str());
  }
  return absl::OkStatus();
}

int Main(int argc, char** argv) {
  CLI::App app("Sound map: the robot's side");
  app.require_subcommand(1);
  ReplayCommand replay;
  SimulateCommand simulate;
  ConvertCommand convert;
  AddReplay(app, replay);
  AddSimulate(app, simulate);
  AddConvert(app, convert);
  RunCommand run;
  SpoolCommand spool;
  AddRun(app, run);
  AddSpool(app, spool);
  try {
    app.parse(argc, argv);
  } catch (const CLI::CallForHelp&) {
    std::fputs(app.help().c_str(), stdout);
    return 0;
  } catch (const CLI::ParseError& error) {
    std::fprintf(stderr, "soundmap-robot: %s\n", error.what());
    return 2;
  }
  const absl::Status status = app.got_subcommand("replay")     ? RunReplay(replay)
                              : app.got_subcommand("simulate") ? RunSimulate(simulate)
                              : app.got_subcommand("run")      ? RunAgent(run.config)
                              : app.got_subcommand("spool")    ? ShowSpool(spool)
                                                               : RunConvert(convert);
  if (status.ok()) return 0;
  std::fprintf(stderr, "soundmap-robot: %s\n", std::string(status.message()).c_str());
  return 1;
}

}  // namespace
}  // namespace soundmap

int main(int argc, char** argv) {
  // Standard error is for sentences, also when a recording has a million texts that are not UTF-8.
  setenv("GRPC_VERBOSITY", "NONE", /*overwrite=*/0);
  google::protobuf::SetLogHandler(nullptr);
  // While no call waits, gRPC looks after a connection in the making only so often, every 5 s
  // without this: a robot whose network is back would wait for that, and for its own back-off
  // again.
  setenv("GRPC_CLIENT_CHANNEL_BACKUP_POLL_INTERVAL_MS", "200", /*overwrite=*/0);
  return soundmap::Main(argc, argv);
}
