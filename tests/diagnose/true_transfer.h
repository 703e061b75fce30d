// Whether two pixels of two images show one point of the scene, by the models' surfaces and by the
// true epipolar geometry.
#pragma once

#include <Eigen/Core>
#include <optional>
#include <vector>

#include "server/vision/geometry/depth_buffer.h"
#include "tests/diagnose/ground_truth.h"
#include "tests/diagnose/true_world.h"

namespace horopter {

enum class MatchTruth { kUnknown, kRight, kWrong };

class TrueTransfer {
 public:
  // Both outlive it.
  TrueTransfer(const TrueWorld& world, const TrueModels& models);

  // pixels: with distortion. A match is wrong when it is farther than 2 px from the epipolar lines,
  // or, where one of the pixels is inside a model's surface, than 3 px from where that surface's
  // point is seen; both grow by what the truth itself is off. Unknown: the poses of the images are
  // not known in one world and neither pixel is on a part without symmetries.
  MatchTruth Judge(int view_a,
                   const Eigen::Vector2d& a,
                   int view_b,
                   const Eigen::Vector2d& b) const;

 private:
  // A point of a part's surface.
  struct Surface {
    int instance = -1;
    Eigen::Vector3d point_in_camera;
  };
  struct View {
    PinholeCamera wide;  // undistorted, with a margin
    DepthBuffer depth;
    std::vector<int> instance;  // per pixel of it, -1: no part
  };

  std::optional<Surface> SurfaceAt(int view, const Eigen::Vector2d& pixel) const;
  std::optional<Rigid3> Motion(int from, int to, int instance) const;
  // Distance in image `to` of what the surface's point should be seen at; empty: not known.
  std::optional<double> TransferError(int from,
                                      const Surface& surface,
                                      int to,
                                      const Eigen::Vector2d& pixel) const;

  const TrueWorld& world_;
  const TrueModels& models_;
  std::vector<View> views_;
};

// Larger distance of two undistorted pixels from their true epipolar lines; both poses are known.
double TrueEpipolarDistance(const BopImage& image_a,
                            const Eigen::Vector2d& a,
                            const BopImage& image_b,
                            const Eigen::Vector2d& b);

}  // namespace horopter
