#include "db/postgres_database.h"

#include <unistd.h>

#include <algorithm>
#include <bit>
#include <charconv>
#include <utility>

#include "absl/strings/str_cat.h"
#include "db/copy_rows.h"
#include "server/base/crash_point.h"
#include "server/base/status_macros.h"

namespace horopter {
namespace {

constexpr int kMostAttempts = 6;
constexpr auto kFirstPause = std::chrono::milliseconds(20);  // doubled from attempt to attempt
// How long a commit whose connection broke is asked after: a failover takes that long.
constexpr auto kAskFor = std::chrono::seconds(20);
constexpr auto kAskEvery = std::chrono::milliseconds(250);

// PostgreSQL's type numbers, which its headers for servers alone name.
constexpr Oid kBool = 16, kBytea = 17, kInt8 = 20, kInt2 = 21, kInt4 = 23, kFloat8 = 701;

// `?` becomes $1, $2, ...; `?N` becomes $N. There are no question marks in our texts.
std::string WithNumberedPlaces(std::string_view sql) {
  std::string out;
  int next = 1;
  for (size_t i = 0; i < sql.size(); ++i) {
    if (sql[i] != '?') {
      out += sql[i];
      continue;
    }
    out += '$';
    const bool numbered = i + 1 < sql.size() && sql[i + 1] >= '1' && sql[i + 1] <= '9';
    if (!numbered) absl::StrAppend(&out, next++);
  }
  return out;
}

template <typename T>
T BigEndian(const char* bytes) {
  uint64_t value = 0;
  for (size_t i = 0; i < sizeof(T); ++i) value = value << 8 | static_cast<unsigned char>(bytes[i]);
  return static_cast<T>(value);
}

void Pause(std::chrono::microseconds time) {
  usleep(static_cast<useconds_t>(time.count()));
}

class PostgresStatement final : public StatementDriver {
 public:
  PostgresStatement(PostgresDatabase* db, std::string_view sql)
      : db_(db), sql_(WithNumberedPlaces(sql)) {}

  void BindInt(int position, int64_t value) override {
    PostgresValue& place = At(position);
    place.form = PostgresValue::Form::kText;
    place.number = absl::StrCat(value);
  }
  void BindDouble(int position, double value) override {
    // The shortest text that reads back as the same number.
    char text[32];
    const auto end = std::to_chars(text, text + sizeof(text), value).ptr;
    PostgresValue& place = At(position);
    place.form = PostgresValue::Form::kText;
    place.number.assign(text, end);
  }
  void BindText(int position, std::string_view text) override { BindBlob(position, text); }
  void BindBlob(int position, std::string_view bytes) override {
    PostgresValue& place = At(position);
    place.form = PostgresValue::Form::kBinary;
    place.bytes = bytes;
  }
  void BindNull(int position) override { At(position).form = PostgresValue::Form::kNull; }

  absl::StatusOr<bool> Step() override {
    if (rows_ == nullptr) {
      PostgresConnection& connection = db_->connection();
      absl::StatusOr<PostgresResult> rows = connection.Query(sql_, values_);
      // A connection that broke since it was used last is noticed when it is used again.
      if (!rows.ok() && !connection.IsConnected() && !db_->InTransaction()) {
        HOROPTER_RETURN_IF_ERROR(connection.Connect());
        rows = connection.Query(sql_, values_);
      }
      if (!rows.ok()) return rows.status();
      rows_ = *std::move(rows);
      row_ = -1;
    }
    return ++row_ < PQntuples(rows_.get());
  }
  absl::Status Run() override {
    if (db_->InTransaction()) return db_->connection().Queue(sql_, values_);
    return Step().status();
  }
  void Reset() override {
    rows_.reset();
    for (PostgresValue& value : values_) value.form = PostgresValue::Form::kNull;
  }

  int64_t Int(int column) const override {
    const char* const bytes = PQgetvalue(rows_.get(), row_, column);
    switch (PQftype(rows_.get(), column)) {
      case kInt8:
        return BigEndian<int64_t>(bytes);
      case kInt4:
        return BigEndian<int32_t>(bytes);
      case kInt2:
        return BigEndian<int16_t>(bytes);
      case kBool:
        return bytes[0];
      default:
        return static_cast<int64_t>(Double(column));
    }
  }
  double Double(int column) const override {
    if (PQftype(rows_.get(), column) != kFloat8) return 0.0;
    return std::bit_cast<double>(BigEndian<int64_t>(PQgetvalue(rows_.get(), row_, column)));
  }
  bool IsNull(int column) const override { return PQgetisnull(rows_.get(), row_, column) == 1; }
  std::string_view Bytes(int column) const override {
    return {PQgetvalue(rows_.get(), row_, column),
            static_cast<size_t>(PQgetlength(rows_.get(), row_, column))};
  }
  int ColumnCount() const override { return PQnfields(rows_.get()); }
  ValueKind KindOf(int column) const override {
    if (IsNull(column)) return ValueKind::kNull;
    switch (PQftype(rows_.get(), column)) {
      case kInt8:
      case kInt4:
      case kInt2:
      case kBool:
        return ValueKind::kInt;
      case kFloat8:
        return ValueKind::kDouble;
      case kBytea:
        return ValueKind::kBlob;
      default:
        return ValueKind::kText;
    }
  }

 private:
  PostgresValue& At(int position) {
    if (values_.size() < static_cast<size_t>(position)) values_.resize(position);
    return values_[position - 1];
  }

  PostgresDatabase* const db_;
  const std::string sql_;
  std::vector<PostgresValue> values_;
  PostgresResult rows_{nullptr, &PQclear};
  int row_ = -1;
};

}  // namespace

absl::StatusOr<std::unique_ptr<PostgresDatabase>> PostgresDatabase::Open(
    const std::string& address, const std::vector<std::string>& migrations) {
  std::unique_ptr<PostgresDatabase> database(new PostgresDatabase(address));
  HOROPTER_RETURN_IF_ERROR(database->connection_.Connect());
  HOROPTER_RETURN_IF_ERROR(database->Migrate(migrations));
  return database;
}

absl::StatusOr<PostgresDatabase::SchemaVersion> PostgresDatabase::ReadSchemaVersion() {
  SchemaVersion found;
  HOROPTER_ASSIGN_OR_RETURN(
      const int64_t tables,
      QueryInt(this,
               "SELECT count(*) FROM information_schema.tables WHERE table_schema = "
               "current_schema() AND table_name = 'catalog_schema'"));
  if (tables == 0) return found;
  Statement select(this, "SELECT version, usable_from FROM catalog_schema");
  HOROPTER_ASSIGN_OR_RETURN(const bool row, select.Step());
  if (row) found = {select.Int(0), select.Int(1)};
  return found;
}

absl::Status PostgresDatabase::Migrate(const std::vector<std::string>& migrations) {
  const auto newest = static_cast<int64_t>(migrations.size());
  const absl::Status migrated = RunInTransaction([&]() -> absl::Status {
    HOROPTER_ASSIGN_OR_RETURN(const SchemaVersion found, ReadSchemaVersion());
    if (found.usable_from > newest) {
      return absl::FailedPreconditionError(absl::StrCat("has schema version ",
                                                        found.version,
                                                        ", this program knows up to ",
                                                        newest,
                                                        "; use a newer horopterd"));
    }
    if (found.version == 0) {
      HOROPTER_ASSIGN_OR_RETURN(
          const int64_t foreign,
          QueryInt(this,
                   "SELECT count(*) FROM information_schema.tables WHERE table_schema = "
                   "current_schema()"));
      if (foreign > 0) {
        return absl::FailedPreconditionError(
            absl::StrCat("holds ",
                         foreign,
                         " tables in schema ",
                         connection_.schema(),
                         " and is not a horopter catalog; give it a schema of its own"));
      }
      HOROPTER_RETURN_IF_ERROR(
          Execute("CREATE TABLE catalog_schema (id BIGINT PRIMARY KEY CHECK (id = 0), "
                  "version BIGINT NOT NULL, usable_from BIGINT NOT NULL);"
                  "INSERT INTO catalog_schema VALUES (0, 0, 1)"));
    }
    // A newer one that this program may use as well stays as it is.
    for (int64_t i = found.version; i < newest; ++i) {
      HOROPTER_RETURN_IF_ERROR(Execute(migrations[i]));
      HOROPTER_RETURN_IF_ERROR(
          Execute(absl::StrCat("UPDATE catalog_schema SET version = ", i + 1)));
    }
    return absl::OkStatus();
  });
  if (migrated.ok()) return migrated;
  return absl::Status(
      migrated.code(),
      absl::StrCat("database ", connection_.shown(), " ", std::string(migrated.message())));
}

std::unique_ptr<StatementDriver> PostgresDatabase::Prepare(std::string_view sql) {
  return std::make_unique<PostgresStatement>(this, sql);
}

absl::Status PostgresDatabase::Execute(const std::string& sql) {
  return connection_.Execute(sql);
}

void PostgresDatabase::RollBack() {
  (void)connection_.Flush();
  if (connection_.IsConnected()) (void)connection_.Execute("ROLLBACK");
}

absl::Status PostgresDatabase::BeginWriting(std::string* transaction_id) {
  HOROPTER_RETURN_IF_ERROR(connection_.Connect());
  HOROPTER_RETURN_IF_ERROR(connection_.Execute("BEGIN ISOLATION LEVEL READ COMMITTED READ WRITE"));
  // One writer of the catalog at a time; each statement after this sees what the last one left.
  HOROPTER_RETURN_IF_ERROR(
      connection_.Execute("SELECT pg_advisory_xact_lock(hashtextextended('horopter.' || "
                          "current_schema(), 0))"));
  HOROPTER_ASSIGN_OR_RETURN(const PostgresResult id,
                            connection_.Query("SELECT pg_current_xact_id()::text", {}));
  transaction_id->assign(PQgetvalue(id.get(), 0, 0));
  return absl::OkStatus();
}

PostgresDatabase::Attempt PostgresDatabase::TryTransaction(const Body& body) {
  connection_.ForgetErrors();
  std::string transaction_id;
  in_transaction_ = true;
  const auto end = [this](absl::Status status) {
    RollBack();
    in_transaction_ = false;
    return Attempt{std::move(status), connection_.IsTransient()};
  };
  if (absl::Status begun = BeginWriting(&transaction_id); !begun.ok()) return end(begun);
  CrashPoint("transaction.begun");
  absl::Status status;
  try {
    status = body();
  } catch (...) {  // memory was short: nothing of it may stay
    (void)end(absl::OkStatus());
    throw;
  }
  if (status.ok()) {
    status = connection_.Execute("SELECT pg_notify('horopter_' || current_schema(), '')");
  }
  CrashPoint("transaction.before_commit");
  if (!status.ok()) return end(status);
  status = connection_.Execute("COMMIT");
  CrashPoint("transaction.after_commit");
  in_transaction_ = false;
  if (status.ok()) return {status};
  if (!connection_.IsConnected()) return AskWhetherCommitted(transaction_id, status);
  return end(status);
}

PostgresDatabase::Attempt PostgresDatabase::AskWhetherCommitted(const std::string& transaction_id,
                                                                const absl::Status& broke) {
  const auto until = std::chrono::steady_clock::now() + kAskFor;
  PostgresValue id;
  id.form = PostgresValue::Form::kBinary;
  id.bytes = transaction_id;
  while (std::chrono::steady_clock::now() < until) {
    if (connection_.Connect().ok()) {
      const auto answer = connection_.Query("SELECT pg_xact_status($1::text::xid8)", {id});
      if (answer.ok() && PQgetisnull(answer->get(), 0, 0) == 0) {
        const std::string_view state = PQgetvalue(answer->get(), 0, 0);
        if (state == "committed") return {absl::OkStatus()};
        if (state == "aborted") return {broke, true};
      } else if (!answer.ok() && connection_.IsConnected()) {
        // A standby that took over knows nothing of it: it is lost, and may be written again.
        return {broke, true};
      }
    }
    Pause(kAskEvery);
  }
  return {absl::UnavailableError(absl::StrCat(
      std::string(broke.message()),
      "; the connection broke while the write was committed: look whether it is there"))};
}

absl::Status PostgresDatabase::RunInTransaction(const Body& body) {
  auto pause = kFirstPause;
  for (int attempt = 1;; ++attempt) {
    Attempt made = TryTransaction(body);
    if (made.status.ok() || !made.again || attempt == kMostAttempts) return made.status;
    Pause(pause);
    pause *= 2;
  }
}

absl::Status PostgresDatabase::ReadAtOneMoment(const Body& body) {
  constexpr char kBegin[] = "BEGIN ISOLATION LEVEL REPEATABLE READ READ ONLY";
  HOROPTER_RETURN_IF_ERROR(connection_.Connect());
  absl::Status begun = Execute(kBegin);
  if (!connection_.IsConnected()) {  // it broke since it was used last
    HOROPTER_RETURN_IF_ERROR(connection_.Connect());
    begun = Execute(kBegin);
  }
  HOROPTER_RETURN_IF_ERROR(begun);
  in_transaction_ = true;
  absl::Status status = body();
  RollBack();
  in_transaction_ = false;
  return status;
}

absl::StatusOr<std::unique_ptr<Database>> PostgresDatabase::OpenReader() {
  std::unique_ptr<PostgresDatabase> reader(new PostgresDatabase(address_));
  HOROPTER_RETURN_IF_ERROR(reader->connection_.Connect());
  return std::unique_ptr<Database>(std::move(reader));
}

absl::StatusOr<std::unique_ptr<Database>> PostgresDatabase::OpenSnapshot() {
  HOROPTER_ASSIGN_OR_RETURN(std::unique_ptr<Database> reader, OpenReader());
  HOROPTER_RETURN_IF_ERROR(reader->Execute("BEGIN ISOLATION LEVEL REPEATABLE READ READ ONLY"));
  static_cast<PostgresDatabase*>(reader.get())->in_transaction_ = true;
  // The first statement fixes the moment.
  HOROPTER_RETURN_IF_ERROR(QueryInt(reader.get(), "SELECT generation FROM catalog_state").status());
  return reader;
}

absl::Status PostgresDatabase::CopyToFile(const std::string& path, const StopRequested& stop) {
  return CopyRowsToFile(this, path, stop);
}

absl::Status PostgresDatabase::AfterCopy() {
  for (const char* const table : {"create_request", "station_event"}) {
    HOROPTER_RETURN_IF_ERROR(
        Execute(absl::StrCat("SELECT setval(pg_get_serial_sequence('",
                             table,
                             "', 'sequence'), coalesce(max(sequence), 0) + 1, false) FROM ",
                             table)));
  }
  return absl::OkStatus();
}

absl::Status PostgresDatabase::ReplaceBy(Database* other, const Body& after) {
  return RunInTransaction([&]() -> absl::Status {
    HOROPTER_RETURN_IF_ERROR(ReplaceRows(other, this));
    return after();
  });
}

absl::Status PostgresDatabase::AwaitWrite(std::chrono::milliseconds timeout) {
  if (!connection_.IsConnected()) listening_ = false;
  HOROPTER_RETURN_IF_ERROR(connection_.Connect());
  if (!listening_) {
    HOROPTER_RETURN_IF_ERROR(
        Execute(absl::StrCat("LISTEN \"horopter_", connection_.schema(), "\"")));
    listening_ = true;
    return absl::OkStatus();  // what was written before is not told
  }
  return connection_.AwaitNotification(static_cast<int>(timeout.count()));
}

}  // namespace horopter
