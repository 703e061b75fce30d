#include "server/service/unary_call.h"

#include <google/protobuf/descriptor.h>
#include <google/protobuf/message.h>

#include <algorithm>
#include <atomic>
#include <chrono>
#include <memory>
#include <optional>
#include <utility>

#include "absl/strings/str_cat.h"
#include "server/base/stop_scope.h"
#include "server/pipeline/exception_status.h"

namespace horopter {
namespace {

using Clock = std::chrono::steady_clock;

// On the steady clock, so that setting the machine's time neither ends nor prolongs a call.
Clock::time_point SteadyDeadline(std::chrono::system_clock::time_point deadline,
                                 Clock::time_point now) {
  constexpr auto kLongest = std::chrono::hours(24 * 365);
  const auto left = deadline - std::chrono::system_clock::now();
  return left > kLongest ? Clock::time_point::max()
                         : now + std::chrono::duration_cast<Clock::duration>(left);
}

// Outlives the reactor, so that a stop token may as well.
struct CallState {
  std::atomic<bool> cancelled{false};
  Clock::time_point deadline, hurry;

  bool DeadlinePassed() const { return Clock::now() >= deadline; }
  bool InHurry() const { return Clock::now() >= hurry; }
};

// Deletes itself when gRPC is done with it.
class UnaryReactor : public grpc::ServerUnaryReactor {
 public:
  UnaryReactor(const CallMethod& method, const CallGate& gate, grpc::CallbackServerContext* context)
      : method_(method),
        pool_(*gate.pool),
        call_(method, gate, context),
        state_(std::make_shared<CallState>()) {
    state_->deadline = SteadyDeadline(context->deadline(), call_.start());
    state_->hurry = state_->deadline;
    if (state_->deadline != Clock::time_point::max()) {
      const std::chrono::duration<double> allowed = state_->deadline - call_.start();
      info_.limits.allowed_s = std::max(0.0, allowed.count());
      state_->hurry =
          call_.start() + std::chrono::duration_cast<Clock::duration>(
                              std::chrono::duration<double>(HurryAfterS(info_.limits.allowed_s)));
    }
    info_.limits.stop = [state = state_] {
      return state->cancelled.load() || state->DeadlinePassed();
    };
    info_.limits.hurry = [state = state_] { return state->InHurry(); };
    info_.record = &call_.record();
    info_.request_id = call_.record().request_id;
    const auto& metadata = context->client_metadata();
    if (const auto variants = metadata.find(kVariantsKey); variants != metadata.end())
      info_.variants.assign(variants->second.data(), variants->second.size());
    if (const auto least = metadata.find(kMinGenerationKey); least != metadata.end())
      info_.min_generation.assign(least->second.data(), least->second.size());
  }

  // Queues the call or finishes it.
  void Start(const CallGate& gate,
             int64_t request_bytes,
             absl::FunctionRef<absl::StatusOr<ParsedCall>()> parse) {
    const absl::Status admitted =
        CatchExceptions([&] { return Admit(gate, request_bytes, parse); });
    if (!admitted.ok()) FinishWith(admitted);
  }

  // The reactor must not be touched afterwards.
  void FinishWith(const absl::Status& status) noexcept { Finish(call_.End(status)); }

 private:
  absl::Status Admit(const CallGate& gate,
                     int64_t request_bytes,
                     absl::FunctionRef<absl::StatusOr<ParsedCall>()> parse) {
    call_.record().request_bytes = request_bytes;
    if (request_bytes < 0) return absl::CancelledError("the call broke off on its way");
    HOROPTER_RETURN_IF_ERROR(call_.Authorize());
    info_.may_teach = Covers(call_.role(), Role::kTeacher);
    if (request_bytes > method_.max_request_bytes) {
      return absl::ResourceExhaustedError(absl::StrCat("the request has ",
                                                       request_bytes,
                                                       " bytes, at most ",
                                                       method_.max_request_bytes,
                                                       " are allowed"));
    }
    // Reading a request to refuse it takes longer than the refusal.
    JobTraits traits;
    traits.peer = call_.TurnOf();
    traits.deadline = state_->deadline;
    if (pool_.IsFull(traits)) return QueueFull(pool_.RetryAfterMs());
    // As delivered, and parsed.
    HOROPTER_ASSIGN_OR_RETURN(MemoryBudget::Lease reserved, Reserve(gate, 2 * request_bytes));
    HOROPTER_ASSIGN_OR_RETURN(ParsedCall call, parse());
    call_.record().resource = std::move(call.resource);
    reserved.GiveBack(request_bytes);
    if (!reserved.Grow(call.demand.bytes)) {
      return OutOfMemory(gate, request_bytes + call.demand.bytes);
    }
    const auto lease = std::make_shared<MemoryBudget::Lease>(std::move(reserved));
    traits.batch = call.demand.batch;
    // The job owns request and bytes: both go when it is done or withdrawn.
    const auto submitted =
        pool_.TrySubmit([this, lease, work = std::move(call.work)] { Run(work); }, traits);
    switch (submitted.admission) {
      case WorkerPool::Admission::kAccepted:
        ticket_ = submitted.ticket;
        return absl::OkStatus();
      case WorkerPool::Admission::kQueueFull:
        return QueueFull(pool_.RetryAfterMs());
      case WorkerPool::Admission::kTooLate:
        return RetryLater("the call would wait beyond its deadline", pool_.RetryAfterMs());
      case WorkerPool::Admission::kClosed:
        break;
    }
    return absl::UnavailableError("the server is stopping");
  }

  absl::StatusOr<MemoryBudget::Lease> Reserve(const CallGate& gate, int64_t bytes) {
    std::optional<MemoryBudget::Lease> lease = gate.memory->TryReserve(bytes);
    if (lease) return *std::move(lease);
    return OutOfMemory(gate, bytes);
  }

  absl::Status OutOfMemory(const CallGate& gate, int64_t bytes) {
    const std::string needs = absl::StrCat("the call needs ", bytes, " bytes of memory, ");
    if (bytes > gate.memory->bytes()) {
      return absl::ResourceExhaustedError(
          absl::StrCat(needs, "calls have ", gate.memory->bytes(), " in all"));
    }
    return RetryLater(absl::StrCat(needs, "which others hold"), pool_.RetryAfterMs());
  }

  void Run(const std::function<absl::Status(const CallInfo&)>& work) noexcept {
    call_.Begin();
    FinishWith(CatchExceptions([&]() -> absl::Status {
      if (info_.limits.stop()) return StopReason();
      const StopScope scope(info_.limits.stop);
      absl::Status status = CatchExceptions([&] { return work(info_); });
      return absl::IsCancelled(status) ? StopReason() : status;
    }));
  }

  // Of a client that cancels or goes away, and at the deadline. gRPC calls it once this reactor was
  // returned to it, and keeps the reactor until it is done.
  void OnCancel() override {
    state_->cancelled = true;
    if (ticket_ == 0 || !pool_.Withdraw(ticket_)) return;
    FinishWith(CatchExceptions([this] { return StopReason(); }));
  }
  void OnDone() override { delete this; }

  absl::Status StopReason() const {
    if (state_->DeadlinePassed()) return absl::DeadlineExceededError("the deadline passed");
    // Who waits through the end of a server seldom goes away just then.
    if (pool_.IsClosed()) {
      return absl::UnavailableError(
          "the server stopped before the call was done: its time to drain ran out");
    }
    return absl::CancelledError("the client cancelled");
  }

  const CallMethod method_;
  WorkerPool& pool_;
  CallRecord call_;
  std::shared_ptr<CallState> state_;
  CallInfo info_;
  uint64_t ticket_ = 0;  // written before gRPC gets the reactor
};

}  // namespace

double HurryAfterS(double allowed_s) {
  constexpr double kLeftShare = 0.25, kLeftS = 0.8, kUnhurriedShare = 0.3;
  return std::max(kUnhurriedShare * allowed_s,
                  allowed_s - std::max(kLeftShare * allowed_s, kLeftS));
}

std::string NamedResource(const google::protobuf::Message& request) {
  const auto* const descriptor = request.GetDescriptor();
  const auto* const reflection = request.GetReflection();
  for (const char* name : {"name", "object_id"}) {
    const auto* const field = descriptor->FindFieldByName(name);
    if (field != nullptr && !field->is_repeated() &&
        field->cpp_type() == google::protobuf::FieldDescriptor::CPPTYPE_STRING) {
      return reflection->GetString(request, field);
    }
  }
  const auto* object = descriptor->FindFieldByName("object");
  if (object == nullptr) object = descriptor->FindFieldByName("station");
  if (object == nullptr || object->is_repeated() ||
      object->cpp_type() != google::protobuf::FieldDescriptor::CPPTYPE_MESSAGE) {
    return "";
  }
  return NamedResource(reflection->GetMessage(request, object));
}

grpc::ServerUnaryReactor* StartUnaryCall(const CallGate& gate,
                                         const CallMethod& method,
                                         grpc::CallbackServerContext* context,
                                         int64_t request_bytes,
                                         absl::FunctionRef<absl::StatusOr<ParsedCall>()> parse) {
  UnaryReactor* reactor = nullptr;
  try {
    reactor = new UnaryReactor(method, gate, context);
  } catch (...) {
    grpc::ServerUnaryReactor* const ready = context->DefaultReactor();
    ready->Finish(grpc::Status(grpc::StatusCode::RESOURCE_EXHAUSTED, "out of memory"));
    return ready;
  }
  reactor->Start(gate, request_bytes, parse);
  return reactor;
}

}  // namespace horopter
