#include "server/service/telemetry.h"

#include <prometheus/counter.h>
#include <prometheus/exposer.h>
#include <prometheus/gauge.h>
#include <prometheus/histogram.h>
#include <prometheus/registry.h>
#include <spdlog/spdlog.h>
#include <unistd.h>

#include <cerrno>
#include <cstdio>
#include <cstring>
#include <ctime>
#include <mutex>
#include <nlohmann/json.hpp>

#include "absl/strings/str_cat.h"
#include "server/base/status_macros.h"
#include "server/service/live_figures.h"
#include "server/service/log_limiter.h"
#include "server/service/trace_context.h"

namespace horopter {
namespace {

// 1 ms to 2 min; recognition takes 0.5 to 40 s.
const prometheus::Histogram::BucketBoundaries kSeconds = {
    0.001, 0.0025, 0.005, 0.01, 0.025, 0.05, 0.1, 0.25, 0.5, 1, 2.5, 5, 10, 20, 40, 60, 120};

// Lines appended to a file; safe to call from all threads.
class LineFile {
 public:
  absl::Status Open(const std::string& path) {
    std::FILE* const file = path == "-" ? stdout : std::fopen(path.c_str(), "ae");
    if (file == nullptr) {
      return absl::PermissionDeniedError(
          absl::StrCat(path, ": cannot be written: ", std::strerror(errno)));
    }
    const std::lock_guard lock(mutex_);
    Close();
    file_ = file;
    path_ = path;
    return absl::OkStatus();
  }
  // The same path again; when that fails, the file as it was.
  absl::Status Reopen() { return open() && path_ != "-" ? Open(path_) : absl::OkStatus(); }
  ~LineFile() { Close(); }
  bool open() const { return file_ != nullptr; }
  const std::string& path() const { return path_; }

  // False: the line is lost.
  bool Write(const std::string& line, bool to_disk = false) {
    const std::lock_guard lock(mutex_);
    std::clearerr(file_);
    if (std::fprintf(file_, "%s\n", line.c_str()) <= 0 || std::fflush(file_) != 0) return false;
    // What cannot be synced, a pipe or a terminal, is written all the same.
    return !to_disk || ::fdatasync(::fileno(file_)) == 0 || errno == EINVAL || errno == EROFS;
  }

 private:
  void Close() {
    if (file_ != nullptr && file_ != stdout) std::fclose(file_);
  }

  std::mutex mutex_;
  std::FILE* file_ = nullptr;  // never null again once it was opened
  std::string path_;           // of it
};

const char* RefusalOf(const RequestRecord& record) {
  switch (record.status.code()) {
    case absl::StatusCode::kOk:
      return nullptr;
    case absl::StatusCode::kResourceExhausted:
      return record.busy ? "busy" : "memory_or_disk";
    case absl::StatusCode::kInvalidArgument:
      return "invalid";
    case absl::StatusCode::kNotFound:
      return "not_found";
    case absl::StatusCode::kDeadlineExceeded:
      return "deadline";
    case absl::StatusCode::kCancelled:
      return "cancelled";
    case absl::StatusCode::kUnavailable:
      return "stopping";
    case absl::StatusCode::kUnauthenticated:
    case absl::StatusCode::kPermissionDenied:
      return "not_allowed";
    default:
      return "other";
  }
}

// Of a call that begins nothing is known but who asks for what.
std::string AuditLine(const RequestRecord& r, bool begins) {
  const auto seconds = std::chrono::duration<double>(r.arrival.time_since_epoch()).count();
  nlohmann::json line = {{"time", seconds},
                         {"request_id", r.request_id},
                         {"caller", r.caller},
                         {"peer", r.peer},
                         {"method", r.method},
                         {"request_bytes", r.request_bytes}};
  if (begins) {
    line["begins"] = true;
  } else {
    line["resource"] = r.resource;
    line["code"] = absl::StatusCodeToString(r.status.code());
    if (!r.status.ok()) line["error"] = std::string(r.status.message());
  }
  return line.dump(-1, ' ', false, nlohmann::json::error_handler_t::replace);
}

// In 10 s, of each peer and kind.
constexpr int kLinesOfStrangers = 100;
constexpr int kLostLinesTold = 5;

}  // namespace

struct Telemetry::Parts {
  using Histogram = prometheus::Histogram;
  using Counter = prometheus::Counter;
  template <typename T>
  using Family = prometheus::Family<T>;

  std::shared_ptr<prometheus::Registry> registry = std::make_shared<prometheus::Registry>();
  Family<Histogram>& seconds = prometheus::BuildHistogram()
                                   .Name("horopter_request_seconds")
                                   .Help("Time from arrival to answer, by method")
                                   .Register(*registry);
  Family<Histogram>& queue = prometheus::BuildHistogram()
                                 .Name("horopter_queue_seconds")
                                 .Help("Time in the queue, by method")
                                 .Register(*registry);
  Family<Histogram>& stages = prometheus::BuildHistogram()
                                  .Name("horopter_stage_seconds")
                                  .Help("Time of a stage of recognition")
                                  .Register(*registry);
  Family<Counter>& requests = prometheus::BuildCounter()
                                  .Name("horopter_requests_total")
                                  .Help("Calls, by method and canonical code")
                                  .Register(*registry);
  Family<Counter>& refusals = prometheus::BuildCounter()
                                  .Name("horopter_refusals_total")
                                  .Help("Calls that failed, by method and reason")
                                  .Register(*registry);
  Family<Counter>& answers = prometheus::BuildCounter()
                                 .Name("horopter_answers_total")
                                 .Help("Answers of recognition, by state")
                                 .Register(*registry);
  Family<Counter>& reasons = prometheus::BuildCounter()
                                 .Name("horopter_answer_reasons_total")
                                 .Help("Reasons why answers are less than they could be")
                                 .Register(*registry);
  Family<prometheus::Gauge>& station_findings =
      prometheus::BuildGauge()
          .Name("horopter_station_finding")
          .Help("1: the last request to the station found it, by kind; 0: it did not")
          .Register(*registry);
  Counter& time_limited = prometheus::BuildCounter()
                              .Name("horopter_answers_time_limited_total")
                              .Help("Answers that were cut short by their deadline")
                              .Register(*registry)
                              .Add({});
  Counter& objects = prometheus::BuildCounter()
                         .Name("horopter_objects_found_total")
                         .Help("Objects in answers")
                         .Register(*registry)
                         .Add({});
  Counter& images = prometheus::BuildCounter()
                        .Name("horopter_images_total")
                        .Help("Images in requests that were read")
                        .Register(*registry)
                        .Add({});
  Counter& lost =
      prometheus::BuildCounter()
          .Name("horopter_telemetry_lost_total")
          .Help("Lines of request log, audit log or trace file that could not be written")
          .Register(*registry)
          .Add({});
  Counter& left_out = prometheus::BuildCounter()
                          .Name("horopter_log_lines_left_out_total")
                          .Help("Calls of strangers and broken-off ones that logs only count")
                          .Register(*registry)
                          .Add({});
  Counter& recorded = prometheus::BuildCounter()
                          .Name("horopter_recordings_total")
                          .Help("Requests that were recorded")
                          .Register(*registry)
                          .Add({});
  Counter& recordings_failed = prometheus::BuildCounter()
                                   .Name("horopter_recordings_failed_total")
                                   .Help("Requests that could not be recorded, e.g. disk full")
                                   .Register(*registry)
                                   .Add({});
  std::shared_ptr<LiveFigures> live;
  LineFile request_log, trace_file, audit_log;
  bool audit_required = false;
  LogLimiter strangers{kLinesOfStrangers};
  LogLimiter lost_audits{kLostLinesTold};
  LogLimiter lost_recordings{kLostLinesTold};
  std::string recordings_folder;
  std::unique_ptr<Recorder> recorder;
  std::unique_ptr<prometheus::Exposer> exposer;

  // False: the line is lost, which the log tells.
  bool Audit(const std::string& line) {
    if (audit_log.Write(line, /*to_disk=*/true)) return true;
    const std::string why = std::strerror(errno);
    lost.Increment();
    const LogLimiter::Verdict verdict = lost_audits.Ask("audit");
    for (const auto& [what, lines] : verdict.left_out) {
      spdlog::error("{} more lines of the audit log are lost", lines);
    }
    if (verdict.write) {
      spdlog::error("a line of the audit log is lost, {}: {}: {}", audit_log.path(), why, line);
    }
    return false;
  }

  void TellLostRecording(const std::string& request_id) {
    recordings_failed.Increment();
    const LogLimiter::Verdict verdict = lost_recordings.Ask("recording");
    for (const auto& [what, lines] : verdict.left_out) {
      spdlog::error("{} more requests could not be recorded", lines);
    }
    if (verdict.write) {
      spdlog::error("request={} could not be recorded in {}: is the disk full?",
                    request_id,
                    recordings_folder);
    }
  }

  // Whether the logs have a line of it. Anybody can bring about thousands of calls that are refused
  // or broken off before they begin.
  bool IsTold(const RequestRecord& r) {
    const bool unknown = absl::IsUnauthenticated(r.status);
    const bool broken_off = absl::IsCancelled(r.status) && r.queue_seconds >= r.total_seconds;
    if (!unknown && !broken_off) return true;
    const std::string host = r.peer.substr(0, r.peer.rfind(':'));
    const LogLimiter::Verdict verdict =
        strangers.Ask(absl::StrCat(absl::StatusCodeToString(r.status.code()), " ", host));
    for (const auto& [what, lines] : verdict.left_out) {
      left_out.Increment(static_cast<double>(lines));
      const std::string line = nlohmann::json{{"left_out", lines}, {"calls", what}}.dump();
      if (request_log.open()) request_log.Write(line);
      if (audit_log.open()) audit_log.Write(line);
    }
    return verdict.write;
  }

  void Count(const RequestRecord& r) {
    const prometheus::Labels method = {{"method", r.method}};
    seconds.Add(method, kSeconds).Observe(r.total_seconds);
    queue.Add(method, kSeconds).Observe(r.queue_seconds);
    requests.Add({{"method", r.method}, {"code", absl::StatusCodeToString(r.status.code())}})
        .Increment();
    if (const char* reason = RefusalOf(r)) {
      refusals.Add({{"method", r.method}, {"reason", reason}}).Increment();
    }
    if (!r.state.empty()) answers.Add({{"state", r.state}}).Increment();
    for (const std::string& reason : r.reasons) reasons.Add({{"reason", reason}}).Increment();
    for (const auto& [kind, found] : r.station_findings) {
      station_findings.Add({{"station", r.station}, {"kind", kind}}).Set(found ? 1.0 : 0.0);
    }
    if (r.time_limited) time_limited.Increment();
    objects.Increment(r.objects);
    images.Increment(r.images);
    for (const auto& [stage, time] : r.stages) {
      stages.Add({{"stage", stage}}, kSeconds).Observe(time);
    }
  }
};

Telemetry::Telemetry(std::unique_ptr<Parts> parts) : parts_(std::move(parts)) {}
Telemetry::~Telemetry() = default;

absl::StatusOr<std::unique_ptr<Telemetry>> Telemetry::Start(
    const TelemetryOptions& options, std::function<CatalogFigures()> catalog) {
  auto parts = std::make_unique<Parts>();
  if (!options.request_log.empty()) {
    HOROPTER_RETURN_IF_ERROR(parts->request_log.Open(options.request_log));
  }
  if (!options.trace_file.empty()) {
    HOROPTER_RETURN_IF_ERROR(parts->trace_file.Open(options.trace_file));
  }
  if (!options.audit_log.empty()) {
    HOROPTER_RETURN_IF_ERROR(parts->audit_log.Open(options.audit_log));
    parts->audit_required = options.audit_required;
  }
  if (!options.recorder.folder.empty()) {
    HOROPTER_ASSIGN_OR_RETURN(parts->recorder,
                              Recorder::Open(options.recorder, options.version, options.settings));
    parts->recordings_folder = options.recorder.folder;
  }
  prometheus::BuildGauge()
      .Name("horopter_build_info")
      .Help("Always 1; the label says the version")
      .Register(*parts->registry)
      .Add({{"version", options.version}})
      .Set(1.0);
  // So that rates of what has not happened yet are 0, not absent.
  for (const char* reason : {"busy", "invalid", "deadline", "cancelled"}) {
    parts->refusals.Add({{"method", "RecognizeScene"}, {"reason", reason}});
  }
  if (!options.metrics_listen.empty()) {
    parts->live = std::make_shared<LiveFigures>(std::move(catalog), options.certificate);
    try {
      parts->exposer = std::make_unique<prometheus::Exposer>(options.metrics_listen, 1);
    } catch (const std::exception& e) {
      return absl::UnavailableError(
          absl::StrCat("cannot listen on ", options.metrics_listen, " for metrics: ", e.what()));
    }
    parts->exposer->RegisterCollectable(parts->registry);
    parts->exposer->RegisterCollectable(parts->live);
  }
  return std::unique_ptr<Telemetry>(new Telemetry(std::move(parts)));
}

absl::Status Telemetry::BeforeAdminCall(const RequestRecord& record) {
  if (!parts_->audit_required) return absl::OkStatus();
  if (parts_->Audit(AuditLine(record, /*begins=*/true))) return absl::OkStatus();
  return absl::FailedPreconditionError(
      "the audit log cannot be written, so nothing is changed (audit-required)");
}

absl::Status Telemetry::Reopen() {
  std::string failed;
  for (LineFile* file : {&parts_->request_log, &parts_->trace_file, &parts_->audit_log}) {
    const absl::Status opened = file->Reopen();
    if (!opened.ok())
      absl::StrAppend(&failed, failed.empty() ? "" : "; ", std::string(opened.message()));
  }
  if (failed.empty()) return absl::OkStatus();
  return absl::PermissionDeniedError(failed + "; lines go on to where they went");
}

void Telemetry::AskForLoad(std::function<LoadFigures()> load) {
  if (parts_->live != nullptr) parts_->live->AskForLoad(std::move(load));
}

void Telemetry::OnRequest(const RequestRecord& record) {
  parts_->Count(record);
  const bool told = parts_->IsTold(record);
  if (parts_->audit_log.open() && record.admin_call && told) {
    parts_->Audit(AuditLogLine(record));
  }
  if (parts_->request_log.open() && told && !parts_->request_log.Write(RequestLogLine(record))) {
    parts_->lost.Increment();
  }
  if (parts_->trace_file.open() && record.trace.sampled &&
      !parts_->trace_file.Write(OtlpJson(record))) {
    parts_->lost.Increment();
  }
  if (parts_->recorder == nullptr) return;
  switch (parts_->recorder->Record(record)) {
    case Recorder::Outcome::kWritten:
      parts_->recorded.Increment();
      break;
    case Recorder::Outcome::kFailed:
      parts_->TellLostRecording(record.request_id);
      break;
    case Recorder::Outcome::kNotWanted:
      break;
  }
}

bool Telemetry::KeepsMessages() const {
  return parts_->recorder != nullptr;
}

int Telemetry::metrics_port() const {
  if (parts_->exposer == nullptr) return 0;
  const std::vector<int> ports = parts_->exposer->GetListeningPorts();
  return ports.empty() ? 0 : ports[0];
}

std::string RequestLogLine(const RequestRecord& r) {
  const auto seconds = std::chrono::duration<double>(r.arrival.time_since_epoch()).count();
  nlohmann::json line = {{"time", seconds},
                         {"request_id", r.request_id},
                         {"method", r.method},
                         {"peer", r.peer},
                         {"caller", r.caller},
                         {"trace_id", r.trace.trace_id},
                         {"span_id", r.trace.span_id},
                         {"code", absl::StatusCodeToString(r.status.code())},
                         {"ms", r.total_seconds * 1e3},
                         {"queue_ms", r.queue_seconds * 1e3}};
  if (!r.status.ok()) line["error"] = std::string(r.status.message());
  if (r.images > 0) line["images"] = r.images;
  if (!r.state.empty()) {
    line["state"] = r.state;
    line["reasons"] = r.reasons;
    line["time_limited"] = r.time_limited;
    line["objects"] = r.objects;
    line["catalog_generation"] = r.catalog_generation;
    for (const auto& [stage, time] : r.stages) line["stages_ms"][stage] = time * 1e3;
  }
  return line.dump(-1, ' ', false, nlohmann::json::error_handler_t::replace);
}

std::string AuditLogLine(const RequestRecord& record) {
  return AuditLine(record, /*begins=*/false);
}

}  // namespace horopter
