// What an answer decided, in words for a line or a table.
#pragma once

#include <string>

#include "horopter/v1/recognition.pb.h"
#include "server/vision/geometry/rigid3.h"

namespace horopter {

// "RECOGNIZED" when there are objects, then every reason and, of an answer cut short,
// "TIME_LIMITED": "RECOGNIZED,AMBIGUOUS,REFERENCE_NOT_FOUND".
std::string OutcomeText(const v1::RecognizeSceneResponse& response);

// "SCALE_CONFLICT"; "UNKNOWN" of a kind that this client does not know.
std::string FindingName(const v1::SceneFinding& finding);

// "focal length 632 px (+- 1.2 %); camera by texture 124 (0.8 px), parts 310 (1.1 px), given", or
// that it was not recovered, and whether the image is of something else.
std::string CameraText(const v1::Camera& camera);

// What the stages left open of all cameras; empty: nothing.
std::string OpenCamerasText(const v1::RecognizeSceneResponse& response);

// "bracket in another pose (0.31): an image from (10.0, -220.5, 140.0) would tell", millimetres in
// the frame.
std::string AlternativeText(const v1::ObjectAlternative& alternative,
                            const Rigid3& frame_from_scene);

// "opening 40" or "cup of radius 8", millimetres.
std::string GripperText(const v1::RecognizedGrasp& grasp);

}  // namespace horopter
