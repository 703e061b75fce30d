#include "server/service/unary_call.h"

#include <google/protobuf/descriptor.h>
#include <google/protobuf/message.h>
#include <spdlog/spdlog.h>

#include <atomic>
#include <chrono>
#include <memory>
#include <optional>
#include <random>
#include <utility>

#include "absl/strings/str_cat.h"
#include "absl/strings/str_format.h"
#include "server/pipeline/exception_status.h"
#include "server/service/trace_context.h"

namespace horopter {
namespace {

using Clock = std::chrono::steady_clock;

constexpr char kTraceParentKey[] = "traceparent";

// Unique in this process; the random part tells the logs of two runs apart.
std::string NextRequestId() {
  static const uint32_t run = std::random_device{}();
  static std::atomic<int64_t> next{1};
  return absl::StrFormat("%08x-%06d", run, next++);
}

// "ipv4:10.0.0.7:41234" -> "ipv4:10.0.0.7": all connections of a machine are one peer.
std::string HostOfPeer(const std::string& peer) {
  return peer.substr(0, peer.rfind(':'));
}

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
        sink_(gate.sink),
        context_(context),
        state_(std::make_shared<CallState>()),
        start_(Clock::now()) {
    state_->deadline = SteadyDeadline(context->deadline(), start_);
    info_.request_id = NextRequestId();
    state_->hurry = state_->deadline;
    if (state_->deadline != Clock::time_point::max()) {
      const std::chrono::duration<double> allowed = state_->deadline - start_;
      state_->hurry =
          start_ + std::chrono::duration_cast<Clock::duration>(kUnhurriedShare * allowed);
    }
    info_.limits.stop = [state = state_] {
      return state->cancelled.load() || state->DeadlinePassed();
    };
    info_.limits.hurry = [state = state_] { return state->InHurry(); };
    context->AddInitialMetadata(kRequestIdKey, info_.request_id);
    info_.record = &record_;
    record_.request_id = info_.request_id;
    record_.method = method.name;
    record_.admin_call = method.needs == Role::kAdmin;
    record_.arrival = std::chrono::system_clock::now();
    const auto& metadata = context->client_metadata();
    const auto parent = metadata.find(kTraceParentKey);
    record_.trace = TraceContextFrom(
        parent == metadata.end() ? std::string_view()
                                 : std::string_view(parent->second.data(), parent->second.size()));
  }

  // Queues the call or finishes it.
  void Start(const CallGate& gate,
             int64_t request_bytes,
             absl::FunctionRef<absl::StatusOr<ParsedCall>()> parse) {
    const absl::Status admitted =
        CatchExceptions([&] { return Admit(gate, request_bytes, parse); });
    if (!admitted.ok()) FinishWith(admitted);
  }

  // The reactor must not be touched afterwards. What cannot be logged or told in words for want of
  // memory is told by its code.
  void FinishWith(const absl::Status& status) noexcept {
    try {
      Log(status);
      Tell(status);
    } catch (...) {
    }
    Finish(ToRpcStatus(status, context_));
  }

 private:
  absl::Status Admit(const CallGate& gate,
                     int64_t request_bytes,
                     absl::FunctionRef<absl::StatusOr<ParsedCall>()> parse) {
    record_.request_bytes = request_bytes;
    if (gate.access == nullptr) return absl::PermissionDeniedError("nobody may call");
    HOROPTER_ASSIGN_OR_RETURN(const Caller caller,
                              gate.access->Authorize(*context_, method_.needs));
    record_.caller = caller.name;
    if (request_bytes > method_.max_request_bytes) {
      return absl::ResourceExhaustedError(absl::StrCat("the request has ",
                                                       request_bytes,
                                                       " bytes, at most ",
                                                       method_.max_request_bytes,
                                                       " are allowed"));
    }
    // As delivered, and parsed.
    HOROPTER_ASSIGN_OR_RETURN(MemoryBudget::Lease reserved, Reserve(gate, 2 * request_bytes));
    HOROPTER_ASSIGN_OR_RETURN(ParsedCall call, parse());
    record_.resource = std::move(call.resource);
    reserved.GiveBack(request_bytes);
    if (!reserved.Grow(call.demand.bytes)) {
      return OutOfMemory(gate, request_bytes + call.demand.bytes);
    }
    const auto lease = std::make_shared<MemoryBudget::Lease>(std::move(reserved));
    JobTraits traits;
    traits.batch = call.demand.batch;
    traits.peer = caller.name.empty() ? HostOfPeer(context_->peer()) : caller.name;
    traits.deadline = state_->deadline;
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
    record_.queue_seconds = SecondsSinceStart();
    taken_ = true;
    FinishWith(CatchExceptions([&]() -> absl::Status {
      if (info_.limits.stop()) return StopReason();
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

  void Log(const absl::Status& status) const {
    const std::chrono::duration<double, std::milli> elapsed = Clock::now() - start_;
    const auto level = status.ok() ? spdlog::level::info : spdlog::level::warn;
    spdlog::log(level,
                "request={} method={} peer={} caller={} code={} ms={:.1f}{}",
                info_.request_id,
                method_.name,
                context_->peer(),
                record_.caller.empty() ? "-" : record_.caller,
                absl::StatusCodeToString(status.code()),
                elapsed.count(),
                status.ok() ? "" : absl::StrCat(" error=", Quoted(std::string(status.message()))));
  }

  double SecondsSinceStart() const {
    return std::chrono::duration<double>(Clock::now() - start_).count();
  }

  void Tell(const absl::Status& status) {
    if (sink_ == nullptr) return;
    record_.peer = context_->peer();
    record_.status = status;
    record_.busy = !RetryAfter(status).empty();
    record_.total_seconds = SecondsSinceStart();
    if (!taken_) record_.queue_seconds = record_.total_seconds;
    sink_->OnRequest(record_);
  }

  absl::Status StopReason() const {
    if (state_->DeadlinePassed()) return absl::DeadlineExceededError("the deadline passed");
    return absl::CancelledError("the client cancelled");
  }

  const CallMethod method_;
  WorkerPool& pool_;
  RequestSink* const sink_;
  RequestRecord record_;
  bool taken_ = false;  // a thread of the pool has it
  grpc::CallbackServerContext* context_;
  std::shared_ptr<CallState> state_;
  CallInfo info_;
  Clock::time_point start_;
  uint64_t ticket_ = 0;  // written before gRPC gets the reactor
};

}  // namespace

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
  const auto* const object = descriptor->FindFieldByName("object");
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
