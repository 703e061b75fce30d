// Scenes of a dataset as requests, and answers as rows of a result file.
#pragma once

#include <optional>
#include <string>
#include <vector>

#include "client/bop_dataset.h"
#include "client/bop_results.h"
#include "client/camera_hints.h"
#include "horopter/v1/recognition.pb.h"

namespace horopter {

// The images of a scene that are sent; `most` > 0 takes that many, spread evenly.
std::vector<const BopImage*> ImagesToSend(const BopScene& scene, int most);

// Errors: those of ReadFileBytes.
absl::StatusOr<v1::RecognizeSceneRequest> SceneRequestOf(const std::vector<const BopImage*>& images,
                                                         DatasetHints hints);

// 12 for "objects/obj_000012"; nothing for an object that is not of a dataset.
std::optional<int> BopIdOf(const std::string& resource);

// Appends what was answered for these images of a scene.
void AddAnswer(int scene_id,
               const std::vector<int>& im_ids,
               const v1::RecognizeSceneResponse& response,
               double seconds,
               BopResults& results);

}  // namespace horopter
