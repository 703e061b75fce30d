// Cameras that are known before any part is, from whoever gives them.
#pragma once

#include "server/pipeline/scene.h"
#include "server/pipeline/station.h"
#include "server/vision/reconstruction/known_cameras.h"

namespace horopter {

// The cameras of a request's images with their places in a station's rig, metres, where all are
// known well enough to look for parts under them (fixed cameras, one image each); else no views.
KnownCameras CamerasOfStation(const StationRequest& station);

// The cameras of a request that says where they are (SceneRequest::camera_poses, a robot's) and
// what their lenses are, metres, where it knows both well enough for all images; else no views.
KnownCameras CamerasOfRequest(const SceneRequest& request);

}  // namespace horopter
