// Writes objects in BOP layout: models/obj_NNNNNN.ply, models/models_info.json, models/names.json,
// cad/, grasps/ (JSON and isaac_grasp YAML). Files are in millimetres.
#pragma once

#include <string>
#include <vector>

#include "absl/status/status.h"
#include "client/bop_dataset.h"
#include "server/vision/geometry/object_model.h"

namespace horopter {

struct BopExportEntry {
  int obj_id = 0;
  ObjectModel model;
  std::string cad_format;   // step, stl, ..; a file of it is written when there is content
  std::string cad_content;  // the file's bytes
  Eigen::Vector3d low = Eigen::Vector3d::Zero();  // bounds of the mesh, metres
  Eigen::Vector3d high = Eigen::Vector3d::Zero();
};

// Mesh, CAD file and grasps of one object. Errors: FAILED_PRECONDITION (cannot be written).
absl::Status WriteBopObject(const std::string& folder, const BopExportEntry& entry);

// models_info.json and names.json; the entries need no mesh, edges and CAD file any more. Errors:
// FAILED_PRECONDITION.
absl::Status WriteBopLists(const std::string& folder, const std::vector<BopExportEntry>& entries);

// The inverse of ReadGrasps. Errors: FAILED_PRECONDITION.
absl::Status WriteGrasps(const std::string& path, const std::vector<Grasp>& grasps);

}  // namespace horopter
