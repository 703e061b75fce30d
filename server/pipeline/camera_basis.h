// What each camera of an answer rests on, for whoever wonders whether to believe it.
#pragma once

#include <vector>

namespace horopter {

struct SceneAnswer;
struct SceneRequest;
struct SceneTrace;

enum class BasisSource {
  kTexture,   // points of texture that other images show too
  kFeatures,  // corners and edges that other images show too, before any part is known
  kParts,     // edges of the parts that were recognised
  kStation,   // what is known of the station
  kGiven,     // what the request says of the camera
};

struct CameraBasis {
  BasisSource source = BasisSource::kParts;
  int matches = 0;      // points, or edge points, of the image that agree; 0: it is prior knowledge
  double rms_px = 0.0;  // their residuals
};

// Fills camera_bases and unrelated_images of the answer, and the reason that names them.
// with_station: what is known of the station was used. Nothing is said of cameras that were not
// recovered but whether they are unrelated: where two other images share matches, an image that
// shares none and has no camera.
void TellCameraBases(const SceneRequest& request,
                     const SceneTrace& trace,
                     bool with_station,
                     SceneAnswer* answer);

}  // namespace horopter
