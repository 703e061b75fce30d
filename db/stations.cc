// Stations in the catalog's file.
#include <array>
#include <mutex>

#include "absl/strings/str_cat.h"
#include "absl/strings/str_join.h"
#include "absl/strings/str_split.h"
#include "db/catalog.h"
#include "db/database.h"
#include "server/base/status_macros.h"
#include "server/vision/geometry/station_blob.h"

namespace horopter {
namespace {

absl::Status NoStation(const std::string& id) {
  return absl::NotFoundError(absl::StrCat("station '", id, "' is not known"));
}

absl::Status ReadHandEye(Database* db, StationRecord* record) {
  Statement select(db,
                   "SELECT camera_id, r11, r12, r13, r21, r22, r23, r31, r32, r33, tx, ty, tz, "
                   "learnt, rotation_sigma_rad, position_sigma_m, requests "
                   "FROM station_hand_eye WHERE station_id = ?");
  select.Bind(std::string_view(record->id));
  while (true) {
    HOROPTER_ASSIGN_OR_RETURN(const bool row, select.Step());
    if (!row) return absl::OkStatus();
    CameraBase& base = record->bases[select.Text(0)];
    for (int i = 0; i < 9; ++i) base.base_from_camera.R(i / 3, i % 3) = select.Double(1 + i);
    for (int i = 0; i < 3; ++i) base.base_from_camera.t(i) = select.Double(10 + i);
    base.learnt = select.Int(13) != 0;
    base.rotation_sigma_rad = select.Double(14);
    base.position_sigma_m = select.Double(15);
    base.requests = select.Int(16);
  }
}

// Stations with id > after (or id == after when `exactly`), ordered by id.
absl::StatusOr<std::vector<StationRecord>> ReadStations(Database* db,
                                                        const std::string& after,
                                                        bool exactly,
                                                        int limit) {
  Statement select(
      db,
      absl::StrCat("SELECT station_id, display_name, create_time, update_time, revision, "
                   "agreed_request_id, agreed_time, state FROM station WHERE station_id ",
                   exactly ? "=" : ">",
                   " ? ORDER BY station_id LIMIT ?"));
  select.Bind(std::string_view(after)).Bind(static_cast<int64_t>(limit));
  std::vector<StationRecord> out;
  while (true) {
    HOROPTER_ASSIGN_OR_RETURN(const bool row, select.Step());
    if (!row) break;
    StationRecord& record = out.emplace_back();
    record.id = select.Text(0);
    record.display_name = select.Text(1);
    record.create_time = select.Text(2);
    record.update_time = select.Text(3);
    record.revision = select.Int(4);
    record.agreed_request_id = select.Text(5);
    record.agreed_time = select.Text(6);
    absl::StatusOr<StationState> state = DecodeStationState(select.Bytes(7));
    if (!state.ok()) {
      return absl::DataLossError(
          absl::StrCat("station ", record.id, ": ", std::string(state.status().message())));
    }
    record.state = *std::move(state);
  }
  for (StationRecord& record : out) HOROPTER_RETURN_IF_ERROR(ReadHandEye(db, &record));
  return out;
}

absl::StatusOr<int64_t> CountWrite(Database* db) {
  HOROPTER_RETURN_IF_ERROR(Execute(db, "UPDATE station_writes SET writes = writes + 1"));
  return QueryInt(db, "SELECT writes FROM station_writes");
}

absl::Status WriteHandEye(Database* db, const StationRecord& record) {
  Statement clear(db, "DELETE FROM station_hand_eye WHERE station_id = ?");
  clear.Bind(std::string_view(record.id));
  HOROPTER_RETURN_IF_ERROR(clear.Run());
  Statement insert(
      db,
      "INSERT INTO station_hand_eye (station_id, camera_id, r11, r12, r13, r21, r22, r23, r31, "
      "r32, "
      "r33, tx, ty, tz, learnt, rotation_sigma_rad, position_sigma_m, requests) VALUES "
      "(?, ?, ?, ?, ?, ?, ?, ?, ?, ?, ?, ?, ?, ?, ?, ?, ?, ?)");
  for (const auto& [camera, base] : record.bases) {
    const Rigid3& pose = base.base_from_camera;
    insert.Bind(std::string_view(record.id)).Bind(std::string_view(camera));
    for (int i = 0; i < 9; ++i) insert.Bind(pose.R(i / 3, i % 3));
    for (int i = 0; i < 3; ++i) insert.Bind(pose.t(i));
    insert.Bind(static_cast<int64_t>(base.learnt))
        .Bind(base.rotation_sigma_rad)
        .Bind(base.position_sigma_m)
        .Bind(static_cast<int64_t>(base.requests));
    HOROPTER_RETURN_IF_ERROR(insert.Run());
  }
  return absl::OkStatus();
}

absl::Status AddEvents(Database* db,
                       const std::string& id,
                       const std::vector<StationEventRecord>& events) {
  if (events.empty()) return absl::OkStatus();
  Statement insert(db,
                   "INSERT INTO station_event (station_id, kind, time, request_id, camera_ids, "
                   "detail) VALUES (?, ?, ?, ?, ?, ?)");
  for (const StationEventRecord& event : events) {
    const std::string cameras = absl::StrJoin(event.camera_ids, " ");
    insert.Bind(std::string_view(id))
        .Bind(static_cast<int64_t>(event.kind))
        .Bind(std::string_view(event.time))
        .Bind(std::string_view(event.request_id))
        .Bind(std::string_view(cameras))
        .Bind(std::string_view(event.detail));
    HOROPTER_RETURN_IF_ERROR(insert.Run());
  }
  Statement forget(db,
                   "DELETE FROM station_event WHERE station_id = ?1 AND sequence NOT IN (SELECT "
                   "sequence FROM station_event WHERE station_id = ?1 ORDER BY sequence DESC LIMIT "
                   "?2)");
  forget.Bind(std::string_view(id)).Bind(static_cast<int64_t>(kKeptStationEvents));
  return forget.Run();
}

absl::Status WriteRow(Database* db, const StationRecord& record) {
  Statement write(db,
                  "INSERT INTO station VALUES (?, ?, ?, ?, ?, ?, ?, ?) ON CONFLICT (station_id) DO "
                  "UPDATE SET display_name = excluded.display_name, update_time = "
                  "excluded.update_time, revision = excluded.revision, agreed_request_id = "
                  "excluded.agreed_request_id, agreed_time = excluded.agreed_time, state = "
                  "excluded.state");
  const std::string state = EncodeStationState(record.state);
  write.Bind(std::string_view(record.id))
      .Bind(std::string_view(record.display_name))
      .Bind(std::string_view(record.create_time))
      .Bind(std::string_view(record.update_time))
      .Bind(record.revision)
      .Bind(std::string_view(record.agreed_request_id))
      .Bind(std::string_view(record.agreed_time))
      .BindBlob(state);
  return write.Run();
}

}  // namespace

absl::StatusOr<StationRecord> Catalog::GetStation(const std::string& id) {
  const std::lock_guard lock(mutex_);
  HOROPTER_ASSIGN_OR_RETURN(std::vector<StationRecord> found,
                            ReadStations(database_.get(), id, true, 1));
  if (found.empty()) return NoStation(id);
  return std::move(found.front());
}

absl::StatusOr<std::vector<StationRecord>> Catalog::ListStations(const std::string& after_id,
                                                                 int limit) {
  if (limit < 1) return absl::InvalidArgumentError("page_size: must be positive");
  const std::lock_guard lock(mutex_);
  return ReadStations(database_.get(), after_id, false, limit);
}

absl::StatusOr<std::vector<StationEventRecord>> Catalog::StationEvents(const std::string& id) {
  const std::lock_guard lock(mutex_);
  Statement select(database_.get(),
                   "SELECT kind, time, request_id, camera_ids, detail FROM station_event WHERE "
                   "station_id = ? ORDER BY sequence DESC");
  select.Bind(std::string_view(id));
  std::vector<StationEventRecord> out;
  while (true) {
    HOROPTER_ASSIGN_OR_RETURN(const bool row, select.Step());
    if (!row) return out;
    out.push_back({static_cast<int>(select.Int(0)),
                   select.Text(1),
                   select.Text(2),
                   absl::StrSplit(select.Text(3), ' ', absl::SkipEmpty()),
                   select.Text(4)});
  }
}

absl::StatusOr<StationRecord> Catalog::WriteStation(const std::string& id,
                                                    const StationChangeFunction& change) {
  const std::lock_guard lock(mutex_);
  Database* db = database_.get();
  StationRecord written;
  const absl::Status done = RunInTransaction(db, [&]() -> absl::Status {
    HOROPTER_ASSIGN_OR_RETURN(std::vector<StationRecord> found, ReadStations(db, id, true, 1));
    std::vector<StationEventRecord> events;
    HOROPTER_ASSIGN_OR_RETURN(written, change(found.empty() ? nullptr : &found.front(), &events));
    written.id = id;
    HOROPTER_ASSIGN_OR_RETURN(written.revision, CountWrite(db));
    HOROPTER_RETURN_IF_ERROR(WriteRow(db, written));
    HOROPTER_RETURN_IF_ERROR(WriteHandEye(db, written));
    return AddEvents(db, id, events);
  });
  HOROPTER_RETURN_IF_ERROR(done);
  return written;
}

absl::Status Catalog::DeleteStation(
    const std::string& id, const std::function<absl::Status(const StationRecord& current)>& check) {
  const std::lock_guard lock(mutex_);
  Database* db = database_.get();
  return database_->RunFreeing([&]() -> absl::Status {
    const absl::StatusOr<std::vector<StationRecord>> found = ReadStations(db, id, true, 1);
    // What is damaged can be removed by whoever does not ask for a certain state of it.
    if (!found.ok() && (check || !absl::IsDataLoss(found.status()))) return found.status();
    if (found.ok() && found->empty()) return NoStation(id);
    if (check) HOROPTER_RETURN_IF_ERROR(check(found->front()));
    Statement remove(db, "DELETE FROM station WHERE station_id = ?");
    remove.Bind(std::string_view(id));
    HOROPTER_RETURN_IF_ERROR(remove.Run());
    return CountWrite(db).status();
  });
}

}  // namespace horopter
