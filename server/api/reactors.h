#pragma once

#include <grpcpp/grpcpp.h>

#include <functional>
#include <string>
#include <utility>

#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "api/access.h"
#include "api/status.h"

namespace soundmap::api {

// Ends a unary call with this status.
inline grpc::ServerUnaryReactor* Finish(grpc::CallbackServerContext* context,
                                        const absl::Status& status) {
  grpc::ServerUnaryReactor* reactor = context->DefaultReactor();
  reactor->Finish(ToGrpcStatus(status));
  return reactor;
}

// The same for a call that changes something: the audit log tells who asked for `deed` on `what`.
class AuditedFinish {
 public:
  AuditedFinish(Access* access, grpc::CallbackServerContext* context, const char* deed,
                std::string what)
      : access_(access), context_(context), deed_(deed), what_(std::move(what)) {}

  grpc::ServerUnaryReactor* operator()(const absl::Status& status) const {
    return Finish(context_, access_->Audit(*context_, deed_, what_, status));
  }

 private:
  Access* const access_;
  grpc::CallbackServerContext* const context_;
  const char* const deed_;
  const std::string what_;
};

// Streams what `next` makes, one message at a time, until it returns false or an error.
template <typename Message>
class StreamReactor : public grpc::ServerWriteReactor<Message> {
 public:
  using Next = std::function<absl::StatusOr<bool>(Message&)>;

  explicit StreamReactor(Next next) : next_(std::move(next)) { Write(); }
  explicit StreamReactor(const absl::Status& status) { this->Finish(ToGrpcStatus(status)); }

  void OnWriteDone(bool ok) override {
    if (ok) {
      Write();
    } else {
      this->Finish(grpc::Status(grpc::StatusCode::CANCELLED, "the client is gone"));
    }
  }
  void OnDone() override { delete this; }

 private:
  void Write() {
    message_.Clear();
    const absl::StatusOr<bool> more = next_(message_);
    if (!more.ok() || !*more) {
      this->Finish(ToGrpcStatus(more.status()));
    } else {
      this->StartWrite(&message_);
    }
  }

  Next next_;
  Message message_;
};

}  // namespace soundmap::api
