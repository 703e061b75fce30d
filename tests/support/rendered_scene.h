// Images of parts on a table, drawn in software: a z-buffer with 3 x 3 samples a pixel, soft
// shadows, light from all around, gloss, lens distortion, blur and sensor noise.
#pragma once

#include <Eigen/Core>
#include <opencv2/core.hpp>
#include <vector>

#include "server/vision/geometry/depth_buffer.h"
#include "server/vision/geometry/pinhole_camera.h"
#include "server/vision/geometry/rigid3.h"
#include "server/vision/recognition/aspects/render_mesh.h"

namespace horopter {

// Colours are red, green, blue; reflectances and radiances are linear, 0..1.
struct PaintedPart {
  const RenderMesh* mesh = nullptr;  // of ExactRenderMesh
  Rigid3 world_from_object;
  Eigen::Vector3f color = Eigen::Vector3f::Constant(0.5f);
  float gloss = 0.0f;       // of the highlight, 0..1
  float shininess = 30.0f;  // Blinn's exponent
};

// The plane z = 0, its reflectance repeated by mirroring beyond the image.
struct PaintedTable {
  cv::Mat_<cv::Vec3f> reflectance;
  double size_m = 1.0;  // of the image's side, its middle at the world's origin
};

// Where light comes from; several stand for one that is not a point.
struct LightSource {
  Eigen::Vector3d position = Eigen::Vector3d(0, 0, 2);  // world, metres
  Eigen::Vector3f radiance = Eigen::Vector3f::Ones();   // at the world's origin
  bool highlights = false;
};

struct PaintedScene {
  std::vector<PaintedPart> parts;
  PaintedTable table;
  std::vector<LightSource> lights;
  double radius_m = 0.3;  // about the origin: holds all parts and the shadows that are seen
};

// What a camera makes of the light.
struct CameraLook {
  float exposure = 1.0f;
  Eigen::Vector3f gains = Eigen::Vector3f::Ones();  // white balance
  double blur_px = 0.5;                             // deviation of a Gaussian
  double noise = 1.5;                               // deviation at middle grey, grey levels
  unsigned seed = 1;                                // of the noise
};

struct Photograph {
  cv::Mat image;  // BGR, 8 bit
  // Per part: visible pixels inside the image over those of its whole silhouette, and their box.
  std::vector<double> visible_share;
  std::vector<cv::Rect> visible_box;
};

// The mesh as it is, not decimated for looking at it from afar. Errors: those of MakeRenderMesh.
absl::StatusOr<RenderMesh> ExactRenderMesh(const TriangleMesh& mesh, double diameter_m);

// Shadows are the same for all cameras and computed once.
class SceneRenderer {
 public:
  // The scene's meshes outlive the renderer.
  explicit SceneRenderer(PaintedScene scene);

  Photograph Take(const PinholeCamera& camera,
                  const Rigid3& camera_from_world,
                  const CameraLook& look) const;

 private:
  struct Canvas;
  struct ShadowMap {
    PinholeCamera camera;
    Rigid3 camera_from_world;
    DepthBuffer depth;
  };

  // Share of the light that reaches a point near the parts.
  float Reaches(const ShadowMap& map, const Eigen::Vector3d& point, double bias_m) const;
  Eigen::Vector3f TableLight(const Eigen::Vector3d& point) const;
  Eigen::Vector3f PartLight(const PaintedPart& part,
                            const Eigen::Vector3d& point,
                            const Eigen::Vector3d& normal,
                            const Eigen::Vector3d& to_camera) const;
  Canvas Draw(const PinholeCamera& camera, const Rigid3& camera_from_world) const;
  void Shade(const Rigid3& camera_from_world, Canvas* canvas) const;
  void Measure(const Canvas& canvas, const PinholeCamera& camera, Photograph* out) const;

  PaintedScene scene_;
  std::vector<ShadowMap> shadows_;  // one a light
  cv::Mat_<cv::Vec3f> table_light_;
};

}  // namespace horopter
