// Cameras and poses of a scene adjusted together to the edges that its parts show.
#pragma once

#include <Eigen/Core>
#include <optional>
#include <span>
#include <vector>

#include "server/base/stop_token.h"
#include "server/vision/geometry/camera_prior.h"
#include "server/vision/geometry/pinhole_camera.h"
#include "server/vision/geometry/rigid3.h"
#include "server/vision/recognition/aspects/aspect_image.h"
#include "server/vision/recognition/aspects/render_mesh.h"

namespace horopter {

// Cameras are those of the original images; scene frame in metres.
struct AspectSceneView {
  PinholeCamera camera;
  Rigid3 camera_from_scene;
  // Prior of the focal length: ln f has this mean and deviation.
  double prior_log_focal = 0.0;
  double log_focal_sigma = kNominalFocalLogSigma;
};

struct AspectSceneObject {
  int object = -1;  // index into the meshes
  Rigid3 scene_from_object;
};

// One equation: the projection of a point of an object, along `normal`, is at `target`.
struct SceneRow {
  int view = -1;
  int object = -1;                                    // index into the scene's objects
  Eigen::Vector3d point = Eigen::Vector3d::Zero();    // object frame
  Eigen::Vector2d target = Eigen::Vector2d::Zero();   // pixels
  Eigen::Vector2d normal = Eigen::Vector2d::UnitX();  // unit
  double weight = 1.0;
};

// The first object stays where it is: it fixes the scene's frame.
struct AspectScene {
  std::vector<std::optional<AspectSceneView>> views;
  std::vector<AspectSceneObject> objects;
};

// Focal length over the larger side of the image: of images of one camera in different sizes the
// same.
double RelativeFocal(const PinholeCamera& camera);

// The scene with one relative focal length for all views, and this prior of it; `middle` (scene
// frame, metres) keeps its place in every image, and what is around it its size.
AspectScene WithOneFocal(AspectScene scene,
                         const Eigen::Vector3d& middle,
                         double relative_focal,
                         double log_focal_sigma);

struct AspectAdjustmentOptions {
  // Of each round: reach along the normals (working pixels) and whether edges are rendered again.
  std::vector<double> search_px = {8.0, 5.0, 4.0, 3.0, 3.0};
  double render_px = 160.0;
  int max_points = 250;   // of an object in a view
  int steps = 3;          // of Gauss-Newton in a round, under the same rows
  double sigma_px = 1.0;  // of a row
};

// Cameras known before any part is: a frame of some unit (KnownCameras), and how far the scene's
// cameras may be from where it has them. The scene's frame is this one in metres, unit_m of them
// are its unit; all objects are free.
struct CamerasPrior {
  std::vector<std::optional<Rigid3>> camera_from_world;  // one per view; translations in the unit
  double rotation_sigma_rad = 0.01;
  double position_sigma = 0.02;  // of a camera's centre, of its distance from the first object
  bool scale_known = false;      // unit_m stays
  double unit_m = 1.0;
};

// Gauss-Newton of all cameras (pose and focal length under its prior) and of all objects but the
// first over the rows; returns the weighted rms of the rows in pixels, 0 without rows. A step that
// makes it worse is damped (Levenberg-Marquardt). prior: of known cameras, its unit is adjusted
// with the scene; null: nothing is known of them.
double AdjustToRows(std::span<const SceneRow> rows,
                    int steps,
                    double sigma_px,
                    AspectScene* scene,
                    CamerasPrior* prior = nullptr);

// One step of a single object's pose over its rows, cameras fixed.
Rigid3 AdjustObjectToRows(std::span<const SceneRow> rows,
                          const std::vector<std::optional<AspectSceneView>>& views,
                          const Rigid3& scene_from_object);

// The same over the image edges that the objects' visible edges meet. `images` one per view,
// `meshes` by AspectSceneObject::object. Leaves the scene as it is where nothing meets. Returns the
// weighted rms of the edges met in the last step, pixels.
double AdjustToEdges(std::span<const AspectImage> images,
                     std::span<const RenderMesh* const> meshes,
                     const AspectAdjustmentOptions& options,
                     int threads,
                     AspectScene* scene,
                     CamerasPrior* prior = nullptr);

}  // namespace horopter
