// The work of one metric adjustment: what is observed of a scene and how its cameras and objects
// follow. Called by euclidean.cc alone.
#pragma once

#include <vector>

#include "server/vision/euclidean/edge_observations.h"
#include "server/vision/euclidean/euclidean.h"
#include "server/vision/euclidean/lens_terms.h"
#include "server/vision/euclidean/scene_bundle.h"

namespace horopter {

// Everything one adjustment works on.
struct Refinement {
  SceneBundle bundle;
  std::vector<EdgeGrid> grids;
  std::vector<VisibleSamples> visible;
  std::vector<AdjustedView> seen_views;  // when `visible` was found
  std::vector<AdjustedObject> seen_objects;
  std::vector<AdjustedView> first_views;  // before anything was adjusted
  std::vector<AdjustedObject> first_objects;
  ObservationOptions observation;
  // Per view: what its lens is taken to do beyond k1; plane and texture as they were matched.
  std::vector<LensTerms> lens;
  std::vector<PlaneCell> matched_cells;
  std::vector<TexturePoint> matched_texture;
};

// objects: of recognition.objects, those that take part.
Refinement BeginRefinement(const RecognitionInput& input,
                           const RecognitionResult& recognition,
                           const std::vector<int>& objects,
                           const CameraGroupPrior& group,
                           const EuclideanOptions& options);

// Rounds of association and adjustment. Errors: CANCELLED, FAILED_PRECONDITION (too few edges, no
// solution).
absl::Status Adjust(const EuclideanOptions& options, const StopRequested& stop, Refinement* r);

// Scatter of the edges found, working pixels: 1.4826 times the median of the sizes.
double RobustRms(const std::vector<EdgeObservation>& observations);

// Where the views come from one camera the scene is adjusted once more with one set of intrinsics.
// Their priors are one for all then, but that of the principal point counts for every view: what
// the views say against it errs in common, because the part's own errors are the same in all.
absl::Status ShareCameras(const RecognitionInput& input,
                          const EuclideanOptions& options,
                          const StopRequested& stop,
                          Refinement* r);

// Where edges and plane prove that a lens does more than k1 the scene is adjusted again without
// that; kept where it then fits no worse.
absl::Status AdjustLenses(const RecognitionInput& input,
                          const EuclideanOptions& options,
                          const StopRequested& stop,
                          Refinement* r);

}  // namespace horopter
