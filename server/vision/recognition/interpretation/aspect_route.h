// The route of any part: hypotheses of single images from the aspects of the CAD, linked through
// the parts they have in common; and the judgement of every other route's answer by what the
// cameras should see of it.
#pragma once

#include <span>
#include <vector>

#include "absl/status/statusor.h"
#include "server/vision/recognition/aspects/aspect_image.h"
#include "server/vision/recognition/aspects/aspect_linking.h"
#include "server/vision/recognition/scene/scene_model.h"

namespace cv {
class Mat;
}

namespace horopter {

// Whether the route can be taken: all objects have aspects and there are few enough of them.
bool HaveAspects(std::span<const std::shared_ptr<const PreparedObject>> objects,
                 const AspectRouteOptions& options);

// Whether the objects have so many edges that the aspects are asked first.
bool AreRich(std::span<const std::shared_ptr<const PreparedObject>> objects,
             const AspectRouteOptions& options);

// drop_pattern: AspectImageOptions::drop_pattern.
std::vector<AspectImage> MakeAspectImages(std::span<const cv::Mat> images,
                                          bool drop_pattern,
                                          int threads);

// What the images say of an answer's objects as their cameras should see them. Single objects may
// be hidden, which scores do not know: the answer as a whole is judged.
struct AspectJudgement {
  std::vector<LinkedObject> objects;  // in the answer's order
  double score = 0.0;                 // sum of what exceeds chance, over objects and views
  double median = 0.0;                // of the objects' scores
};
AspectJudgement JudgeAnswer(const JointContext& context,
                            std::span<const AspectImage> images,
                            const RecognitionResult& answer);

// Empties an answer whose median score is below `least`.
void RefuseContradicted(const AspectJudgement& judgement, double least, RecognitionResult* answer);

// The scene that the aspects find. Errors: CANCELLED.
struct AspectAnswer {
  RecognitionResult result;
  double score = 0.0;  // as AspectJudgement::score
};
absl::StatusOr<AspectAnswer> RecognizeByAspects(const JointContext& context,
                                                std::span<const AspectImage> images);

}  // namespace horopter
