#pragma once

#include <grpcpp/grpcpp.h>

#include <chrono>
#include <condition_variable>
#include <cstdint>
#include <memory>
#include <mutex>
#include <optional>
#include <thread>

#include "soundmap/v1/ingest_service.grpc.pb.h"

namespace soundmap::uplink {

// How far the server has come with a session: frames received, synced to disk, with their effect in
// the map.
struct Watermarks {
  std::int64_t received = 0;
  std::int64_t durable = 0;
  std::int64_t processed = 0;
};

// One `Ingest` call: one thread writes, the stream's own thread takes in what the server says.
class IngestStream {
 public:
  // What the server has said so far, and what of it is still to be heeded.
  struct State {
    std::optional<v1::Welcome> welcome;
    Watermarks watermarks;
    std::int64_t credit_bytes = 0;  // that may still be sent
    std::optional<std::int64_t> rewind_offset;
    bool drain = false;
    bool ended = false;        // the server says no more; Finish() tells why
    std::int64_t version = 0;  // goes up with every change
  };

  IngestStream(v1::IngestService::StubInterface& stub,
               std::unique_ptr<grpc::ClientContext> context);
  // Cancels the call if it has not ended.
  ~IngestStream();

  // False: the call is over.
  bool Write(const v1::IngestRequest& request);

  State state() const;
  // Waits until the server has said something since `seen`, or `time` is over; with none as long as
  // it takes.
  void WaitForNews(const State& seen, std::optional<std::chrono::nanoseconds> time) const;
  void SpendCredit(std::int64_t bytes);
  std::optional<std::int64_t> TakeRewind();

  // Waits for the end of the call; why it ended.
  grpc::Status Finish();

 private:
  void Read();

  const std::unique_ptr<grpc::ClientContext> context_;
  const std::unique_ptr<grpc::ClientReaderWriterInterface<v1::IngestRequest, v1::IngestResponse>>
      stream_;
  mutable std::mutex mutex_;
  mutable std::condition_variable news_;
  State state_;  // guarded by mutex_
  std::thread reader_;
};

}  // namespace soundmap::uplink
