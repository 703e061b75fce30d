// The sub-commands of the `horopter` program. They print their result to stdout (output.h),
// progress and warnings to stderr.
#pragma once

#include <cstdint>
#include <optional>
#include <string>
#include <vector>

#include "absl/status/status.h"
#include "client/api.h"
#include "client/camera_hints.h"
#include "client/regions.h"

namespace horopter {

struct ObjectAddArguments {
  std::string cad_path;
  std::string id;
  std::string grasps_path;   // empty: none
  std::string unit;          // empty: the file's, or mm
  std::string display_name;  // empty: what the file calls the solid
  // An assembly becomes one object per different solid: ID-1, ID-2, ..; grasps belong to none.
  bool split = false;
  std::string preview_path;  // PNG of what was enrolled; empty: none
};
absl::Status ObjectAdd(HoropterClient& client, const ObjectAddArguments& arguments);

struct ObjectUpdateArguments {
  std::string id;
  std::optional<std::string> cad_path;
  std::optional<std::string> grasps_path;
  std::optional<std::string> display_name;
  std::string unit;
};
absl::Status ObjectUpdateCommand(HoropterClient& client, const ObjectUpdateArguments& arguments);

absl::Status ObjectList(HoropterClient& client);
absl::Status ObjectShow(HoropterClient& client, const std::string& id);
// Writes a PNG of what the server knows of the object (preview.h).
absl::Status ObjectPreview(HoropterClient& client, const std::string& id, const std::string& path);
// What the object is and was, newest first.
// Learns what is printed on the object from recordings of requests in which it was answered;
// `remove`: removes it instead.
absl::Status ObjectLearnPrint(HoropterClient& client,
                              const std::string& id,
                              const std::vector<std::string>& recordings,
                              bool remove,
                              const std::string& if_match);
absl::Status ObjectHistory(HoropterClient& client, const std::string& id);
// Makes it what it was; revision 0: before the last change. if_match: only while it has this etag;
// empty: whatever it has.
absl::Status ObjectRestore(HoropterClient& client,
                           const std::string& id,
                           int64_t revision,
                           const std::string& if_match);
absl::Status ObjectRemove(HoropterClient& client, const std::vector<std::string>& ids);

// Prints the objects that the named one can be taken for; of none, the first prints nothing.
absl::Status ReportLookAlikes(HoropterClient& client, const std::string& id);
absl::Status ObjectLookAlikes(HoropterClient& client, const std::string& id);

// DATA_LOSS when a problem is found. recompute: derived data are recomputed and compared.
// Everything is checked; with ids, only problems of these objects and of the catalog as a whole are
// reported. Errors: NOT_FOUND (an id).
absl::Status CatalogVerify(HoropterClient& client,
                           bool recompute,
                           const std::vector<std::string>& ids);
// Recomputes the derived data of the named objects; no ids: of all.
absl::Status CatalogRebuild(HoropterClient& client, std::vector<std::string> ids);
// Both write to new files and folders only.
absl::Status CatalogBackup(HoropterClient& client, const std::string& path);
absl::Status CatalogRestore(HoropterClient& client, const std::string& path);
// Copies a catalog, a file or postgresql://..., into an empty one: becomes horopterd, which does
// it. Errors: FAILED_PRECONDITION (there is no horopterd on this machine).
absl::Status CatalogMigrate(const std::string& from, const std::string& to);
absl::Status CatalogExport(HoropterClient& client, const std::string& folder);
absl::Status ObjectExport(HoropterClient& client,
                          const std::vector<std::string>& ids,
                          const std::string& folder);
// What CatalogExport wrote comes back exactly; any other BOP dataset is enrolled.
absl::Status CatalogImport(HoropterClient& client, const std::string& folder);

// Enrols every object of a BOP dataset, or updates those that are in the catalog already. Those
// that cannot be are named and left out; the error is the first of them.
absl::Status DatasetEnroll(HoropterClient& client, const std::string& dataset);

struct DatasetRecognizeArguments {
  std::string dataset;
  std::string split;
  std::string out;
  std::vector<int> scenes;  // empty: all
  std::string targets;      // file; empty: the split's own for several views, "none": none
  int max_images = 0;       // per scene, spread evenly; 0: all
  DatasetHints hints = DatasetHints::kNone;
  bool cropped = false;  // the images are cut-outs
  TrueRegions regions = TrueRegions::kNone;
  double region_margin = 0.2;  // of a region's longer side, on every side
};
absl::Status DatasetRecognize(HoropterClient& client, const DatasetRecognizeArguments& arguments);

struct DatasetEvaluateArguments {
  std::string dataset;
  std::string split;
  std::string results;
  std::vector<int> scenes;  // empty: all
  double min_visib = 0.3;   // less visible instances are no targets
};
absl::Status DatasetEvaluate(const DatasetEvaluateArguments& arguments);  // needs no server

struct RecognizeArguments {
  std::vector<std::string> images;
  std::string overlay_path;             // empty: none; see WriteOverlays
  bool unexplained = false;             // the overlay shows edges of no object, too
  std::vector<std::string> candidates;  // empty: the whole catalog
  // Object id, then optionally its pose in the robot base: x y z (metres) qw qx qy qz; several one
  // after the other, each with its pose. Empty: no reference.
  std::vector<std::string> reference;
  std::vector<double> reference_sigma;  // of all of them: radians, metres; empty: exact
  CameraArguments cameras;
  bool cropped = false;                      // the images are cut-outs
  bool ignore_exif = false;                  // what their files say of the cameras is not used
  std::string station;                       // whose cameras took the images; empty: none
  std::vector<std::string> station_cameras;  // ids, one per image
  bool read_only = false;                    // the station learns nothing
  std::vector<std::string> expected;         // see AddExpectedParts
  std::optional<double> unknown_share;       // of what lies there; unset: the server's
  RegionArguments regions;
};
// Errors beside those of the call: OUT_OF_RANGE (of expected parts not all are present).
absl::Status Recognize(HoropterClient& client, const RecognizeArguments& arguments);

// Why an object is, or is not, among what is recognised.
absl::Status Explain(HoropterClient& client,
                     const std::string& object,
                     const RecognizeArguments& arguments);

// Stations: fixed cameras that the server calibrates by use.
absl::Status StationList(HoropterClient& client);
// Cameras with deviations, and what was noticed of them.
absl::Status StationShow(HoropterClient& client, const std::string& id);
struct StationSetArguments {
  std::string id;
  std::optional<std::string> display_name;
  std::vector<std::string> moving, zooming, fixed;  // cameras
  // Camera, then its pose in the robot base: x y z (metres) qw qx qy qz; several one after the
  // other.
  std::vector<std::string> camera_pose;
  std::vector<double> camera_pose_sigma;  // of all of them: radians, metres; empty: the server's
};
// Makes the station where it is missing.
absl::Status StationSet(HoropterClient& client, const StationSetArguments& arguments);
absl::Status StationRemove(HoropterClient& client, const std::string& id);
// Camera empty: the whole station. keep_base: what was learnt of the robot's base stays.
absl::Status StationReset(HoropterClient& client,
                          const std::string& id,
                          const std::string& camera,
                          bool keep_base);
// path: see ReadCameraFile. Errors: INVALID_ARGUMENT (a lens beyond k1, no image size).
absl::Status StationImport(HoropterClient& client,
                           const std::string& id,
                           const std::string& camera,
                           const std::string& path);
// Writes camera_info YAML of ROS.
absl::Status StationExport(HoropterClient& client,
                           const std::string& id,
                           const std::string& camera,
                           const std::string& path);

// Sends recorded requests and compares the answers with the recorded ones, bit for bit but for
// times and ids. Errors: ABORTED (answers differ; they are printed), those of reading and of the
// calls.
absl::Status Replay(HoropterClient& client, const std::vector<std::string>& files);

// Whether the server takes calls, its version, limits, load and catalog. Errors:
// UNAVAILABLE (it is stopping or not there).
absl::Status ServerStatus(HoropterClient& client);

// Whole file as bytes. Errors: NOT_FOUND, INVALID_ARGUMENT (empty).
absl::StatusOr<std::string> ReadFileBytes(const std::string& path);

}  // namespace horopter
