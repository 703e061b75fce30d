// By how much a placed part would have to be stretched along its axes to fit the images best: a
// part that is not the one enrolled, but nearly, betrays itself so, whatever its support is.
#pragma once

#include <Eigen/Core>
#include <optional>
#include <span>
#include <vector>

#include "server/vision/geometry/calibrated_camera.h"
#include "server/vision/geometry/depth_buffer.h"
#include "server/vision/geometry/rigid3.h"
#include "server/vision/recognition/aspects/aspect_image.h"
#include "server/vision/recognition/aspects/render_mesh.h"

namespace horopter {

// The two directions of strain that images see, orthonormal columns of sum 0: sizes are not seen.
Eigen::Matrix<double, 3, 2> StrainDirections();

struct ShapeStrain {
  // Along the object frame's axes, ln of the stretch; of mean 0: images have no scale.
  Eigen::Vector3d strain = Eigen::Vector3d::Zero();
  Eigen::Matrix3d covariance = Eigen::Matrix3d::Zero();
};

// Stretch and cameras (pose and focal length of each view, loosely where they are) adjusted
// together to the edges met. Zero where too few edges (60 rows) are met. views: cameras of the
// original images, metres. hidden: what stands before the part, in each view's working image
// without its lens; what it hides is not asked for. Empty: nothing does.
ShapeStrain EstimateStrain(std::span<const AspectImage> images,
                           const RenderMesh& mesh,
                           const std::vector<std::optional<CalibratedCamera>>& views,
                           const Rigid3& scene_from_object,
                           std::span<const DepthBuffer> hidden = {});

// The part stretched by exp(strain) along its frame's axes about the centre of its bounding box.
RenderMesh Strained(const RenderMesh& mesh, const Eigen::Vector3d& strain);

}  // namespace horopter
