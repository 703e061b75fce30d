#include "server/service/stream_call.h"

#include "server/base/status_macros.h"
#include "server/service/rpc_status.h"

namespace horopter {

absl::Status SubmitStream(const CallGate& gate, CallRecord& call, std::function<void()> job) {
  HOROPTER_RETURN_IF_ERROR(call.Authorize());
  JobTraits traits;
  traits.peer = call.TurnOf();
  switch (gate.pool->TrySubmit(std::move(job), traits).admission) {
    case WorkerPool::Admission::kAccepted:
      return absl::OkStatus();
    case WorkerPool::Admission::kQueueFull:
    case WorkerPool::Admission::kTooLate:
      return QueueFull(gate.pool->RetryAfterMs());
    case WorkerPool::Admission::kClosed:
      break;
  }
  return absl::UnavailableError("the server is stopping");
}

}  // namespace horopter
