// Metrics, request log and traces of a server.
#pragma once

#include <functional>
#include <memory>
#include <string>

#include "absl/status/statusor.h"
#include "server/service/recorder.h"
#include "server/service/request_record.h"

namespace horopter {

struct TelemetryOptions {
  std::string metrics_listen;  // ADDRESS:PORT for Prometheus, port 0: any free one; empty: none
  std::string request_log;     // file with one JSON line a request, "-": stdout; empty: none
  std::string trace_file;      // file with spans in OTLP/JSON, one line a request; empty: none
  // File with one JSON line per call that needs an admin, refused ones too, on disk before the
  // caller gets the answer; empty: none.
  std::string audit_log;
  // Calls that need an admin are refused when the audit log cannot be written: each then has a line
  // when it begins, too.
  bool audit_required = false;
  RecorderOptions recorder;  // nothing is recorded by default
  std::string certificate;   // of the server, PEM, whose end the metrics tell; empty: no TLS
  std::string version;       // of the server
  std::string settings;      // its options as JSON, for recordings
};

// What is read when metrics are asked for.
struct CatalogFigures {
  int64_t objects = 0;
  int64_t unusable = 0;
  int64_t pending = 0;
  int64_t generation = 0;
  double behind_s = 0.0;  // CatalogStore::SecondsBehind
};

struct LoadFigures {
  int running = 0;  // scenes
  int waiting = 0;
  int64_t reserved_bytes = 0;  // by calls, and what they may have in all
  int64_t limit_bytes = 0;
};

// Files are appended to. One that cannot be written any more (a full disk) loses lines, which a
// metric counts and, of the audit log and of recordings, an error in the log tells; serving goes on
// unless the audit is required. Of what was refused for want of a known caller, or was cancelled
// before it began, the request log and the audit log have a hundred lines per peer in 10 s, and a
// line that counts the others.
class Telemetry final : public RequestSink {
 public:
  // Errors: UNAVAILABLE (the address cannot be bound), PERMISSION_DENIED (a file or folder cannot
  // be written), INVALID_ARGUMENT (options).
  static absl::StatusOr<std::unique_ptr<Telemetry>> Start(const TelemetryOptions& options,
                                                          std::function<CatalogFigures()> catalog);
  ~Telemetry() override;

  // Who says what load there is; empty: nobody, the figures are left out. Returns when the former
  // is no longer asked.
  void AskForLoad(std::function<LoadFigures()> load);

  void OnRequest(const RequestRecord& record) override;
  absl::Status BeforeAdminCall(const RequestRecord& record) override;
  bool KeepsMessages() const override;  // when it records

  // Opens the files anew, for who has moved them away. Errors: PERMISSION_DENIED naming those that
  // cannot be opened, which go on where they were.
  absl::Status Reopen();

  // 0 without a listener.
  int metrics_port() const;

 private:
  struct Parts;
  explicit Telemetry(std::unique_ptr<Parts> parts);
  std::unique_ptr<Parts> parts_;
};

// The lines of the request log and of the audit log.
std::string RequestLogLine(const RequestRecord& record);
std::string AuditLogLine(const RequestRecord& record);

}  // namespace horopter
