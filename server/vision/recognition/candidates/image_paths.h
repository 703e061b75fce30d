// Pairs of connected image edges, and the poses in which a pair of model edges looks so.
#pragma once

#include <Eigen/Core>
#include <vector>

#include "server/vision/features/features.h"
#include "server/vision/geometry/object_model.h"
#include "server/vision/geometry/pinhole_camera.h"
#include "server/vision/geometry/rigid3.h"
#include "server/vision/recognition/object/prepared_object.h"

namespace horopter {

// A path edge must be visible to this share in the pose's aspect.
inline constexpr double kMinPathVisible = 0.45;

// Image points a, b, c with edges a-b and b-c; b is a junction. Image pixels.
struct ImagePath {
  Eigen::Vector2d a = Eigen::Vector2d::Zero();
  Eigen::Vector2d b = Eigen::Vector2d::Zero();
  Eigen::Vector2d c = Eigen::Vector2d::Zero();
  int segment_ab = -1;  // indices into ImageFeatures::segments
  int segment_bc = -1;
  double rank = 0.0;  // larger: longer edges, ends that are junctions
};

// The image's paths, best rank first, at most max_paths. Segments in fine texture take no part.
// on_plane (empty or one per segment): segments that lie on the supporting plane; paths of two such
// rank low.
std::vector<ImagePath> FindImagePaths(const ImageFeatures& features,
                                      const std::vector<bool>& on_plane,
                                      double working_from_image,
                                      int max_paths);

// The up to two poses in which a weak-perspective view, corrected to full perspective, shows the
// model path along the image path. `reversed` matches the image's a with the model's c.
struct PathPoses {
  int count = 0;
  Rigid3 camera_from_object[2];
};
PathPoses PosesFromPath(const ObjectModel& model,
                        const VertexPath& path,
                        bool reversed,
                        const PinholeCamera& camera,
                        const ImagePath& image_path);

}  // namespace horopter
