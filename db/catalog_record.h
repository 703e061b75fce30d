// What the catalog keeps of one object.
#pragma once

#include <cstdint>
#include <map>
#include <string>

#include "absl/status/status.h"
#include "server/vision/geometry/object_model.h"

namespace horopter {

// The file an object was made from.
struct CadSource {
  std::string file_name;  // without folders
  std::string format;     // step, iges, stl, ply, obj, cao, json
  std::string unit;       // of the file's coordinates, e.g. "mm"
  std::string content;    // the file's bytes; empty when not asked for
  std::string sha256;     // of content, lower-case hex
  int64_t size_bytes = 0;
};

struct CatalogRecord {
  ObjectModel model;
  CadSource source;
  std::string create_time;  // RFC 3339, UTC
  std::string update_time;
  std::map<std::string, std::string> labels;
  // Generation of the catalog's write that made the object what it is; set by the catalog.
  int64_t revision = 0;
  std::string changed_by;  // who made that write, by the name in the access file; empty: not known
};

// An object without its bulk: model.vertices, model.edges, model.mesh and source.content are empty.
struct ObjectSummary {
  CatalogRecord record;
  int vertex_count = 0;
  int edge_count = 0;
  int triangle_count = 0;
};

// What the program made of an object's geometry (server/vision/recognition/object/prepared_blob.h);
// the catalog keeps the bytes and knows nothing of them.
struct DerivedData {
  int version = 0;
  std::string data;  // empty: none
  std::string keys;  // kept apart, so that the keys of all objects can be read without the rest
  std::string address = {};  // DerivedAddress of the shape and the version; empty: not known
};

// Of each object data of so many versions are kept: servers of two versions run beside each other
// while they are exchanged.
inline constexpr int kKeptDerivedVersions = 2;
inline constexpr int kNewestVersion = -1;

// What is read of an object's derived data.
struct DerivedWanted {
  int version = kNewestVersion;  // none of it there: none at all
  bool bytes = true;             // false: version and address alone
};

// What is stored of one object's derived data, without the data. Version 0: none.
struct DerivedEntry {
  std::string id;
  int version = 0;
  std::string address;
};

// The invariant keys of one object as stored; empty keys: none, or none of a version.
struct StoredKeys {
  std::string id;
  int version = 0;
  int vertex_count = 0;
  std::string keys;
  std::string address = {};
};

struct LoadedObject {
  absl::Status damage;  // DATA_LOSS: the model has its id and nothing else that can be used
  ObjectModel model;
  DerivedData derived;
};

// Limits of a record; what lies outside is refused before it reaches the database.
inline constexpr size_t kMaxDisplayNameBytes = 200;
inline constexpr size_t kMaxGraspNameBytes = 63;
inline constexpr size_t kMaxGrasps = 1000;
inline constexpr size_t kMaxSymmetries = 1000;
inline constexpr size_t kMaxModelVertices = 1'000'000;
inline constexpr size_t kMaxEdges = 200'000;
inline constexpr size_t kMaxPolylinePoints = 100'000;
inline constexpr size_t kMaxMeshVertices = 2'000'000;
inline constexpr size_t kMaxTriangles = 4'000'000;
inline constexpr size_t kMaxLabels = 64;
inline constexpr size_t kMaxLabelKeyBytes = 63;
inline constexpr size_t kMaxLabelValueBytes = 255;
inline constexpr size_t kMaxRequestIdBytes = 63;
inline constexpr size_t kMaxCadBytes = size_t{128} << 20;
// Parts a camera set can measure; a size outside means a wrong unit.
inline constexpr double kMinDiameterM = 1e-4;
inline constexpr double kMaxDiameterM = 100.0;
// Ends of an edge agree with its vertices within this (STEP writers stay below 10 micrometres).
inline constexpr double kEdgeEndToleranceM = 1e-5;

// True for [a-z0-9_-]{1,63}.
bool IsObjectId(const std::string& id);

// Checks everything but source.content's hash. Errors: INVALID_ARGUMENT; the message begins with
// the offending field as the wire names it ("edges[3].polyline_m: ...").
absl::Status ValidateModel(const ObjectModel& model);
absl::Status ValidateGrasps(const std::vector<Grasp>& grasps);
absl::Status ValidateSource(const CadSource& source);
// Keys match [a-z0-9_./-]{1,63}.
absl::Status ValidateLabels(const std::map<std::string, std::string>& labels);

}  // namespace horopter
