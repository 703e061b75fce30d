#include "db/object_rows.h"

#include "absl/strings/str_cat.h"
#include "db/blob.h"
#include "server/base/sha256.h"
#include "server/base/status_macros.h"
#include "server/vision/geometry/grasp_kind.h"

namespace horopter {
namespace {

constexpr int64_t kSuctionKind = 1;  // grasp.kind

void BindRigid(Statement& statement, const Rigid3& transform) {
  for (int row = 0; row < 3; ++row) {
    for (int col = 0; col < 3; ++col) statement.Bind(transform.R(row, col));
  }
  for (int i = 0; i < 3; ++i) statement.Bind(transform.t[i]);
}

Rigid3 ReadRigid(const Statement& statement, int first_column) {
  Rigid3 transform;
  for (int row = 0; row < 3; ++row) {
    for (int col = 0; col < 3; ++col)
      transform.R(row, col) = statement.Double(first_column + 3 * row + col);
  }
  for (int i = 0; i < 3; ++i) transform.t[i] = statement.Double(first_column + 9 + i);
  return transform;
}

// Calls row(statement) for each row.
template <typename RowFunction>
absl::Status ForEachRow(Statement& statement, const RowFunction& row) {
  while (true) {
    HOROPTER_ASSIGN_OR_RETURN(const bool more, statement.Step());
    if (!more) return absl::OkStatus();
    HOROPTER_RETURN_IF_ERROR(row(statement));
  }
}

absl::Status NameObject(const absl::Status& status, const std::string& id) {
  return absl::Status(status.code(),
                      absl::StrCat("object ", id, ": ", std::string(status.message())));
}

}  // namespace

absl::Status InsertObjectRow(Database* db, const CatalogRecord& record, int64_t revision) {
  const ObjectModel& model = record.model;
  Statement insert(db, "INSERT INTO object VALUES (?, ?, ?, ?, ?, ?, ?, ?, ?, ?)");
  insert.Bind(std::string_view(model.id))
      .Bind(std::string_view(model.display_name))
      .Bind(model.diameter_m);
  insert.Bind(std::string_view(record.create_time)).Bind(std::string_view(record.update_time));
  insert.Bind(static_cast<int64_t>(model.vertices.size()))
      .Bind(static_cast<int64_t>(model.edges.size()))
      .Bind(static_cast<int64_t>(model.mesh.triangles.size()))
      .Bind(revision)
      .Bind(std::string_view(record.changed_by));
  return insert.Run();
}

absl::Status InsertGeometry(Database* db, const ObjectModel& model) {
  Statement vertex(db, "INSERT INTO vertex VALUES (?, ?, ?, ?, ?)");
  for (size_t i = 0; i < model.vertices.size(); ++i) {
    const Eigen::Vector3d& v = model.vertices[i];
    vertex.Bind(std::string_view(model.id))
        .Bind(static_cast<int64_t>(i))
        .Bind(v.x())
        .Bind(v.y())
        .Bind(v.z());
    HOROPTER_RETURN_IF_ERROR(vertex.Run());
  }
  Statement edge(db, "INSERT INTO edge VALUES (?, ?, ?, ?, ?, ?, ?)");
  for (size_t i = 0; i < model.edges.size(); ++i) {
    const ModelEdge& e = model.edges[i];
    edge.Bind(std::string_view(model.id))
        .Bind(static_cast<int64_t>(i))
        .Bind(static_cast<int64_t>(e.kind));
    for (const int end : {e.start_vertex, e.end_vertex}) {
      end < 0 ? edge.BindNull() : edge.Bind(static_cast<int64_t>(end));
    }
    const std::string polyline = EncodePolyline(e.polyline);
    edge.Bind(e.dihedral_rad).BindBlob(polyline);
    HOROPTER_RETURN_IF_ERROR(edge.Run());
  }
  const std::string data = EncodeMesh(model.mesh);
  Statement mesh(db, "INSERT INTO mesh VALUES (?, ?)");
  mesh.Bind(std::string_view(model.id)).BindBlob(data);
  return mesh.Run();
}

absl::Status InsertSymmetries(Database* db, const ObjectModel& model) {
  Statement insert(db, "INSERT INTO symmetry VALUES (?, ?, ?, ?, ?, ?, ?, ?, ?, ?, ?, ?, ?, ?)");
  for (size_t i = 0; i < model.symmetries.size(); ++i) {
    insert.Bind(std::string_view(model.id)).Bind(static_cast<int64_t>(i));
    BindRigid(insert, model.symmetries[i]);
    HOROPTER_RETURN_IF_ERROR(insert.Run());
  }
  return absl::OkStatus();
}

absl::Status InsertGrasps(Database* db, const ObjectModel& model) {
  Statement insert(
      db,
      "INSERT INTO grasp VALUES (?, ?, ?, ?, ?, ?, ?, ?, ?, ?, ?, ?, ?, ?, ?, ?, ?, ?, "
      "?, ?, ?, ?, ?, ?, ?, ?, ?, ?, ?, ?, ?, ?)");
  for (size_t i = 0; i < model.grasps.size(); ++i) {
    const Grasp& grasp = model.grasps[i];
    insert.Bind(std::string_view(model.id)).Bind(static_cast<int64_t>(i));
    BindRigid(insert, grasp.object_from_gripper);
    const bool suction = IsSuction(grasp);
    insert.Bind(std::string_view(grasp.name))
        .Bind(suction ? 0.0 : grasp.jaw_opening_m)
        .Bind(suction ? 0.0 : grasp.grip_width_m)
        .Bind(grasp.quality);
    if (grasp.object_from_pregrasp) {
      BindRigid(insert, *grasp.object_from_pregrasp);
    } else {
      for (int k = 0; k < 12; ++k) insert.BindNull();
    }
    insert.Bind(static_cast<int64_t>(suction)).Bind(suction ? CupRadius(grasp) : 0.0);
    HOROPTER_RETURN_IF_ERROR(insert.Run());
  }
  return absl::OkStatus();
}

absl::Status InsertPrint(Database* db, const ObjectModel& model) {
  if (model.print.places.empty()) return absl::OkStatus();
  Statement insert(db, "INSERT INTO surface_print VALUES (?, ?, ?)");
  const std::string data = EncodePrint(model.print), sha256 = Sha256Hex(data);
  insert.Bind(std::string_view(model.id)).Bind(std::string_view(sha256)).BindBlob(data);
  return insert.Run();
}

absl::Status InsertLabels(Database* db,
                          const std::string& id,
                          const std::map<std::string, std::string>& labels) {
  Statement insert(db, "INSERT INTO label VALUES (?, ?, ?)");
  for (const auto& [key, value] : labels) {
    insert.Bind(std::string_view(id)).Bind(std::string_view(key)).Bind(std::string_view(value));
    HOROPTER_RETURN_IF_ERROR(insert.Run());
  }
  return absl::OkStatus();
}

absl::Status InsertSource(Database* db, const std::string& id, const CadSource& source) {
  Statement insert(db, "INSERT INTO cad_source VALUES (?, ?, ?, ?, ?, ?)");
  insert.Bind(std::string_view(id))
      .Bind(std::string_view(source.file_name))
      .Bind(std::string_view(source.format));
  insert.Bind(std::string_view(source.unit))
      .Bind(std::string_view(source.sha256))
      .BindBlob(source.content);
  return insert.Run();
}

absl::Status WriteDerived(Database* db, const std::string& id, const DerivedData& derived) {
  if (derived.data.empty()) {
    Statement remove(db, "DELETE FROM derived WHERE object_id = ?");
    remove.Bind(std::string_view(id));
    return remove.Run();
  }
  const auto version = static_cast<int64_t>(derived.version);
  Statement write(db,
                  "INSERT INTO derived VALUES (?, ?, ?, ?) ON CONFLICT (object_id, version) DO "
                  "UPDATE SET address = excluded.address, data = excluded.data");
  write.Bind(std::string_view(id))
      .Bind(version)
      .Bind(std::string_view(derived.address))
      .BindBlob(derived.data);
  HOROPTER_RETURN_IF_ERROR(write.Run());
  Statement keys(db,
                 "INSERT INTO derived_keys VALUES (?, ?, ?) ON CONFLICT (object_id, version) DO "
                 "UPDATE SET data = excluded.data");
  keys.Bind(std::string_view(id)).Bind(version).BindBlob(derived.keys);
  HOROPTER_RETURN_IF_ERROR(keys.Run());
  static_assert(kKeptDerivedVersions == 2, "one beside the one that is written");
  Statement forget(db,
                   "DELETE FROM derived WHERE object_id = ? AND version <> ? AND version < (SELECT "
                   "max(o.version) FROM derived o WHERE o.object_id = ? AND o.version <> ?)");
  forget.Bind(std::string_view(id)).Bind(version).Bind(std::string_view(id)).Bind(version);
  return forget.Run();
}

absl::Status ReplaceDerived(Database* db, const std::string& id, const DerivedData& derived) {
  HOROPTER_RETURN_IF_ERROR(WriteDerived(db, id, {}));
  return derived.data.empty() ? absl::OkStatus() : WriteDerived(db, id, derived);
}

namespace {

// A condition on the version of `derived d`.
std::string OfVersion(int version) {
  return version == kNewestVersion ? "d.version = (SELECT max(v.version) FROM derived v WHERE "
                                     "v.object_id = d.object_id)"
                                   : absl::StrCat("d.version = ", version);
}

}  // namespace

absl::Status ReadDerived(Database* db,
                         const std::string& id,
                         const DerivedWanted& wanted,
                         DerivedData& derived) {
  const std::string condition =
      absl::StrCat("WHERE d.object_id = ? AND ", OfVersion(wanted.version));
  Statement select(
      db,
      wanted.bytes
          ? absl::StrCat("SELECT d.version, d.address, d.data, k.data FROM derived d LEFT JOIN "
                         "derived_keys k ON k.object_id = d.object_id AND k.version = d.version ",
                         condition)
          : absl::StrCat("SELECT d.version, d.address FROM derived d ", condition));
  select.Bind(std::string_view(id));
  return ForEachRow(select, [&](const Statement& row) {
    derived.version = static_cast<int>(row.Int(0));
    derived.address = row.Text(1);
    if (!wanted.bytes) return absl::OkStatus();
    derived.data = row.Text(2);
    derived.keys = row.Text(3);
    return absl::OkStatus();
  });
}

absl::StatusOr<std::vector<StoredKeys>> ReadKeys(Database* db,
                                                 const std::string& after,
                                                 int limit,
                                                 int version) {
  Statement select(
      db,
      absl::StrCat("SELECT o.object_id, d.version, o.vertex_count, k.data, d.address FROM object o "
                   "LEFT JOIN derived d ON d.object_id = o.object_id AND ",
                   OfVersion(version),
                   " LEFT JOIN derived_keys k ON k.object_id = d.object_id AND k.version = "
                   "d.version WHERE o.object_id > ? ORDER BY o.object_id LIMIT ?"));
  select.Bind(std::string_view(after)).Bind(static_cast<int64_t>(limit));
  std::vector<StoredKeys> found;
  HOROPTER_RETURN_IF_ERROR(ForEachRow(select, [&](const Statement& row) {
    found.push_back({row.Text(0),
                     static_cast<int>(row.Int(1)),
                     static_cast<int>(row.Int(2)),
                     row.Text(3),
                     row.Text(4)});
    return absl::OkStatus();
  }));
  return found;
}

absl::StatusOr<std::vector<DerivedEntry>> ReadDerivedEntries(
    Database* db, const std::string& after, int limit, int version, int64_t since) {
  // The sum keeps SQLite from its index of the primary key, which has no address: each row of data
  // would be read.
  Statement select(
      db,
      absl::StrCat("SELECT o.object_id, d.version, d.address FROM object o LEFT JOIN "
                   "derived d ON d.object_id = o.object_id AND ",
                   version == kNewestVersion ? OfVersion(version)
                                             : absl::StrCat("d.version + 0 = ", version),
                   " WHERE o.object_id > ? AND o.revision > ? ORDER BY o.object_id LIMIT ?"));
  select.Bind(std::string_view(after)).Bind(since).Bind(static_cast<int64_t>(limit));
  std::vector<DerivedEntry> found;
  HOROPTER_RETURN_IF_ERROR(ForEachRow(select, [&](const Statement& row) {
    found.push_back({row.Text(0), static_cast<int>(row.Int(1)), row.Text(2)});
    return absl::OkStatus();
  }));
  return found;
}

absl::Status ReadGeometry(Database* db, ObjectModel& model) {
  Statement vertex(db, "SELECT x, y, z FROM vertex WHERE object_id = ? ORDER BY idx");
  vertex.Bind(std::string_view(model.id));
  HOROPTER_RETURN_IF_ERROR(ForEachRow(vertex, [&](const Statement& row) {
    model.vertices.emplace_back(row.Double(0), row.Double(1), row.Double(2));
    return absl::OkStatus();
  }));
  Statement edge(db,
                 "SELECT kind, start_vertex, end_vertex, dihedral_rad, polyline FROM edge "
                 "WHERE object_id = ? ORDER BY idx");
  edge.Bind(std::string_view(model.id));
  const absl::Status edges = ForEachRow(edge, [&](const Statement& row) -> absl::Status {
    ModelEdge e;
    e.kind = static_cast<CurveKind>(row.Int(0));
    e.start_vertex = row.IsNull(1) ? -1 : static_cast<int>(row.Int(1));
    e.end_vertex = row.IsNull(2) ? -1 : static_cast<int>(row.Int(2));
    e.dihedral_rad = row.Double(3);
    absl::StatusOr<std::vector<Eigen::Vector3d>> polyline = DecodePolyline(row.Bytes(4));
    if (!polyline.ok()) return NameObject(polyline.status(), model.id);
    e.polyline = *std::move(polyline);
    model.edges.push_back(std::move(e));
    return absl::OkStatus();
  });
  if (!edges.ok()) return edges;
  Statement mesh(db, "SELECT data FROM mesh WHERE object_id = ?");
  mesh.Bind(std::string_view(model.id));
  return ForEachRow(mesh, [&](const Statement& row) -> absl::Status {
    absl::StatusOr<TriangleMesh> decoded = DecodeMesh(row.Bytes(0));
    if (!decoded.ok()) return NameObject(decoded.status(), model.id);
    model.mesh = *std::move(decoded);
    return absl::OkStatus();
  });
}

absl::Status ReadSymmetries(Database* db, ObjectModel& model) {
  Statement select(db,
                   "SELECT r11, r12, r13, r21, r22, r23, r31, r32, r33, tx, ty, tz FROM symmetry "
                   "WHERE object_id = ? ORDER BY idx");
  select.Bind(std::string_view(model.id));
  return ForEachRow(select, [&](const Statement& row) {
    model.symmetries.push_back(ReadRigid(row, 0));
    return absl::OkStatus();
  });
}

absl::Status ReadGrasps(Database* db, ObjectModel& model) {
  Statement select(
      db,
      "SELECT r11, r12, r13, r21, r22, r23, r31, r32, r33, tx, ty, tz, name, jaw_opening_m, "
      "grip_width_m, quality, pre_r11, pre_r12, pre_r13, pre_r21, pre_r22, pre_r23, pre_r31, "
      "pre_r32, pre_r33, pre_tx, pre_ty, pre_tz, kind, cup_radius_m FROM grasp WHERE object_id = ? "
      "ORDER BY idx");
  select.Bind(std::string_view(model.id));
  return ForEachRow(select, [&](const Statement& row) {
    Grasp grasp;
    grasp.object_from_gripper = ReadRigid(row, 0);
    grasp.name = row.Text(12);
    grasp.jaw_opening_m = row.Double(13);
    grasp.grip_width_m = row.Double(14);
    grasp.quality = row.Double(15);
    if (!row.IsNull(16)) grasp.object_from_pregrasp = ReadRigid(row, 16);
    if (row.Int(28) == kSuctionKind) SetSuction(row.Double(29), &grasp);
    model.grasps.push_back(std::move(grasp));
    return absl::OkStatus();
  });
}

absl::Status ReadPrint(Database* db, ObjectModel& model) {
  Statement select(db, "SELECT sha256, data FROM surface_print WHERE object_id = ?");
  select.Bind(std::string_view(model.id));
  return ForEachRow(select, [&](const Statement& row) -> absl::Status {
    if (Sha256Hex(row.Bytes(1)) != row.Bytes(0))
      return NameObject(absl::DataLossError("its print differs from its SHA-256"), model.id);
    absl::StatusOr<SurfacePrint> print = DecodePrint(row.Bytes(1));
    if (!print.ok()) return NameObject(print.status(), model.id);
    model.print = *std::move(print);
    return absl::OkStatus();
  });
}

absl::Status ReadSource(Database* db, const std::string& id, CadSource& source) {
  Statement select(db,
                   "SELECT file_name, format, unit, sha256, length(content) FROM cad_source WHERE "
                   "object_id = ?");
  select.Bind(std::string_view(id));
  return ForEachRow(select, [&](const Statement& row) {
    source.file_name = row.Text(0);
    source.format = row.Text(1);
    source.unit = row.Text(2);
    source.sha256 = row.Text(3);
    source.size_bytes = row.Int(4);
    return absl::OkStatus();
  });
}

namespace {

absl::Status ReadLabels(Database* db, CatalogRecord& record) {
  Statement select(db, "SELECT key, value FROM label WHERE object_id = ?");
  select.Bind(std::string_view(record.model.id));
  return ForEachRow(select, [&](const Statement& row) {
    record.labels[row.Text(0)] = row.Text(1);
    return absl::OkStatus();
  });
}

}  // namespace

absl::StatusOr<std::vector<ObjectSummary>> ReadSummaries(Database* db,
                                                         const std::string& after,
                                                         bool exactly,
                                                         int limit) {
  Statement select(
      db,
      absl::StrCat("SELECT object_id, display_name, diameter_m, create_time, update_time, "
                   "vertex_count, edge_count, triangle_count, revision, changed_by FROM object "
                   "WHERE object_id ",
                   exactly ? "=" : ">",
                   " ? ORDER BY object_id LIMIT ?"));
  select.Bind(std::string_view(after)).Bind(static_cast<int64_t>(limit));
  std::vector<ObjectSummary> summaries;
  HOROPTER_RETURN_IF_ERROR(ForEachRow(select, [&](const Statement& row) {
    ObjectSummary summary;
    summary.record.model.id = row.Text(0);
    summary.record.model.display_name = row.Text(1);
    summary.record.model.diameter_m = row.Double(2);
    summary.record.create_time = row.Text(3);
    summary.record.update_time = row.Text(4);
    summary.vertex_count = static_cast<int>(row.Int(5));
    summary.edge_count = static_cast<int>(row.Int(6));
    summary.triangle_count = static_cast<int>(row.Int(7));
    summary.record.revision = row.Int(8);
    summary.record.changed_by = row.Text(9);
    summaries.push_back(std::move(summary));
    return absl::OkStatus();
  }));
  for (ObjectSummary& summary : summaries) {
    HOROPTER_RETURN_IF_ERROR(ReadSymmetries(db, summary.record.model));
    HOROPTER_RETURN_IF_ERROR(ReadGrasps(db, summary.record.model));
    HOROPTER_RETURN_IF_ERROR(ReadSource(db, summary.record.model.id, summary.record.source));
    HOROPTER_RETURN_IF_ERROR(ReadLabels(db, summary.record));
  }
  return summaries;
}

}  // namespace horopter
