// What recognition derives from an ObjectModel once, at enrolment: edge samples, aspects, stable
// poses and keys.
#pragma once

#include <Eigen/Core>
#include <memory>
#include <vector>

#include "absl/status/statusor.h"
#include "server/vision/geometry/mesh_symmetry.h"
#include "server/vision/geometry/object_model.h"
#include "server/vision/invariants/object_keys.h"
#include "server/vision/recognition/aspects/aspect_blob.h"
#include "server/vision/recognition/aspects/aspect_fragments.h"
#include "server/vision/recognition/object/shape_alignment.h"

namespace horopter {

// A point on an edge of the model.
struct EdgeSample {
  Eigen::Vector3f point = Eigen::Vector3f::Zero();     // object frame, metres
  Eigen::Vector3f tangent = Eigen::Vector3f::UnitX();  // unit
  int edge = -1;                                       // index into model.edges
};

// A pose in which the part rests on a plane: `up` is the plane's normal in the object frame, the
// plane is {x : up.x = -height} below the part.
struct StablePose {
  Eigen::Vector3d up = Eigen::Vector3d::UnitZ();
  double height_m = 0.0;  // of the object origin above the plane
  double margin_m =
      0.0;  // distance of the projected centre of mass from the border of the support polygon
  bool rolls = false;  // one of many along a round side
};

// The part as a camera sees it from around, and the contour fragments that ask for it.
struct ModelAspects {
  ObjectAspects object;
  ModelFragments fragments;
};

struct PreparedObject {
  ObjectModel model;
  Eigen::Vector3d center = Eigen::Vector3d::Zero();  // of the bounding box, object frame
  double radius_m = 0.0;                             // half the diameter

  std::vector<EdgeSample> samples;
  double sample_spacing_m = 0.0;

  std::vector<StablePose> stable_poses;
  // Turns that only small features tell from the identity: poses that images without these features
  // leave open.
  std::vector<NearSymmetry> near_symmetries;
  bool sphere = false;                          // has no orientation
  ObjectKeys keys;                              // for the catalog's index
  std::shared_ptr<const ModelAspects> aspects;  // null: not asked for
  std::shared_ptr<const LazyMirrorTwin> twin = std::make_shared<LazyMirrorTwin>();
};

struct PrepareOptions {
  int max_samples = 448;  // edge samples per object; more: finer scores, slower
  bool aspects = false;   // also PreparedObject::aspects: a second or two more, 0.5 MB
};

// A model without sharp edges (a ball, a casting) has no samples: it is found by its
// aspects alone. Errors: INVALID_ARGUMENT when it has no mesh or no extent.
absl::StatusOr<std::shared_ptr<const PreparedObject>> PrepareObject(
    ObjectModel model, const PrepareOptions& options = {});

// The cheap beginning of PrepareObject, which what was stored is completed with (prepared_blob.h):
// samples, everything else empty. Errors: as PrepareObject.
absl::StatusOr<std::shared_ptr<PreparedObject>> BeginPrepared(ObjectModel model,
                                                              const PrepareOptions& options);

// PreparedObject::aspects. Errors: INVALID_ARGUMENT (see MakeRenderMesh).
absl::StatusOr<std::shared_ptr<const ModelAspects>> MakeModelAspects(const ObjectModel& model);

// Stable resting poses of a mesh on a plane, of any shape: facets of the convex hull above which
// the centre of mass lies, largest margin first. Of a round side, which has as many as facets, at
// most kRollingPoses, evenly spread, stand for all.
inline constexpr int kRollingPoses = 40;
std::vector<StablePose> FindStablePoses(const TriangleMesh& mesh);

}  // namespace horopter
