// The C++ client of a Horopter server: one call per rpc, errors as absl::Status.
#pragma once

#include <cstdint>
#include <functional>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "client/channel.h"
#include "horopter/v1/catalog.pb.h"
#include "horopter/v1/recognition.pb.h"
#include "horopter/v1/server.pb.h"
#include "horopter/v1/station.pb.h"
#include "server/vision/geometry/object_model.h"

namespace grpc {
class ClientContext;
class Status;
}  // namespace grpc

namespace horopter {

// The CAD file an object was made from.
struct CadFile {
  std::string file_name;  // without folders
  std::string format;     // step, iges, ply, stl or obj
  std::string unit;
  std::string content;
};

struct ObjectUpdate {
  bool geometry = false;  // vertices, edges, mesh, diameter, symmetries and source
  bool grasps = false;
  bool display_name = false;
};

struct ClientOptions {
  double timeout_s = 600.0;  // of one call, with all its tries
  // How often a call that was refused with a time to try again is tried again, after that time.
  int max_retries = 0;
  // Asked some times a second; true cancels the call. Empty: never.
  std::function<bool()> interrupted;
  // Told before each wait; empty: nobody.
  std::function<void(int retry_after_ms)> on_retry;
  ChannelSecurity security = {};
  // Variants of the methods for every call (horopterd --allow-variants); printable ASCII.
  std::string variants = {};
  // Of a catalog that several servers share: scenes are answered by the writes up to this one, a
  // `revision` that another server acknowledged; UNAVAILABLE where the server does not get it
  // within two seconds. Not positive: whatever the server has.
  int64_t min_generation = 0;
};

// What the server says of a failed call beside code and message; of errors of this client only.
std::string RequestIdOf(const absl::Status& status);   // empty: it did not say
std::string ErrorFieldOf(const absl::Status& status);  // empty: none
std::optional<int> RetryAfterMsOf(const absl::Status& status);
std::string ErrorReasonOf(const absl::Status& status);  // of ErrorInfo (errors.proto); empty: none

// Errors keep the server's code; the message says the address when it cannot be reached, the
// offending field when the server names one, and the request's id in the server's log.
// Thread-safe.
//
// Options that give no channel (MakeChannel) are the error of every call.
//
//   HoropterClient client("localhost:50051", 60.0);
//   auto objects = client.ListObjects();
class HoropterClient {
 public:
  HoropterClient(const std::string& address, double timeout_s);
  HoropterClient(const std::string& address, ClientOptions options);
  ~HoropterClient();

  // model.id names the object.
  absl::StatusOr<v1::Object> CreateObject(const ObjectModel& model, const CadFile& file);
  absl::StatusOr<v1::Object> UpdateObject(const ObjectModel& model,
                                          const CadFile& file,
                                          const ObjectUpdate& what);
  // Creates the object, or replaces all of it when its name is taken.
  absl::Status PutObject(const v1::Object& object);
  absl::StatusOr<v1::Object> GetObject(const std::string& id, v1::ObjectView view);
  absl::StatusOr<std::vector<v1::Object>> ListObjects();  // all pages, basic view
  absl::Status DeleteObject(const std::string& id);
  // Newest first; the first is what the object is.
  absl::StatusOr<v1::ListObjectVersionsResponse> ListObjectVersions(const std::string& id);
  // Makes the object what it was. if_match: only while it has this etag; empty: whatever it has.
  absl::StatusOr<v1::Object> RestoreObject(const std::string& id,
                                           int64_t revision,
                                           const std::string& if_match = {});
  // Learns what is printed on an object, see CatalogService.LearnPrint.
  absl::StatusOr<v1::Object> LearnPrint(const v1::LearnPrintRequest& request);
  // Removes it. if_match: as for RestoreObject.
  absl::StatusOr<v1::Object> RemovePrint(const std::string& id, const std::string& if_match = {});
  absl::StatusOr<v1::ListLookAlikesResponse> ListLookAlikes(const std::string& id);
  // All problems in one; `progress` is told the share of the work that is done, 0..1.
  absl::StatusOr<v1::VerifyCatalogResponse> VerifyCatalog(
      bool recompute, const std::function<void(double)>& progress = {});
  // True: the stored derived data differed from the new ones.
  absl::StatusOr<bool> RebuildObject(const std::string& id);
  // Hands the catalog file over piece by piece, from `offset` on of the copy of that id (empty: a
  // new copy); an error of `write` ends the call with it.
  absl::Status BackupCatalog(
      const std::string& backup_id,
      int64_t offset,
      const std::function<absl::Status(const v1::BackupCatalogResponse& piece)>& write);
  // Replaces the whole catalog by that of the file. Errors: those of the rpc, NOT_FOUND (no file).
  absl::StatusOr<v1::RestoreCatalogResponse> RestoreCatalog(const std::string& path);
  absl::StatusOr<v1::RecognizeSceneResponse> RecognizeScene(
      const v1::RecognizeSceneRequest& request);
  // Stations by their ids; cameras by `stations/{station}/cameras/{camera}`.
  absl::StatusOr<v1::Station> GetStation(const std::string& id);
  absl::StatusOr<std::vector<v1::Station>> ListStations();  // all pages, without events
  absl::StatusOr<v1::Station> UpdateStation(const v1::UpdateStationRequest& request);
  absl::Status DeleteStation(const std::string& id);
  // Of a station or a camera; keep_base: where the cameras are in the robot's base is kept.
  absl::StatusOr<v1::Station> ResetStation(const std::string& name, bool keep_base = false);
  absl::StatusOr<v1::Station> ImportCalibration(const std::string& camera_name,
                                                const v1::CameraCalibration& calibration);
  absl::StatusOr<v1::CameraCalibration> ExportCalibration(const std::string& camera_name);
  // Version, limits, catalog and load of the server.
  absl::StatusOr<v1::ServerInfo> GetServerInfo();
  // True: the server takes calls; false: it is stopping.
  absl::StatusOr<bool> CheckHealth();

  const std::string& address() const { return address_; }
  double timeout_s() const { return options_.timeout_s; }
  std::shared_ptr<grpc::Channel> channel() const;

 private:
  struct Stubs;
  using Done = std::function<void(grpc::Status)>;
  // Runs one unary call to its end: tries, waits, interruption.
  absl::Status Call(const std::function<void(grpc::ClientContext*, Done)>& start);

  std::unique_ptr<Stubs> stubs_;
  std::string address_;
  ClientOptions options_;
};

}  // namespace horopter
