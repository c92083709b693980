// gRPC hands calls from thread to thread by atomics, which the thread sanitizer does not see in a
// library that is not built with it: every stream would race with itself. Linked before gRPC into
// programs that are built with the sanitizer, this tells it what gRPC promises, and nothing more:
// what was done before a batch was started is seen by who hears that the batch is done, and what a
// server's calls did until their end by who has shut it down. Where
// client and server are one process, also what the client did before it sent is seen by the call
// that begins at the server, and what the server did before it answered by the client that has the
// answer.
#include <dlfcn.h>
#include <grpc/grpc.h>
#include <grpcpp/grpcpp.h>
#include <sanitizer/tsan_interface.h>

#include <algorithm>

namespace {

char to_server;  // the addresses stand for the wire
char to_client;
char to_end;  // of a server

template <typename Function>
Function* Next(const char* name) {
  return reinterpret_cast<Function*>(::dlsym(RTLD_NEXT, name));
}

bool IsServers(const grpc_op& op) {
  return op.op == GRPC_OP_SEND_STATUS_FROM_SERVER || op.op == GRPC_OP_RECV_CLOSE_ON_SERVER;
}

void Acquire(const grpc_event& event) {
  if (event.type != GRPC_OP_COMPLETE) return;
  __tsan_acquire(event.tag);
  __tsan_acquire(&to_client);
}

using Functor = grpc_completion_queue_functor;
using grpc::internal::ServerCallbackCall;
using grpc::internal::ServerReactor;

// What is private there, but for explicit instantiations.
using OnCancelFunction = void (ServerReactor::*)();
using Count = std::atomic_int ServerCallbackCall::*;
OnCancelFunction OnCancelOf();
Count UnfinishedOf();
Count CancelConditionsOf();
template <OnCancelFunction kOnCancel, Count kUnfinished, Count kCancelConditions>
struct Opened {
  friend OnCancelFunction OnCancelOf() { return kOnCancel; }
  friend Count UnfinishedOf() { return kUnfinished; }
  friend Count CancelConditionsOf() { return kCancelConditions; }
};
template struct Opened<&ServerReactor::OnCancel, &ServerCallbackCall::callbacks_outstanding_,
                       &ServerCallbackCall::on_cancel_conditions_remaining_>;

// A reactor that counts as done, for the sanitizer too, when it has heard of the cancellation.
class CancelledReactor : public ServerReactor {
 public:
  CancelledReactor(ServerCallbackCall* call, ServerReactor* reactor)
      : call_(call), reactor_(reactor) {}

 private:
  void OnDone() override {}
  void OnCancel() override {
    (reactor_->*OnCancelOf())();
    __tsan_release(&(call_->*UnfinishedOf()));
    delete this;
  }

  ServerCallbackCall* const call_;
  ServerReactor* const reactor_;
};

}  // namespace

extern "C" {

grpc_call_error grpc_call_start_batch(grpc_call* call, const grpc_op* ops, size_t count, void* tag,
                                      void* reserved) {
  static auto* const next = Next<decltype(grpc_call_start_batch)>("grpc_call_start_batch");
  if (tag != nullptr) __tsan_release(tag);
  __tsan_release(std::any_of(ops, ops + count, IsServers) ? &to_client : &to_server);
  return next(call, ops, count, tag, reserved);
}

grpc_event grpc_completion_queue_next(grpc_completion_queue* queue, gpr_timespec deadline,
                                      void* reserved) {
  static auto* const next =
      Next<decltype(grpc_completion_queue_next)>("grpc_completion_queue_next");
  const grpc_event event = next(queue, deadline, reserved);
  Acquire(event);
  return event;
}

grpc_event grpc_completion_queue_pluck(grpc_completion_queue* queue, void* tag,
                                       gpr_timespec deadline, void* reserved) {
  static auto* const next =
      Next<decltype(grpc_completion_queue_pluck)>("grpc_completion_queue_pluck");
  const grpc_event event = next(queue, tag, deadline, reserved);
  Acquire(event);
  return event;
}

// After OnDone(), and before the server may go.
void grpc_call_unref(grpc_call* call) {
  static auto* const next = Next<decltype(grpc_call_unref)>("grpc_call_unref");
  __tsan_release(&to_end);
  next(call);
}

// grpc::Server::ShutdownInternal, which waits for all calls.
#define SHUT_DOWN "_ZN4grpc6Server16ShutdownInternalE12gpr_timespec"
void ShutDown(grpc::Server* server, gpr_timespec deadline) __asm__(SHUT_DOWN);
void ShutDown(grpc::Server* server, gpr_timespec deadline) {
  static auto* const next = Next<void(grpc::Server*, gpr_timespec)>(SHUT_DOWN);
  next(server, deadline);
  __tsan_acquire(&to_end);
}

// grpc::internal::CallbackWithSuccessTag::StaticRun: an operation of a callback is done.
#define SUCCESS_RUN \
  "_ZN4grpc8internal22CallbackWithSuccessTag9StaticRunEP29grpc_completion_queue_functori"
void RunSuccess(Functor* functor, int ok) __asm__(SUCCESS_RUN);
void RunSuccess(Functor* functor, int ok) {
  static auto* const next = Next<void(Functor*, int)>(SUCCESS_RUN);
  __tsan_acquire(functor);
  next(functor, ok);
}

// grpc_core::Executor::Run: what a reactor is told last, or that its call was cancelled, comes on
// another thread. The status is passed by a pointer to the caller's; the closure has its function
// behind a link to the next one.
struct Closure {
  void* next;
  void (*run)(void* argument, void* status);
  void* argument;
};
struct Posted {
  Closure* closure;
  Closure was;
};
#define EXECUTOR_RUN                                                                            \
  "_ZN9grpc_core8Executor3RunEP12grpc_closureN4absl7debian36StatusENS_12ExecutorTypeENS_15Exec" \
  "utorJobTypeE"
void RunPosted(Closure* closure, void* status, int executor, int length) __asm__(EXECUTOR_RUN);
void RunPosted(Closure* closure, void* status, int executor, int length) {
  static auto* const next = Next<void(Closure*, void*, int, int)>(EXECUTOR_RUN);
  auto* const posted = new Posted{closure, *closure};
  closure->argument = posted;
  closure->run = [](void* argument, void* its_status) {
    __tsan_acquire(argument);
    const Posted posted_before = *static_cast<Posted*>(argument);
    delete static_cast<Posted*>(argument);
    // It may be posted again, or go while it runs.
    posted_before.closure->run = posted_before.was.run;
    posted_before.closure->argument = posted_before.was.argument;
    posted_before.was.run(posted_before.was.argument, its_status);
  };
  __tsan_release(posted);
  next(closure, status, executor, length);
}

// ServerCallbackCall::CallOnCancel and ScheduleOnDone: a reactor is done when all that it was told
// is over.
#define CALL_ON_CANCEL "_ZN4grpc8internal18ServerCallbackCall12CallOnCancelEPNS0_13ServerReactorE"
void CallOnCancel(ServerCallbackCall* call, ServerReactor* reactor) __asm__(CALL_ON_CANCEL);
void CallOnCancel(ServerCallbackCall* call, ServerReactor* reactor) {
  static auto* const next = Next<void(ServerCallbackCall*, ServerReactor*)>(CALL_ON_CANCEL);
  __tsan_acquire(&(call->*CancelConditionsOf()));
  if (reactor->InternalInlineable()) return next(call, reactor);
  next(call, new CancelledReactor(call, reactor));
}
#define SCHEDULE_ON_DONE "_ZN4grpc8internal18ServerCallbackCall14ScheduleOnDoneEb"
void ScheduleOnDone(ServerCallbackCall* call, bool at_once) __asm__(SCHEDULE_ON_DONE);
void ScheduleOnDone(ServerCallbackCall* call, bool at_once) {
  static auto* const next = Next<void(ServerCallbackCall*, bool)>(SCHEDULE_ON_DONE);
  __tsan_acquire(&(call->*UnfinishedOf()));
  next(call, at_once);
}

// grpc::Server::CallbackRequest<grpc::CallbackServerContext>::CallbackCallTag::StaticRun: a call
// begins at the server.
#define BEGIN_RUN                                                                                \
  "_ZN4grpc6Server15CallbackRequestINS_21CallbackServerContextEE15CallbackCallTag9StaticRunEP29" \
  "grpc_completion_queue_functori"
void RunBegin(Functor* functor, int ok) __asm__(BEGIN_RUN);
void RunBegin(Functor* functor, int ok) {
  static auto* const next = Next<void(Functor*, int)>(BEGIN_RUN);
  __tsan_acquire(&to_server);
  next(functor, ok);
}
}
