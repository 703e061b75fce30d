// The adjustment of a scene whose cameras are known before any part is.
#pragma once

#include <optional>
#include <span>
#include <vector>

#include "server/vision/recognition/aspect_scenes/aspect_adjustment.h"

namespace horopter {

// A frame of some unit (KnownCameras), and how far the scene's cameras may be from where it has
// them. The scene's frame is this one in metres, unit_m of them are its unit; all objects are free.
struct CamerasPrior {
  std::vector<std::optional<Rigid3>> camera_from_world;  // one per view; translations in the unit
  double rotation_sigma_rad = 0.01;
  double position_sigma = 0.02;  // of a camera's centre, of its distance from the first object
  bool scale_known = false;      // unit_m stays
  double unit_m = 1.0;
};

// As the functions of aspect_adjustment.h, under the prior, whose unit is adjusted with the scene.
double AdjustToRows(std::span<const SceneRow> rows,
                    int steps,
                    double sigma_px,
                    AspectScene* scene,
                    CamerasPrior* prior);
double AdjustToEdges(std::span<const AspectImage> images,
                     std::span<const RenderMesh* const> meshes,
                     const AspectAdjustmentOptions& options,
                     int threads,
                     AspectScene* scene,
                     CamerasPrior* prior);

}  // namespace horopter
