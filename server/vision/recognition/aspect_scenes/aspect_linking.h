// From hypotheses of single images to a scene: the same part seen in two images gives their
// relative pose in metres and both focal lengths, other parts confirm it, every hypothesis is
// carried into the views that missed it, and all is adjusted together. Needs no table and no
// calibration.
#pragma once

#include <functional>
#include <optional>
#include <span>
#include <vector>

#include "server/base/stop_token.h"
#include "server/vision/geometry/camera_prior.h"
#include "server/vision/recognition/aspect_scenes/aspect_adjustment.h"
#include "server/vision/recognition/aspect_scenes/scene_judgement.h"
#include "server/vision/recognition/aspect_scenes/search_effort.h"
#include "server/vision/recognition/aspect_scenes/surface_agreement.h"
#include "server/vision/recognition/aspect_search/find_aspects.h"
#include "server/vision/recognition/aspects/aspect_image.h"
#include "server/vision/recognition/aspects/fragment_index.h"

namespace horopter {

inline constexpr double kOnePlaceShare =
    0.4;  // of the smaller diameter: nearer centres are one place

struct AspectLinkOptions {
  int standing = 24;        // places on a plane under the parts that are looked at closer
  double min_quick = 0.36;  // mean score over the views of one that is placed and adjusted
  double min_joint = 0.40;  // objects that explain less are left out
  // What may be left out, to measure what it is worth.
  bool printed_surfaces = true;  // views linked by what is on a part's surface
  bool doubtful_views = true;    // looked at again
  bool faint_parts = true;       // by their surface
  bool competing_parts = true;   // best scores of other parts in each place
  AspectAdjustmentOptions adjustment;
  int threads = 1;
};

// What is known of a view's camera before any part is.
struct AspectViewPrior {
  PinholeCamera camera;
  double log_focal_sigma = kNominalFocalLogSigma;
};

class SceneGenerator;

struct AspectLinkInput {
  std::span<const AspectImage> images;
  std::span<const AspectViewPrior> priors;                    // one per image
  std::span<const std::vector<AspectHypothesis>> hypotheses;  // of each image, best first
  std::span<const AspectModel> models;
  // Searches a view for all parts, best hypothesis first; `hypotheses` are empty lists then. Only
  // views that are needed are searched. Null: all have been.
  std::function<std::vector<AspectHypothesis>(int view)> search = nullptr;
  // What proposes scenes beside the links of views.
  std::span<SceneGenerator* const> generators = {};
  SearchEffort* effort = nullptr;  // that is made and may be; null: whatever it takes
};

// Nothing where nobody counts it.
inline void SpendEffort(const AspectLinkInput& input, double effort) {
  if (input.effort != nullptr) input.effort->Spend(effort);
}
// Asks also once the effort is spent. The input and `stop` outlive the result.
StopRequested WithEffort(const AspectLinkInput& input, const StopRequested& stop);

struct LinkedScene {
  std::vector<std::optional<AspectSceneView>> views;
  std::vector<LinkedObject> objects;  // best first
  // Sum over objects and views of what exceeds chance, less where the views do not agree on the
  // surface of the best object.
  double score = 0.0;
  ViewAgreement agreement;  // on the best object; `ground` is what LinkAspects sets in the end
  int registered() const;
};

// By score.
void SortBestFirst(LinkedScene* scene);

// Its views and the places of its objects.
AspectScene SceneOf(const LinkedScene& linked);

// A scene adjusted to the images at a coarse scale.
void AdjustCoarsely(const AspectLinkInput& input,
                    const AspectLinkOptions& options,
                    AspectScene* scene);

}  // namespace horopter
