#include "server/pipeline/texture_stage.h"

#include <algorithm>
#include <utility>

#include "server/base/status_macros.h"
#include "server/pipeline/clocks.h"
#include "server/pipeline/recognition_stage.h"
#include "server/vision/matching/camera_matching.h"
#include "server/vision/matching/texture_matching.h"
#include "server/vision/reconstruction/texture_route.h"

namespace horopter {

absl::StatusOr<std::vector<Reconstruction>> ReconstructTexture(const SceneRequest& request,
                                                               const PipelineOptions& options,
                                                               const StopRequested& stop,
                                                               std::vector<StageReport>* stages) {
  StageClock matching_clock("matching", stages);
  const TextureMatching texture = MatchTexture(request.images,
                                               options.matching.texture,
                                               options.matching.views,
                                               options.matching.threads,
                                               stop);
  if (IsStopRequested(stop)) return absl::CancelledError("matching: cancelled");
  matching_clock.Finish(texture.counts);

  StageClock reconstruction_clock("reconstruction", stages);
  std::vector<ImageSize> sizes;
  for (const cv::Mat& image : request.images) sizes.push_back({image.cols, image.rows});
  // Poses that are given are tested against what the images say: here they say it alone.
  std::vector<ViewPrior> priors = PriorsOf(request);
  for (ViewPrior& prior : priors) prior.camera_from_world.reset();
  HOROPTER_ASSIGN_OR_RETURN(
      std::vector<Reconstruction> solutions,
      SolutionsOfTexture(texture, sizes, priors, options.reconstruction.texture, stop));
  reconstruction_clock.Finish(solutions.front().counts);
  return solutions;
}

bool IsShownByMore(const RecognitionResult& one, const RecognitionResult& other) {
  const auto sights = [](const RecognitionResult& result) {
    std::ptrdiff_t count = 0;
    for (const auto& object : result.objects) {
      count += std::count_if(object.view_scores.begin(),
                             object.view_scores.end(),
                             [](double score) { return score >= 0.0; });
    }
    return count;
  };
  return sights(one) > sights(other);
}

absl::StatusOr<MatchingResult> MatchUnderCameras(const SceneRequest& request,
                                                 std::span<const ImageFeatures> features,
                                                 const Reconstruction& reconstruction,
                                                 const PipelineOptions& options,
                                                 const StopRequested& stop,
                                                 std::vector<StageReport>* stages) {
  StageClock clock("matching", stages);
  std::vector<std::optional<CalibratedCamera>> cameras(reconstruction.views.begin(),
                                                       reconstruction.views.end());
  HOROPTER_ASSIGN_OR_RETURN(
      MatchingResult matching,
      MatchViewsOfCameras(request.images, features, cameras, options.matching, stop));
  clock.Finish(matching.counts);
  return matching;
}

}  // namespace horopter
