#include "server/service/unary_call.h"

#include <spdlog/spdlog.h>

#include <atomic>
#include <chrono>
#include <memory>
#include <random>
#include <utility>

#include "absl/strings/str_cat.h"
#include "absl/strings/str_format.h"
#include "server/pipeline/exception_status.h"
#include "server/service/rpc_status.h"

namespace horopter {
namespace {

using Clock = std::chrono::steady_clock;

// Unique in this process; the random part tells the logs of two runs apart.
std::string NextRequestId() {
  static const uint32_t run = std::random_device{}();
  static std::atomic<int64_t> next{1};
  return absl::StrFormat("%08x-%06d", run, next++);
}

// Outlives the reactor, so that a stop token may as well.
struct CallState {
  std::atomic<bool> cancelled{false};
  std::chrono::system_clock::time_point deadline, hurry;

  bool DeadlinePassed() const { return std::chrono::system_clock::now() >= deadline; }
  bool InHurry() const { return std::chrono::system_clock::now() >= hurry; }
};

// Deletes itself when gRPC is done with it.
class UnaryReactor : public grpc::ServerUnaryReactor {
 public:
  UnaryReactor(const char* method, grpc::CallbackServerContext* context)
      : method_(method),
        context_(context),
        state_(std::make_shared<CallState>()),
        start_(Clock::now()) {
    state_->deadline = context->deadline();
    info_.request_id = NextRequestId();
    const auto now = std::chrono::system_clock::now();
    const std::chrono::duration<double> allowed = state_->deadline - now;
    state_->hurry = state_->deadline == std::chrono::system_clock::time_point::max()
                        ? state_->deadline
                        : now + std::chrono::duration_cast<std::chrono::system_clock::duration>(
                                    kUnhurriedShare * allowed);
    info_.limits.stop = [state = state_] {
      return state->cancelled.load() || state->DeadlinePassed();
    };
    info_.limits.hurry = [state = state_] { return state->InHurry(); };
    context->AddInitialMetadata(kRequestIdKey, info_.request_id);
  }

  void Run(const CallHandler& handler) { FinishWith(Handle(handler)); }

  // The reactor must not be touched afterwards.
  void FinishWith(const absl::Status& status) {
    const std::chrono::duration<double, std::milli> elapsed = Clock::now() - start_;
    const auto level = status.ok() ? spdlog::level::info : spdlog::level::warn;
    spdlog::log(level,
                "request={} method={} peer={} code={} ms={:.1f}{}",
                info_.request_id,
                method_,
                context_->peer(),
                absl::StatusCodeToString(status.code()),
                elapsed.count(),
                status.ok() ? "" : absl::StrCat(" error=\"", std::string(status.message()), "\""));
    Finish(ToRpcStatus(status, context_));
  }

 private:
  void OnCancel() override { state_->cancelled = true; }
  void OnDone() override { delete this; }

  absl::Status Handle(const CallHandler& handler) {
    if (info_.limits.stop()) return StopReason();
    absl::Status status = CatchExceptions([&] { return handler(info_); });
    return absl::IsCancelled(status) ? StopReason() : status;
  }

  absl::Status StopReason() const {
    if (state_->DeadlinePassed()) return absl::DeadlineExceededError("the deadline passed");
    return absl::CancelledError("the client cancelled");
  }

  const char* method_;
  grpc::CallbackServerContext* context_;
  std::shared_ptr<CallState> state_;
  CallInfo info_;
  Clock::time_point start_;
};

}  // namespace

grpc::ServerUnaryReactor* RunUnaryCall(const char* method,
                                       grpc::CallbackServerContext* context,
                                       WorkerPool& pool,
                                       CallHandler handler) {
  auto* reactor = new UnaryReactor(method, context);
  switch (pool.TrySubmit([reactor, handler = std::move(handler)] { reactor->Run(handler); })) {
    case WorkerPool::Admission::kAccepted:
      break;
    case WorkerPool::Admission::kQueueFull:
      reactor->FinishWith(QueueFull(pool.RetryAfterMs()));
      break;
    case WorkerPool::Admission::kClosed:
      reactor->FinishWith(absl::UnavailableError("the server is stopping"));
      break;
  }
  return reactor;
}

}  // namespace horopter
