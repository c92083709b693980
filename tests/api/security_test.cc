#include <gmock/gmock.h>
#include <google/protobuf/descriptor.h>
#include <google/protobuf/dynamic_message.h>
#include <grpcpp/generic/generic_stub.h>
#include <grpcpp/grpcpp.h>
#include <gtest/gtest.h>

#include <atomic>
#include <cstdlib>
#include <filesystem>
#include <fstream>
#include <nlohmann/json.hpp>
#include <optional>
#include <sstream>
#include <thread>

#include "absl/strings/ascii.h"
#include "absl/strings/match.h"
#include "absl/strings/str_cat.h"
#include "google/rpc/status_details.pb.h"
#include "soundmap/v1/ingest_service.grpc.pb.h"
#include "soundmap/v1/live_service.pb.h"
#include "soundmap/v1/map_service.grpc.pb.h"
#include "soundmap/v1/session_service.grpc.pb.h"
#include "soundmap/v1/site_service.grpc.pb.h"
#include "tests/api/test_server.h"

// A whole gRPC server with TLS and tokens, and clients of all kinds. The credentials are those that
// deploy/credentials makes.
namespace soundmap::api {
namespace {

using google::protobuf::FieldDescriptor;
using google::protobuf::MethodDescriptor;
using ::testing::AnyOf;
using ::testing::Contains;
using ::testing::HasSubstr;

std::string Read(const std::string& path) {
  std::ifstream file(path, std::ios::binary);
  std::ostringstream text;
  text << file.rdbuf();
  return text.str();
}

void Credentials(const std::string& arguments) {
  const std::string command =
      absl::StrCat(SOUNDMAP_SOURCE_DIR, "/deploy/credentials ", arguments, " >/dev/null");
  ASSERT_EQ(std::system(command.c_str()), 0) << command;
}

// Makes a valid request in which every site is `site`: the first choice of each oneof, a site that
// is to change, names of the right form. Returns whether a site stands in it.
bool Fill(const std::string& site, google::protobuf::Message& message) {
  const auto* reflection = message.GetReflection();
  const auto* type = message.GetDescriptor();
  bool has_site = false;
  for (int i = 0; i < type->field_count(); ++i) {
    const FieldDescriptor* field = type->field(i);
    if (field->is_repeated()) continue;
    const auto* oneof = field->real_containing_oneof();
    if (oneof != nullptr && oneof->field(0) != field) continue;
    if (field->cpp_type() == FieldDescriptor::CPPTYPE_MESSAGE) {
      if (oneof == nullptr && field->message_type()->name() != "Site") continue;
      has_site |= Fill(site, *reflection->MutableMessage(&message, field));
    } else if (field->cpp_type() == FieldDescriptor::CPPTYPE_STRING) {
      const std::string& of = type->name();
      std::string value;
      if (field->name() == "site") value = "sites/" + site;
      if (field->name() == "site_id") value = site;
      if (field->name() == "session") value = absl::StrCat("sites/", site, "/sessions/s");
      if (field->name() == "robot") value = "robots/r";
      if (field->name() == "name") {
        if (absl::StrContains(of, "Site")) value = "sites/" + site;
        if (absl::StrContains(of, "Session") || absl::StrContains(of, "Trajectory")) {
          value = absl::StrCat("sites/", site, "/sessions/s");
        }
        if (absl::StrContains(of, "SoundSource")) {
          value = absl::StrCat("sites/", site, "/soundSources/s");
        }
        if (absl::StrContains(of, "Robot")) value = "robots/r";
        if (absl::StrContains(of, "Operation")) value = "operations/o";
      }
      has_site |= value == site || absl::StartsWith(value, "sites/");
      reflection->SetString(&message, field, value);
    }
  }
  return has_site;
}

class SecurityTest : public testing::Test {
 protected:
  static void SetUpTestSuite() {
    if (folder_ != nullptr) return;
    // Failed handshakes are expected, their log is not.
    setenv("GRPC_VERBOSITY", "NONE", /*overwrite=*/0);
    folder_ = new std::string(::testing::TempDir() + "/credentials");
    Credentials("dev " + *folder_);
    Credentials(absl::StrCat("token ", *folder_, " a-admin admin a"));
    Credentials(absl::StrCat("token ", *folder_, " a-read read a"));
    Credentials(absl::StrCat("token ", *folder_, " r1-token robot:r1 a"));
    Credentials(absl::StrCat("robot ", *folder_, " r1 a"));
    Credentials(absl::StrCat("robot ", *folder_, " r2 a,b"));
    Credentials(absl::StrCat("robot ", *folder_, " late a 0"));
    Credentials(absl::StrCat("ca ", *folder_, "/stranger"));
    Credentials(absl::StrCat("robot ", *folder_, "/stranger r1 '*'"));
  }
  static std::string File(const std::string& name) { return absl::StrCat(*folder_, "/", name); }

  SecurityTest() {
    options_.folder = ::testing::TempDir() + "/data";
    options_.now_ns = [] { return absl::ToUnixNanos(absl::Now()); };
    options_.access.robots_by_certificate = true;
    options_.access.audit_log = options_.folder + ".audit";
  }

  void SetUp() override {
    options_.access.token_file = File("tokens.toml");
    options_.tls = {File("server.pem"), File("server-key.pem"), File("ca.pem")};
    server_.emplace(options_);
    for (const char* site : {"a", "b"}) {
      ASSERT_TRUE(server_->sites().Create(site, "default", "").ok());
    }
  }
  void TearDown() override {
    server_.reset();
    std::filesystem::remove_all(options_.folder);
  }

  // With the certificate of `robot`, if one is named; `from`: the folder that holds it.
  std::shared_ptr<grpc::Channel> Channel(const std::string& robot = "",
                                         const std::string& from = ".",
                                         const std::string& ca = "ca.pem") {
    grpc::SslCredentialsOptions ssl;
    ssl.pem_root_certs = Read(File(ca));
    if (!robot.empty()) {
      ssl.pem_cert_chain = Read(File(absl::StrCat(from, "/", robot, ".pem")));
      ssl.pem_private_key = Read(File(absl::StrCat(from, "/", robot, "-key.pem")));
    }
    grpc::ChannelArguments arguments;
    arguments.SetInt(GRPC_ARG_USE_LOCAL_SUBCHANNEL_POOL, 1);
    return grpc::CreateCustomChannel(server_->address(), grpc::SslCredentials(ssl), arguments);
  }

  static void Prepare(grpc::ClientContext& context, const std::string& token) {
    context.set_deadline(std::chrono::system_clock::now() + std::chrono::seconds(30));
    if (token.empty()) return;
    const std::string secret(absl::StripAsciiWhitespace(Read(File(token + ".token"))));
    ASSERT_FALSE(secret.empty());
    context.AddMetadata("authorization", "Bearer " + secret);
  }

  // Any method, with one message; the status that the call ends with.
  static grpc::Status Call(const std::shared_ptr<grpc::Channel>& channel, const std::string& method,
                           const std::string& message, const std::string& token) {
    grpc::GenericStub stub(channel);
    grpc::ClientContext context;
    Prepare(context, token);
    grpc::CompletionQueue queue;
    const auto wait = [&queue] {
      void* tag = nullptr;
      bool ok = false;
      return queue.Next(&tag, &ok) && ok;
    };
    const auto call = stub.PrepareCall(&context, method, &queue);
    call->StartCall(nullptr);
    wait();
    const grpc::Slice slice(message);
    call->WriteLast(grpc::ByteBuffer(&slice, 1), {}, nullptr);
    wait();
    grpc::ByteBuffer answer;
    do {
      call->Read(&answer, nullptr);
    } while (wait());
    grpc::Status status;
    call->Finish(&status, nullptr);
    wait();
    queue.Shutdown();
    wait();
    return status;
  }
  grpc::Status ListSites(const std::shared_ptr<grpc::Channel>& channel, const std::string& token,
                         std::vector<std::string>* names = nullptr) {
    grpc::ClientContext context;
    Prepare(context, token);
    v1::ListSitesResponse response;
    const auto status =
        v1::SiteService::NewStub(channel)->ListSites(&context, v1::ListSitesRequest(), &response);
    for (const v1::Site& site : response.sites()) {
      if (names != nullptr) names->push_back(site.name());
    }
    return status;
  }
  grpc::Status CreateSession(const std::shared_ptr<grpc::Channel>& channel,
                             const std::string& token, const std::string& site,
                             const std::string& robot, v1::Session* session = nullptr) {
    grpc::ClientContext context;
    Prepare(context, token);
    v1::CreateSessionRequest request;
    request.set_site("sites/" + site);
    request.set_session_id("drive-of-" + robot);
    request.set_robot("robots/" + robot);
    request.set_purpose(v1::PURPOSE_MAPPING);
    request.mutable_calibration()->mutable_base_from_lidar()->mutable_rotation()->set_w(1.0);
    v1::Session response;
    const auto status = v1::SessionService::NewStub(channel)->CreateSession(
        &context, request, session != nullptr ? session : &response);
    return status;
  }
  grpc::Status Open(const std::shared_ptr<grpc::Channel>& channel, const std::string& token,
                    const v1::Session& session) {
    v1::IngestRequest request;
    request.mutable_open()->set_session(session.name());
    request.mutable_open()->set_epoch(session.epoch());
    return Call(channel, "/soundmap.v1.IngestService/Ingest", request.SerializeAsString(), token);
  }

  // Every rpc that is declared under proto/soundmap/v1.
  static std::vector<const MethodDescriptor*> Methods() {
    std::vector<const MethodDescriptor*> methods;
    const auto* pool = google::protobuf::DescriptorPool::generated_pool();
    for (const auto& entry : std::filesystem::directory_iterator(std::string(SOUNDMAP_SOURCE_DIR) +
                                                                 "/proto/soundmap/v1")) {
      const auto* file = pool->FindFileByName("soundmap/v1/" + entry.path().filename().string());
      EXPECT_NE(file, nullptr) << entry.path();
      for (int i = 0; file != nullptr && i < file->service_count(); ++i) {
        for (int j = 0; j < file->service(i)->method_count(); ++j) {
          methods.push_back(file->service(i)->method(j));
        }
      }
    }
    EXPECT_GT(methods.size(), 20u);
    return methods;
  }
  static std::string Path(const MethodDescriptor* method) {
    return absl::StrCat("/", method->service()->full_name(), "/", method->name());
  }

  static inline const std::string* folder_ = nullptr;
  TestServer::Options options_;
  std::optional<TestServer> server_;
};

TEST_F(SecurityTest, NoCallWithoutCredentials) {
  const auto channel = Channel();
  for (const MethodDescriptor* method : Methods()) {
    // Beyond what one address may try in vain it is told so.
    EXPECT_THAT(Call(channel, Path(method), "", "").error_code(),
                AnyOf(grpc::StatusCode::UNAUTHENTICATED, grpc::StatusCode::RESOURCE_EXHAUSTED))
        << method->full_name();
  }
  // Those who look after the process need none.
  EXPECT_TRUE(Call(channel, "/grpc.health.v1.Health/Check", "", "").ok());
}

TEST_F(SecurityTest, NoCallReachesTheSiteOfOthers) {
  const auto channel = Channel();
  google::protobuf::DynamicMessageFactory factory;
  for (const MethodDescriptor* method : Methods()) {
    const std::unique_ptr<google::protobuf::Message> request(
        factory.GetPrototype(method->input_type())->New());
    if (!Fill("b", *request)) continue;
    const auto status = Call(channel, Path(method), request->SerializeAsString(), "a-admin");
    EXPECT_EQ(status.error_code(), grpc::StatusCode::PERMISSION_DENIED)
        << method->full_name() << ": " << status.error_message();
  }
  std::vector<std::string> names;
  EXPECT_TRUE(ListSites(channel, "a-admin", &names).ok());
  EXPECT_EQ(names, std::vector<std::string>{"sites/a"});
  ASSERT_TRUE(CreateSession(channel, "write", "b", "r9").ok());
  EXPECT_EQ(server_->access().refusals(Access::Refusal::kUnauthenticated), 0);
}

TEST_F(SecurityTest, WhoReadsChangesNothing) {
  const auto channel = Channel();
  google::protobuf::DynamicMessageFactory factory;
  const auto operation =
      server_->operations().Start("work", "a", "", [](auto&) { return std::string(); }).value();
  for (const MethodDescriptor* method : Methods()) {
    const std::string& name = method->name();
    bool reads = false;
    for (const char* verb : {"Get", "List", "Query", "Watch", "Export", "Wait"}) {
      reads |= absl::StartsWith(name, verb);
    }
    const std::unique_ptr<google::protobuf::Message> request(
        factory.GetPrototype(method->input_type())->New());
    Fill("a", *request);
    if (const auto* field = method->input_type()->FindFieldByName("name");
        field != nullptr && absl::StrContains(name, "Operation")) {
      request->GetReflection()->SetString(request.get(), field, "operations/" + operation.id);
    }
    if (reads) continue;
    const auto status = Call(channel, Path(method), request->SerializeAsString(), "a-read");
    // A drive is asked for by name before it is known whose it is.
    EXPECT_EQ(status.error_code(),
              name == "Ingest" ? grpc::StatusCode::NOT_FOUND : grpc::StatusCode::PERMISSION_DENIED)
        << method->full_name() << ": " << status.error_message();
  }
}

TEST_F(SecurityTest, ARobotStreamsAsItselfAtItsSites) {
  v1::Session own;
  const auto r1 = Channel("r1");
  ASSERT_TRUE(CreateSession(r1, "", "a", "r1", &own).ok());
  EXPECT_EQ(CreateSession(r1, "", "a", "r2").error_code(), grpc::StatusCode::PERMISSION_DENIED);
  EXPECT_EQ(CreateSession(r1, "", "b", "r1").error_code(), grpc::StatusCode::PERMISSION_DENIED);
  EXPECT_EQ(CreateSession(r1, "", "nowhere", "r1").error_code(),
            grpc::StatusCode::PERMISSION_DENIED);
  EXPECT_TRUE(Open(r1, "", own).ok());

  const auto r2 = Channel("r2");
  EXPECT_EQ(Open(r2, "", own).error_code(), grpc::StatusCode::PERMISSION_DENIED);
  EXPECT_EQ(Open(Channel(), "a-read", own).error_code(), grpc::StatusCode::PERMISSION_DENIED);
  EXPECT_EQ(Open(Channel(), "", own).error_code(), grpc::StatusCode::UNAUTHENTICATED);
  EXPECT_TRUE(Open(Channel(), "r1-token", own).ok());
  // Its live view, too.
  const auto live = [](const auto& channel, const std::string& token, const std::string& site,
                       const std::string& robot) {
    v1::LiveRequest request;
    request.mutable_open()->set_robot("robots/" + robot);
    request.mutable_open()->set_session(absl::StrCat("sites/", site, "/sessions/drive"));
    return Call(channel, "/soundmap.v1.LiveService/Live", request.SerializeAsString(), token)
        .error_code();
  };
  EXPECT_EQ(live(r1, "", "a", "r1"), grpc::StatusCode::OK);
  EXPECT_EQ(live(r1, "", "a", "r2"), grpc::StatusCode::PERMISSION_DENIED);
  EXPECT_EQ(live(r1, "", "b", "r1"), grpc::StatusCode::PERMISSION_DENIED);
  EXPECT_EQ(live(r1, "", "nowhere", "r1"), grpc::StatusCode::PERMISSION_DENIED);
  EXPECT_EQ(live(Channel(), "r1-token", "a", "r1"), grpc::StatusCode::OK);
  EXPECT_EQ(live(Channel(), "r1-token", "a", "r2"), grpc::StatusCode::PERMISSION_DENIED);
  EXPECT_EQ(live(Channel(), "a-read", "a", "r1"), grpc::StatusCode::PERMISSION_DENIED);
  EXPECT_EQ(live(Channel(), "", "a", "r1"), grpc::StatusCode::UNAUTHENTICATED);
  // It sees its sites and makes none.
  std::vector<std::string> names;
  EXPECT_TRUE(ListSites(r2, "", &names).ok());
  EXPECT_EQ(names, (std::vector<std::string>{"sites/a", "sites/b"}));
  v1::CreateSiteRequest create;
  create.set_site_id("a");
  EXPECT_EQ(
      Call(r2, "/soundmap.v1.SiteService/CreateSite", create.SerializeAsString(), "").error_code(),
      grpc::StatusCode::PERMISSION_DENIED);
}

TEST_F(SecurityTest, BadCertificatesDoNotConnect) {
  EXPECT_EQ(ListSites(Channel("r1", "stranger"), "").error_code(), grpc::StatusCode::UNAVAILABLE);
  EXPECT_EQ(ListSites(Channel("late"), "").error_code(), grpc::StatusCode::UNAVAILABLE);
  // Nor does a client connect to a server that it does not trust.
  EXPECT_EQ(ListSites(Channel("", ".", "stranger/ca.pem"), "read").error_code(),
            grpc::StatusCode::UNAVAILABLE);
  // The server's own certificate names no robot.
  EXPECT_THAT(ListSites(Channel("server"), "").error_code(),
              AnyOf(grpc::StatusCode::UNAVAILABLE, grpc::StatusCode::UNAUTHENTICATED));
  // Plain text is not heard.
  grpc::ChannelArguments arguments;
  EXPECT_EQ(ListSites(server_->Channel(), "read").error_code(), grpc::StatusCode::UNAVAILABLE);
  EXPECT_TRUE(ListSites(Channel("r1"), "").ok());
  EXPECT_TRUE(ListSites(Channel(), "read").ok());
}

TEST_F(SecurityTest, LargeAndCompressedMessagesAreRefused) {
  const auto channel = Channel();
  v1::ListSitesRequest request;
  request.set_page_token(std::string(2 << 20, '0'));
  EXPECT_EQ(Call(channel, "/soundmap.v1.SiteService/ListSites", request.SerializeAsString(), "read")
                .error_code(),
            grpc::StatusCode::RESOURCE_EXHAUSTED);
  // 64 KiB that would become 64 MiB.
  request.set_page_token(std::string(64 << 20, '0'));
  for (const auto algorithm : {GRPC_COMPRESS_GZIP, GRPC_COMPRESS_DEFLATE}) {
    grpc::ClientContext context;
    Prepare(context, "read");
    context.set_compression_algorithm(algorithm);
    v1::ListSitesResponse response;
    EXPECT_EQ(
        v1::SiteService::NewStub(channel)->ListSites(&context, request, &response).error_code(),
        grpc::StatusCode::UNIMPLEMENTED);
  }
  EXPECT_TRUE(ListSites(channel, "read").ok());
}

TEST_F(SecurityTest, NamesDoNotLeaveTheDataFolder) {
  const auto channel = Channel();
  for (const char* name : {"../x", "..", "a/../b", "/etc", "A", "a%2fb"}) {
    v1::CreateSiteRequest request;
    request.set_site_id(name);
    EXPECT_EQ(
        Call(channel, "/soundmap.v1.SiteService/CreateSite", request.SerializeAsString(), "admin")
            .error_code(),
        grpc::StatusCode::INVALID_ARGUMENT)
        << name;
  }
}

TEST_F(SecurityTest, AThirdImportAtATimeIsRefused) {
  const auto channel = Channel();
  v1::ImportMapRequest header;
  header.mutable_header()->set_site("sites/a");
  header.mutable_header()->set_format("none");
  const auto third = [&] {
    return Call(channel, "/soundmap.v1.MapService/ImportMap", header.SerializeAsString(), "write");
  };
  EXPECT_TRUE(ListSites(channel, "write").ok());
  const auto stub = v1::MapService::NewStub(channel);
  grpc::ClientContext contexts[2];
  v1::Operation operations[2];
  std::unique_ptr<grpc::ClientWriter<v1::ImportMapRequest>> writers[2];
  for (int i = 0; i < 2; ++i) {
    Prepare(contexts[i], "write");
    writers[i] = stub->ImportMap(&contexts[i], &operations[i]);
    ASSERT_TRUE(writers[i]->Write(header));
  }
  // Until the server has seen both.
  const auto deadline = std::chrono::steady_clock::now() + std::chrono::seconds(30);
  const auto has_no_place = HasSubstr("being imported already");  // not: calls too often
  grpc::Status status;
  while (!testing::Matches(has_no_place)(status.error_message())) {
    status = third();
    ASSERT_LT(std::chrono::steady_clock::now(), deadline);
  }
  EXPECT_EQ(status.error_code(), grpc::StatusCode::RESOURCE_EXHAUSTED);
  for (auto& context : contexts) context.TryCancel();
  for (auto& writer : writers) EXPECT_FALSE(writer->Finish().ok());
  while (third().error_code() == grpc::StatusCode::RESOURCE_EXHAUSTED) {
    ASSERT_LT(std::chrono::steady_clock::now(), deadline);
  }
}

class ImpatientServerTest : public SecurityTest {
 protected:
  ImpatientServerTest() { options_.import_patience = std::chrono::milliseconds(300); }
};

TEST_F(ImpatientServerTest, AnImportThatStallsLosesItsPlace) {
  const auto channel = Channel();
  v1::ImportMapRequest header;
  header.mutable_header()->set_site("sites/a");
  header.mutable_header()->set_format("none");
  grpc::ClientContext context;
  Prepare(context, "write");
  v1::Operation operation;
  const auto stub = v1::MapService::NewStub(channel);
  const auto writer = stub->ImportMap(&context, &operation);
  ASSERT_TRUE(writer->Write(header));
  // Drops are a stall too.
  v1::ImportMapRequest drop;
  drop.set_data("x");
  for (int i = 0; i < 100; ++i) writer->Write(drop);
  const grpc::Status stalled = writer->Finish();
  EXPECT_EQ(stalled.error_code(), grpc::StatusCode::DEADLINE_EXCEEDED);
  EXPECT_THAT(stalled.error_message(), HasSubstr("the import stalls"));
}

TEST_F(SecurityTest, AServerThatStopsSaysSoFirst) {
  const auto channel = Channel();
  grpc::GenericStub stub(channel);
  grpc::ClientContext context;
  Prepare(context, "");
  grpc::CompletionQueue queue;
  const auto wait = [&queue] {
    void* tag = nullptr;
    bool ok = false;
    return queue.Next(&tag, &ok) && ok;
  };
  const auto call = stub.PrepareCall(&context, "/grpc.health.v1.Health/Watch", &queue);
  call->StartCall(nullptr);
  ASSERT_TRUE(wait());
  const grpc::Slice empty;
  call->WriteLast(grpc::ByteBuffer(&empty, 1), {}, nullptr);
  ASSERT_TRUE(wait());
  const auto next = [&]() -> std::string {
    grpc::ByteBuffer answer;
    call->Read(&answer, nullptr);
    grpc::Slice slice;
    if (!wait() || !answer.DumpToSingleSlice(&slice).ok()) return "end";
    return std::string(reinterpret_cast<const char*>(slice.begin()), slice.size());
  };
  EXPECT_EQ(next(), "\x08\x01");  // SERVING
  std::thread stop([this] { server_->Shutdown(); });
  EXPECT_EQ(next(), "\x08\x02");  // NOT_SERVING, while the connection still lives
  stop.join();
  context.TryCancel();
  grpc::Status status;
  call->Finish(&status, nullptr);
  wait();
  queue.Shutdown();
  wait();
}

TEST_F(SecurityTest, MutationsAreOnTheAuditLog) {
  v1::CreateSiteRequest create;
  create.set_site_id("c");
  EXPECT_TRUE(
      Call(Channel(), "/soundmap.v1.SiteService/CreateSite", create.SerializeAsString(), "admin")
          .ok());
  EXPECT_EQ(CreateSession(Channel("r1"), "", "a", "r2").error_code(),
            grpc::StatusCode::PERMISSION_DENIED);
  EXPECT_EQ(CreateSession(Channel(), "", "a", "r2").error_code(),
            grpc::StatusCode::UNAUTHENTICATED);
  EXPECT_TRUE(ListSites(Channel(), "read").ok());
  std::istringstream lines(Read(options_.access.audit_log));
  std::vector<std::string> told;
  for (std::string line; std::getline(lines, line);) {
    const auto json = nlohmann::json::parse(line);
    EXPECT_EQ(json["event"], "audit");
    EXPECT_EQ(json["peer"], "ipv4:127.0.0.1");
    told.push_back(
        absl::StrCat(json["who"].get<std::string>(), "|", json["deed"].get<std::string>(), "|",
                     json["what"].get<std::string>(), "|", json["result"].get<std::string>()));
  }
  std::filesystem::remove(options_.access.audit_log);
  EXPECT_THAT(told, Contains("token admin|create site|c|OK"));
  EXPECT_THAT(told, Contains("robot r1|create session|sites/a/sessions/drive-of-r2 of robots/r2|"
                             "PERMISSION_DENIED"));
  EXPECT_THAT(told, Contains("nobody|create session|sites/a/sessions/drive-of-r2 of robots/r2|"
                             "UNAUTHENTICATED"));
}

TEST_F(SecurityTest, AFloodIsToldWhenToComeAgain) {
  options_.access.calls_per_s = 1.0;
  server_.reset();
  server_.emplace(options_);
  const auto channel = Channel();
  grpc::Status status;
  // Less than one call in a second.
  for (int i = 0; i < 1000 && status.ok(); ++i) status = ListSites(channel, "read");
  EXPECT_EQ(status.error_code(), grpc::StatusCode::RESOURCE_EXHAUSTED);
  google::rpc::Status details;
  ASSERT_TRUE(details.ParseFromString(status.error_details()));
  bool retry_info = false;
  for (const auto& detail : details.details()) retry_info |= detail.Is<google::rpc::RetryInfo>();
  EXPECT_TRUE(retry_info);
  EXPECT_TRUE(ListSites(channel, "admin").ok());
}

TEST_F(SecurityTest, CertificatesAreReadAgain) {
  ASSERT_TRUE(ListSites(Channel(), "read").ok());
  Credentials(absl::StrCat("server ", *folder_, "/stranger 127.0.0.1"));
  for (const char* name : {"server-key.pem", "server.pem", "ca.pem"}) {
    std::filesystem::copy_file(File(absl::StrCat("stranger/", name)), File("next"));
    std::filesystem::rename(File(name), File(absl::StrCat("old-", name)));
    std::filesystem::rename(File("next"), File(name));
  }
  const auto deadline = std::chrono::steady_clock::now() + std::chrono::seconds(60);
  const auto served = [&] { return ListSites(Channel("r1", "stranger"), "").ok(); };
  bool renewed = false;
  while (!(renewed = served()) && std::chrono::steady_clock::now() < deadline) {
  }
  EXPECT_TRUE(renewed);
  EXPECT_EQ(ListSites(Channel("r1"), "").error_code(), grpc::StatusCode::UNAVAILABLE);
  for (const char* name : {"server-key.pem", "server.pem", "ca.pem"}) {
    std::filesystem::rename(File(absl::StrCat("old-", name)), File(name));
  }
}

TEST(CheckTlsFiles, NamesTheFileAtFault) {
  const std::string folder = ::testing::TempDir() + "/pairs";
  Credentials(absl::StrCat("ca ", folder));
  Credentials(absl::StrCat("server ", folder, " localhost"));
  Credentials(absl::StrCat("robot ", folder, " other a"));
  Credentials(absl::StrCat("robot ", folder, " late a 0"));
  const auto check = [&](const char* certificate, const char* key, const char* ca) {
    const auto path = [&](const char* name) {
      return *name == '\0' ? std::string() : absl::StrCat(folder, "/", name);
    };
    return std::string(CheckTlsFiles({path(certificate), path(key), path(ca)}).message());
  };
  EXPECT_EQ(check("", "", ""), "");
  EXPECT_EQ(check("server.pem", "server-key.pem", ""), "");
  EXPECT_EQ(check("server.pem", "server-key.pem", "ca.pem"), "");
  EXPECT_THAT(check("missing.pem", "server-key.pem", ""), HasSubstr("missing.pem"));
  EXPECT_THAT(check("server-key.pem", "server-key.pem", ""), HasSubstr("server-key.pem"));
  EXPECT_THAT(check("server.pem", "other-key.pem", ""), HasSubstr("other-key.pem"));
  EXPECT_THAT(check("server.pem", "server.pem", ""), HasSubstr("private key"));
  EXPECT_THAT(check("server.pem", "server-key.pem", "ca-key.pem"), HasSubstr("ca-key.pem"));
  EXPECT_THAT(check("late.pem", "late-key.pem", ""), HasSubstr("expired"));
}

}  // namespace
}  // namespace soundmap::api
