// What is printed on a part: learnt from images in which it was answered, and what it then says of
// a placed part that edges do not: which of its equal sides is seen, and which of equal parts it
// is.
#pragma once

#include <optional>
#include <span>
#include <vector>

#include "absl/status/statusor.h"
#include "server/vision/geometry/calibrated_camera.h"
#include "server/vision/geometry/depth_buffer.h"
#include "server/vision/geometry/surface_print.h"
#include "server/vision/recognition/aspects/aspect_image.h"
#include "server/vision/recognition/object/joint_context.h"

namespace horopter {

// `count` places spread evenly over a mesh, brightness 0. Deterministic.
std::vector<PrintPlace> PlacesOn(const TriangleMesh& mesh, int count);

// An image of a placed part; what is pointed to outlives it.
struct PrintSight {
  const AspectImage* image = nullptr;
  PinholeCamera camera;  // of the original image
  Rigid3 camera_from_object;
  // What else stands in the scene, of the working camera without its lens; null or empty: nothing.
  const DepthBuffer* others = nullptr;
};

// Sights of one instance, which share its turn: one of its symmetries, by chance.
using PrintSights = std::vector<PrintSight>;

// The brightness of places of the surface, each against the mean of those that face the same way,
// over the sights that agree; instances are turned by symmetries to agree with the first one.
// Places that fewer than two sights show are left out. Errors: FAILED_PRECONDITION (fewer than two
// sights show enough and agree, or the surface is plain).
absl::StatusOr<SurfacePrint> LearnPrint(const ObjectModel& model,
                                        std::span<const PrintSights> instances);

// Log likelihood that the sights show the part's print, against any other. Nothing where it has
// none, and where no sight shows enough of it.
std::optional<double> PrintLogLikelihood(const ObjectModel& model,
                                         std::span<const PrintSight> sights,
                                         double most_log_odds);

// A part placed in the views of an answer.
std::vector<PrintSight> SightsOf(std::span<const AspectImage> images,
                                 const std::vector<std::optional<CalibratedCamera>>& views,
                                 const Rigid3& scene_from_object,
                                 std::span<const DepthBuffer> hidden);

// Log odds of the first placed part against the second by their prints; 0 where not both have one
// that the images show.
double PrintLogOdds(const ObjectModel& a,
                    std::span<const PrintSight> sights_of_a,
                    const ObjectModel& b,
                    std::span<const PrintSight> sights_of_b,
                    double most_log_odds);

// The symmetry under which the sights show the part's print best, where that is likelier than
// without it by so many log odds; nothing else.
std::optional<Rigid3> TurnOfPrint(const ObjectModel& model,
                                  std::span<const PrintSight> sights,
                                  double least_log_odds,
                                  double most_log_odds);

// Objects whose print the images show clearly better under one of their symmetries are turned by
// it.
void TurnByPrint(const JointContext& context,
                 std::span<const AspectImage> images,
                 RecognitionResult* result);

}  // namespace horopter
