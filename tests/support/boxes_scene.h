// Texture-less boxes as the cameras of a synthetic scene see them.
#pragma once

#include <opencv2/core/mat.hpp>

#include "tests/support/synthetic_scene.h"

namespace horopter {

// Boxes of different colours (at most 9, by seed) standing on the plane, as view v of the scene
// sees them, faces far to near, with sensor noise; CV_8UC3. texture: of the plane (PlaneTexture);
// empty: plain grey. Straight edges stay straight: k1 moves corners only.
cv::Mat RenderBoxes(
    const SyntheticScene& scene, int v, unsigned seed, int boxes, const cv::Mat& texture = {});

}  // namespace horopter
