#include "uplink/ingest_stream.h"

#include <algorithm>
#include <utility>

namespace soundmap::uplink {

IngestStream::IngestStream(v1::IngestService::StubInterface& stub,
                           std::unique_ptr<grpc::ClientContext> context)
    : context_(std::move(context)),
      stream_(stub.Ingest(context_.get())),
      reader_([this] { Read(); }) {}

IngestStream::~IngestStream() {
  if (!reader_.joinable()) return;
  context_->TryCancel();
  Finish();
}

bool IngestStream::Write(const v1::IngestRequest& request) { return stream_->Write(request); }

IngestStream::State IngestStream::state() const {
  std::lock_guard lock(mutex_);
  return state_;
}

void IngestStream::WaitForNews(const State& seen,
                               std::optional<std::chrono::nanoseconds> time) const {
  std::unique_lock lock(mutex_);
  const auto is_new = [&] { return state_.version != seen.version; };
  if (time) {
    news_.wait_for(lock, *time, is_new);
  } else {
    news_.wait(lock, is_new);
  }
}

void IngestStream::SpendCredit(std::int64_t bytes) {
  std::lock_guard lock(mutex_);
  state_.credit_bytes -= bytes;
}

std::optional<std::int64_t> IngestStream::TakeRewind() {
  std::lock_guard lock(mutex_);
  return std::exchange(state_.rewind_offset, std::nullopt);
}

grpc::Status IngestStream::Finish() {
  reader_.join();
  return stream_->Finish();
}

void IngestStream::Read() {
  v1::IngestResponse response;
  bool more = true;
  while (more) {
    more = stream_->Read(&response);
    {
      std::lock_guard lock(mutex_);
      ++state_.version;
      if (!more) {
        state_.ended = true;
      } else if (response.has_welcome()) {
        state_.welcome = response.welcome();
      } else if (response.has_ack()) {
        state_.watermarks = {response.ack().received(), response.ack().durable(),
                             response.ack().processed()};
      } else if (response.has_credit()) {
        state_.credit_bytes += std::max<std::int64_t>(response.credit().bytes(), 0);
      } else if (response.has_rewind()) {
        state_.rewind_offset = response.rewind().offset();
      } else if (response.has_drain()) {
        state_.drain = true;
      }
    }
    news_.notify_all();
  }
}

}  // namespace soundmap::uplink
