// Runs a unary rpc of the callback API on a worker pool, with deadline, cancellation and a request
// id.
#pragma once

#include <grpcpp/server_context.h>
#include <grpcpp/support/server_callback.h>

#include <functional>
#include <string>

#include "absl/status/status.h"
#include "server/base/call_limits.h"
#include "server/service/worker_pool.h"

namespace horopter {

// Share of the time from a call's arrival to its deadline after which it is in a hurry: a third
// round of search, the rivals and the adjustment take about as long as what came before them.
inline constexpr double kUnhurriedShare = 0.6;

struct CallInfo {
  std::string request_id;
  // stop: true once the client cancelled or its deadline passed; hurry: once kUnhurriedShare of the
  // time is gone, never without a deadline. Usable after the call as well.
  CallLimits limits;
};

// The handler fills the response and returns its status. It runs on a pool thread, or not at all: a
// full queue answers RESOURCE_EXHAUSTED, a closed pool UNAVAILABLE, a call that is over before its
// turn CANCELLED or DEADLINE_EXCEEDED. A CANCELLED of the handler becomes DEADLINE_EXCEEDED when
// the deadline was the reason; an exception becomes RESOURCE_EXHAUSTED or INTERNAL
// (StatusOfException). Writes one log line.
using CallHandler = std::function<absl::Status(const CallInfo&)>;

grpc::ServerUnaryReactor* RunUnaryCall(const char* method,
                                       grpc::CallbackServerContext* context,
                                       WorkerPool& pool,
                                       CallHandler handler);

}  // namespace horopter
