// Z-buffer of meshes in one view: hidden-line removal for verification, overlays and ground truth.
#pragma once

#include <Eigen/Core>
#include <vector>

#include "server/vision/geometry/object_model.h"
#include "server/vision/geometry/pinhole_camera.h"
#include "server/vision/geometry/rigid3.h"

namespace horopter {

// Depth along the optical axis (camera z, metres) of the nearest surface through each pixel centre,
// row-major; kNoDepth where nothing was drawn.
struct DepthBuffer {
  static constexpr float kNoDepth = 1e30f;  // metres; further than anything drawn

  int width = 0;
  int height = 0;
  std::vector<float> depth;

  float At(int x, int y) const { return depth[static_cast<size_t>(y) * width + x]; }
};

// An empty buffer. Non-positive sizes give a buffer without pixels.
DepthBuffer MakeDepthBuffer(int width, int height);

// Sets every pixel back to kNoDepth and keeps the memory.
void ClearDepth(DepthBuffer* buffer);

// Draws a mesh into the buffer, keeping the nearer surface: call it once per object to merge
// several. Both faces of a triangle are drawn. The buffer's size counts, not the camera's. Straight
// lines stay straight: k1 is ignored. Triangles are clipped at z = 1 mm; those with indices out of
// range or non-finite corners are skipped.
void RenderDepth(const TriangleMesh& mesh,
                 const PinholeCamera& camera,
                 const Rigid3& camera_from_object,
                 DepthBuffer* buffer);

// True when a surface point seen at `pixel` (of the same undistorted camera) with depth `z`
// (metres) is not behind anything by more than `tolerance_m`. The farthest of the 3x3 pixels around
// decides, so that points on a silhouette are not hidden by their own face. Pixels outside the
// buffer are not visible.
bool IsVisible(const DepthBuffer& buffer,
               const Eigen::Vector2d& pixel,
               double z,
               double tolerance_m);

}  // namespace horopter
