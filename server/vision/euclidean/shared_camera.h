// Whether the views of a scene come from one camera, by what the scene says of each of them.
#pragma once

#include <vector>

#include "server/vision/euclidean/camera_similarity.h"
#include "server/vision/euclidean/scene_bundle.h"
#include "server/vision/euclidean/scene_covariance.h"

namespace horopter {

struct SharedCameraOptions {
  // Spread of log f among cameras of one kind, or of one that is refocused for every image: the
  // likeliest alternative to one camera (parts-train: 0.03). Higher: unlike cameras are fixed
  // together.
  double similar_log_focal = 0.03;
  // What is left between the views of one camera.
  double same_log_focal = 0.0005;
  double same_center_px = 0.2;
  double same_k1 = 0.0005;
  // Focal lengths are taken for this many times less sure than their covariance says: the parts
  // photographed are not quite their models. Higher: more scenes are said to come from one camera.
  double widening = 2.0;
  // Log of the factor by which the focal lengths must be likelier under one camera than under
  // similar ones. Higher: fewer scenes are said to come from one camera.
  double least_log_odds = 2.0;
};

// Groups of views with images of one size, of whose cameras nothing is given, that come from one
// camera: their focal lengths are likelier under one than drawn about a mean or each on its own.
// bundle: adjusted with every camera on its own (`alike` empty); covariance: of that adjustment.
// The principal point is not asked: where it is open, what single views say of it is mostly the
// error of their edges.
std::vector<CameraSimilarity> JudgeCameras(const SceneBundle& bundle,
                                           const SceneCovariance& covariance,
                                           const std::vector<bool>& hinted,
                                           const SharedCameraOptions& options);

}  // namespace horopter
