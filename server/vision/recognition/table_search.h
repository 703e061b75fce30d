// Poses of parts that stand on the supporting plane. With the cameras known in the plane's frame a
// pose has three unknowns, and the scene's scale is a fourth: one or two edges of one image give
// them all, and every view judges the result.
#pragma once

#include <Eigen/Core>
#include <cstdint>
#include <optional>
#include <span>
#include <vector>

#include "server/vision/recognition/pose_refine.h"
#include "server/vision/recognition/pose_votes.h"
#include "server/vision/recognition/scene_model.h"
#include "server/vision/reconstruction/reconstruction.h"

namespace horopter {

// A part at rest: lowest points on z = 0, turned in one of its stable poses, yaw zero.
struct StandingPart {
  Rigid3 table_from_object;
  std::vector<Eigen::Vector3d> vertices;  // of the model, in the table frame, metres
};
std::vector<StandingPart> StandingParts(const PreparedObject& object);

// Where a pixel's ray meets the table and how that point moves with height: the ray is at
// base + z * shift, at height z (table frame).
struct TableSighting {
  Eigen::Vector2d base = Eigen::Vector2d::Zero();
  Eigen::Vector2d shift = Eigen::Vector2d::Zero();
};
// False for rays that do not go down to the table.
bool SightTable(const PinholeCamera& camera,
                const Rigid3& camera_from_table,
                const Eigen::Vector2d& pixel,
                TableSighting* sighting);

// The heights at which a level edge seen as one segment would also be seen in other views.
class HeightMask {
 public:
  static constexpr int kBins = 128;
  void Set(int bin) { bits_[bin >> 6] |= 1ull << (bin & 63); }
  // height_share: height / the largest height the mask covers.
  bool At(double height_share) const {
    const int bin = static_cast<int>(height_share * kBins);
    return bin >= 0 && bin < kBins && (bits_[bin >> 6] >> (bin & 63) & 1);
  }

 private:
  std::uint64_t bits_[2] = {0, 0};
};

// Poses, up to two, in which the vertices a, b, c of a standing part are seen at the sightings of
// the same names, scale unknown: a and b are met exactly, c within `tolerance` of the path's
// length.
int PosesFromSightings(const Eigen::Vector3d vertices[3],
                       const TableSighting sightings[3],
                       double tolerance,
                       TableYaw out[2]);

struct TableSearchOptions {
  int max_paths = 700;            // image paths per view, scale unknown
  double path_tolerance = 0.12;   // misfit of the third point, share of the path
  float quick_reach_px = 10.0f;   // working pixels
  float min_quick = 0.42f;        // mean over the views
  float known_reach_px = 7.0f;    // ... once the cameras are known well
  double settle_reach_px = 14.0;  // first association when poses are refined over all views
  float settled_reach_px = 3.0f;  // ... of the refined poses
  int settled_per_object = 24;    // distinct poses refined
  int kept_per_object = 8;        // distinct poses
  int refined_seeds = 40;         // ... of all objects that are verified as seeds
  double min_edge_px = 14.0;      // working pixels, scale known
  double min_partial = 0.5;       // seen share of an edge of which one end is hidden
  double min_path_votes = 2.0;    // of two-edge paths, scale unknown
  double min_edge_votes = 2.2;    // of edges seen whole; 0.5 for one of which an end is hidden
  int peaks = 150;                // poses scored per standing pose of an object
};

// The reconstruction's cameras in metres with one part placed, refined and judged; empty when the
// refinement fails. world_from_object: metres.
std::optional<SceneModel> RefinedSeed(const JointContext& context,
                                      const Reconstruction& reconstruction,
                                      double units_per_metre,
                                      int object,
                                      const Rigid3& world_from_object);

// Scenes of one part each, cameras from the reconstruction and scaled by the part; best first, at
// most `max_scales` different scales. Empty when the reconstruction has no two views.
std::vector<SceneModel> TableSeeds(const JointContext& context,
                                   const Reconstruction& reconstruction,
                                   const TableSearchOptions& options,
                                   int max_scales);

struct TablePose {
  Rigid3 scene_from_object;
  double quick = 0.0;
};

// Poses of one object on the scene's plane, or on a level surface above it, suggested by single
// edges of the registered views. The scene must have a plane.
class TableSearch {
 public:
  TableSearch(const JointContext& context,
              const SceneModel& scene,
              const TableSearchOptions& options);
  // Best quick score first, distinct. base_m: heights of the surfaces above the plane, metres.
  std::vector<TablePose> Find(int object, std::span<const double> base_m) const;

 private:
  PoseVotes VoteByEdges(const PreparedObject& object, const StandingPart& part) const;

  struct SightedEdge {
    TableSighting ends[2];
    HeightMask heights;
    bool corner[2] = {false, false};  // the end is a junction
    double pixel[2] = {0, 0};         // table metres per working pixel about the ends
    bool on_plane = false;
  };
  const JointContext& context_;
  TableSearchOptions options_;
  Rigid3 scene_from_table_;
  double max_height_ = 0.0;
  std::vector<KnownView> views_;                 // in the table frame
  std::vector<std::vector<SightedEdge>> edges_;  // per entry of views_
};

}  // namespace horopter
