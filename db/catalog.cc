#include "db/catalog.h"

#include <filesystem>
#include <utility>

#include "absl/strings/str_cat.h"
#include "absl/strings/str_split.h"
#include "db/catalog_writes.h"
#include "db/copy_rows.h"
#include "db/migrations.h"
#include "db/missing_digests.h"
#include "db/object_digest.h"
#include "db/object_rows.h"
#include "db/object_versions.h"
#include "db/postgres_database.h"
#include "db/sqlite_database.h"
#include "server/base/sha256.h"
#include "server/base/status_macros.h"

namespace horopter {
namespace {

absl::Status NotFound(const std::string& id) {
  return absl::NotFoundError(absl::StrCat("object '", id, "' is not in the catalog"));
}

absl::StatusOr<bool> Exists(Database* db, const std::string& id) {
  Statement select(db, "SELECT 1 FROM object WHERE object_id = ?");
  select.Bind(std::string_view(id));
  return select.Step();
}

// What a write is to whoever rests on it, once it is committed.
absl::Status Became(absl::Status committed, WriteIdentity written, RestsOn rests_on) {
  if (committed.ok() && rests_on != nullptr) *rests_on = std::move(written);
  return committed;
}

absl::Status RememberRequest(Database* db,
                             const RepeatableRequest& request,
                             const std::vector<Catalog::NewObject>& objects) {
  if (request.id.empty()) return absl::OkStatus();
  std::string ids;
  for (const Catalog::NewObject& object : objects) {
    absl::StrAppend(&ids, ids.empty() ? "" : " ", object.record.model.id);
  }
  Statement insert(db,
                   "INSERT INTO create_request (request_id, digest, object_ids) VALUES (?, ?, ?)");
  insert.Bind(std::string_view(request.id))
      .Bind(std::string_view(request.digest))
      .Bind(std::string_view(ids));
  HOROPTER_RETURN_IF_ERROR(insert.Run());
  Statement forget(db,
                   "DELETE FROM create_request WHERE sequence <= "
                   "(SELECT max(sequence) FROM create_request) - ?");
  forget.Bind(static_cast<int64_t>(kRememberedRequests));
  return forget.Run();
}

// All rows of a new object. Errors: ALREADY_EXISTS.
absl::Status InsertObject(Database* db,
                          const CatalogRecord& record,
                          int64_t revision,
                          const CadSource& source,
                          const DerivedData& derived) {
  const std::string& id = record.model.id;
  HOROPTER_ASSIGN_OR_RETURN(const bool exists, Exists(db, id));
  if (exists) {
    return absl::AlreadyExistsError(absl::StrCat("object '", id, "' is already in the catalog"));
  }
  HOROPTER_RETURN_IF_ERROR(InsertObjectRow(db, record, revision));
  HOROPTER_RETURN_IF_ERROR(InsertGeometry(db, record.model));
  HOROPTER_RETURN_IF_ERROR(InsertSymmetries(db, record.model));
  HOROPTER_RETURN_IF_ERROR(InsertGrasps(db, record.model));
  HOROPTER_RETURN_IF_ERROR(InsertPrint(db, record.model));
  HOROPTER_RETURN_IF_ERROR(InsertLabels(db, id, record.labels));
  HOROPTER_RETURN_IF_ERROR(InsertSource(db, id, source));
  HOROPTER_RETURN_IF_ERROR(WriteDigest(db, record.model));
  return WriteDerived(db, id, derived);
}

absl::Status DeleteRows(Database* db, const char* table, const std::string& id) {
  Statement statement(db, absl::StrCat("DELETE FROM ", table, " WHERE object_id = ?"));
  statement.Bind(std::string_view(id));
  return statement.Run();
}

absl::Status ReplaceGeometry(Database* db, const ObjectModel& model) {
  for (const char* table : {"edge", "vertex", "mesh"}) {
    HOROPTER_RETURN_IF_ERROR(DeleteRows(db, table, model.id));
  }
  HOROPTER_RETURN_IF_ERROR(InsertGeometry(db, model));
  Statement update(
      db,
      "UPDATE object SET diameter_m = ?, vertex_count = ?, edge_count = ?, triangle_count = ? "
      "WHERE object_id = ?");
  update.Bind(model.diameter_m)
      .Bind(static_cast<int64_t>(model.vertices.size()))
      .Bind(static_cast<int64_t>(model.edges.size()))
      .Bind(static_cast<int64_t>(model.mesh.triangles.size()))
      .Bind(std::string_view(model.id));
  return update.Run();
}

// Errors: DATA_LOSS: not what was written.
absl::StatusOr<CatalogRecord> ReadRecord(Database* db, CatalogRecord record) {
  HOROPTER_RETURN_IF_ERROR(ReadGeometry(db, record.model));
  HOROPTER_RETURN_IF_ERROR(CheckDigest(db, record.model));
  HOROPTER_RETURN_IF_ERROR(ReadPrint(db, record.model));
  return record;
}

// With its derived data; of a damaged one what is wrong.
absl::StatusOr<LoadedObject> LoadFound(Database* db,
                                       CatalogRecord found,
                                       const DerivedWanted& wanted) {
  LoadedObject object;
  object.model.id = found.model.id;
  absl::StatusOr<CatalogRecord> record = ReadRecord(db, std::move(found));
  if (absl::IsDataLoss(record.status())) {
    object.damage = record.status();
    return object;
  }
  HOROPTER_RETURN_IF_ERROR(record.status());
  object.model = std::move(record->model);
  HOROPTER_RETURN_IF_ERROR(ReadDerived(db, object.model.id, wanted, object.derived));
  return object;
}

}  // namespace

absl::StatusOr<CadSource> WithHash(CadSource source) {
  HOROPTER_RETURN_IF_ERROR(ValidateSource(source));
  const std::string expected = source.content.empty() ? "" : Sha256Hex(source.content);
  if (!source.sha256.empty() && source.sha256 != expected) {
    return absl::InvalidArgumentError("source.sha256: differs from the content's SHA-256 " +
                                      expected);
  }
  source.sha256 = expected;
  return source;
}

Catalog::Catalog(std::string path, std::unique_ptr<Database> database)
    : path_(std::move(path)), database_(std::move(database)) {}
Catalog::~Catalog() = default;

std::string Catalog::ShownPath(const std::string& path) {
  return ShownPostgresAddress(path);
}

bool Catalog::IsSharedPath(const std::string& path) {
  return IsPostgresAddress(path);
}

bool Catalog::IsShared() const {
  return database_->IsShared();
}

namespace {

absl::StatusOr<std::unique_ptr<Database>> OpenEither(const std::string& path,
                                                     const CatalogOptions& options) {
  if (IsPostgresAddress(path)) {
    HOROPTER_ASSIGN_OR_RETURN(std::unique_ptr<PostgresDatabase> shared,
                              PostgresDatabase::Open(path, PostgresMigrations()));
    HOROPTER_RETURN_IF_ERROR(FillAddresses(shared.get()));
    return std::unique_ptr<Database>(std::move(shared));
  }
  HOROPTER_ASSIGN_OR_RETURN(std::unique_ptr<SqliteDatabase> file,
                            SqliteDatabase::Open(path, options));
  HOROPTER_RETURN_IF_ERROR(FillDigests(file.get()));
  HOROPTER_RETURN_IF_ERROR(FillAddresses(file.get()));
  HOROPTER_RETURN_IF_ERROR(file->BeginServing(options.disk_reserve));
  return std::unique_ptr<Database>(std::move(file));
}

}  // namespace

absl::StatusOr<std::unique_ptr<Catalog>> Catalog::Open(const std::string& path,
                                                       const CatalogOptions& options) {
  HOROPTER_ASSIGN_OR_RETURN(std::unique_ptr<Database> database, OpenEither(path, options));
  HOROPTER_ASSIGN_OR_RETURN(const int64_t generation,
                            QueryInt(database.get(), "SELECT generation FROM catalog_state"));
  if (generation == kUnfinishedCopy) {
    return absl::FailedPreconditionError(
        absl::StrCat("database ",
                     ShownPostgresAddress(path),
                     " is half filled by `horopter catalog migrate`: run that again to its end"));
  }
  std::unique_ptr<Catalog> catalog(new Catalog(path, std::move(database)));
  catalog->kept_version_bytes_ = options.kept_version_bytes;
  return catalog;
}

absl::StatusOr<CopyReport> Catalog::Migrate(const std::string& from,
                                            const std::string& to,
                                            const StopRequested& stop,
                                            const CopyProgress& progress) {
  if (!IsSharedPath(from) && !std::filesystem::exists(from))
    return absl::NotFoundError(absl::StrCat(from, ": there is no such catalog to copy"));
  HOROPTER_ASSIGN_OR_RETURN(const std::unique_ptr<Catalog> source, Open(from));
  // Of one moment, whoever writes meanwhile. A file has no other writer.
  HOROPTER_ASSIGN_OR_RETURN(const std::unique_ptr<Database> moment,
                            source->database_->OpenSnapshot());
  HOROPTER_ASSIGN_OR_RETURN(const std::unique_ptr<Database> target, OpenEither(to, {}));
  return FillCatalog(
      moment == nullptr ? source->database_.get() : moment.get(), target.get(), stop, progress);
}

absl::Status Catalog::CreateObject(const CatalogRecord& record, const DerivedData& derived) {
  return CreateObjects({{record, derived}});
}

absl::Status Catalog::CreateObjects(const std::vector<NewObject>& objects,
                                    const RepeatableRequest& request,
                                    RestsOn rests_on) {
  std::vector<CadSource> sources;
  for (const NewObject& object : objects) {
    HOROPTER_RETURN_IF_ERROR(ValidateModel(object.record.model));
    HOROPTER_RETURN_IF_ERROR(ValidateLabels(object.record.labels));
    HOROPTER_ASSIGN_OR_RETURN(sources.emplace_back(), WithHash(object.record.source));
  }
  const std::lock_guard lock(mutex_);
  Database* db = database_.get();
  WriteIdentity written;
  absl::Status committed = RunInTransaction(db, [&]() -> absl::Status {
    HOROPTER_ASSIGN_OR_RETURN(written, CountGeneration(db, rests_on));
    for (size_t i = 0; i < objects.size(); ++i) {
      HOROPTER_RETURN_IF_ERROR(
          InsertObject(db, objects[i].record, written.generation, sources[i], objects[i].derived));
    }
    return RememberRequest(db, request, objects);
  });
  return Became(std::move(committed), std::move(written), rests_on);
}

absl::StatusOr<MadeObjects> Catalog::FindRequest(const std::string& request_id) {
  const std::lock_guard lock(mutex_);
  Statement select(database_.get(),
                   "SELECT digest, object_ids FROM create_request WHERE request_id = ?");
  select.Bind(std::string_view(request_id));
  HOROPTER_ASSIGN_OR_RETURN(const bool row, select.Step());
  if (!row) return absl::NotFoundError(absl::StrCat("request '", request_id, "' is not known"));
  return MadeObjects{select.Text(0), absl::StrSplit(select.Text(1), ' ')};
}

absl::Status Catalog::UpdateObject(const CatalogRecord& record,
                                   const UpdateParts& parts,
                                   const DerivedData& derived,
                                   RestsOn rests_on) {
  HOROPTER_RETURN_IF_ERROR(ValidateModel(record.model));
  HOROPTER_RETURN_IF_ERROR(ValidateLabels(record.labels));
  CadSource source;
  if (parts.source) {
    HOROPTER_ASSIGN_OR_RETURN(source, WithHash(record.source));
  }
  const ObjectModel& model = record.model;
  const std::lock_guard lock(mutex_);
  Database* db = database_.get();
  WriteIdentity written;
  absl::Status committed = RunInTransaction(db, [&]() -> absl::Status {
    HOROPTER_ASSIGN_OR_RETURN(const FormerState former, ReadState(db, model.id, parts));
    HOROPTER_ASSIGN_OR_RETURN(written, CountGeneration(db, rests_on));
    const bool digested = parts.geometry || parts.symmetries || parts.grasps;
    if (digested) {  // what is damaged does not get a digest that says otherwise
      HOROPTER_ASSIGN_OR_RETURN(const CatalogRecord before, ReadUnchecked(db, model.id));
      HOROPTER_RETURN_IF_ERROR(CheckDigest(db, before.model));
    }
    Statement touch(db,
                    "UPDATE object SET update_time = ?, revision = ?, changed_by = ? "
                    "WHERE object_id = ?");
    touch.Bind(std::string_view(record.update_time))
        .Bind(written.generation)
        .Bind(std::string_view(record.changed_by))
        .Bind(std::string_view(model.id));
    HOROPTER_RETURN_IF_ERROR(touch.Run());
    if (parts.display_name) {
      Statement rename(db, "UPDATE object SET display_name = ? WHERE object_id = ?");
      rename.Bind(std::string_view(model.display_name)).Bind(std::string_view(model.id));
      HOROPTER_RETURN_IF_ERROR(rename.Run());
    }
    if (parts.geometry) {
      HOROPTER_RETURN_IF_ERROR(ReplaceGeometry(db, model));
    }
    if (parts.geometry || parts.symmetries)
      HOROPTER_RETURN_IF_ERROR(ReplaceDerived(db, model.id, derived));
    if (parts.symmetries) {
      HOROPTER_RETURN_IF_ERROR(DeleteRows(db, "symmetry", model.id));
      HOROPTER_RETURN_IF_ERROR(InsertSymmetries(db, model));
    }
    if (parts.grasps) {
      HOROPTER_RETURN_IF_ERROR(DeleteRows(db, "grasp", model.id));
      HOROPTER_RETURN_IF_ERROR(InsertGrasps(db, model));
    }
    if (parts.source) {
      HOROPTER_RETURN_IF_ERROR(DeleteRows(db, "cad_source", model.id));
      HOROPTER_RETURN_IF_ERROR(InsertSource(db, model.id, source));
    }
    if (parts.print) {
      HOROPTER_RETURN_IF_ERROR(DeleteRows(db, "surface_print", model.id));
      HOROPTER_RETURN_IF_ERROR(InsertPrint(db, model));
    }
    if (parts.labels) {
      HOROPTER_RETURN_IF_ERROR(DeleteRows(db, "label", model.id));
      HOROPTER_RETURN_IF_ERROR(InsertLabels(db, model.id, record.labels));
    }
    if (digested) {
      HOROPTER_ASSIGN_OR_RETURN(const CatalogRecord after, ReadUnchecked(db, model.id));
      HOROPTER_RETURN_IF_ERROR(WriteDigest(db, after.model));
    }
    return KeepVersion(db, former, parts, kept_version_bytes_);
  });
  return Became(std::move(committed), std::move(written), rests_on);
}

absl::Status Catalog::StoreDerived(const std::vector<std::pair<std::string, DerivedData>>& derived,
                                   bool counts,
                                   RestsOn rests_on) {
  const std::lock_guard lock(mutex_);
  Database* db = database_.get();
  WriteIdentity written;
  absl::Status committed = RunInTransaction(db, [&]() -> absl::Status {
    if (counts) {
      HOROPTER_ASSIGN_OR_RETURN(written, CountGeneration(db, rests_on));
    }
    for (const auto& [id, data] : derived) {
      HOROPTER_ASSIGN_OR_RETURN(const bool exists, Exists(db, id));
      if (exists) HOROPTER_RETURN_IF_ERROR(WriteDerived(db, id, data));
    }
    return absl::OkStatus();
  });
  return Became(std::move(committed), std::move(written), counts ? rests_on : nullptr);
}

absl::StatusOr<DerivedData> Catalog::GetDerived(const std::string& id,
                                                const DerivedWanted& wanted) {
  const std::lock_guard lock(mutex_);
  Database* db = database_.get();
  HOROPTER_ASSIGN_OR_RETURN(const bool exists, Exists(db, id));
  if (!exists) return NotFound(id);
  DerivedData derived;
  HOROPTER_RETURN_IF_ERROR(ReadDerived(db, id, wanted, derived));
  return derived;
}

absl::Status Catalog::DeleteObject(const std::string& id, RestsOn rests_on) {
  const std::lock_guard lock(mutex_);
  Database* db = database_.get();
  WriteIdentity written;
  absl::Status committed = database_->RunFreeing([&]() -> absl::Status {
    HOROPTER_ASSIGN_OR_RETURN(const bool exists, Exists(db, id));
    if (!exists) return NotFound(id);
    HOROPTER_RETURN_IF_ERROR(DeleteRows(db, "object", id));
    HOROPTER_ASSIGN_OR_RETURN(written, CountGeneration(db, rests_on));
    return absl::OkStatus();
  });
  return Became(std::move(committed), std::move(written), rests_on);
}

absl::StatusOr<ObjectSummary> Catalog::GetSummary(const std::string& id) {
  const std::lock_guard lock(mutex_);
  HOROPTER_ASSIGN_OR_RETURN(std::vector<ObjectSummary> found,
                            ReadSummaries(database_.get(), id, /*exactly=*/true, 1));
  if (found.empty()) return NotFound(id);
  return std::move(found.front());
}

absl::StatusOr<CatalogRecord> Catalog::GetObject(const std::string& id) {
  const std::lock_guard lock(mutex_);
  Database* db = database_.get();
  HOROPTER_ASSIGN_OR_RETURN(std::vector<ObjectSummary> found,
                            ReadSummaries(db, id, /*exactly=*/true, 1));
  if (found.empty()) return NotFound(id);
  return ReadRecord(db, std::move(found.front().record));
}

absl::StatusOr<std::string> Catalog::GetCadFile(const std::string& id) {
  const std::lock_guard lock(mutex_);
  Statement select(database_.get(), "SELECT content, sha256 FROM cad_source WHERE object_id = ?");
  select.Bind(std::string_view(id));
  HOROPTER_ASSIGN_OR_RETURN(const bool row, select.Step());
  if (!row) return NotFound(id);
  std::string content = select.Text(0);
  if (!content.empty() && Sha256Hex(content) != select.Text(1)) {
    return absl::DataLossError(
        absl::StrCat("object ", id, ": the stored CAD file differs from its SHA-256"));
  }
  return content;
}

absl::StatusOr<std::vector<ObjectSummary>> Catalog::ListObjects(const std::string& after_id,
                                                                int limit) {
  if (limit < 1) return absl::InvalidArgumentError("page_size: must be positive");
  const std::lock_guard lock(mutex_);
  return ReadSummaries(database_.get(), after_id, /*exactly=*/false, limit);
}

absl::StatusOr<int> Catalog::CountObjects() {
  const std::lock_guard lock(mutex_);
  HOROPTER_ASSIGN_OR_RETURN(const int64_t count,
                            QueryInt(database_.get(), "SELECT count(*) FROM object"));
  return static_cast<int>(count);
}

absl::StatusOr<int64_t> Catalog::Generation() {
  const std::lock_guard lock(mutex_);
  return QueryInt(database_.get(), "SELECT generation FROM catalog_state");
}

absl::Status Catalog::ReadAfter(WriteIdentity* seen, const std::function<absl::Status()>& read) {
  if (seen == nullptr) return read();
  WriteIdentity last;
  HOROPTER_RETURN_IF_ERROR(database_->ReadAtOneMoment([&]() -> absl::Status {
    HOROPTER_ASSIGN_OR_RETURN(last, LastWriteAfter(database_.get(), *seen));
    return read();
  }));
  *seen = std::move(last);
  return absl::OkStatus();
}

absl::StatusOr<WriteIdentity> Catalog::LastWrite() {
  const std::lock_guard lock(mutex_);
  return LastWriteAfter(database_.get(), {});
}

absl::StatusOr<std::vector<LoadedObject>> Catalog::LoadObjects(const std::string& after_id,
                                                               int limit,
                                                               const DerivedWanted& wanted,
                                                               WriteIdentity* seen) {
  if (limit < 1) return absl::InvalidArgumentError("limit: must be positive");
  const std::lock_guard lock(mutex_);
  Database* db = database_.get();
  std::vector<LoadedObject> objects;
  HOROPTER_RETURN_IF_ERROR(ReadAfter(seen, [&]() -> absl::Status {
    HOROPTER_ASSIGN_OR_RETURN(std::vector<ObjectSummary> found,
                              ReadSummaries(db, after_id, /*exactly=*/false, limit));
    objects.reserve(found.size());
    for (ObjectSummary& summary : found) {
      HOROPTER_ASSIGN_OR_RETURN(objects.emplace_back(),
                                LoadFound(db, std::move(summary.record), wanted));
    }
    return absl::OkStatus();
  }));
  return objects;
}

absl::StatusOr<std::vector<LoadedObject>> Catalog::LoadObjects(std::span<const std::string> ids,
                                                               const DerivedWanted& wanted,
                                                               WriteIdentity* seen) {
  const std::lock_guard lock(mutex_);
  Database* db = database_.get();
  std::vector<LoadedObject> objects;
  HOROPTER_RETURN_IF_ERROR(ReadAfter(seen, [&]() -> absl::Status {
    for (const std::string& id : ids) {
      HOROPTER_ASSIGN_OR_RETURN(std::vector<ObjectSummary> found,
                                ReadSummaries(db, id, /*exactly=*/true, 1));
      if (found.empty()) continue;
      HOROPTER_ASSIGN_OR_RETURN(objects.emplace_back(),
                                LoadFound(db, std::move(found.front().record), wanted));
    }
    return absl::OkStatus();
  }));
  return objects;
}

absl::StatusOr<LoadedObject> Catalog::LoadObject(const std::string& id,
                                                 const DerivedWanted& wanted) {
  HOROPTER_ASSIGN_OR_RETURN(std::vector<LoadedObject> found,
                            LoadObjects(std::span(&id, 1), wanted));
  if (found.empty()) return NotFound(id);
  HOROPTER_RETURN_IF_ERROR(found.front().damage);
  return std::move(found.front());
}

absl::StatusOr<std::vector<StoredKeys>> Catalog::LoadKeys(const std::string& after_id,
                                                          int limit,
                                                          int version) {
  if (limit < 1) return absl::InvalidArgumentError("limit: must be positive");
  const std::lock_guard lock(mutex_);
  return ReadKeys(database_.get(), after_id, limit, version);
}

absl::StatusOr<std::vector<DerivedEntry>> Catalog::ListDerived(
    const std::string& after_id, int limit, int version, int64_t since, WriteIdentity* seen) {
  if (limit < 1) return absl::InvalidArgumentError("limit: must be positive");
  const std::lock_guard lock(mutex_);
  std::vector<DerivedEntry> entries;
  HOROPTER_RETURN_IF_ERROR(ReadAfter(seen, [&]() -> absl::Status {
    HOROPTER_ASSIGN_OR_RETURN(entries,
                              ReadDerivedEntries(database_.get(), after_id, limit, version, since));
    return absl::OkStatus();
  }));
  return entries;
}

}  // namespace horopter
