#include <google/protobuf/descriptor.h>
#include <google/protobuf/stubs/logging.h>
#include <grpcpp/generic/generic_stub.h>
#include <grpcpp/grpcpp.h>
#include <spdlog/spdlog.h>

#include <atomic>
#include <boost/asio/thread_pool.hpp>
#include <chrono>

#include "api/decode_message.h"
#include "api/server.h"
#include "recording/foxglove_messages.h"
#include "soundmap/v1/backup_service.pb.h"
#include "soundmap/v1/ingest_service.pb.h"
#include "soundmap/v1/live_service.pb.h"
#include "soundmap/v1/map_service.pb.h"
#include "soundmap/v1/operation_service.pb.h"
#include "soundmap/v1/robot_service.pb.h"
#include "soundmap/v1/session_service.pb.h"
#include "soundmap/v1/site_service.pb.h"
#include "soundmap/v1/sound_map_service.pb.h"
#include "soundmap/v1/tuning_service.pb.h"
#include "soundmap/v1/watch_service.pb.h"
#include "storage/crc32c.h"
#include "tests/fuzz/fields.h"
#include "tests/fuzz/target.h"
#include "tests/fuzz/temporary_folder.h"

namespace soundmap::fuzz {
namespace {

constexpr char kSite[] = "hall";
constexpr char kSession[] = "sites/hall/sessions/d";
constexpr int kCallsOfAServer = 2000;  // what calls have left behind goes with it
constexpr int kMaxAnswers = 16;
// Of a call; a call that waits for something else is cut here.
constexpr std::chrono::milliseconds kPatience(200);
// The chunks of an input get the checksum, the offset and the epoch that the server expects.
constexpr int kMended = 0x80;

struct Method {
  std::string path;
  bool watches = false;  // its stream does not end by itself
};

std::vector<Method> AllMethods() {
  std::vector<Method> methods;
  for (const google::protobuf::Descriptor* message :
       {v1::Site::descriptor(), v1::Session::descriptor(), v1::IngestRequest::descriptor(),
        v1::LiveRequest::descriptor(), v1::Robot::descriptor(), v1::SoundSource::descriptor(),
        v1::BuildMapRequest::descriptor(), v1::Operation::descriptor(),
        v1::CreateBackupRequest::descriptor(), v1::TryParametersRequest::descriptor(),
        v1::WatchRequest::descriptor()}) {
    Require(message->file()->service_count() == 1);
    const auto& service = *message->file()->service(0);
    for (int i = 0; i < service.method_count(); ++i) {
      methods.push_back({"/" + service.full_name() + "/" + service.method(i)->name(),
                         service.name() == "WatchService"});
    }
  }
  return methods;
}
const std::vector<Method>& Methods() {
  static const std::vector<Method> methods = AllMethods();
  return methods;
}

// A whole server, but for its settings and its HTTP port.
class RunningServer {
 public:
  RunningServer() {
    spdlog::set_level(spdlog::level::off);
    google::protobuf::SetLogHandler(nullptr);
    // Time flies, so that nobody calls too often.
    const auto now_ns = [this] { return now_ns_ += 100'000'000; };
    store_ = storage::Store::Open(folder_.path().string() + "/data").value();
    access_ = api::Access::Create({.audit_log = "/dev/null"}, now_ns).value();
    pipeline::Sites::Options options;
    options.executor = pool_.get_executor();
    options.decode = api::DecodeMessage;
    options.profile = pipeline::ProfileByName;
    options.now_ns = now_ns;
    sites_ = pipeline::Sites::Open(store_.get(), std::move(options)).value();
    operations_ = std::make_unique<pipeline::Operations>(now_ns, pool_.get_executor());
    api::Server::Parts parts;
    parts.sites = sites_.get();
    parts.operations = operations_.get();
    parts.access = access_.get();
    parts.store = store_.get();
    parts.executor = pool_.get_executor();
    parts.now_ns = now_ns;
    parts.server_id = "fuzz";
    server_ = api::Server::Start("127.0.0.1:0", {}, parts).value();
    stub_ = std::make_unique<grpc::GenericStub>(
        grpc::CreateChannel(server_->address(), grpc::InsecureChannelCredentials()));
  }
  ~RunningServer() {
    stub_.reset();
    server_->Shutdown();
    server_.reset();
    operations_.reset();
    sites_->Stop();
    sites_.reset();
    pool_.join();
    store_.reset();
  }

  // The site and the drive that the seeds speak of, as new when they are gone.
  std::shared_ptr<pipeline::Session> Drive() {
    auto site = sites_->Get(kSite);
    if (!site.ok()) site = sites_->Create(kSite, "", "");
    Require(site.ok());
    auto session = (*site)->GetSession("d");
    if (!session.ok()) {
      pipeline::SessionRequest request;
      request.session = "d";
      request.robot = "r";
      request.purpose = pipeline::Purpose::kMapping;
      request.calibration.mic_in_array_m = {{0.1, 0.0, 0.0}, {-0.1, 0.0, 0.0}};
      request.calibration.audio_sample_rate_hz = 16000;
      session = (*site)->CreateSession(request, 1);
    }
    Require(session.ok());
    return *session;
  }

  grpc::Status Call(const Method& method, const std::vector<std::string>& messages,
                    std::chrono::milliseconds patience = kPatience) {
    grpc::ClientContext context;
    context.set_deadline(std::chrono::system_clock::now() + patience);
    grpc::CompletionQueue queue;
    const auto call = stub_->PrepareCall(&context, method.path, &queue);
    const auto done = [&queue] {
      void* tag = nullptr;
      bool ok = false;
      return queue.Next(&tag, &ok) && ok;
    };
    call->StartCall(nullptr);
    bool going = done();
    for (const std::string& message : messages) {
      if (!going) break;
      const grpc::Slice slice(message);
      call->Write(grpc::ByteBuffer(&slice, 1), nullptr);
      going = done();
    }
    if (going) {
      call->WritesDone(nullptr);
      going = done();
    }
    for (int answers = 0; going; ++answers) {
      if (answers == (method.watches ? 1 : kMaxAnswers)) context.TryCancel();
      grpc::ByteBuffer answer;
      call->Read(&answer, nullptr);
      going = done();
    }
    grpc::Status status;
    call->Finish(&status, nullptr);
    done();
    return status;
  }

 private:
  const TemporaryFolder folder_;
  std::atomic<std::int64_t> now_ns_ = 1'700'000'000'000'000'000;
  boost::asio::thread_pool pool_{2};
  std::unique_ptr<storage::Store> store_;
  std::unique_ptr<api::Access> access_;
  std::unique_ptr<pipeline::Sites> sites_;
  std::unique_ptr<pipeline::Operations> operations_;
  std::unique_ptr<api::Server> server_;
  std::unique_ptr<grpc::GenericStub> stub_;
};

std::string Mended(const std::string& bytes, const pipeline::Session& drive) {
  v1::IngestRequest request;
  if (!request.ParseFromString(bytes)) return bytes;
  if (request.has_open()) request.mutable_open()->set_epoch(drive.record().epoch);
  if (request.has_chunk()) {
    v1::Chunk& chunk = *request.mutable_chunk();
    std::uint32_t crc = 0;
    for (const v1::Frame& frame : chunk.frames()) crc = storage::Crc32c(frame.payload(), crc);
    chunk.set_crc32c(crc);
    // Near the offset that comes next.
    chunk.set_first_offset(drive.watermarks().received +
                           static_cast<std::int8_t>(chunk.first_offset()));
  }
  return request.SerializeAsString();
}

// A byte for the method, then the messages.
template <typename... Messages>
std::string Seed(std::string_view method, int flags, const Messages&... messages) {
  const auto& all = Methods();
  const auto found = std::find_if(all.begin(), all.end(), [&](const Method& other) {
    return other.path == "/soundmap.v1." + std::string(method);
  });
  Require(found != all.end());
  std::string seed(1, static_cast<char>((found - all.begin()) | flags));
  return (seed + ... + MakeField(messages.SerializeAsString()));
}

v1::IngestRequest ChunkOf(v1::Sensor sensor, const std::string& payload) {
  v1::IngestRequest request;
  v1::Frame& frame = *request.mutable_chunk()->add_frames();
  frame.set_sensor(sensor);
  frame.set_log_time_ns(1'000'000'000);
  frame.set_payload(payload);
  return request;
}

std::vector<std::string> StreamSeeds() {
  v1::IngestRequest open;
  open.mutable_open()->set_session(kSession);
  open.mutable_open()->set_epoch(1);
  const std::int16_t samples[] = {1, -2, 3, -4, 5, -6};
  const v1::IngestRequest audio =
      ChunkOf(v1::SENSOR_AUDIO,
              recording::MakeRawAudio(1'000'000'000, 16000, 2, samples).SerializeAsString());
  v1::IngestRequest part = audio;
  part.mutable_chunk()->mutable_frames(0)->set_part_count(2);
  v1::IngestRequest coded = audio;
  coded.mutable_chunk()->mutable_frames(0)->set_coding(v1::CODING_ZSTD);
  coded.mutable_chunk()->mutable_frames(0)->set_message_bytes(100);
  v1::IngestRequest finish;
  finish.mutable_finish()->set_frame_count(3);
  v1::LiveRequest live;
  live.mutable_open()->set_robot("robots/r");
  live.mutable_open()->set_session(kSession);
  v1::LiveRequest report;
  report.mutable_report()->set_drive_state(v1::DRIVE_STATE_RECORDING);
  report.mutable_report()->set_odometry_time_ns(5);
  report.mutable_report()->mutable_odom_from_base()->set_x_m(1.0);
  report.mutable_report()->mutable_laser()->set_angle_increment_rad(0.1);
  report.mutable_report()->mutable_laser()->add_range_m(2.0f);
  report.mutable_report()->mutable_clock_offset()->set_server_minus_robot_ns(1 << 20);
  report.mutable_report()->mutable_clock_offset()->set_uncertainty_ns(1 << 10);
  v1::ImportMapRequest header;
  header.mutable_header()->set_site("sites/hall");
  header.mutable_header()->set_format("ply");
  v1::ImportMapRequest data;
  data.set_data(
      "ply\nformat ascii 1.0\nelement vertex 1\nproperty float x\nproperty float y\nproperty "
      "float z\nend_header\n1 2 3\n");
  return {Seed("IngestService/Ingest", kMended, open, audio, audio),
          Seed("IngestService/Ingest", kMended, open, part, part),
          Seed("IngestService/Ingest", kMended, open, coded, finish),
          Seed("IngestService/Ingest", 0, open, audio, finish),
          Seed("LiveService/Live", 0, live, report, report),
          Seed("MapService/ImportMap", 0, header, data)};
}

}  // namespace

std::vector<std::string> Seeds() {
  std::vector<std::string> seeds = StreamSeeds();
  v1::CreateSiteRequest create_site;
  create_site.set_site_id("annex");
  create_site.set_profile("paper");
  create_site.set_request_id("q");
  seeds.push_back(Seed("SiteService/CreateSite", 0, create_site));
  v1::ListSitesRequest list_sites;
  list_sites.set_page_size(1);
  list_sites.set_page_token("1");
  seeds.push_back(Seed("SiteService/ListSites", 0, list_sites));
  v1::UpdateSiteRequest update_site;
  update_site.mutable_site()->set_name("sites/hall");
  update_site.mutable_site()->set_keep_frames_s(3600);
  update_site.mutable_update_mask()->add_paths("keep_frames_s");
  seeds.push_back(Seed("SiteService/UpdateSite", 0, update_site));
  v1::DeleteSiteRequest delete_site;
  delete_site.set_name("sites/hall");
  seeds.push_back(Seed("SiteService/DeleteSite", 0, delete_site));
  seeds.push_back(Seed("SiteService/GetSite", 0, delete_site));
  v1::CreateSessionRequest create_session;
  create_session.set_site("sites/hall");
  create_session.set_robot("robots/r");
  create_session.set_session_id("e");
  create_session.set_purpose(v1::PURPOSE_MAPPING);
  create_session.mutable_calibration()->add_mic_in_array_m()->set_x(0.25);
  create_session.mutable_calibration()->set_audio_sample_rate_hz(16000);
  create_session.mutable_calibration()->mutable_base_from_array()->mutable_rotation()->set_w(1.0);
  create_session.mutable_initial_pose()->set_x_m(1.0);
  seeds.push_back(Seed("SessionService/CreateSession", 0, create_session));
  v1::GetSessionRequest get_session;
  get_session.set_name(kSession);
  seeds.push_back(Seed("SessionService/GetSession", 0, get_session));
  seeds.push_back(Seed("SessionService/GetTrajectory", 0, get_session));
  v1::ListSessionsRequest list_sessions;
  list_sessions.set_site("sites/hall");
  list_sessions.set_robot("robots/r");
  seeds.push_back(Seed("SessionService/ListSessions", 0, list_sessions));
  v1::GetRobotRequest get_robot;
  get_robot.set_name("robots/r");
  seeds.push_back(Seed("RobotService/GetRobot", 0, get_robot));
  v1::GetSoundSourceRequest get_source;
  get_source.set_name("sites/hall/soundSources/0000000000000001");
  seeds.push_back(Seed("SoundMapService/GetSoundSource", 0, get_source));
  v1::ListSoundSourcesRequest list_sources;
  list_sources.set_site("sites/hall");
  list_sources.set_start_ns(1);
  list_sources.set_end_ns(2);
  list_sources.add_states(v1::SOUND_SOURCE_STATE_ACTIVE);
  seeds.push_back(Seed("SoundMapService/ListSoundSources", 0, list_sources));
  v1::QueryVoxelsRequest voxels;
  voxels.set_site("sites/hall");
  voxels.mutable_box()->mutable_max_m()->set_x(5.0);
  voxels.set_min_updates(2);
  seeds.push_back(Seed("SoundMapService/QueryVoxels", 0, voxels));
  v1::ListAudioScansRequest scans;
  scans.set_site("sites/hall");
  scans.set_session(kSession);
  scans.set_page_token("5:6");
  seeds.push_back(Seed("SoundMapService/ListAudioScans", 0, scans));
  v1::BuildMapRequest build;
  build.set_site("sites/hall");
  build.add_sessions(kSession);
  build.add_surveyed_poses()->set_time_ns(1);
  seeds.push_back(Seed("MapService/BuildMap", 0, build));
  for (const auto what : {v1::EXPORT_WHAT_SOUND, v1::EXPORT_WHAT_GEOMETRY}) {
    v1::ExportMapRequest map;
    map.set_site("sites/hall");
    map.set_what(what);
    map.set_format("ot");
    seeds.push_back(Seed("MapService/ExportMap", 0, map));
  }
  v1::WaitOperationRequest wait;
  wait.set_name("operations/1");
  wait.set_timeout_ms(5);
  seeds.push_back(Seed("OperationService/WaitOperation", 0, wait));
  v1::ListOperationsRequest operations;
  operations.set_site("sites/hall");
  seeds.push_back(Seed("OperationService/ListOperations", 0, operations));
  v1::CreateBackupRequest backup;
  backup.set_backup_id("b");
  seeds.push_back(Seed("BackupService/CreateBackup", 0, backup));
  v1::TryParametersRequest tuning;
  tuning.set_site("sites/hall");
  tuning.add_parameters_toml("profile = \"default\"\n");
  seeds.push_back(Seed("TuningService/TryParameters", 0, tuning));
  v1::WatchRequest watch;
  watch.set_site("sites/hall");
  watch.set_robots(true);
  watch.set_resume_token("fuzz:0");
  seeds.push_back(Seed("WatchService/Watch", 0, watch));
  return seeds;
}

void Decode(std::string_view bytes) {
  if (bytes.empty()) return;
  // Made at once, so that it goes before what gRPC keeps until the process ends.
  static auto server = std::make_unique<RunningServer>();
  static int calls = 0;
  if (++calls % kCallsOfAServer == 0) {
    server.reset();
    server = std::make_unique<RunningServer>();
  }
  const int first = static_cast<unsigned char>(bytes[0]);
  const Method& method = Methods()[static_cast<std::size_t>(first % kMended) % Methods().size()];
  bytes.remove_prefix(1);
  const auto drive = server->Drive();
  std::vector<std::string> messages;
  while (!bytes.empty() && messages.size() < kMaxAnswers) {
    std::string message(TakeField(bytes));
    messages.push_back((first & kMended) != 0 ? Mended(message, *drive) : std::move(message));
    if (bytes.size() == 1) break;
  }
  const grpc::Status status = server->Call(method, messages);
  // No call is answered by a fault of the server's own.
  Require(status.error_code() != grpc::StatusCode::UNKNOWN);
  if (calls % 64 == 0) {
    // It serves on.
    const Method list = {"/soundmap.v1.SiteService/ListSites"};
    Require(server->Call(list, {""}, std::chrono::minutes(1)).ok());
  }
}

}  // namespace soundmap::fuzz
