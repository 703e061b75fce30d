// What recognition derives from an ObjectModel once, at enrolment: edge samples, what is visible
// from where, vertex paths and stable poses.
#pragma once

#include <Eigen/Core>
#include <cstdint>
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

// The view sphere is a cube map of kAspectGrid^2 cells per face (cells are 5 to 9 degrees wide).
inline constexpr int kAspectGrid = 12;
inline constexpr int kAspectCount = 6 * kAspectGrid * kAspectGrid;

// Cell of a direction (need not be of unit length; not zero), and a cell's central unit direction.
int AspectIndex(const Eigen::Vector3f& direction);
Eigen::Vector3d AspectDirection(int index);

// A point on an edge of the model.
struct EdgeSample {
  Eigen::Vector3f point = Eigen::Vector3f::Zero();     // object frame, metres
  Eigen::Vector3f tangent = Eigen::Vector3f::UnitX();  // unit
  int edge = -1;                                       // index into model.edges
};

// Two straight edges a-b and b-c that share the vertex b. inverse_frame maps two image-space
// vectors to a rotation: R = [q1 q2 q1xq2] * inverse_frame for q1 = R(A-B), q2 = R(C-B).
struct VertexPath {
  int a = -1;
  int b = -1;
  int c = -1;
  int edge_ab = -1;
  int edge_bc = -1;
  double length_ab = 0.0;
  double length_bc = 0.0;
  double length_ac = 0.0;
  Eigen::Matrix3d inverse_frame = Eigen::Matrix3d::Identity();
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

// Which cells of the bounding box lie inside the part: objects are solid, two of them cannot share
// space.
struct Occupancy {
  Eigen::Vector3d origin = Eigen::Vector3d::Zero();  // corner of cell (0,0,0), object frame
  double cell_m = 0.0;
  Eigen::Vector3i size = Eigen::Vector3i::Zero();
  std::vector<bool> inside;               // x fastest
  std::vector<Eigen::Vector3f> interior;  // centres of at most 300 inside cells

  bool Contains(const Eigen::Vector3d& point) const;
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
  int words = 0;                           // 64-bit words per aspect in `visible`
  std::vector<std::uint64_t> visible;      // kAspectCount * words, bit i: samples[i] is visible
  std::vector<std::uint8_t> edge_visible;  // kAspectCount * edges, visible share of the edge * 255

  std::vector<VertexPath> paths;
  // Indices of the paths that no symmetry takes onto an earlier one, in either direction: the
  // others lead to the same poses again.
  std::vector<int> distinct_paths;
  std::vector<StablePose> stable_poses;
  // Turns that only small features tell from the identity: poses that images without these features
  // leave open.
  std::vector<NearSymmetry> near_symmetries;
  bool sphere = false;  // has no orientation
  Occupancy occupancy;
  ObjectKeys keys;                              // for the catalog's index
  std::shared_ptr<const ModelAspects> aspects;  // null: not asked for
  std::shared_ptr<const LazyMirrorTwin> twin = std::make_shared<LazyMirrorTwin>();

  const std::uint64_t* VisibleBits(int aspect) const {
    return visible.data() + static_cast<std::size_t>(aspect) * words;
  }
  double EdgeVisible(int aspect, int edge) const {
    return edge_visible[static_cast<std::size_t>(aspect) * model.edges.size() + edge] / 255.0;
  }
};

struct PrepareOptions {
  int max_samples = 448;                   // edge samples per object; more: finer scores, slower
  double min_path_angle_rad = 0.2618;      // paths straighter than this are no corner
  double aspect_distance_diameters = 6.0;  // camera distance at which visibility is computed
  bool aspects = false;  // also PreparedObject::aspects: a second or two more, 0.5 MB
};

// A model without sharp edges (a ball, a casting) has no samples and no paths: it is found by its
// aspects alone. Errors: INVALID_ARGUMENT when it has no mesh or no extent.
absl::StatusOr<std::shared_ptr<const PreparedObject>> PrepareObject(
    ObjectModel model, const PrepareOptions& options = {});

// The two cheap ends of PrepareObject, which what was stored is completed with (prepared_blob.h):
// samples and vertex paths, everything else empty; then `edge_visible` from `visible`. Errors: as
// PrepareObject.
absl::StatusOr<std::shared_ptr<PreparedObject>> BeginPrepared(ObjectModel model,
                                                              const PrepareOptions& options);
void FillEdgeVisibility(PreparedObject* object);

// PreparedObject::aspects. Errors: INVALID_ARGUMENT (see MakeRenderMesh).
absl::StatusOr<std::shared_ptr<const ModelAspects>> MakeModelAspects(const ObjectModel& model);

// Stable resting poses of a mesh on a plane, of any shape: facets of the convex hull above which
// the centre of mass lies, largest margin first. Of a round side, which has as many as facets, at
// most kRollingPoses, evenly spread, stand for all.
inline constexpr int kRollingPoses = 40;
std::vector<StablePose> FindStablePoses(const TriangleMesh& mesh);

// Cells of a closed mesh by ray parity along z; cells of an open mesh may be wrong.
Occupancy ComputeOccupancy(const TriangleMesh& mesh);

// Share (0..1) of the smaller part's interior that lies inside the other one.
double SharedVolume(const PreparedObject& a,
                    const Rigid3& scene_from_a,
                    const PreparedObject& b,
                    const Rigid3& scene_from_b);

}  // namespace horopter
