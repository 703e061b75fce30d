#include "db/copy_rows.h"

#include <unistd.h>

#include <cstdint>
#include <filesystem>
#include <map>
#include <utility>

#include "absl/strings/str_cat.h"
#include "db/catalog.h"
#include "db/sqlite_database.h"
#include "server/base/sha256.h"
#include "server/base/status_macros.h"

namespace horopter {
namespace {

// Objects whose rows are read, compared and written together: a large one may hold 100 MB.
constexpr int kObjectsAtOnce = 16;

// Objects with `after` < id <= last; the last one, empty when there are none, and their number.
struct Stretch {
  std::string after, last;
  int objects = 0;
};

absl::StatusOr<Stretch> NextStretch(Database* db, const std::string& after) {
  Stretch stretch{after, "", 0};
  Statement select(db,
                   "SELECT object_id FROM object WHERE object_id > ? ORDER BY object_id LIMIT ?");
  select.Bind(std::string_view(after)).Bind(static_cast<int64_t>(kObjectsAtOnce));
  while (true) {
    HOROPTER_ASSIGN_OR_RETURN(const bool row, select.Step());
    if (!row) return stretch;
    stretch.last = select.Text(0);
    ++stretch.objects;
  }
}

// Rows of one table; of a stretch of objects where it has rows of objects.
Statement SelectRows(Database* db, const CatalogTable& table, const Stretch& stretch) {
  const std::string from = absl::StrCat("SELECT * FROM ", table.name);
  const std::string order = absl::StrCat(" ORDER BY ", table.key);
  if (!table.of_object) return Statement(db, from + order);
  Statement select(db, absl::StrCat(from, " WHERE object_id > ? AND object_id <= ?", order));
  select.Bind(std::string_view(stretch.after)).Bind(std::string_view(stretch.last));
  return select;
}

template <typename T>
void AddRaw(T value, Sha256* sha) {
  sha->Add({reinterpret_cast<const char*>(&value), sizeof(value)});
}

void AddValue(const Statement& row, int column, Sha256* sha) {
  const ValueKind kind = row.KindOf(column);
  sha->Add(std::string_view("nidtb").substr(static_cast<size_t>(kind), 1));
  switch (kind) {
    case ValueKind::kNull:
      return;
    case ValueKind::kInt:
      return AddRaw(row.Int(column), sha);
    case ValueKind::kDouble: {
      const double value = row.Double(column);
      return AddRaw(value == 0.0 ? 0.0 : value, sha);
    }
    case ValueKind::kText:
    case ValueKind::kBlob: {
      const std::string_view bytes = row.Bytes(column);
      AddRaw(static_cast<uint64_t>(bytes.size()), sha);
      sha->Add(bytes);
    }
  }
}

using TableDigests = std::map<std::string, Sha256>;

absl::Status DigestRows(Database* db,
                        const CatalogTable& table,
                        const Stretch& stretch,
                        TableDigests* digests) {
  Sha256& sha = (*digests)[table.name];
  Statement select = SelectRows(db, table, stretch);
  while (true) {
    HOROPTER_ASSIGN_OR_RETURN(const bool row, select.Step());
    if (!row) return absl::OkStatus();
    for (int c = 0; c < select.ColumnCount(); ++c) AddValue(select, c, &sha);
  }
}

std::string Together(const TableDigests& digests) {
  Sha256 all;
  for (const auto& [name, sha] : digests) all.Add(absl::StrCat(name, " ", sha.Hex(), "\n"));
  return all.Hex();
}

absl::StatusOr<std::string> DigestOfStretch(Database* db, const Stretch& stretch) {
  TableDigests digests;
  for (const CatalogTable& table : CatalogTables()) {
    if (table.of_object) HOROPTER_RETURN_IF_ERROR(DigestRows(db, table, stretch, &digests));
  }
  return Together(digests);
}

absl::Status CopyTable(Database* from,
                       Database* to,
                       const CatalogTable& table,
                       const Stretch& stretch) {
  Statement select = SelectRows(from, table, stretch);
  HOROPTER_ASSIGN_OR_RETURN(bool row, select.Step());
  if (!row) return absl::OkStatus();
  std::string places = "?";
  for (int c = 1; c < select.ColumnCount(); ++c) places += ", ?";
  Statement insert(to, absl::StrCat("INSERT INTO ", table.name, " VALUES (", places, ")"));
  while (row) {
    for (int c = 0; c < select.ColumnCount(); ++c) {
      switch (select.KindOf(c)) {
        case ValueKind::kNull:
          insert.BindNull();
          break;
        case ValueKind::kInt:
          insert.Bind(select.Int(c));
          break;
        case ValueKind::kDouble:
          insert.Bind(select.Double(c));
          break;
        case ValueKind::kText:
          insert.Bind(select.Bytes(c));
          break;
        case ValueKind::kBlob:
          insert.BindBlob(select.Bytes(c));
          break;
      }
    }
    HOROPTER_RETURN_IF_ERROR(insert.Run());
    HOROPTER_ASSIGN_OR_RETURN(row, select.Step());
  }
  return absl::OkStatus();
}

absl::Status CopyStretch(Database* from, Database* to, const Stretch& stretch) {
  for (const CatalogTable& table : CatalogTables()) {
    if (table.of_object) HOROPTER_RETURN_IF_ERROR(CopyTable(from, to, table, stretch));
  }
  return absl::OkStatus();
}

// Whatever is not of an object: replaced as a whole.
absl::Status ReplaceOtherTables(Database* from, Database* to) {
  const std::vector<CatalogTable>& tables = CatalogTables();
  for (auto table = tables.rbegin(); table != tables.rend(); ++table) {
    if (!table->of_object) HOROPTER_RETURN_IF_ERROR(Execute(to, "DELETE FROM " + table->name));
  }
  for (const CatalogTable& table : tables) {
    if (!table.of_object) HOROPTER_RETURN_IF_ERROR(CopyTable(from, to, table, {}));
  }
  return to->AfterCopy();
}

// Objects between the stretch before and this one's end that are not what they should be.
absl::Status RemoveStretch(Database* to, const Stretch& stretch) {
  Statement remove(to, "DELETE FROM object WHERE object_id > ? AND object_id <= ?");
  return remove.Bind(std::string_view(stretch.after)).Bind(std::string_view(stretch.last)).Run();
}

absl::Status RemoveAfter(Database* to, const std::string& last) {
  Statement remove(to, "DELETE FROM object WHERE object_id > ?");
  return remove.Bind(std::string_view(last)).Run();
}

absl::Status SetGeneration(Database* to, int64_t generation) {
  Statement set(to, "UPDATE catalog_state SET generation = ?");
  return set.Bind(generation).Run();
}

absl::Status BeginFilling(Database* to) {
  return to->RunInTransaction([&]() -> absl::Status {
    HOROPTER_ASSIGN_OR_RETURN(const int64_t generation,
                              QueryInt(to, "SELECT generation FROM catalog_state"));
    HOROPTER_ASSIGN_OR_RETURN(const int64_t objects, QueryInt(to, "SELECT count(*) FROM object"));
    HOROPTER_ASSIGN_OR_RETURN(const int64_t stations, QueryInt(to, "SELECT count(*) FROM station"));
    if (generation != kUnfinishedCopy && objects + stations + generation > 0) {
      return absl::AlreadyExistsError(absl::StrCat("the catalog to be filled holds ",
                                                   objects,
                                                   " objects and ",
                                                   stations,
                                                   " stations already; take an empty one"));
    }
    return SetGeneration(to, kUnfinishedCopy);
  });
}

absl::Status BrokenOff() {
  return absl::CancelledError("stopped; begin it again and it goes on from there");
}

}  // namespace

const std::vector<CatalogTable>& CatalogTables() {
  static const auto* const tables = new std::vector<CatalogTable>{
      {"object", "object_id", true},
      {"vertex", "object_id, idx", true},
      {"edge", "object_id, idx", true},
      {"mesh", "object_id", true},
      {"symmetry", "object_id, idx", true},
      {"grasp", "object_id, idx", true},
      {"cad_source", "object_id", true},
      {"derived", "object_id, version", true},
      {"derived_keys", "object_id, version", true},
      {"object_digest", "object_id", true},
      {"label", "object_id, key", true},
      {"surface_print", "object_id", true},
      {"object_version", "object_id, version", true},
      {"create_request", "sequence", false},
      {"station", "station_id", false},
      {"station_hand_eye", "station_id, camera_id", false},
      {"station_event", "sequence", false},
      {"station_writes", "id", false},
      {"catalog_state", "id", false},
  };
  return *tables;
}

absl::StatusOr<std::string> DigestOfRows(Database* db, const StopRequested& stop) {
  TableDigests digests;
  for (Stretch stretch;;) {
    HOROPTER_ASSIGN_OR_RETURN(stretch, NextStretch(db, stretch.last));
    if (stretch.objects == 0) break;
    if (IsStopRequested(stop)) return BrokenOff();
    for (const CatalogTable& table : CatalogTables()) {
      if (table.of_object) HOROPTER_RETURN_IF_ERROR(DigestRows(db, table, stretch, &digests));
    }
  }
  for (const CatalogTable& table : CatalogTables()) {
    if (!table.of_object) HOROPTER_RETURN_IF_ERROR(DigestRows(db, table, {}, &digests));
  }
  return Together(digests);
}

absl::Status ReplaceRows(Database* from, Database* to, const StopRequested& stop) {
  HOROPTER_RETURN_IF_ERROR(Execute(to, "DELETE FROM object"));
  for (Stretch stretch;;) {
    HOROPTER_ASSIGN_OR_RETURN(stretch, NextStretch(from, stretch.last));
    if (stretch.objects == 0) break;
    if (IsStopRequested(stop)) return absl::CancelledError("stopped");
    HOROPTER_RETURN_IF_ERROR(CopyStretch(from, to, stretch));
  }
  return ReplaceOtherTables(from, to);
}

absl::StatusOr<CopyReport> FillCatalog(Database* from,
                                       Database* to,
                                       const StopRequested& stop,
                                       const CopyProgress& progress) {
  HOROPTER_ASSIGN_OR_RETURN(const int64_t source,
                            QueryInt(from, "SELECT generation FROM catalog_state"));
  if (source == kUnfinishedCopy)
    return absl::FailedPreconditionError("the catalog to be read is itself an unfinished copy");
  HOROPTER_RETURN_IF_ERROR(BeginFilling(to));
  HOROPTER_ASSIGN_OR_RETURN(const int64_t total, QueryInt(from, "SELECT count(*) FROM object"));
  CopyReport report;
  for (Stretch stretch;;) {
    const std::string after = stretch.last;
    HOROPTER_ASSIGN_OR_RETURN(stretch, NextStretch(from, after));
    if (IsStopRequested(stop)) return BrokenOff();
    if (stretch.objects == 0) {
      HOROPTER_RETURN_IF_ERROR(to->RunInTransaction([&] { return RemoveAfter(to, after); }));
      break;
    }
    HOROPTER_ASSIGN_OR_RETURN(const std::string wanted, DigestOfStretch(from, stretch));
    HOROPTER_ASSIGN_OR_RETURN(const std::string there, DigestOfStretch(to, stretch));
    if (wanted != there) {
      const absl::Status copied = to->RunInTransaction([&]() -> absl::Status {
        HOROPTER_RETURN_IF_ERROR(RemoveStretch(to, stretch));
        return CopyStretch(from, to, stretch);
      });
      HOROPTER_RETURN_IF_ERROR(copied);
      report.copied += stretch.objects;
    }
    report.objects += stretch.objects;
    if (progress) progress(report.objects, static_cast<int>(total));
  }
  HOROPTER_ASSIGN_OR_RETURN(report.digest, DigestOfRows(from, stop));
  // The generation takes its true value only together with digests that agree.
  const absl::Status finished = to->RunInTransaction([&]() -> absl::Status {
    HOROPTER_RETURN_IF_ERROR(ReplaceOtherTables(from, to));
    HOROPTER_ASSIGN_OR_RETURN(const std::string written, DigestOfRows(to, stop));
    if (written == report.digest) return absl::OkStatus();
    return absl::DataLossError(absl::StrCat(
        "the copy has digest ", written, ", the catalog it was made of ", report.digest));
  });
  HOROPTER_RETURN_IF_ERROR(finished);
  return report;
}

absl::Status CopyRowsToFile(Database* from, const std::string& path, const StopRequested& stop) {
  const std::string rows = absl::StrCat(path, ".rows.", getpid(), ".unfinished");
  absl::Status status;
  {
    HOROPTER_ASSIGN_OR_RETURN(const std::unique_ptr<SqliteDatabase> file,
                              SqliteDatabase::Open(rows, {}));
    status = file->RunInTransaction([&] { return ReplaceRows(from, file.get(), stop); });
    if (status.ok()) status = file->CopyToFile(path, stop);
  }
  for (const char* const part : {"", "-wal", "-shm", ".lock"}) {
    std::error_code ignored;
    std::filesystem::remove(rows + part, ignored);
  }
  return status;
}

}  // namespace horopter
