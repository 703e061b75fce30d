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
  // Views, three at least, whose log focal lengths differ by more than this say nothing of them
  // that could be believed (parts-dev, parts-train and cad-dev, which vary them: 0.30 at most): one
  // camera is likelier than any zoom between them.
  double unbelievable_log_focal = 0.35;
  // ... unless one camera leaves residuals that are larger by this factor. Sets of one camera: 0.8
  // - 1.04; scenes of cad-dev with every other image enlarged by 1.5: 2.1 - 4.3.
  double as_good = 1.3;
};

// Groups of views with images of one size, of whose cameras nothing is given, that come from one
// camera: their focal lengths are likelier under one than drawn about a mean or each on its own, or
// cannot be believed at all.
// bundle: adjusted with every camera on its own (`alike` empty); covariance: of that adjustment.
// The principal point is not asked: where it is open, what single views say of it is mostly the
// error of their edges.
std::vector<CameraSimilarity> JudgeCameras(const SceneBundle& bundle,
                                           const SceneCovariance& covariance,
                                           const std::vector<bool>& hinted,
                                           const SharedCameraOptions& options);

// Whether the focal lengths of these views, three at least, differ by more than can be believed.
bool AreUnbelievable(const SceneBundle& bundle,
                     const std::vector<int>& views,
                     const SharedCameraOptions& options);

}  // namespace horopter
