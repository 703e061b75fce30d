// Scenes of a dataset as requests, and answers as rows of a result file.
#pragma once

#include <optional>
#include <string>
#include <vector>

#include "client/bop_dataset.h"
#include "client/bop_results.h"
#include "client/bop_targets.h"
#include "client/camera_hints.h"
#include "client/regions.h"
#include "horopter/v1/recognition.pb.h"

namespace horopter {

// What is read of a scene that is only to be recognised: images of all sensors, and their cameras
// where the hints want them. Truth that is missing or broken does not matter then.
// Where true regions are sent the truth is read, too.
BopSceneOptions ReadForRecognition(DatasetHints hints, TrueRegions regions = TrueRegions::kNone);

// Errors: NOT_FOUND (an image of the set is not there).
absl::Status CheckSet(const BopScene& scene, const BopImageSet& set);

// The images of a scene that are sent, of those in the set; `most` > 0 takes that many, spread
// evenly.
std::vector<const BopImage*> ImagesToSend(const BopScene& scene,
                                          int most,
                                          const BopImageSet& set = {});

// Errors: those of ReadFileBytes.
absl::StatusOr<v1::RecognizeSceneRequest> SceneRequestOf(const std::vector<const BopImage*>& images,
                                                         DatasetHints hints);

// 12 for "objects/obj_000012"; nothing for an object that is not of a dataset.
std::optional<int> BopIdOf(const std::string& resource);

// Ids by which a result file tells of the images. Of several sensors only the first one's, as the
// ids name none; -1 of the others.
std::vector<int> ReportedIds(const std::vector<const BopImage*>& images);

// Appends what was answered for these images of a scene; those with a negative id are left out.
void AddAnswer(int scene_id,
               const std::vector<int>& im_ids,
               const v1::RecognizeSceneResponse& response,
               double seconds,
               BopResults& results);

}  // namespace horopter
