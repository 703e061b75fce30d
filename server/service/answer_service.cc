#include "server/service/answer_service.h"

#include <memory>
#include <mutex>
#include <utility>
#include <variant>

#include "server/base/status_macros.h"
#include "server/pipeline/exception_status.h"
#include "server/service/call_record.h"
#include "server/service/convert.h"
#include "server/service/rpc_status.h"
#include "server/service/station_store.h"

namespace horopter {
namespace {

absl::StatusOr<WatchOptions> WatchOptionsOf(const grpc::ByteBuffer& bytes) {
  v1::WatchAnswersRequest request;
  grpc::ByteBuffer copy = bytes;
  if (copy.Length() > 0 &&
      !grpc::SerializationTraits<v1::WatchAnswersRequest>::Deserialize(&copy, &request).ok()) {
    return absl::InvalidArgumentError("the request is not a message of this method");
  }
  if (request.last() < 0) return InvalidField("last", "negative");
  if (request.after() < 0) return InvalidField("after", "negative");
  if (!request.station().empty()) {
    HOROPTER_RETURN_IF_ERROR(StationIdFromName(request.station(), "station").status());
  }
  return WatchOptions{request.last(), request.after(), request.previews(), request.station()};
}

// Sends what the board has, one message at a time; deletes itself when gRPC is done with it.
class WatchReactor final : public grpc::ServerWriteReactor<grpc::ByteBuffer> {
 public:
  WatchReactor(AnswerBoard& board, const CallGate& gate, grpc::CallbackServerContext* context)
      : board_(board),
        context_(context),
        call_({.name = "WatchAnswers", .needs = Role::kObserver}, gate, context) {}

  void Start(const grpc::ByteBuffer& request) {
    const absl::Status begun = CatchExceptions([&]() -> absl::Status {
      HOROPTER_RETURN_IF_ERROR(call_.Authorize());
      HOROPTER_ASSIGN_OR_RETURN(const WatchOptions options, WatchOptionsOf(request));
      HOROPTER_ASSIGN_OR_RETURN(watch_, board_.Open(options));
      return absl::OkStatus();
    });
    if (!begun.ok()) return Finish(call_.End(begun));
    call_.Begin();
    // Nobody ends the call before there is a write to fail: this is safe until Drive.
    watch_->Attach([this] { Drive(); }, [context = context_] { context->TryCancel(); });
    Drive();
  }

 private:
  // The reactor may be gone when this returns.
  void Drive() {
    AnswerBoard::Step step;
    {
      const std::lock_guard lock(mutex_);
      if (sending_ || finished_) return;
      step = NextStep();
      if (auto* const message = std::get_if<grpc::ByteBuffer>(&step)) {
        message_.Swap(message);
        sending_ = true;
        watch_->SetSending(true);
      }
      finished_ = std::holds_alternative<absl::Status>(step);
    }
    if (std::holds_alternative<grpc::ByteBuffer>(step)) StartWrite(&message_);
    if (const auto* const end = std::get_if<absl::Status>(&step)) Finish(call_.End(*end));
  }

  // Who may no longer watch, as his token has expired or was taken away, sees nothing more.
  AnswerBoard::Step NextStep() {
    if (cancelled_) return absl::CancelledError("the client went away");
    if (absl::Status may = call_.Authorize(); !may.ok()) return may;
    return board_.Next(*watch_);
  }

  void OnWriteDone(bool ok) override {
    {
      const std::lock_guard lock(mutex_);
      sending_ = false;
      if (!ok) cancelled_ = true;
      message_.Clear();
      watch_->SetSending(false);
    }
    Drive();
  }
  void OnCancel() override {
    {
      const std::lock_guard lock(mutex_);
      cancelled_ = true;
    }
    Drive();
  }
  void OnDone() override {
    if (watch_ != nullptr) {
      watch_->Detach();
      board_.Leave(watch_);
    }
    delete this;
  }

  AnswerBoard& board_;
  grpc::CallbackServerContext* const context_;
  CallRecord call_;
  std::shared_ptr<Watch> watch_;
  std::mutex mutex_;
  bool sending_ = false, cancelled_ = false, finished_ = false;  // guarded by mutex_
  grpc::ByteBuffer message_;
};

}  // namespace

grpc::ServerWriteReactor<grpc::ByteBuffer>* AnswerService::WatchAnswers(
    grpc::CallbackServerContext* context, const grpc::ByteBuffer* request) {
  auto* const reactor = new WatchReactor(board_, gate_, context);
  reactor->Start(*request);
  return reactor;
}

grpc::ServerUnaryReactor* AnswerService::GetAnswer(grpc::CallbackServerContext* context,
                                                   const grpc::ByteBuffer* request,
                                                   grpc::ByteBuffer* response) {
  return RunUnaryCall<v1::GetAnswerRequest, v1::WatchedAnswer>(
      gate_,
      context,
      request,
      response,
      {{.name = "GetAnswer", .needs = Role::kObserver},
       [this](const auto& message, const CallInfo&, v1::WatchedAnswer* answer) -> absl::Status {
         HOROPTER_ASSIGN_OR_RETURN(grpc::ByteBuffer bytes, board_.Get(message.number()));
         if (!grpc::SerializationTraits<v1::WatchedAnswer>::Deserialize(&bytes, answer).ok()) {
           return absl::InternalError("a held answer cannot be read");
         }
         return absl::OkStatus();
       },
       // As parsed, and as sent.
       [this](const v1::GetAnswerRequest& message) -> absl::StatusOr<CallDemand> {
         HOROPTER_ASSIGN_OR_RETURN(const grpc::ByteBuffer bytes, board_.Get(message.number()));
         return CallDemand{2 * static_cast<int64_t>(bytes.Length())};
       }});
}

}  // namespace horopter
