// The joint hypothesis about a scene: cameras and placed objects in one metric frame.
#pragma once

#include <Eigen/Core>
#include <memory>
#include <optional>
#include <span>
#include <vector>

#include "server/vision/geometry/supporting_plane.h"
#include "server/vision/matching/matching.h"
#include "server/vision/recognition/options.h"
#include "server/vision/recognition/scoring/pose_score.h"
#include "server/vision/recognition/scoring/view_evidence.h"
#include "server/vision/recognition/types.h"

namespace horopter {

struct PlacedObject {
  int object = -1;
  Rigid3 scene_from_object;
  std::vector<EdgeSupport> support;  // per view, zero where the view is not registered
  EdgeSupport total;
  double score = 0.0;             // see JointScore
  double description_gain = 0.0;  // see DescriptionGain
  double texture = 0.0;  // log odds that the texture on its faces adds, see surface_texture.h
};

// What a placement's edges and the texture on its faces say for it, log odds (log_odds.h).
double LogLikelihoodRatio(const PlacedObject& placed);

struct SceneModel {
  std::vector<std::optional<CalibratedCamera>> views;
  std::vector<PlacedObject> objects;
  std::optional<SupportingPlane> plane;
  double description_gain = 0.0;  // sum over the objects
  int registered() const {
    int n = 0;
    for (const auto& v : views) n += v.has_value();
    return n;
  }
};

struct Reconstruction;  // reconstruction/reconstruction.h

// What a request gives to the joint search: nothing of it changes. What the search works on is told
// beside it, to those who read it or write it.
struct JointContext {
  std::span<const std::shared_ptr<const PreparedObject>> objects;
  std::vector<ViewEvidence> views;
  std::vector<PinholeCamera> start_cameras;
  std::vector<double> focal_log_sigma;  // prior about the start camera, per view
  const MatchingResult* matching = nullptr;
  RecognitionOptions options;
  StopRequested stop;
  // A stop or a hurry: initial hypotheses need not be looked for any more, nor another round begun.
  StopRequested give_up;
  StepListener on_step;
};

// Hypotheses of single views, [view][object]: a list for each pair, empty where none was looked for
// yet. Only routes that are led by views write it (interpretation/routes.h).
using HypothesisTable = std::vector<std::vector<ViewHypotheses>>;

// What a request brings, as far as the images and cameras go. hints: empty or one per view.
struct EvidenceInput {
  std::span<const ImageFeatures> features;
  std::span<const CameraHint> hints;
  const MatchingResult* matching = nullptr;
  const Reconstruction* reconstruction = nullptr;  // null: none
  std::span<const std::shared_ptr<const PreparedObject>> objects;
  bool edge_maps = true;  // false: JointContext::views stays empty; aspects need none
};

// Edge maps and start cameras of a request. The spans must outlive the result.
JointContext MakeContext(const EvidenceInput& input,
                         const RecognitionOptions& options,
                         const StopRequested& stop,
                         const StepListener& on_step);

// Says that a step begins; only from the thread that recognition was called on.
inline void BeginStep(const JointContext& context, std::string_view step) {
  if (context.on_step) context.on_step(step);
}

// Description-length gain of an object in working pixels: edges it explains minus what it predicts
// in vain and what it leaves unexplained inside its silhouette. Positive for poses that are more
// right than wrong.
double DescriptionGain(const EdgeSupport& support);

// Geometric mean of the silhouette F1 over the views in which the object should be seen; 0 when it
// lies outside the image in most registered views, or is seen in one of several only: wrong cameras
// push objects out of the images that contradict them.
double JointScore(std::span<const EdgeSupport> support,
                  const std::vector<std::optional<CalibratedCamera>>& views);

// One byte per segment sample of every view: 1 where an object explains it.
using ExplainedSegments = std::vector<std::vector<std::uint8_t>>;

// Verifies a placed object in every registered view. occluders: one depth buffer per view (empty:
// none). explained: if not null, receives what the object explains.
void EvaluatePlacement(const JointContext& context,
                       const std::vector<std::optional<CalibratedCamera>>& views,
                       std::span<const DepthBuffer> occluders,
                       VerifyScratch* scratch,
                       PlacedObject* placed,
                       ExplainedSegments* explained = nullptr);

// Verifies every object of the scene in every registered view, hidden behind the others where it
// is, and sums up the description-length gain.
void EvaluateTogether(const JointContext& context, SceneModel* scene);

// Up to 8 points of the object that touch the plane of a stable pose (object frame): its footprint.
std::vector<Eigen::Vector3d> Footprint(const PreparedObject& object, const StablePose& pose);

}  // namespace horopter
