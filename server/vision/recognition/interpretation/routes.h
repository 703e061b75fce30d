// The ways to a scene's first part, and with it to metric cameras; each ends in a scene with all
// that its cameras show.
#pragma once

#include <cstddef>
#include <span>
#include <vector>

#include "absl/status/statusor.h"
#include "server/vision/features/features.h"
#include "server/vision/recognition/initialization/bottom_up_route.h"
#include "server/vision/recognition/invariant_matching/key_index.h"
#include "server/vision/recognition/scene/scene_model.h"
#include "server/vision/reconstruction/reconstruction.h"

namespace horopter {

// A scene with what was verified in it, and the route that found its first part.
struct FoundScene {
  SceneModel scene;
  std::vector<PlacedObject> verified;
  std::vector<double> best_competing;  // of the scene's objects, see BestCompeting (decision.h)
  RecognitionRoute route = RecognitionRoute::kNone;
};

// What routes read besides the context.
struct RouteInput {
  std::span<const ImageFeatures> features;
  const Reconstruction* reconstruction = nullptr;
  const KeyIndexSnapshot* keys = nullptr;      // null: an index is built when it is asked for
  std::span<const int> slots;                  // of the objects in `keys`
  const BottomUpOptions* bottom_up = nullptr;  // null: the defaults
};

// What the routes work on, for those that follow and for the answer.
struct RouteWork {
  HypothesisTable hypotheses;
  std::size_t initial_count = 0;  // linked hypotheses of single views; for the report
};

// Whether further routes have a say: nothing was found, or what chance explains.
bool IsOpen(const JointContext& context, const FoundScene& found);

// Keeps the scene that nothing speaks against, of two such or neither the one that explains more.
void TakeIfBetter(const JointContext& context, FoundScene other, FoundScene* best);

// A route's scene; empty where it finds none or gives up. Errors: CANCELLED.
absl::StatusOr<FoundScene> MetricRoute(const RouteInput& input,
                                       const JointContext& context,
                                       RouteWork* work);
absl::StatusOr<FoundScene> PlaneRoute(const RouteInput& input,
                                      const JointContext& context,
                                      RouteWork* work);
absl::StatusOr<FoundScene> ViewLedRoute(const RouteInput& input,
                                        const JointContext& context,
                                        RouteWork* work);
absl::StatusOr<FoundScene> ProjectiveRoute(const RouteInput& input,
                                           const JointContext& context,
                                           RouteWork* work);

}  // namespace horopter
