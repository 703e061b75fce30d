// What the edges of the images say for one placed part against another in its place.
#pragma once

#include <optional>
#include <span>
#include <vector>

#include "server/vision/geometry/depth_buffer.h"
#include "server/vision/recognition/aspects/aspect_image.h"
#include "server/vision/recognition/aspects/visible_edges.h"
#include "server/vision/recognition/object/joint_context.h"

namespace horopter {

// The other objects of the answer in each view's working image, lenses left out: what may hide
// this one. Empty buffers where the view has no camera.
std::vector<DepthBuffer> DepthOfOthers(const JointContext& context,
                                       std::span<const AspectImage> images,
                                       const RecognitionResult& result,
                                       std::size_t object);

// A part in each view's working image; nothing where the view has no camera.
std::vector<VisibleEdges> EdgesInViews(std::span<const AspectImage> images,
                                       const std::vector<std::optional<CalibratedCamera>>& views,
                                       const RenderMesh& mesh,
                                       const Rigid3& scene_from_object);

// How an image supports a point of visible edge, working pixels.
struct PointEvidence {
  double support = 0.0;  // 0..1, by the nearest like edge
  double chance = 0.0;   // what is found there where nothing is
};
// Nothing outside the image, and where parts are not looked for.
std::optional<PointEvidence> SupportAt(const AspectImage& image, const VisibleEdgePoint& p);

// Log odds that the point's edge is there.
double PointLogOdds(const AspectImage& image,
                    const VisibleEdgePoint& p,
                    const PoseChoiceAcceptance& acceptance);

// Of what a view says, what is believed: PoseChoiceAcceptance::most_log_odds.
double BoundedLogOdds(double of_view, const PoseChoiceAcceptance& acceptance);

// Whether something stands before the point. others: empty, nothing does. camera: of the working
// image, without its lens.
bool IsHidden(const DepthBuffer& others,
              const PinholeCamera& camera,
              const Rigid3& camera_from_object,
              const VisibleEdgePoint& p,
              double tolerance_m);

// A placed part and its edges in the views.
struct SeenPart {
  const RenderMesh& mesh;
  const Rigid3& scene_from_object;
  const std::vector<VisibleEdges>& edges;
};

// Log odds that the images show the first and not the second placed object: over the edges that
// only one of them has, what finding or missing them says (against what chance finds there).
// `hidden` (may be empty): per view a depth buffer of what else stands in the scene, of the working
// camera without its lens. differing_share (may be null): of both's visible edges.
double LogOddsOfPose(std::span<const AspectImage> images,
                     const std::vector<std::optional<CalibratedCamera>>& views,
                     const RenderMesh& a,
                     const Rigid3& scene_from_a,
                     const RenderMesh& b,
                     const Rigid3& scene_from_b,
                     std::span<const DepthBuffer> hidden,
                     const PoseChoiceAcceptance& acceptance = {},
                     double* differing_share = nullptr);

// The same of parts whose edges are known.
double LogOddsBetween(std::span<const AspectImage> images,
                      const std::vector<std::optional<CalibratedCamera>>& views,
                      const SeenPart& a,
                      const SeenPart& b,
                      std::span<const DepthBuffer> hidden,
                      const PoseChoiceAcceptance& acceptance,
                      double* differing_share = nullptr);

}  // namespace horopter
