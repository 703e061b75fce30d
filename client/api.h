// The C++ client of a Horopter server: one call per rpc, errors as absl::Status.
#pragma once

#include <functional>
#include <memory>
#include <string>
#include <vector>

#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "horopter/v1/catalog.pb.h"
#include "horopter/v1/recognition.pb.h"
#include "server/vision/geometry/object_model.h"

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

// Every call waits at most `timeout_s`. Errors keep the server's code; the message says the address
// when it cannot be reached and the offending field when the server names one. Thread-safe.
//
//   HoropterClient client("localhost:50051", 60.0);
//   auto objects = client.ListObjects();
class HoropterClient {
 public:
  HoropterClient(const std::string& address, double timeout_s);
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
  absl::StatusOr<v1::ListLookAlikesResponse> ListLookAlikes(const std::string& id);
  absl::StatusOr<v1::VerifyCatalogResponse> VerifyCatalog(bool recompute);
  // True: the stored derived data differed from the new ones.
  absl::StatusOr<bool> RebuildObject(const std::string& id);
  // Hands the catalog file over piece by piece; an error of `write` ends the call with it.
  absl::Status BackupCatalog(const std::function<absl::Status(const std::string& chunk)>& write);
  absl::StatusOr<v1::RecognizeSceneResponse> RecognizeScene(
      const v1::RecognizeSceneRequest& request);

 private:
  struct Stubs;
  std::unique_ptr<Stubs> stubs_;
  std::string address_;
  double timeout_s_;
};

}  // namespace horopter
