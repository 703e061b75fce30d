#include "db/object_versions.h"

#include <array>
#include <mutex>
#include <optional>
#include <utility>

#include "absl/strings/str_cat.h"
#include "db/blob.h"
#include "db/object_digest.h"
#include "db/object_rows.h"
#include "db/version_blob.h"
#include "server/base/sha256.h"
#include "server/base/status_macros.h"

namespace horopter {
namespace {

// Bits of object_version.changes.
constexpr std::array<bool UpdateParts::*, 7> kParts = {&UpdateParts::display_name,
                                                       &UpdateParts::geometry,
                                                       &UpdateParts::symmetries,
                                                       &UpdateParts::grasps,
                                                       &UpdateParts::source,
                                                       &UpdateParts::labels,
                                                       &UpdateParts::print};

int64_t BitsOf(const UpdateParts& parts) {
  int64_t bits = 0;
  for (size_t i = 0; i < kParts.size(); ++i) bits |= int64_t{parts.*kParts[i]} << i;
  return bits;
}

UpdateParts PartsOf(int64_t bits) {
  UpdateParts parts;
  for (size_t i = 0; i < kParts.size(); ++i) parts.*kParts[i] = ((bits >> i) & 1) != 0;
  return parts;
}

absl::Status NoVersion(const std::string& id, int64_t revision) {
  return absl::NotFoundError(
      absl::StrCat("object '", id, "' has no revision ", revision, ", or none any more"));
}

absl::Status Damaged(const std::string& id, int64_t version, std::string_view what) {
  return absl::DataLossError(
      absl::StrCat("object ", id, ": revision ", version, ": ", std::string(what)));
}

absl::StatusOr<ObjectSummary> SummaryOf(Database* db, const std::string& id) {
  HOROPTER_ASSIGN_OR_RETURN(std::vector<ObjectSummary> found,
                            ReadSummaries(db, id, /*exactly=*/true, 1));
  if (!found.empty()) {
    HOROPTER_RETURN_IF_ERROR(ReadPrint(db, found.front().record.model));
    return std::move(found.front());
  }
  return absl::NotFoundError(absl::StrCat("object '", id, "' is not in the catalog"));
}

// The bytes of one kind alone, to be compared.
std::string Bytes(const std::vector<Rigid3>& symmetries, const std::vector<Grasp>& grasps) {
  ObjectSummary alone;
  alone.record.model.symmetries = symmetries;
  alone.record.model.grasps = grasps;
  return EncodeDetails(alone);
}

UpdateParts Differing(const FormerState& a, const FormerState& b) {
  const CatalogRecord& was = a.summary.record;
  const CatalogRecord& is = b.summary.record;
  const auto file = [](const CadSource& s) {
    return std::array<std::string, 4>{s.file_name, s.format, s.unit, s.sha256};
  };
  return {.display_name = was.model.display_name != is.model.display_name,
          .geometry = a.geometry != b.geometry,
          .symmetries = Bytes(was.model.symmetries, {}) != Bytes(is.model.symmetries, {}),
          .grasps = Bytes({}, was.model.grasps) != Bytes({}, is.model.grasps),
          .source = file(was.source) != file(is.source),
          .labels = was.labels != is.labels,
          .print = EncodePrint(was.model.print) != EncodePrint(is.model.print)};
}

// Versions that are too many, the oldest first, go.
absl::Status Forget(Database* db, const std::string& id, int64_t most_bytes) {
  Statement select(db,
                   "SELECT version, length(details) + coalesce(length(geometry), 0) + "
                   "coalesce(length(cad_file), 0) FROM object_version WHERE object_id = ? "
                   "ORDER BY version DESC");
  select.Bind(std::string_view(id));
  int64_t bytes = 0, oldest = 0;
  for (int kept = 0; kept <= kKeptVersions; ++kept) {
    HOROPTER_ASSIGN_OR_RETURN(const bool row, select.Step());
    if (!row) return absl::OkStatus();
    bytes += select.Int(1);
    oldest = select.Int(0);
    if (bytes > most_bytes) break;
  }
  Statement forget(db, "DELETE FROM object_version WHERE object_id = ? AND version <= ?");
  forget.Bind(std::string_view(id)).Bind(oldest);
  return forget.Run();
}

// Columns of a version that every reader needs.
constexpr char kColumns[] = "version, update_time, changed_by, changes, details_sha256, details";

absl::StatusOr<ObjectSummary> DetailsOf(const Statement& row, const std::string& id) {
  const int64_t version = row.Int(0);
  if (Sha256Hex(row.Bytes(5)) != row.Bytes(4)) {
    return Damaged(id, version, "differs from its SHA-256");
  }
  absl::StatusOr<ObjectSummary> summary = DecodeDetails(row.Bytes(5));
  if (!summary.ok()) return Damaged(id, version, std::string(summary.status().message()));
  CatalogRecord& record = summary->record;
  record.model.id = id;
  record.revision = version;
  record.update_time = row.Text(1);
  record.changed_by = row.Text(2);
  return summary;
}

// That of the version or the next one that has it; none: the object's own.
absl::StatusOr<std::optional<std::string>> GeometryOf(Database* db,
                                                      const std::string& id,
                                                      int64_t version) {
  Statement select(db,
                   "SELECT version, geometry, geometry_sha256 FROM object_version WHERE object_id "
                   "= ? AND version >= ? AND geometry IS NOT NULL ORDER BY version LIMIT 1");
  select.Bind(std::string_view(id)).Bind(version);
  HOROPTER_ASSIGN_OR_RETURN(const bool row, select.Step());
  if (!row) return std::nullopt;
  if (Sha256Hex(select.Bytes(1)) != select.Bytes(2)) {
    return Damaged(id, select.Int(0), "its geometry differs from its SHA-256");
  }
  return select.Text(1);
}

absl::StatusOr<std::string> CadFileOf(Database* db, const std::string& id, int64_t version) {
  Statement former(db,
                   "SELECT cad_file FROM object_version WHERE object_id = ? AND version >= ? AND "
                   "cad_file IS NOT NULL ORDER BY version LIMIT 1");
  former.Bind(std::string_view(id)).Bind(version);
  HOROPTER_ASSIGN_OR_RETURN(const bool row, former.Step());
  if (row) return former.Text(0);
  Statement own(db, "SELECT content FROM cad_source WHERE object_id = ?");
  own.Bind(std::string_view(id));
  HOROPTER_ASSIGN_OR_RETURN(const bool there, own.Step());
  return there ? own.Text(0) : std::string();
}

absl::Status FillGeometry(Database* db, int64_t version, ObjectModel* model) {
  HOROPTER_ASSIGN_OR_RETURN(const std::optional<std::string> geometry,
                            GeometryOf(db, model->id, version));
  if (geometry) {
    const absl::Status decoded = DecodeGeometry(*geometry, model);
    if (!decoded.ok()) return Damaged(model->id, version, std::string(decoded.message()));
    return absl::OkStatus();
  }
  HOROPTER_ASSIGN_OR_RETURN(ObjectSummary now, SummaryOf(db, model->id));
  HOROPTER_RETURN_IF_ERROR(ReadGeometry(db, now.record.model));
  HOROPTER_RETURN_IF_ERROR(CheckDigest(db, now.record.model));
  model->diameter_m = now.record.model.diameter_m;
  model->vertices = std::move(now.record.model.vertices);
  model->edges = std::move(now.record.model.edges);
  model->mesh = std::move(now.record.model.mesh);
  return absl::OkStatus();
}

}  // namespace

absl::StatusOr<FormerState> ReadState(Database* db,
                                      const std::string& id,
                                      const UpdateParts& parts) {
  FormerState state;
  HOROPTER_ASSIGN_OR_RETURN(state.summary, SummaryOf(db, id));
  if (parts.geometry) {
    ObjectModel model;
    model.id = id;
    model.diameter_m = state.summary.record.model.diameter_m;
    HOROPTER_RETURN_IF_ERROR(ReadGeometry(db, model));
    state.geometry = EncodeGeometry(model);
  }
  if (parts.source) {
    Statement select(db, "SELECT content FROM cad_source WHERE object_id = ?");
    select.Bind(std::string_view(id));
    HOROPTER_ASSIGN_OR_RETURN(const bool row, select.Step());
    if (row) state.cad_file = select.Text(0);
  }
  return state;
}

absl::Status KeepVersion(Database* db,
                         const FormerState& former,
                         const UpdateParts& parts,
                         int64_t most_bytes) {
  const CatalogRecord& record = former.summary.record;
  const std::string& id = record.model.id;
  HOROPTER_ASSIGN_OR_RETURN(const FormerState now, ReadState(db, id, {.geometry = parts.geometry}));
  const int64_t changes = BitsOf(Differing(former, now));
  if (changes == 0) return absl::OkStatus();
  const std::string details = EncodeDetails(former.summary);
  const std::string sha256 = Sha256Hex(details);
  Statement insert(db, "INSERT INTO object_version VALUES (?, ?, ?, ?, ?, ?, ?, ?, ?, ?)");
  insert.Bind(std::string_view(id))
      .Bind(record.revision)
      .Bind(std::string_view(record.update_time))
      .Bind(std::string_view(record.changed_by))
      .Bind(changes)
      .Bind(std::string_view(sha256))
      .BindBlob(details);
  const std::string geometry_sha256 = Sha256Hex(former.geometry);
  if (former.geometry != now.geometry) {
    insert.Bind(std::string_view(geometry_sha256)).BindBlob(former.geometry);
  } else {
    insert.BindNull().BindNull();
  }
  if (record.source.sha256 != now.summary.record.source.sha256) {
    insert.BindBlob(former.cad_file);
  } else {
    insert.BindNull();
  }
  HOROPTER_RETURN_IF_ERROR(insert.Run());
  return Forget(db, id, most_bytes);
}

absl::StatusOr<std::vector<ObjectVersion>> ReadVersions(Database* db, const std::string& id) {
  std::vector<ObjectVersion> versions(1);
  HOROPTER_ASSIGN_OR_RETURN(versions.front().summary, SummaryOf(db, id));
  Statement select(
      db,
      absl::StrCat(
          "SELECT ", kColumns, " FROM object_version WHERE object_id = ? ORDER BY version DESC"));
  select.Bind(std::string_view(id));
  while (true) {
    HOROPTER_ASSIGN_OR_RETURN(const bool row, select.Step());
    if (!row) return versions;
    versions.back().changed = PartsOf(select.Int(3));
    HOROPTER_ASSIGN_OR_RETURN(versions.emplace_back().summary, DetailsOf(select, id));
  }
}

absl::StatusOr<CatalogRecord> ReadVersion(Database* db, const std::string& id, int64_t revision) {
  HOROPTER_ASSIGN_OR_RETURN(ObjectSummary summary, SummaryOf(db, id));
  if (summary.record.revision != revision) {
    Statement select(
        db,
        absl::StrCat(
            "SELECT ", kColumns, " FROM object_version WHERE object_id = ? AND version = ?"));
    select.Bind(std::string_view(id)).Bind(revision);
    HOROPTER_ASSIGN_OR_RETURN(const bool row, select.Step());
    if (!row) return NoVersion(id, revision);
    HOROPTER_ASSIGN_OR_RETURN(summary, DetailsOf(select, id));
  }
  CatalogRecord& record = summary.record;
  HOROPTER_RETURN_IF_ERROR(FillGeometry(db, revision, &record.model));
  HOROPTER_ASSIGN_OR_RETURN(record.source.content, CadFileOf(db, id, revision));
  const std::string sha256 = record.source.content.empty() ? "" : Sha256Hex(record.source.content);
  if (sha256 != record.source.sha256) {
    return Damaged(id, revision, "its CAD file differs from its SHA-256");
  }
  return std::move(record);
}

std::vector<std::string> CheckVersions(Database* db, const std::string& id) {
  std::vector<std::string> problems;
  std::vector<int64_t> versions;
  Statement select(db, "SELECT version FROM object_version WHERE object_id = ?");
  select.Bind(std::string_view(id));
  absl::StatusOr<bool> row;
  while ((row = select.Step()).ok() && *row) versions.push_back(select.Int(0));
  if (!row.ok()) problems.emplace_back(row.status().message());
  for (const int64_t version : versions) {
    const absl::Status read = ReadVersion(db, id, version).status();
    if (!read.ok()) problems.emplace_back(read.message());
  }
  return problems;
}

absl::StatusOr<std::vector<ObjectVersion>> Catalog::ListVersions(const std::string& id) {
  const std::lock_guard lock(mutex_);
  return ReadVersions(database_.get(), id);
}

absl::StatusOr<CatalogRecord> Catalog::GetVersion(const std::string& id, int64_t revision) {
  const std::lock_guard lock(mutex_);
  return ReadVersion(database_.get(), id, revision);
}

}  // namespace horopter
