// Cameras around a few simple parts.
#pragma once

#include <gtest/gtest.h>

#include <Eigen/Geometry>
#include <cmath>
#include <optional>
#include <vector>

#include "server/vision/recognition/aspect_scenes/aspect_adjustment.h"
#include "server/vision/recognition/aspects/aspect_image.h"
#include "tests/support/part_photos.h"

namespace horopter {

inline constexpr int kViews = 4;

// A block with a step, so that no turn of it looks the same.
inline TriangleMesh SteppedBlock() {
  return SweptMesh(
      {{0.03, -0.02}, {0.03, 0.004}, {0.0, 0.012}, {0.0, 0.02}, {-0.03, 0.02}, {-0.03, -0.02}},
      0.012);
}

inline PinholeCamera Camera() {
  return CenteredCamera(640, 480, 800.0);
}

// From above, half a metre away, around the z axis.
inline Rigid3 CameraFromScene(int view) {
  const Eigen::Quaterniond tilt(Eigen::AngleAxisd(2.5, Eigen::Vector3d::UnitX()));
  const Eigen::Quaterniond around(Eigen::AngleAxisd(0.3 * view, Eigen::Vector3d::UnitZ()));
  return {(tilt * around).toRotationMatrix(), Eigen::Vector3d(0, 0, 0.32)};
}

inline std::vector<std::optional<AspectSceneView>> Views() {
  std::vector<std::optional<AspectSceneView>> out;
  for (int v = 0; v < kViews; ++v)
    out.push_back(AspectSceneView{Camera(), CameraFromScene(v), std::log(800.0), 0.35});
  return out;
}

// The block before these cameras.
class PhotographedBlock : public testing::TestWithParam<unsigned> {
 protected:
  static void SetUpTestSuite() {
    block_ = new PhotoPart(MakePart(SteppedBlock()));
    for (int v = 0; v < kViews; ++v) {
      images_.push_back(
          MakeAspectImage(PhotoOf({{&block_->object.mesh, CameraFromScene(v)}}, Camera())));
    }
  }
  static void TearDownTestSuite() {
    delete block_;
    images_.clear();
  }

  static inline PhotoPart* block_ = nullptr;
  static inline std::vector<AspectImage> images_;
};

}  // namespace horopter
