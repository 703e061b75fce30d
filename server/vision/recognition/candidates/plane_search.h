// Poses of parts that stand on the supporting plane. With the cameras known in the plane's frame a
// pose has three unknowns: one edge of one image gives them all, and every view judges the result.
// Where the scale is unknown too, see plane_initialization.h.
#pragma once

#include <Eigen/Core>
#include <vector>

#include "server/vision/recognition/candidates/plane_sighting.h"
#include "server/vision/recognition/candidates/pose_votes.h"
#include "server/vision/recognition/candidates/standing_poses.h"
#include "server/vision/recognition/scene/scene_model.h"
#include "server/vision/recognition/scene/support_surface.h"
#include "server/vision/recognition/search_options.h"

namespace horopter {

struct PlanePose {
  Rigid3 scene_from_object;
  double quick = 0.0;
};

// Poses of one object on the scene's plane and on level surfaces above it, suggested by single
// edges of the registered views. The scene must have a plane.
class PlaneSearch {
 public:
  PlaneSearch(const JointContext& context,
              const SceneModel& scene,
              const std::vector<SearchSurface>& surfaces,
              const PlaneSearchOptions& options);
  // Best quick score first, distinct.
  std::vector<PlanePose> Find(int object) const;

 private:
  struct SightedEdge {
    PlaneSighting ends[2];
    HeightMask heights;
    bool corner[2] = {false, false};  // the end is a junction
    double pixel[2] = {0, 0};         // plane metres per working pixel about the ends
    bool on_plane = false;
  };
  struct Disc {
    Eigen::Vector2d center = Eigen::Vector2d::Zero();  // plane frame, metres
    double radius_m = 0.0;
  };
  struct Surface {
    double height_m = 0.0;
    std::vector<Disc> discs;  // empty: anywhere
  };
  // Of views_[i], which is view v of the request; top: metres above the plane that parts reach.
  std::vector<SightedEdge> SightedEdges(int i, std::size_t v, double top) const;
  // Per view the edges that a part of this size (diameter) may show on the surface.
  std::vector<std::vector<const SightedEdge*>> EdgesOver(const Surface& surface,
                                                         double diameter_m) const;
  PoseVotes VoteByEdges(const PreparedObject& object,
                        const StandingObject& standing,
                        const Surface& surface,
                        const std::vector<std::vector<const SightedEdge*>>& edges) const;

  const JointContext& context_;
  PlaneSearchOptions options_;
  Rigid3 scene_from_plane_;
  double max_height_ = 0.0;
  std::vector<Surface> surfaces_;
  std::vector<KnownView> views_;                 // in the supporting plane frame
  std::vector<std::vector<SightedEdge>> edges_;  // per entry of views_
};

}  // namespace horopter
