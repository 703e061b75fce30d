// What the service knows of a call when it is over, for metrics, logs, traces and recordings.
#pragma once

#include <chrono>
#include <cstdint>
#include <optional>
#include <string>
#include <utility>
#include <vector>

#include "absl/status/status.h"

namespace google::protobuf {
class Message;
}

namespace horopter {

// W3C trace context of a call: ids in lower-case hex.
struct TraceContext {
  std::string trace_id;        // 32 digits
  std::string parent_span_id;  // 16 digits; empty: the trace begins here
  std::string span_id;         // 16 digits, of this call
  bool sampled = true;
};

struct RequestRecord {
  std::string request_id;
  std::string method;
  std::string peer;
  std::string caller;       // name in the access file; empty: nobody had to say who he is
  bool admin_call = false;  // of a method that needs an admin: told to the audit log
  std::string resource;     // name of the object that the request names; empty: none
  int64_t request_bytes = 0;
  TraceContext trace;
  std::chrono::system_clock::time_point arrival;
  double queue_seconds = 0.0;  // from arrival until a thread took it; all of it when none did
  double total_seconds = 0.0;  // from arrival until the status was known
  absl::Status status;
  bool busy = false;  // RESOURCE_EXHAUSTED with a time to try again: queue, memory or deadline

  // Of RecognizeScene.
  int images = 0;
  int objects = 0;
  // RECOGNIZED, or the first of the reasons why nothing is; empty without an answer.
  std::string state;
  std::vector<std::string> reasons;  // all of them, e.g. AMBIGUOUS
  bool time_limited = false;
  // Of a request that named a station: its id, and of each kind of finding whether it was there.
  std::string station;
  std::vector<std::pair<std::string, bool>> station_findings;
  int64_t catalog_generation = 0;
  // Of a catalog that is shared: how long ago it was known to be all there is; trails the answer.
  std::optional<int64_t> catalog_age_ms;
  std::vector<std::pair<std::string, double>> stages;  // seconds, in order of execution

  // Of RecognizeScene that was read, for a sink that KeepsMessages, only while the sink is called.
  const google::protobuf::Message* request = nullptr;
  const google::protobuf::Message* response = nullptr;
  // Serialized fields that the request did not have and that a replay needs: what was known of its
  // station.
  std::string request_supplement;
};

// Thread-safe; called once per call, before the client gets the answer. Must not throw and should
// not wait.
class RequestSink {
 public:
  virtual ~RequestSink() = default;
  virtual void OnRequest(const RequestRecord& record) = 0;
  // Before a call that needs an admin does anything; an error refuses it.
  virtual absl::Status BeforeAdminCall(const RequestRecord&) { return absl::OkStatus(); }
  // False: requests are freed as soon as they are no longer needed.
  virtual bool KeepsMessages() const { return false; }
};

}  // namespace horopter
