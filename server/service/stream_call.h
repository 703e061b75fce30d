// Runs a rpc that answers with a stream: a thread of the pool makes the messages, gRPC's threads
// send them, and nobody waits for the client.
#pragma once

#include <grpcpp/support/server_callback.h>

#include <atomic>
#include <functional>
#include <mutex>
#include <utility>

#include "server/base/stop_token.h"
#include "server/pipeline/exception_status.h"
#include "server/service/call_record.h"

namespace horopter {

// Queues the job of a call whose caller may make it. Errors: those of Access, RESOURCE_EXHAUSTED
// (queue full), UNAVAILABLE (the server is stopping); the job then never runs.
absl::Status SubmitStream(const CallGate& gate, CallRecord& call, std::function<void()> job);

// Post may be called from any thread; messages that wait for the one under way are merged into one
// (repeated fields append, others take the last value). Deletes itself when gRPC is done with it:
// nothing of it may be touched after Complete.
template <typename Response>
class StreamReactor : public grpc::ServerWriteReactor<Response> {
 public:
  StreamReactor(const CallMethod& method,
                const CallGate& gate,
                grpc::CallbackServerContext* context)
      : gate_(gate), call_(method, gate, context) {}

  // Begin() on a thread of the pool, or the call ends with the error.
  void Start() {
    const absl::Status admitted = CatchExceptions([this] {
      return SubmitStream(gate_, call_, [this] {
        call_.Begin();
        EndUnlessOk(
            [this] { return cancelled_ ? absl::CancelledError("the client cancelled") : Begin(); });
      });
    });
    if (!admitted.ok()) this->Finish(call_.End(admitted));
  }

 protected:
  // Errors end the call.
  virtual absl::Status Begin() = 0;
  // All that was posted has gone, and Complete was not called. Errors end the call.
  virtual absl::Status OnSent() { return absl::OkStatus(); }

  void Post(const Response& message) {
    {
      const std::lock_guard lock(mutex_);
      waiting_.MergeFrom(message);
      has_waiting_ = true;
    }
    Drive();
  }
  // Ends the call once all has gone.
  void Complete(const absl::Status& status) {
    {
      const std::lock_guard lock(mutex_);
      ending_ = status;
      complete_ = true;
    }
    Drive();
  }
  StopRequested stop() const {
    return [this] { return cancelled_.load(); };
  }
  RequestRecord& record() { return call_.record(); }

 private:
  // No exception may reach gRPC's threads.
  template <typename Step>
  void EndUnlessOk(const Step& step) noexcept {
    const absl::Status status = CatchExceptions(step);
    if (!status.ok()) Complete(status);
  }

  // The reactor may be gone when this returns: another thread can end the call.
  void Drive() {
    enum class Next { kNothing, kWrite, kFinish } next = Next::kNothing;
    {
      const std::lock_guard lock(mutex_);
      if (under_way_ || finished_) return;
      if (cancelled_ && !complete_ && !PostsByItself()) {
        ending_ = absl::CancelledError("the client went away");
        complete_ = true;
      }
      if (has_waiting_ && !cancelled_) {
        next = Next::kWrite;
        under_way_ = true;
        has_waiting_ = false;
        message_.Swap(&waiting_);
        waiting_.Clear();
      } else if (complete_) {
        next = Next::kFinish;
        finished_ = true;
      }
    }
    if (next == Next::kWrite) this->StartWrite(&message_);
    if (next == Next::kFinish) this->Finish(call_.End(ending_));
  }

  void OnWriteDone(bool ok) override {
    bool idle = false;
    {
      const std::lock_guard lock(mutex_);
      if (!ok) cancelled_ = true;
      under_way_ = false;
      idle = !has_waiting_ && !complete_;
    }
    if (ok && idle) {
      EndUnlessOk([this] { return OnSent(); });
    } else {
      Drive();
    }
  }
  void OnCancel() override { cancelled_ = true; }
  void OnDone() override { delete this; }

  // True: Begin posts until it completes the call; false: OnSent does.
  virtual bool PostsByItself() const = 0;

  const CallGate gate_;
  CallRecord call_;
  std::atomic<bool> cancelled_{false};
  std::mutex mutex_;
  bool under_way_ = false;  // guarded by mutex_, as all below
  bool has_waiting_ = false, complete_ = false, finished_ = false;
  absl::Status ending_;
  Response waiting_, message_;
};

}  // namespace horopter
