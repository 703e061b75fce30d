#include "server/service/station_store.h"

#include <algorithm>
#include <chrono>
#include <numbers>
#include <opencv2/core/mat.hpp>
#include <utility>

#include "absl/strings/str_cat.h"
#include "absl/strings/str_format.h"
#include "absl/strings/str_split.h"
#include "absl/time/clock.h"
#include "absl/time/time.h"
#include "horopter/v1/station.pb.h"
#include "server/base/sha256.h"
#include "server/base/status_macros.h"
#include "server/service/rpc_status.h"
#include "server/vision/geometry/station_blob.h"

namespace horopter {
namespace {

constexpr double kDegrees = 180.0 / std::numbers::pi;

int IndexOfCamera(const StationState& state, const std::string& id) {
  for (size_t c = 0; c < state.cameras.size(); ++c) {
    if (state.cameras[c].id == id) return static_cast<int>(c);
  }
  return -1;
}

// The cameras of the images, those the state does not have yet appended; cameras of which nothing
// is known take the images' size.
absl::StatusOr<StationViews> CamerasOf(const std::vector<std::string>& ids,
                                       const std::vector<cv::Mat>& images,
                                       StationState* state,
                                       std::vector<std::string>* resized) {
  const StationOptions options;
  StationViews views;
  for (size_t i = 0; i < ids.size(); ++i) {
    const std::string field = absl::StrCat("images[", i, "].camera_id");
    if (!IsStationId(ids[i]))
      return InvalidField(field, "a request of a station needs [a-z0-9_-]{1,63} here");
    int c = IndexOfCamera(*state, ids[i]);
    if (c < 0 && static_cast<int>(state->cameras.size()) >= kMostStationCameras)
      return InvalidField(
          field, absl::StrCat("the station has ", kMostStationCameras, " cameras already"));
    const int width = images[i].cols, height = images[i].rows;
    if (c < 0) c = AddStationCamera(ids[i], width, height, options, state);
    StationCamera& camera = state->cameras[c];
    // One on the arm takes several; of one that stands still the second image is another's.
    if (const auto first = std::find(views.begin(), views.end(), c);
        first != views.end() && !camera.moving) {
      return InvalidField(field,
                          absl::StrCat("camera '",
                                       ids[i],
                                       "' took image ",
                                       first - views.begin(),
                                       " already; only one that is declared moving takes several"));
    }
    if (camera.camera.width != width || camera.camera.height != height) {
      if (camera.requests > 0) resized->push_back(ids[i]);
      camera.camera.width = width;
      camera.camera.height = height;
      ForgetLens(c, options, state);
      ForgetPlace(c, state);
    }
    views.push_back(c);
  }
  return views;
}

// Where the request's cameras are in the station, by their ids: others may have been added since.
// New ones are added, resized ones forgotten. Errors: FAILED_PRECONDITION, the station is full.
absl::StatusOr<StationViews> PlaceCameras(const StationStart& start,
                                          const std::string& request_id,
                                          const StationOptions& options,
                                          StationState* state,
                                          std::vector<StationEventRecord>* events) {
  StationViews views;
  for (const int c : start.request.views) {
    const StationCamera& camera = start.request.state.cameras[c];
    int index = IndexOfCamera(*state, camera.id);
    if (index < 0) {
      if (static_cast<int>(state->cameras.size()) >= kMostStationCameras)
        return absl::FailedPreconditionError("the station is full");
      index =
          AddStationCamera(camera.id, camera.camera.width, camera.camera.height, options, state);
      events->push_back({v1::StationEvent::KIND_CAMERA_ADDED,
                         StationTime(),
                         request_id,
                         {camera.id},
                         "first seen"});
    }
    StationCamera& now = state->cameras[index];
    if (now.camera.width != camera.camera.width || now.camera.height != camera.camera.height) {
      now.camera.width = camera.camera.width;
      now.camera.height = camera.camera.height;
      ForgetLens(index, options, state);
      ForgetPlace(index, state);
    }
    views.push_back(index);
  }
  return views;
}

}  // namespace

std::string StationName(const std::string& id) {
  return "stations/" + id;
}

std::string StationCameraName(const std::string& id, const std::string& camera) {
  return absl::StrCat("stations/", id, "/cameras/", camera);
}

absl::StatusOr<std::string> StationIdFromName(const std::string& name, const std::string& field) {
  const std::vector<std::string> parts = absl::StrSplit(name, '/');
  if (parts.size() == 2 && parts[0] == "stations" && IsStationId(parts[1])) return parts[1];
  return InvalidField(
      field,
      absl::StrCat("'",
                   name.substr(0, 80),
                   "' is not stations/{station} with {station} of [a-z0-9_-]{1,63}"));
}

absl::StatusOr<StationCameraId> StationCameraFromName(const std::string& name,
                                                      const std::string& field) {
  const std::vector<std::string> parts = absl::StrSplit(name, '/');
  if (parts.size() == 4 && parts[0] == "stations" && parts[2] == "cameras" &&
      IsStationId(parts[1]) && IsStationId(parts[3])) {
    return StationCameraId{parts[1], parts[3]};
  }
  return InvalidField(
      field,
      absl::StrCat("'", name.substr(0, 160), "' is not stations/{station}/cameras/{camera}"));
}

std::string EtagOf(const StationRecord& record) {
  constexpr size_t kDigits = 16;
  return Sha256Hex(
             absl::StrCat("station\n", record.id, "\n", record.revision, "\n", record.update_time))
      .substr(0, kDigits);
}

std::string StationTime() {
  return absl::FormatTime("%Y-%m-%dT%H:%M:%E3SZ", absl::Now(), absl::UTCTimeZone());
}

absl::StatusOr<StationStart> BeginStation(Catalog& catalog,
                                          const std::string& id,
                                          const StationUse& use,
                                          const std::vector<cv::Mat>& images) {
  StationStart out;
  out.id = id;
  out.learns = use.state.empty() && !use.read_only;
  StationRecord record;
  if (use.state.empty()) {
    absl::StatusOr<StationRecord> stored = catalog.GetStation(id);
    if (absl::IsNotFound(stored.status())) {
      return FieldError(absl::StatusCode::kNotFound,
                        "station",
                        absl::StrCat("'", StationName(id), "' is not known"));
    }
    HOROPTER_RETURN_IF_ERROR(stored.status());
    record = *std::move(stored);
  } else {
    absl::StatusOr<StationState> brought = DecodeStationState(use.state);
    if (!brought.ok())
      return InvalidField("station_state", std::string(brought.status().message()));
    record.state = *std::move(brought);
  }
  out.state = EncodeStationState(record.state);
  out.agreed_request_id = record.agreed_request_id;
  out.agreed_time = record.agreed_time;
  out.request.state = std::move(record.state);
  HOROPTER_ASSIGN_OR_RETURN(out.request.views,
                            CamerasOf(use.camera_ids, images, &out.request.state, &out.resized));
  out.request.bases.resize(out.request.state.cameras.size());
  for (const auto& [camera, base] : record.bases) {
    if (const int c = IndexOfCamera(out.request.state, camera); c >= 0) out.request.bases[c] = base;
  }
  return out;
}

int KindOf(const StationChange& change) {
  switch (change.kind) {
    case StationChangeKind::kMoved:
      return v1::StationFinding::KIND_CAMERA_MOVED;
    case StationChangeKind::kLens:
      return v1::StationFinding::KIND_LENS_CHANGED;
    case StationChangeKind::kSwapped:
      return v1::StationFinding::KIND_CAMERAS_SWAPPED;
  }
  return v1::StationFinding::KIND_UNSPECIFIED;
}

std::string DescribeChange(const StationState& state, const StationChange& change) {
  std::string cameras;
  for (const int c : change.cameras)
    absl::StrAppend(&cameras, cameras.empty() ? "" : " or ", state.cameras[c].id);
  switch (change.kind) {
    case StationChangeKind::kMoved:
      return absl::StrFormat("camera %s moved by %.2f degrees and %.1f mm",
                             cameras,
                             kDegrees * change.turn_rad,
                             1000.0 * change.shift_m);
    case StationChangeKind::kLens:
      return absl::StrFormat(
          "lens of camera %s changed: focal length %+.2f %%, principal point %+.1f %+.1f px",
          cameras,
          100.0 * change.log_focal,
          change.center_px.x(),
          change.center_px.y());
    case StationChangeKind::kSwapped:
      return absl::StrCat("the images fit the cameras in another order: ", cameras);
  }
  return cameras;
}

std::string DescribeBaseChange(const BaseChange& change) {
  return absl::StrFormat(
      "references put the robot's base %.2f degrees and %.1f mm from where it was known to be; %s",
      kDegrees * change.turn_rad,
      1000.0 * change.shift_m,
      change.given ? "what was given of it stays" : "what was learnt of it is forgotten");
}

namespace {

// Of cameras that moved the hand-eye calibration is void; the others take theirs over through the
// rig as it was before.
void ForgetMovedBases(const StationTest& test, StationRecord* record) {
  const std::vector<StationCamera>& cameras = record->state.cameras;
  const auto fixed = [&](const StationCamera& c) { return c.posed && !c.moving; };
  for (size_t m = 0; m < cameras.size(); ++m) {
    const auto known = record->bases.find(cameras[m].id);
    if (!HasMoved(test, static_cast<int>(m)) || known == record->bases.end()) continue;
    if (fixed(cameras[m])) {
      for (size_t c = 0; c < cameras.size(); ++c) {
        if (!fixed(cameras[c]) || HasMoved(test, static_cast<int>(c))) continue;
        record->bases.try_emplace(
            cameras[c].id,
            ThroughRig(record->state, known->second, static_cast<int>(m), static_cast<int>(c)));
      }
    }
    record->bases.erase(cameras[m].id);
  }
}

// What references say of the places of fixed cameras in the base joins what was learnt of them.
// Where they contradict it, the base has moved: all that was learnt of it is forgotten, and the
// next reference is believed. What people said stays.
void LearnBases(const StationViews& views,
                const StationOutcome& outcome,
                const std::string& request_id,
                const StationOptions& options,
                StationRecord* record,
                std::vector<StationEventRecord>* events) {
  StationRequest now;
  now.state = record->state;
  now.views = views;
  for (const StationCamera& camera : record->state.cameras) {
    const auto known = record->bases.find(camera.id);
    now.bases.push_back(known == record->bases.end() ? std::nullopt : std::optional(known->second));
  }
  if (const std::optional<BaseChange> moved = BaseMoved(now, outcome, options)) {
    StationEventRecord& event = events->emplace_back();
    event.kind = v1::StationEvent::KIND_BASE_MOVED;
    event.time = record->update_time;
    event.request_id = request_id;
    for (const int c : moved->cameras) event.camera_ids.push_back(now.state.cameras[c].id);
    event.detail = DescribeBaseChange(*moved);
    std::erase_if(record->bases, [](const auto& entry) { return entry.second.learnt; });
    return;
  }
  std::vector<std::string> learnt;
  for (size_t v = 0; v < std::min(views.size(), outcome.bases_seen.size()); ++v) {
    const StationCamera& camera = record->state.cameras[views[v]];
    if (!outcome.bases_seen[v] || camera.moving) continue;
    const CameraBase& seen = *outcome.bases_seen[v];
    const auto [known, is_new] = record->bases.try_emplace(camera.id, seen);
    if (is_new) {
      learnt.push_back(camera.id);
    } else {
      known->second = UpdateBase(known->second, seen, options);
    }
  }
  if (learnt.empty()) return;
  events->push_back({v1::StationEvent::KIND_BASE_LEARNT,
                     record->update_time,
                     request_id,
                     learnt,
                     "places in the robot's base frame by the reference object"});
}

}  // namespace

absl::StatusOr<bool> TeachStation(Catalog& catalog,
                                  const StationStart& start,
                                  const StationOutcome& outcome,
                                  const std::string& request_id) {
  if (!start.learns || outcome.evidence.information.size() == 0) return false;
  const StationOptions options;
  bool learnt = false;
  const auto teach = [&](const StationRecord* current,
                         std::vector<StationEventRecord>* events) -> absl::StatusOr<StationRecord> {
    if (current == nullptr) return absl::NotFoundError("the station was deleted meanwhile");
    StationRecord next = *current;
    HOROPTER_ASSIGN_OR_RETURN(const StationViews views,
                              PlaceCameras(start, request_id, options, &next.state, events));
    // A prior that stood because of the scene adjusted under it stands here, too.
    StationTest test = TestStation(next.state, views, outcome.evidence, options);
    next.update_time = StationTime();
    for (const StationChange& change : test.changes) {
      StationEventRecord& event = events->emplace_back();
      event.kind = KindOf(change);
      event.time = next.update_time;
      event.request_id = request_id;
      for (const int c : change.cameras) event.camera_ids.push_back(next.state.cameras[c].id);
      event.detail = DescribeChange(next.state, change);
    }
    learnt = !IsSwapped(test);
    if (test.agrees) {
      next.agreed_request_id = request_id;
      next.agreed_time = next.update_time;
    }
    ForgetMovedBases(test, &next);
    if (learnt) LearnBases(views, outcome, request_id, options, &next, events);
    next.state = UpdateStation(std::move(next.state), views, outcome.evidence, test, options);
    return next;
  };
  const absl::StatusOr<StationRecord> written = catalog.WriteStation(start.id, teach);
  if (absl::IsNotFound(written.status()) || absl::IsFailedPrecondition(written.status()))
    return false;
  HOROPTER_RETURN_IF_ERROR(written.status());
  return learnt;
}

}  // namespace horopter
