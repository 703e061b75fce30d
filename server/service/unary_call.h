// Runs a unary rpc of the callback API on a worker pool: admission by bytes before the request is
// parsed, deadline, cancellation, a request id, and no exception that leaves.
#pragma once

#include <grpcpp/server_context.h>
#include <grpcpp/support/byte_buffer.h>
#include <grpcpp/support/server_callback.h>

#include <functional>
#include <memory>
#include <string>
#include <utility>

#include "absl/functional/function_ref.h"
#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "server/base/call_limits.h"
#include "server/base/status_macros.h"
#include "server/service/call_record.h"
#include "server/service/rpc_status.h"

namespace horopter {

// When a call is in a hurry, seconds after its arrival: once a quarter of the time to its deadline,
// at least .8 s, is left, but not before .3 of it are gone. Views that were searched are linked
// then, and what is found is judged, adjusted and said: of eight scenes that took up to .6 s with 3
// s allowed and 1.0 s with 6 (ADR 60).
double HurryAfterS(double allowed_s);

struct CallInfo {
  std::string request_id;
  std::string variants;        // what the client's metadata say under kVariantsKey
  std::string min_generation;  // and under kMinGenerationKey
  // stop: true once the client cancelled or its deadline passed; hurry: after
  // HurryAfterS, never without a deadline. Usable after the call as well.
  CallLimits limits;
  bool may_teach = true;  // the caller's requests may change what stations know
  // The handler says here what it knows beyond the status; never null.
  RequestRecord* record = nullptr;
};

// What a call takes beside its request, and how it waits.
struct CallDemand {
  int64_t bytes = 0;
  bool batch = false;
};

// The handler fills the response and returns its status. It runs on a pool thread, or not at all: a
// caller who may not (Access), a request above the method's limit, a full queue or budget and a
// deadline that cannot be met answer RESOURCE_EXHAUSTED (all but the second with a time to try
// again), a closed pool UNAVAILABLE. A call that is over before its turn gives place and bytes back
// at once and answers CANCELLED or DEADLINE_EXCEEDED. A CANCELLED of the handler becomes
// DEADLINE_EXCEEDED when the deadline was the reason; an exception becomes RESOURCE_EXHAUSTED or
// INTERNAL (StatusOfException). Writes one log line.
template <typename Request, typename Response>
struct UnaryMethod {
  CallMethod method;
  std::function<absl::Status(const Request&, const CallInfo&, Response*)> handle;
  // Asked before the call is queued; its error is that of the call. Empty: the call takes nothing
  // beside its request.
  std::function<absl::StatusOr<CallDemand>(const Request&)> demand = {};
};

// A call whose request is parsed.
struct ParsedCall {
  std::function<absl::Status(const CallInfo&)> work;
  CallDemand demand;
  std::string resource;  // the object that the request names
};

// The object or station that a request names in `name`, `object_id`, `object.name` or
// `station.name`; empty: none.
std::string NamedResource(const google::protobuf::Message& request);

// The part that does not depend on the messages. `parse` is called at most once, before this
// returns; not for less than 0 bytes, a request that did not arrive.
grpc::ServerUnaryReactor* StartUnaryCall(const CallGate& gate,
                                         const CallMethod& method,
                                         grpc::CallbackServerContext* context,
                                         int64_t request_bytes,
                                         absl::FunctionRef<absl::StatusOr<ParsedCall>()> parse);

template <typename Request, typename Response>
grpc::ServerUnaryReactor* RunUnaryCall(const CallGate& gate,
                                       grpc::CallbackServerContext* context,
                                       const grpc::ByteBuffer* request,
                                       grpc::ByteBuffer* response,
                                       UnaryMethod<Request, Response> method) {
  struct Messages {
    Request request;
    Response response;
  };
  const auto parse = [&]() -> absl::StatusOr<ParsedCall> {
    const auto messages = std::make_shared<Messages>();
    // gRPC gives the bytes to this call alone; they go as soon as they are parsed.
    auto* const bytes = const_cast<grpc::ByteBuffer*>(request);
    if (bytes->Length() > 0 &&
        !grpc::SerializationTraits<Request>::Deserialize(bytes, &messages->request).ok()) {
      return absl::InvalidArgumentError("the request is not a message of this method");
    }
    bytes->Clear();
    ParsedCall call;
    call.resource = NamedResource(messages->request);
    if (method.demand) {
      HOROPTER_ASSIGN_OR_RETURN(call.demand, method.demand(messages->request));
    }
    call.work = [messages, response, handle = std::move(method.handle)](
                    const CallInfo& info) -> absl::Status {
      HOROPTER_RETURN_IF_ERROR(handle(messages->request, info, &messages->response));
      if (info.record->request == nullptr) messages->request.Clear();
      bool own = false;
      const grpc::Status sent =
          grpc::SerializationTraits<Response>::Serialize(messages->response, response, &own);
      return sent.ok() ? absl::OkStatus() : absl::InternalError(sent.error_message());
    };
    return call;
  };
  // Of a call that broke off on its way gRPC delivers no buffer; an empty message has one.
  const int64_t bytes = request->Valid() ? static_cast<int64_t>(request->Length()) : -1;
  return StartUnaryCall(gate, method.method, context, bytes, parse);
}

}  // namespace horopter
