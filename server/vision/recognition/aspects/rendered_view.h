// Software z-buffer around a part: depth and faces in a window of the image, drawn at its own
// scale.
#pragma once

#include <Eigen/Core>
#include <array>
#include <cstdint>
#include <vector>

#include "server/vision/geometry/pinhole_camera.h"
#include "server/vision/geometry/rigid3.h"
#include "server/vision/recognition/aspects/render_mesh.h"

namespace horopter {

// A window of the undistorted image with `scale` rendered pixels per image pixel: rendered pixel
// (x, y) has its centre at origin + (x, y) / scale of the image without lens distortion.
struct RenderedView {
  int width = 0;
  int height = 0;
  double scale = 1.0;
  Eigen::Vector2d origin = Eigen::Vector2d::Zero();
  std::vector<float> inverse_depth;    // 1 / (camera z in metres), row-major; 0 = background
  std::vector<std::int32_t> triangle;  // nearest triangle of the RenderMesh, -1 = background

  bool Covered(int x, int y) const {
    return inverse_depth[static_cast<std::size_t>(y) * width + x] > 0.0f;
  }
};

// Where pixels of the image (with lens distortion) lie in a rendering, in rendered pixels: inside
// the image exact to 0.001 pixels for |k1| <= 0.3.
class RenderedFromImage {
 public:
  RenderedFromImage(const RenderedView& view, const PinholeCamera& camera);

  Eigen::Vector2d operator()(const Eigen::Vector2d& pixel) const;

 private:
  static constexpr int kRadialSteps = 256;

  PinholeCamera camera_;
  Eigen::Vector2d origin_;
  double scale_;
  // By which distances from the principal point shrink without distortion, by their square.
  double steps_per_px2_ = 0.0;
  std::array<double, kRadialSteps> factor_;
};

// A view with what it was drawn from. Screen coordinates are rendered pixels; the inverse depth of
// a plane is linear over the screen.
struct Rendering {
  RenderedView view;
  float focal_px = 0.0f;  // of the rendering
  Eigen::Vector2f principal = Eigen::Vector2f::Zero();
  std::vector<Eigen::Vector3f> screen;  // of the mesh's vertices: u, v, 1 / z; 1 / z = 0 if behind
  std::vector<std::int8_t> facing;      // of triangles: 1 front face seen, -1 back face, 0 edge-on
};

struct RenderOptions {
  double render_px = 180.0;  // see VisibleEdgeOptions
  double max_scale = 1.0;
};

// The window covers the part of the object inside the image and a margin of a few pixels; empty
// (width 0) if nothing of the object is in front of the camera and inside the image.
Rendering Render(const RenderMesh& mesh,
                 const PinholeCamera& camera,
                 const Rigid3& camera_from_object,
                 const RenderOptions& options);

// The inverse depth of a triangle's plane: value at (u, v) = at_zero + gradient . (u, v). Zero
// gradient for a triangle seen edge-on.
struct InverseDepthPlane {
  float at_zero = 0.0f;
  Eigen::Vector2f gradient = Eigen::Vector2f::Zero();

  float At(float u, float v) const { return at_zero + gradient.x() * u + gradient.y() * v; }
};

InverseDepthPlane PlaneOf(const Rendering& rendering, const RenderMesh& mesh, int triangle);

}  // namespace horopter
