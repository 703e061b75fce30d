// A pose held against the edges of one image: which image point each visible edge point meets, and
// the pose that brings them together.
#pragma once

#include <Eigen/Core>
#include <span>
#include <vector>

#include "server/vision/geometry/camera_prior.h"
#include "server/vision/geometry/pinhole_camera.h"
#include "server/vision/geometry/rigid3.h"
#include "server/vision/recognition/aspect_search/pose_rendering.h"
#include "server/vision/recognition/aspects/aspect_image.h"
#include "server/vision/recognition/aspects/render_mesh.h"
#include "server/vision/recognition/aspects/visible_edges.h"

namespace horopter {

// A point of a visible edge in the object's frame (metres), with the direction of its edge.
struct ModelEdgePoint {
  Eigen::Vector3f point = Eigen::Vector3f::Zero();
  Eigen::Vector3f direction = Eigen::Vector3f::UnitX();
  float weight = 1.0f;  // e.g. the length it stands for
};

// Cameras and pixels are those of the original image.
struct PoseEdgeMatch {
  Eigen::Vector3d point = Eigen::Vector3d::Zero();  // object frame, metres
  Eigen::Vector2d projected = Eigen::Vector2d::Zero();
  Eigen::Vector2d normal = Eigen::Vector2d::UnitX();  // unit, of the projected edge
  Eigen::Vector2d matched = Eigen::Vector2d::Zero();  // sub-pixel image edge point
  double residual_px = 0.0;                           // normal . (matched - projected)
  double weight = 0.0;                                // 0..1, robust, x the point's own
};

struct PoseEdgeOptions {
  double search_px = 6.0;     // along the normal, working pixels
  int max_points = 400;       // visible edge points used; more are thinned evenly
  double render_px = 160.0;   // a diameter, of renderings made here
  int iterations = 5;         // Gauss-Newton steps between renderings; the search narrows
  int renderings = 2;         // of a refinement
  bool refine_focal = false;  // with the prior below
  double nominal_focal_share = kNominalFocalShare;  // focal length over image width
  double log_focal_sigma = kNominalFocalLogSigma;
};

// Edge points thinned evenly to max_points.
std::vector<ModelEdgePoint> ThinnedEdgePoints(const VisibleEdges& edges, int max_points);

// ... of a rendering at this pose.
std::vector<ModelEdgePoint> RenderedEdgePoints(const RenderMesh& mesh,
                                               const PinholeCamera& camera,
                                               const Rigid3& camera_from_object,
                                               const PoseEdgeOptions& options = {});

// Edge correspondences of a pose in one image: of each visible edge point that meets a
// like-directed image edge within search_px along its normal, the nearest one. For adjustments over
// several views.
std::vector<PoseEdgeMatch> MatchPoseEdges(const AspectImage& image,
                                          const RenderMesh& mesh,
                                          const PinholeCamera& camera,
                                          const Rigid3& camera_from_object,
                                          const PoseEdgeOptions& options = {});

// The same with given edge points.
std::vector<PoseEdgeMatch> MatchPoseEdges(const AspectImage& image,
                                          std::span<const ModelEdgePoint> points,
                                          const PinholeCamera& camera,
                                          const Rigid3& camera_from_object,
                                          const PoseEdgeOptions& options = {});

struct RefinedAspect {
  PinholeCamera camera;
  Rigid3 camera_from_object;
  int matches = 0;      // of the last iteration; 0: nothing met, the pose is as given
  double rms_px = 0.0;  // weighted, of those, working pixels
};

// Gauss-Newton over the pose, and the focal length when asked, rendering the edges again at the
// pose reached.
RefinedAspect RefinePose(const AspectImage& image,
                         const RenderMesh& mesh,
                         const PinholeCamera& camera,
                         const Rigid3& camera_from_object,
                         const PoseEdgeOptions& options = {});

// The same on edges of the working image that are kept as far as they serve.
RefinedAspect RefinePose(const AspectImage& image,
                         const RenderMesh& mesh,
                         const PinholeCamera& camera,
                         const Rigid3& camera_from_object,
                         const PoseEdgeOptions& options,
                         PoseRendering* rendering);

// The same with given edge points and no rendering: `center` (object frame) is what rotations keep.
RefinedAspect RefinePose(const AspectImage& image,
                         std::span<const ModelEdgePoint> points,
                         const Eigen::Vector3d& center,
                         const PinholeCamera& camera,
                         const Rigid3& camera_from_object,
                         const PoseEdgeOptions& options = {});

}  // namespace horopter
