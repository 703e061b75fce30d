// The plane that parts are looked for on, in axes of its own, and the cameras over it.
#pragma once

#include <Eigen/Core>
#include <cstddef>
#include <cstdint>
#include <optional>
#include <span>
#include <vector>

#include "server/vision/recognition/aspect_scenes/aspect_adjustment.h"
#include "server/vision/recognition/aspect_scenes/standing_planes.h"
#include "server/vision/recognition/aspects/aspect_image.h"
#include "server/vision/recognition/aspects/fragment_index.h"

namespace horopter {

// How near the parts taken are, in the cells of an image's half map.
struct HidingMap {
  int width = 0, height = 0;
  std::vector<float> depth_m;         // infinite where there is none
  std::vector<std::int32_t> covered;  // sums of cells that have one, as `unexplained`

  // Whether a point of this depth, at a half map's cell, is behind a part.
  bool Hides(int x, int y, float depth) const {
    return static_cast<unsigned>(x) < static_cast<unsigned>(width) &&
           static_cast<unsigned>(y) < static_cast<unsigned>(height) &&
           depth_m[static_cast<std::size_t>(y) * width + x] < depth;
  }
};

struct StandingGround {
  StandingPlane plane;
  Eigen::Vector3d origin, e1, e2;
  Eigen::Vector2d low = Eigen::Vector2d::Zero(), high = Eigen::Vector2d::Zero();
  std::vector<AspectImage> images;     // without the edges that the parts taken explain
  std::vector<PinholeCamera> cameras;  // of the working images
  std::vector<Rigid3> camera_from_scene;
  std::size_t least_views = 2;                         // that show a place
  std::vector<std::vector<std::int32_t>> unexplained;  // sums of edge points over the half maps
  std::vector<HidingMap> hiding;                       // by the parts taken, one per image
  std::vector<std::vector<std::int32_t>> ground;  // sums of AspectImage::ground, empty: not known

  Eigen::Vector3d At(double x, double y) const { return origin + x * e1 + y * e2; }
};

// `views` without a camera are left out; threads work on the others. The region is where half of
// the others, at least two, see the plane not much farther than the parts taken.
StandingGround MakeGround(std::span<const AspectImage> images,
                          const std::vector<std::optional<AspectSceneView>>& views,
                          const StandingPlane& plane,
                          std::span<const AspectSceneObject> taken,
                          std::span<const AspectModel> models,
                          int threads = 1);

// Whether a point of view v's camera frame, metres, lies in its image.
bool IsShown(const StandingGround& ground, std::size_t v, const Eigen::Vector3d& in_camera);

// Edge points that no part taken explains, in a square about a pixel of view v's working image.
int UnexplainedNear(const StandingGround& ground,
                    std::size_t v,
                    const Eigen::Vector2d& at,
                    double half_px);

// Share of such a square that is seen to be ground, 0 where that is not known.
double GroundShareNear(const StandingGround& ground,
                       std::size_t v,
                       const Eigen::Vector2d& at,
                       double half_px);

// Whether a part taken covers anything there.
bool IsCoveredNear(const StandingGround& ground,
                   std::size_t v,
                   const Eigen::Vector2d& at,
                   double half_px);

}  // namespace horopter
