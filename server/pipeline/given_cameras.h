// Cameras that are known before any part is, from whoever gives them.
#pragma once

#include "server/pipeline/scene.h"
#include "server/pipeline/station.h"
#include "server/vision/reconstruction/known_cameras.h"
#include "server/vision/reconstruction/reconstruction.h"

namespace horopter {

// The cameras of a request's images with their places in a station's rig, metres, where all are
// known well enough to look for parts under them (fixed cameras, one image each); else no views.
KnownCameras CamerasOfStation(const StationRequest& station);

// Those of a reconstruction that is to be trusted, in its unit; else no views.
KnownCameras CamerasOfReconstruction(const Reconstruction& reconstruction);

}  // namespace horopter
