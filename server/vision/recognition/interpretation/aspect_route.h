// Hypotheses of single images from the aspects of the CAD, linked through the parts they have in
// common or placed under cameras that are known, and verified in all images.
#pragma once

#include <span>
#include <vector>

#include "absl/status/statusor.h"
#include "server/vision/recognition/aspect_scenes/scene_generator.h"
#include "server/vision/recognition/aspects/aspect_image.h"
#include "server/vision/recognition/object/aspect_options.h"
#include "server/vision/recognition/object/aspect_search.h"
#include "server/vision/recognition/object/joint_context.h"
#include "server/vision/recognition/refusals.h"
#include "server/vision/reconstruction/known_cameras.h"

namespace horopter {

// Cameras as the aspects' scenes have them, with the nominal deviation of their focal lengths.
std::vector<std::optional<AspectSceneView>> SceneViews(
    const std::vector<std::optional<CalibratedCamera>>& views);

// Whether the route can be taken: all objects have aspects.
bool HaveAspects(PreparedObjects objects);

// The objects that are searched for by all their aspects, and their index. Of more than max_objects
// the images choose ObjectRankingOptions::objects by a few fragments of each (object_ranking.h).
struct AspectSearch {
  std::vector<int> objects;  // of each part of the index; likeliest first if the images chose
  std::shared_ptr<const FragmentIndex> index;
};

// Errors: CANCELLED.
absl::StatusOr<AspectSearch> ChooseObjects(const JointContext& context,
                                           std::span<const AspectImage> images,
                                           const ObjectRankingOptions& ranking);

// What has been derived of a request's images, for attempts that follow each other on the same
// objects, ground and hints: nothing is searched twice.
struct AspectWork {
  std::vector<AspectImage> images;
  AspectSearch search;
  std::vector<std::optional<std::vector<AspectHypothesis>>> hypotheses;  // of each image searched
  SearchEffort effort;                                                   // of all attempts together
};

// Scenes that are listed when they are asked for, objects by the numbers of the catalog; cost as
// SceneGenerator has it.
struct SceneList {
  double cost = 0.0;
  ListedScenes::List list;
};

// What proposes scenes beside links of views.
struct AspectStarts {
  std::vector<SceneList> lists;
  // Cameras of the matched features: what is found under them is proposed.
  const KnownCameras* matched = nullptr;
  bool single_images = true;  // false: single images are not searched, scenes are all there is
};

// The scene that the aspects find of the objects searched for. log: may be null. Errors: CANCELLED.
// work: images and the objects searched for; images are searched that have not been.
absl::StatusOr<RecognitionResult> RecognizeByAspects(const JointContext& context,
                                                     AspectWork* work,
                                                     const AspectStarts& starts,
                                                     RefusalLog* log,
                                                     const AspectRecognitionOptions& options = {});

// The same under cameras that are known before, one entry per image (camera_search.h): nothing
// where they leave a doubt. Errors: CANCELLED.
absl::StatusOr<RecognitionResult> RecognizeByAspectsWithCameras(
    const JointContext& context,
    AspectWork* work,
    const KnownCameras& cameras,
    RefusalLog* log,
    const AspectRecognitionOptions& options = {});

}  // namespace horopter
