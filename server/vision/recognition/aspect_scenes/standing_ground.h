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

struct StandingGround {
  StandingPlane plane;
  Eigen::Vector3d origin, e1, e2;
  Eigen::Vector2d low = Eigen::Vector2d::Zero(), high = Eigen::Vector2d::Zero();
  std::vector<const AspectImage*> images;
  std::vector<PinholeCamera> cameras;  // of the working images
  std::vector<Rigid3> camera_from_scene;
  std::size_t least_views = 2;                         // that show a place
  std::vector<std::vector<std::int32_t>> unexplained;  // sums of edge points over the half maps

  Eigen::Vector3d At(double x, double y) const { return origin + x * e1 + y * e2; }
};

// `views` without a camera are left out. The region is where half of the others, at least two, see
// the plane not much farther than the parts taken.
StandingGround MakeGround(std::span<const AspectImage> images,
                          const std::vector<std::optional<AspectSceneView>>& views,
                          const StandingPlane& plane,
                          std::span<const AspectSceneObject> taken,
                          std::span<const AspectModel> models);

// Whether a point of view v's camera frame, metres, lies in its image.
bool IsShown(const StandingGround& ground, std::size_t v, const Eigen::Vector3d& in_camera);

// Edge points that no part taken explains, in a square about a pixel of view v's working image.
int UnexplainedNear(const StandingGround& ground,
                    std::size_t v,
                    const Eigen::Vector2d& at,
                    double half_px);

}  // namespace horopter
