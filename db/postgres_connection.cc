#include "db/postgres_connection.h"

#include <poll.h>

#include <algorithm>
#include <cerrno>
#include <set>
#include <utility>

#include "absl/strings/str_cat.h"
#include "absl/strings/strip.h"
#include "server/base/status_macros.h"

namespace horopter {
namespace {

// What waits in the pipeline is bounded, so that neither side waits for the other to read.
constexpr int kMostQueued = 128;
constexpr size_t kMostQueuedBytes = size_t{4} << 20;

// Where the address says nothing of them: a server that does not answer is noticed in seconds, and
// of several hosts the one that can be written to is taken.
constexpr std::pair<const char*, const char*> kDefaults[] = {
    {"connect_timeout", "5"},
    {"application_name", "horopterd"},
    {"client_encoding", "UTF8"},
    {"keepalives_idle", "5"},
    {"keepalives_interval", "2"},
    {"keepalives_count", "3"},
    {"tcp_user_timeout", "10000"},
    {"target_session_attrs", "read-write"}};

// A write that is acknowledged is on disk, and nobody who hangs keeps the others from writing.
constexpr char kSettings[] =
    "SELECT set_config('synchronous_commit', 'on', false) "
    "WHERE current_setting('synchronous_commit') IN ('off', 'local');"
    "SELECT set_config('statement_timeout', '60s', false) "
    "WHERE current_setting('statement_timeout') = '0';"
    "SELECT set_config('lock_timeout', '20s', false) WHERE current_setting('lock_timeout') = '0';"
    "SELECT set_config('idle_in_transaction_session_timeout', '30s', false) "
    "WHERE current_setting('idle_in_transaction_session_timeout') = '0';"
    "SET client_min_messages = warning";

using Options = std::unique_ptr<PQconninfoOption, decltype(&PQconninfoFree)>;

bool StartsWith(std::string_view text, std::string_view prefix) {
  return text.substr(0, prefix.size()) == prefix;
}

absl::StatusCode CodeOfState(std::string_view state) {
  if (state == "23505") return absl::StatusCode::kAlreadyExists;
  if (state == "42501" || StartsWith(state, "28")) return absl::StatusCode::kPermissionDenied;
  if (StartsWith(state, "XX00") && state != "XX000") return absl::StatusCode::kDataLoss;
  if (StartsWith(state, "53")) return absl::StatusCode::kResourceExhausted;
  if (state == "22021") return absl::StatusCode::kInvalidArgument;  // text that is none
  if (state == "3D000" || state == "3F000") return absl::StatusCode::kFailedPrecondition;
  // Connections that broke, shutting down, locked too long, cancelled, serialisation and deadlock,
  // a server that became a standby.
  for (const char* const prefix : {"08", "57", "55P03", "40", "25006"}) {
    if (StartsWith(state, prefix)) return absl::StatusCode::kUnavailable;
  }
  return absl::StatusCode::kInternal;
}

std::string OneLine(std::string_view text) {
  std::string line(absl::StripAsciiWhitespace(std::string(text)));
  std::replace(line.begin(), line.end(), '\n', ' ');
  return line;
}

}  // namespace

bool IsPostgresAddress(const std::string& address) {
  return StartsWith(address, "postgresql://") || StartsWith(address, "postgres://");
}

std::string ShownPostgresAddress(const std::string& address) {
  if (!IsPostgresAddress(address)) return address;
  const Options options(PQconninfoParse(address.c_str(), nullptr), &PQconninfoFree);
  if (options == nullptr) return "postgresql://...";
  std::string host, port, name, user;
  for (const PQconninfoOption* o = options.get(); o->keyword != nullptr; ++o) {
    const std::string value = o->val == nullptr ? "" : o->val;
    const std::string_view key = o->keyword;
    if (key == "host" || (key == "hostaddr" && host.empty())) host = value;
    if (key == "port") port = value;
    if (key == "dbname") name = value;
    if (key == "user") user = value;
  }
  return absl::StrCat("postgresql://",
                      user,
                      user.empty() ? "" : "@",
                      host,
                      port.empty() ? "" : ":",
                      port,
                      "/",
                      name);
}

absl::Status PostgresConnection::Connect() {
  if (IsConnected()) return absl::OkStatus();
  PQfinish(std::exchange(connection_, nullptr));
  prepared_.clear();
  queued_ = 0;
  queued_bytes_ = 0;
  char* wrong = nullptr;
  const Options options(PQconninfoParse(address_.c_str(), &wrong), &PQconninfoFree);
  if (options == nullptr) {
    // libpq repeats the address, which may hold a password.
    PQfreemem(wrong);
    return absl::FailedPreconditionError(
        absl::StrCat("database ",
                     shown_,
                     ": not an address of the form ",
                     "postgresql://user@host:port/name?option=value"));
  }
  std::vector<const char*> keys, values;
  std::set<std::string> given;
  for (const PQconninfoOption* o = options.get(); o->keyword != nullptr; ++o) {
    if (o->val == nullptr) continue;
    keys.push_back(o->keyword);
    values.push_back(o->val);
    given.insert(o->keyword);
  }
  for (const auto& [key, value] : kDefaults) {
    if (given.count(key) > 0) continue;
    keys.push_back(key);
    values.push_back(value);
  }
  keys.push_back(nullptr);
  values.push_back(nullptr);
  connection_ = PQconnectdbParams(keys.data(), values.data(), /*expand_dbname=*/0);
  if (connection_ == nullptr) return absl::ResourceExhaustedError("out of memory");
  // What the server says of its end comes with the status; libpq would print it.
  PQsetNoticeProcessor(
      connection_, [](void*, const char*) {}, nullptr);
  if (PQstatus(connection_) != CONNECTION_OK) {
    const std::string why = OneLine(PQerrorMessage(connection_));
    // libpq has no SQLSTATE of a connection that was refused.
    auto code = absl::StatusCode::kUnavailable;
    if (why.find("authentication failed") != std::string::npos ||
        why.find("no password supplied") != std::string::npos ||
        (why.find("role \"") != std::string::npos &&
         why.find("does not exist") != std::string::npos)) {
      code = absl::StatusCode::kPermissionDenied;
    } else if (why.find("does not exist") != std::string::npos &&
               why.find("database \"") != std::string::npos) {
      code = absl::StatusCode::kFailedPrecondition;
    }
    return absl::Status(code, absl::StrCat("database ", shown_, " cannot be reached: ", why));
  }
  return Configure();
}

absl::Status PostgresConnection::Configure() {
  HOROPTER_RETURN_IF_ERROR(Execute(kSettings));
  HOROPTER_ASSIGN_OR_RETURN(const PostgresResult schema,
                            Query("SELECT coalesce(current_schema(), '')", {}));
  schema_ = PQgetvalue(schema.get(), 0, 0);
  if (!schema_.empty()) return absl::OkStatus();
  return absl::FailedPreconditionError(
      absl::StrCat("database ", shown_, ": the schema that its search_path names is not there"));
}

absl::Status PostgresConnection::Lost(std::string_view what) {
  transient_ = true;
  return absl::UnavailableError(absl::StrCat("database ",
                                             shown_,
                                             ": the connection is lost: ",
                                             std::string(what.substr(0, 80)),
                                             ": ",
                                             connection_ == nullptr
                                                 ? std::string("not connected")
                                                 : OneLine(PQerrorMessage(connection_))));
}

absl::Status PostgresConnection::ErrorOf(const PGresult* result, std::string_view what) {
  if (result == nullptr || !IsConnected()) return Lost(what);
  const char* const field = PQresultErrorField(result, PG_DIAG_SQLSTATE);
  const std::string state = field == nullptr ? "" : field;
  if (StartsWith(state, "40") || StartsWith(state, "08") || StartsWith(state, "57P"))
    transient_ = true;
  return absl::Status(CodeOfState(state),
                      absl::StrCat(std::string(what.substr(0, 200)),
                                   ": ",
                                   OneLine(PQresultErrorMessage(result)),
                                   " (SQLSTATE ",
                                   state,
                                   ")"));
}

absl::Status PostgresConnection::Execute(const std::string& sql) {
  HOROPTER_RETURN_IF_ERROR(Flush());
  if (!IsConnected()) return Lost(sql);
  const PostgresResult result(PQexec(connection_, sql.c_str()), &PQclear);
  const ExecStatusType status = PQresultStatus(result.get());
  if (status == PGRES_COMMAND_OK || status == PGRES_TUPLES_OK) return absl::OkStatus();
  return ErrorOf(result.get(), sql);
}

absl::StatusOr<std::string> PostgresConnection::PreparedName(const std::string& sql) {
  if (const auto known = prepared_.find(sql); known != prepared_.end()) return known->second;
  HOROPTER_RETURN_IF_ERROR(Flush());
  if (!IsConnected()) return Lost(sql);
  const std::string name = absl::StrCat("h", prepared_.size());
  const PostgresResult result(PQprepare(connection_, name.c_str(), sql.c_str(), 0, nullptr),
                              &PQclear);
  if (PQresultStatus(result.get()) != PGRES_COMMAND_OK) return ErrorOf(result.get(), sql);
  prepared_[sql] = name;
  return name;
}

namespace {

// libpq's four arrays.
struct Parameters {
  explicit Parameters(const std::vector<PostgresValue>& from) {
    for (const PostgresValue& value : from) {
      const bool text = value.form == PostgresValue::Form::kText;
      const std::string_view bytes = text ? std::string_view(value.number) : value.bytes;
      const char* const data = bytes.data() == nullptr ? "" : bytes.data();
      values.push_back(value.form == PostgresValue::Form::kNull ? nullptr : data);
      lengths.push_back(static_cast<int>(bytes.size()));
      formats.push_back(text ? 0 : 1);
      size += bytes.size();
    }
  }
  int count() const { return static_cast<int>(values.size()); }
  std::vector<const char*> values;
  std::vector<int> lengths, formats;
  size_t size = 0;
};

}  // namespace

absl::StatusOr<PostgresResult> PostgresConnection::Query(const std::string& sql,
                                                         const std::vector<PostgresValue>& values) {
  HOROPTER_ASSIGN_OR_RETURN(const std::string name, PreparedName(sql));
  HOROPTER_RETURN_IF_ERROR(Flush());
  if (!IsConnected()) return Lost(sql);
  const Parameters p(values);
  PostgresResult result(PQexecPrepared(connection_,
                                       name.c_str(),
                                       p.count(),
                                       p.values.data(),
                                       p.lengths.data(),
                                       p.formats.data(),
                                       /*resultFormat=*/1),
                        &PQclear);
  const ExecStatusType status = PQresultStatus(result.get());
  if (status == PGRES_COMMAND_OK || status == PGRES_TUPLES_OK) return result;
  return ErrorOf(result.get(), sql);
}

absl::Status PostgresConnection::Queue(const std::string& sql,
                                       const std::vector<PostgresValue>& values) {
  HOROPTER_ASSIGN_OR_RETURN(const std::string name, PreparedName(sql));
  if (!IsConnected()) return Lost(sql);
  const Parameters p(values);
  if (queued_ == 0 && PQenterPipelineMode(connection_) != 1) return Lost(sql);
  ++queued_;
  queued_bytes_ += p.size;
  if (PQsendQueryPrepared(connection_,
                          name.c_str(),
                          p.count(),
                          p.values.data(),
                          p.lengths.data(),
                          p.formats.data(),
                          /*resultFormat=*/1) != 1) {
    return Lost(sql);
  }
  return queued_ < kMostQueued && queued_bytes_ < kMostQueuedBytes ? absl::OkStatus() : Flush();
}

absl::Status PostgresConnection::Flush() {
  if (queued_ == 0) return absl::OkStatus();
  queued_ = 0;
  queued_bytes_ = 0;
  if (!IsConnected() || PQpipelineSync(connection_) != 1) return Lost("pipeline");
  absl::Status first;
  bool synced = false;
  while (!synced) {
    // Null: the end of one statement's results.
    const PostgresResult result(PQgetResult(connection_), &PQclear);
    if (!IsConnected()) return Lost("pipeline");
    if (result == nullptr) continue;
    const ExecStatusType status = PQresultStatus(result.get());
    synced = status == PGRES_PIPELINE_SYNC;
    if (status == PGRES_FATAL_ERROR && first.ok()) first = ErrorOf(result.get(), "statement");
  }
  if (PQexitPipelineMode(connection_) != 1) return Lost("pipeline");
  return first;
}

absl::Status PostgresConnection::AwaitNotification(int timeout_ms) {
  if (!IsConnected()) return Lost("wait");
  pollfd socket = {PQsocket(connection_), POLLIN, 0};
  const int ready = poll(&socket, 1, timeout_ms);
  if (ready > 0 && PQconsumeInput(connection_) != 1) return Lost("wait");
  while (PGnotify* const notice = PQnotifies(connection_)) PQfreemem(notice);
  return absl::OkStatus();
}

}  // namespace horopter
