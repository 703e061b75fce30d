// The route of any part: hypotheses of single images from the aspects of the CAD, linked through
// the parts they have in common; and the judgement of every other route's answer by what the
// cameras should see of it.
#pragma once

#include <span>
#include <vector>

#include "absl/status/statusor.h"
#include "server/vision/recognition/aspect_scenes/aspect_linking.h"
#include "server/vision/recognition/aspects/aspect_image.h"
#include "server/vision/recognition/object/aspect_options.h"
#include "server/vision/recognition/object/aspect_search.h"
#include "server/vision/recognition/refusals.h"
#include "server/vision/recognition/scene/scene_model.h"
#include "server/vision/reconstruction/known_cameras.h"

namespace horopter {

// Whether the route can be taken: all objects have aspects.
bool HaveAspects(PreparedObjects objects);

// Whether the objects have so many edges that the aspects are asked first. Of more objects than
// AspectRouteOptions::max_objects the images' shortlist decides: here whether any has.
bool AreRich(PreparedObjects objects, const AspectRouteOptions& options);

// The objects that are searched for by all their aspects, and their index. Of more than max_objects
// the images choose ObjectRankingOptions::objects by a few fragments of each (object_ranking.h).
struct AspectSearch {
  std::vector<int> objects;  // of each part of the index; likeliest first if the images chose
  std::shared_ptr<const FragmentIndex> index;
  bool rich = false;  // see AreRich; of a choice the leading ones decide
};

// Errors: those of the index, CANCELLED.
absl::StatusOr<AspectSearch> ChooseObjects(const JointContext& context,
                                           std::span<const AspectImage> images,
                                           const ObjectRankingOptions& ranking);

// What has been derived of a request's images, for attempts that follow each other on the same
// objects, ground and hints: nothing is searched twice.
struct AspectWork {
  std::vector<AspectImage> images;
  AspectSearch search;
  std::vector<std::optional<std::vector<AspectHypothesis>>> hypotheses;  // of each image searched
};

// What the images say of an answer's objects as their cameras should see them. Single objects may
// be hidden, which scores do not know: the answer as a whole is judged.
struct AspectJudgement {
  std::vector<LinkedObject> objects;  // in the answer's order
  double score = 0.0;                 // sum of what exceeds chance, over objects and views
  double median = 0.0;                // of the objects' scores
};
AspectJudgement JudgeAnswer(const JointContext& context,
                            std::span<const AspectImage> images,
                            const RecognitionResult& answer,
                            const AspectRecognitionOptions& options = {});

// Empties an answer of other routes that the aspects speak against: whose median score contradicts
// it or, where the aspects themselves find nothing, does not confirm it. log: may be null.
void RefuseContradicted(const AspectJudgement& judgement,
                        bool aspects_find_something,
                        const AspectAcceptance& options,
                        RefusalLog* log,
                        RecognitionResult* answer);

// What other stages offer the aspects to start from; null: nothing.
struct AspectStarts {
  // With the focal lengths of trusted cameras: a scene under them is taken where it explains more
  // than one under those that the parts give.
  const JointContext* matched = nullptr;
  const RecognitionResult* known = nullptr;  // another route's answer, to complete
  // The ground's edges are gone: where nothing is accepted, views are linked once more with objects
  // that explain less, and the decision is left to say what they are worth. ADR 56.
  bool without_ground = false;
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

// Adds to an answer, whose cameras and objects stay, what the aspects find beside them in its
// middle view and the other views confirm. Errors: CANCELLED.
absl::Status AddOthers(const JointContext& context,
                       std::span<const AspectImage> images,
                       const AspectSearch& search,
                       RecognitionResult* answer,
                       const AspectRecognitionOptions& options = {});

}  // namespace horopter
