// What is kept, checked and told of one call, whatever its kind.
#pragma once

#include <grpcpp/server_context.h>
#include <grpcpp/support/status.h>

#include <chrono>
#include <string>

#include "absl/status/status.h"
#include "server/service/access.h"
#include "server/service/memory_budget.h"
#include "server/service/request_record.h"
#include "server/service/worker_pool.h"

namespace horopter {

// Where calls are admitted; what it names must outlive them.
struct CallGate {
  WorkerPool* pool = nullptr;
  MemoryBudget* memory = nullptr;
  Access* access = nullptr;     // who may call; null: nobody
  RequestSink* sink = nullptr;  // told of each call when its status is known; null: nobody is
};

struct CallMethod {
  const char* name = "";
  int64_t max_request_bytes = 1 << 20;
  Role needs = Role::kAdmin;  // what only reads says so
};

// From the arrival of a call to its status. Not thread-safe.
class CallRecord {
 public:
  // Gives the call its id, which its initial metadata tell.
  CallRecord(const CallMethod& method, const CallGate& gate, grpc::CallbackServerContext* context);

  // Whether the caller may call the method. Errors: those of Access.
  absl::Status Authorize();
  // Whose turn it is in a queue: the caller's by name, else his machine's.
  std::string TurnOf() const;
  // A thread has it.
  void Begin();
  // One line of the log, and the sink is told. The status for gRPC; what cannot be logged or told
  // in words for want of memory is told by its code.
  grpc::Status End(const absl::Status& status) noexcept;

  RequestRecord& record() { return record_; }
  Role role() const { return role_; }  // of the caller, once authorized
  std::chrono::steady_clock::time_point start() const { return start_; }

 private:
  double SecondsSinceStart() const;
  void Log(const absl::Status& status) const;
  void Tell(const absl::Status& status);

  const CallMethod method_;
  const CallGate gate_;
  grpc::CallbackServerContext* const context_;
  const std::chrono::steady_clock::time_point start_;
  RequestRecord record_;
  Role role_ = Role::kNone;
  bool begun_ = false;
};

}  // namespace horopter
