// Reads a dataset in BOP layout: models/ + models_info.json, cad/, grasps/, names.json, and the
// scenes of a split. Files are in millimetres; everything here is in metres. Numbers in names of
// files and folders may have any number of digits.
//
// Meshes are looked for in models/, models_cad/, models_reconst/, models_eval/ and any other
// models_*/, in this order: published datasets have some of them.
#pragma once

#include <Eigen/Core>
#include <Eigen/Geometry>
#include <string>
#include <vector>

#include "absl/status/statusor.h"
#include "server/vision/geometry/object_model.h"
#include "server/vision/geometry/pinhole_camera.h"
#include "server/vision/geometry/rigid3.h"

namespace horopter {

struct BopObject {
  int obj_id = 0;
  std::string name;         // of names.json, may be empty
  std::string cad_path;     // cad/obj_NNNNNN.step (.stp), or empty
  std::string mesh_path;    // models/obj_NNNNNN.ply (.obj, .stl), or empty
  std::string grasps_path;  // grasps/obj_NNNNNN.json, or empty
  double diameter_m = 0.0;  // 0 when models_info.json does not say
  bool in_models_info = false;
  std::vector<Rigid3> symmetries;  // without the identity; continuous ones discretised
};

struct BopDataset {
  std::string folder;
  std::vector<BopObject> objects;  // by obj_id
  const BopObject* Find(int obj_id) const;
};

// An annotated instance of an object in one image.
struct BopInstance {
  int obj_id = 0;
  Rigid3 camera_from_object;
  double visib_fract = 1.0;  // of scene_gt_info.json; 1 without it
  // bbox_visib of scene_gt_info.json, pixels from the image's left and upper border; empty:
  // unknown, or nothing is visible.
  Eigen::AlignedBox2d visible_box;
};

struct BopImage {
  int im_id = 0;
  std::string sensor;  // "cam1" of rgb_cam1/ and scene_camera_cam1.json; empty: rgb/ or gray/
  std::string path;    // empty when the dataset has no image file for the id
  // Ground truth, not an input of recognition. focal_px is fx, k1 of cam_dist; K keeps fx, fy and
  // skew as written. width and height come from the image's header, 0 when unknown.
  PinholeCamera camera;
  Eigen::Matrix3d K = Eigen::Matrix3d::Identity();
  std::vector<double> distortion;  // k1 k2 p1 p2, may be empty
  bool has_pose = false;           // cam_R_w2c, cam_t_w2c present
  Rigid3 camera_from_world;
  std::vector<BopInstance> instances;  // in file order
};

struct BopScene {
  int scene_id = 0;
  std::string folder;
  std::string tier = "all";       // scene_meta.json
  bool has_ground_truth = false;  // scene_gt.json
  std::vector<BopImage> images;   // by sensor, then by im_id
};

struct BopSceneOptions {
  bool cameras = true;       // scene_camera.json
  bool truth = true;         // scene_gt.json and scene_gt_info.json
  bool all_sensors = false;  // else of several the first: results name no sensor
};

// Catalog id of a dataset's object: 1 -> "obj_000001".
std::string BopObjectName(int obj_id);

// Errors: NOT_FOUND (no such folder, no models/ and no cad/), INVALID_ARGUMENT (a file that is not
// what it should be).
absl::StatusOr<BopDataset> ReadBopDataset(const std::string& folder);

// Ids of the scene folders of a split, ascending. Errors: NOT_FOUND.
absl::StatusOr<std::vector<int>> ListBopScenes(const std::string& folder, const std::string& split);

// Whether a scene's folder has one with images: rgb/, gray/, rgb_SENSOR/ and the like.
bool HasBopImages(const std::string& scene_folder);

// Needs images or scene_camera.json; ground truth files are optional, and what `options` leave out
// is not opened.
// Errors: NOT_FOUND (no such scene, no images), INVALID_ARGUMENT (broken file, named).
absl::StatusOr<BopScene> ReadBopScene(const std::string& folder,
                                      const std::string& split,
                                      int scene_id,
                                      const BopSceneOptions& options = {});

// Reads a grasp file: {"grasps": [{"name", "T_gripper_in_object" (16, row-major, mm),
// "jaw_opening_mm", "grip_width_mm" (or "suction_cup_radius_mm"), optional "quality" and
// "T_pregrasp_in_object"}]}; .yaml and .yml are isaac_grasp files. Errors: NOT_FOUND,
// INVALID_ARGUMENT.
absl::StatusOr<std::vector<Grasp>> ReadGrasps(const std::string& path);

}  // namespace horopter
