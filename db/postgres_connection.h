// One connection to PostgreSQL by libpq: statements prepared once, those without rows in a
// pipeline; internal to db/.
#pragma once

#include <libpq-fe.h>

#include <map>
#include <memory>
#include <string>
#include <string_view>
#include <vector>

#include "absl/status/status.h"
#include "absl/status/statusor.h"

namespace horopter {

// True for postgresql://... and postgres://...
bool IsPostgresAddress(const std::string& address);

// The address without what is secret in it, for logs.
std::string ShownPostgresAddress(const std::string& address);

using PostgresResult = std::unique_ptr<PGresult, decltype(&PQclear)>;

struct PostgresValue {
  enum class Form { kNull, kText, kBinary };
  Form form = Form::kNull;
  std::string number;      // of kText, which holds numbers only
  std::string_view bytes;  // of kBinary
};

// Not thread-safe. Passwords are read anew (passfile, service file) at each Connect.
class PostgresConnection {
 public:
  explicit PostgresConnection(std::string address) : address_(std::move(address)) {}
  ~PostgresConnection() { PQfinish(connection_); }
  PostgresConnection(const PostgresConnection&) = delete;
  PostgresConnection& operator=(const PostgresConnection&) = delete;

  // Connects anew where it is not connected. Errors: UNAVAILABLE, PERMISSION_DENIED (password),
  // FAILED_PRECONDITION (no such database or schema, no address), each with the address.
  absl::Status Connect();
  bool IsConnected() const {
    return connection_ != nullptr && PQstatus(connection_) == CONNECTION_OK;
  }

  // Carries out what waits in the pipeline, then this.
  absl::Status Execute(const std::string& sql);
  // Rows in binary form.
  absl::StatusOr<PostgresResult> Query(const std::string& sql,
                                       const std::vector<PostgresValue>& values);
  // Without waiting for the answer, but for every so many.
  absl::Status Queue(const std::string& sql, const std::vector<PostgresValue>& values);
  // Waits for the answers. The first error among them.
  absl::Status Flush();

  // Whether an error since then (serialisation failure, deadlock, a connection that broke) would
  // not come again.
  bool IsTransient() const { return transient_; }
  void ForgetErrors() { transient_ = false; }

  // The schema that the connection works in.
  const std::string& schema() const { return schema_; }
  const std::string& shown() const { return shown_; }
  // Waits for a notification, at most so long.
  absl::Status AwaitNotification(int timeout_ms);

 private:
  absl::Status Configure();
  absl::StatusOr<std::string> PreparedName(const std::string& sql);
  absl::Status ErrorOf(const PGresult* result, std::string_view what);
  absl::Status Lost(std::string_view what);

  const std::string address_;
  const std::string shown_ = ShownPostgresAddress(address_);
  std::string schema_;
  PGconn* connection_ = nullptr;
  std::map<std::string, std::string> prepared_;  // SQL -> name
  int queued_ = 0;
  size_t queued_bytes_ = 0;
  bool transient_ = false;
};

}  // namespace horopter
