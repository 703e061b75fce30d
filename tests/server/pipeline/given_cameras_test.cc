#include "server/pipeline/given_cameras.h"

#include <gtest/gtest.h>

namespace horopter {
namespace {

// Cameras half a metre apart from each other, the last one unknown.
Reconstruction Reconstructed() {
  Reconstruction out;
  out.trusted = true;
  for (int v = 0; v < 3; ++v) {
    CalibratedView view;
    view.camera = CenteredCamera(640, 480, 700.0 + v);
    view.camera_from_scene.t = {-0.5 * v, 0.0, 2.0};
    view.focal_log_sigma = 0.03;
    out.views.emplace_back(view);
  }
  out.views.emplace_back();
  out.points.push_back({{0.1, 0.2, 0.3}, {}, false});
  return out;
}

TEST(GivenCameras, OfATrustedReconstructionAreItsOwnUpToScale) {
  const KnownCameras known = CamerasOfReconstruction(Reconstructed());
  ASSERT_EQ(known.views.size(), 4u);
  EXPECT_EQ(known.known(), 3);
  EXPECT_FALSE(known.scale_known);
  EXPECT_GT(known.rotation_sigma_rad, 0.0);
  EXPECT_GT(known.position_sigma, 0.0);
  EXPECT_EQ(known.views[1]->camera.focal_px, 701.0);
  EXPECT_EQ(known.views[1]->focal_log_sigma, 0.03);
  ASSERT_EQ(known.points_in_world.size(), 1u);
}

TEST(GivenCameras, OfAReconstructionThatIsNotTrustedOrHasOneViewAreNone) {
  Reconstruction untrusted = Reconstructed();
  untrusted.trusted = false;
  EXPECT_TRUE(CamerasOfReconstruction(untrusted).views.empty());
  Reconstruction one = Reconstructed();
  one.views[1].reset();
  one.views[2].reset();
  EXPECT_TRUE(CamerasOfReconstruction(one).views.empty());
}

}  // namespace
}  // namespace horopter
