#include "tests/uplink/scripted_server.h"

#include <algorithm>

#include "recording/frame_coding.h"

namespace soundmap::uplink {
namespace {

constexpr std::int64_t kMaxChunkBytes = 256 << 10;

// CRC-32C bit by bit, from its polynomial.
std::uint32_t BitwiseCrc32c(std::uint32_t crc, const std::string& bytes) {
  crc = ~crc;
  for (const char c : bytes) {
    crc ^= static_cast<unsigned char>(c);
    for (int bit = 0; bit < 8; ++bit) crc = (crc >> 1) ^ (crc & 1 ? 0x82f63b78u : 0u);
  }
  return ~crc;
}

}  // namespace

ScriptedServer::ScriptedServer(std::int64_t credit_bytes, std::vector<Connection> connections)
    : credit_bytes_(credit_bytes), connections_(std::move(connections)) {}

ScriptedServer::~ScriptedServer() { Stop(); }

void ScriptedServer::Start(int port) {
  grpc::ServerBuilder builder;
  builder.AddListeningPort("127.0.0.1:" + std::to_string(port), grpc::InsecureServerCredentials(),
                           &port_);
  builder.RegisterService(static_cast<v1::IngestService::Service*>(this));
  builder.RegisterService(static_cast<v1::SessionService::Service*>(this));
  server_ = builder.BuildAndStart();
}

void ScriptedServer::Stop() {
  if (server_) server_->Shutdown(std::chrono::system_clock::now());
  server_.reset();
}

std::string ScriptedServer::address() const { return "127.0.0.1:" + std::to_string(port_); }

std::vector<ReceivedFrame> ScriptedServer::frames() const {
  std::lock_guard lock(mutex_);
  return frames_;
}
std::vector<std::string> ScriptedServer::complaints() const {
  std::lock_guard lock(mutex_);
  return complaints_;
}
int ScriptedServer::connection_count() const {
  std::lock_guard lock(mutex_);
  return session_count_;
}
v1::CreateSessionRequest ScriptedServer::session_request() const {
  std::lock_guard lock(mutex_);
  return session_request_;
}
std::string ScriptedServer::authorization() const {
  std::lock_guard lock(mutex_);
  return authorization_;
}

std::int64_t ScriptedServer::payload_bytes() const {
  std::lock_guard lock(mutex_);
  return payload_bytes_;
}

void ScriptedServer::Complain(const std::string& what) {
  std::lock_guard lock(mutex_);
  complaints_.push_back(what);
}

const Connection& ScriptedServer::Script(int index) const {
  return connections_[std::min<std::size_t>(index, connections_.size() - 1)];
}

grpc::Status ScriptedServer::CreateSession(grpc::ServerContext* context,
                                           const v1::CreateSessionRequest* request,
                                           v1::Session* response) {
  std::lock_guard lock(mutex_);
  const Connection& script = Script(session_count_++);
  if (!script.refuse_session.ok()) return script.refuse_session;
  session_request_ = *request;
  if (const auto found = context->client_metadata().find("authorization");
      found != context->client_metadata().end()) {
    authorization_ = std::string(found->second.data(), found->second.size());
  }
  response->set_name(request->site() + "/sessions/" + request->session_id());
  response->set_epoch(++epoch_);
  return grpc::Status::OK;
}

grpc::Status ScriptedServer::Ingest(
    grpc::ServerContext*, grpc::ServerReaderWriter<v1::IngestResponse, v1::IngestRequest>* stream) {
  v1::IngestRequest request;
  if (!stream->Read(&request) || !request.has_open()) {
    Complain("the first message is not `open`");
    return grpc::Status(grpc::StatusCode::INVALID_ARGUMENT, "open");
  }
  Connection script;
  {
    std::lock_guard lock(mutex_);
    if (request.open().epoch() != epoch_) complaints_.push_back("an old epoch");
    script = Script(session_count_ - 1);
  }
  const auto received = [this] { return static_cast<std::int64_t>(frames().size()); };
  v1::IngestResponse response;
  response.mutable_welcome()->set_resume_offset(received());
  response.mutable_welcome()->mutable_limits()->set_max_chunk_bytes(kMaxChunkBytes);
  response.mutable_welcome()->mutable_limits()->set_max_frame_bytes(16 << 20);
  for (const v1::Coding coding : script.codings) response.mutable_welcome()->add_codings(coding);
  stream->Write(response);
  response.Clear();
  response.mutable_credit()->set_bytes(credit_bytes_);
  stream->Write(response);

  std::int64_t credit_bytes = credit_bytes_;
  std::int64_t next_offset = received();
  std::string parts;
  std::uint32_t next_part = 0;
  bool rewinding = false;
  while (stream->Read(&request)) {
    if (request.has_finish()) {
      if (rewinding) continue;
      if (request.finish().frame_count() != received()) Complain("finished with another count");
      return grpc::Status::OK;
    }
    if (!request.has_chunk()) {
      Complain("a message that is neither chunk nor finish");
      continue;
    }
    const v1::Chunk& chunk = request.chunk();
    std::int64_t bytes = 0;
    std::int64_t credit = 0;
    std::uint32_t crc = 0;
    for (const v1::Frame& frame : chunk.frames()) {
      bytes += static_cast<std::int64_t>(frame.payload().size());
      const std::int64_t parts = std::max<std::int64_t>(frame.part_count(), 1);
      credit += frame.coding() == v1::CODING_UNSPECIFIED
                    ? static_cast<std::int64_t>(frame.payload().size())
                    : (frame.message_bytes() + parts - 1) / parts;
      crc = BitwiseCrc32c(crc, frame.payload());
    }
    {
      std::lock_guard lock(mutex_);
      payload_bytes_ += bytes;
    }
    if (bytes > kMaxChunkBytes) Complain("a chunk of " + std::to_string(bytes) + " bytes");
    if (crc != chunk.crc32c()) Complain("a wrong checksum");
    if (std::min(credit, kMaxChunkBytes) > credit_bytes) Complain("more than there is credit for");
    if (chunk.frames().empty()) Complain("an empty chunk");
    if (rewinding && chunk.first_offset() == script.rewind_to) {
      rewinding = false;
      next_offset = script.rewind_to;
      std::lock_guard lock(mutex_);
      frames_.resize(static_cast<std::size_t>(script.rewind_to));
    }
    if (!rewinding) {
      if (chunk.first_offset() != next_offset) {
        Complain("offset " + std::to_string(chunk.first_offset()) + " after " +
                 std::to_string(next_offset));
      }
      for (const v1::Frame& frame : chunk.frames()) {
        if (script.fail_at_offset == next_offset) return script.failure;
        if (script.drain_at_offset == next_offset) {
          response.Clear();
          response.mutable_drain();
          stream->Write(response);
          return grpc::Status(grpc::StatusCode::UNAVAILABLE, "the server is stopping");
        }
        if (script.rewind_at_offset == next_offset) {
          script.rewind_at_offset.reset();
          rewinding = true;
          response.Clear();
          response.mutable_rewind()->set_offset(script.rewind_to);
          stream->Write(response);
          break;
        }
        std::string payload = frame.payload();
        if (frame.part_count() > 0) {
          if (chunk.frames_size() != 1) Complain("a part beside something else");
          if (frame.part() != next_part) Complain("parts out of order");
          parts += payload;
          if (++next_part < frame.part_count()) continue;
          payload = std::exchange(parts, {});
          next_part = 0;
        }
        if (frame.coding() != v1::CODING_UNSPECIFIED) {
          if (std::count(script.codings.begin(), script.codings.end(), frame.coding()) == 0) {
            Complain("a coding that was not offered");
          }
          auto message = recording::DecodeFrame(frame.coding(), payload, frame.message_bytes());
          if (!message.ok()) Complain(message.status().ToString());
          payload = message.value_or("");
        }
        std::lock_guard lock(mutex_);
        frames_.push_back(
            {frame.sensor(), static_cast<std::int64_t>(frame.log_time_ns()), payload});
        ++next_offset;
      }
    }
    credit_bytes -= credit;
    response.Clear();
    response.mutable_ack()->set_received(received());
    response.mutable_ack()->set_durable(received());
    response.mutable_ack()->set_processed(received());
    stream->Write(response);
    response.Clear();
    response.mutable_credit()->set_bytes(credit);
    credit_bytes += credit;
    stream->Write(response);
  }
  Complain("the stream ended without `finish`");
  return grpc::Status::OK;
}

}  // namespace soundmap::uplink
