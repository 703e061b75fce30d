#include "server/vision/recognition/interpretation/pose_alternatives.h"

#include <Eigen/Eigenvalues>
#include <algorithm>
#include <cmath>
#include <numbers>
#include <optional>
#include <utility>

#include "absl/strings/str_cat.h"
#include "absl/strings/str_format.h"
#include "server/base/parallel_for.h"
#include "server/vision/recognition/aspect_scenes/scene_objects.h"
#include "server/vision/recognition/aspects/edge_difference.h"
#include "server/vision/recognition/interpretation/aspect_answer.h"
#include "server/vision/recognition/interpretation/aspect_route.h"
#include "server/vision/recognition/interpretation/pose_odds.h"
#include "server/vision/recognition/interpretation/surface_print.h"
#include "server/vision/recognition/object/prepared_object.h"

namespace horopter {
namespace {

// A pose turned end for end or upside down: rendered so large (a diameter; for time), of whose
// edges so many are met before it is settled, and which takes the answer's place with these log
// odds.
constexpr double kFlippedRenderPx = 110.0;
constexpr double kFlippedLeastMet = 0.34, kFlippedLogOdds = 3.0;
constexpr double kSureSupport = 0.55;  // of an answer that nobody asks to be flipped; for time
constexpr double kCircleReach = 0.06;  // diameters between a feature and a circle's middle

// When two poses are one.
struct SamePoseLimits {
  double turn_rad = 0.0;
  double shift_diameters = 0.0;  // of the object's centre
};

// Of placements before they are refined: nearer ones are refined into each other.
constexpr SamePoseLimits kSamePlacement{0.25, 0.1};
// Of refined and answered poses: what differs by more can be seen in the images.
constexpr SamePoseLimits kSameAnswer{0.09, 0.02};

// Whether `a`, turned by the identity or a symmetry of the object, is `b` within the limits.
bool IsSamePose(const PreparedObject& object,
                const Rigid3& a,
                const Rigid3& b,
                const SamePoseLimits& limits) {
  const auto close = [&](const Rigid3& x) {
    const double cosine = 0.5 * ((x.R.transpose() * b.R).trace() - 1.0);
    return cosine > std::cos(limits.turn_rad) &&
           (x * object.center - b * object.center).norm() <
               limits.shift_diameters * object.model.diameter_m;
  };
  return close(a) || std::any_of(object.model.symmetries.begin(),
                                 object.model.symmetries.end(),
                                 [&](const Rigid3& s) { return close(a * s); });
}

using Views = std::vector<std::optional<CalibratedCamera>>;

RatedPoses CandidatesFor(const JointContext& context,
                         const SceneObject& answer,
                         std::span<const OtherPose> alternatives) {
  const PoseChoiceAcceptance& acceptance = context.options.acceptance.pose_choices;
  const PreparedObject& object = *context.objects[answer.object];
  RatedPoses out;
  const auto add = [&](int k, const Rigid3& pose, bool near_symmetric) {
    const PreparedObject& other = *context.objects[k];
    if (other.aspects == nullptr || static_cast<int>(out.size()) >= acceptance.most_tried) return;
    if (k == answer.object && IsSamePose(other, answer.scene_from_object, pose, kSameAnswer))
      return;
    // A turn of a near symmetry is asked for as it is, beside another pose that it is like.
    bool repeated = false, asked = false;
    for (const RatedPose& c : out) {
      if (c.object != k || !IsSamePose(other, c.scene_from_object, pose, kSameAnswer)) continue;
      repeated = true;
      asked = asked || c.near_symmetric;
    }
    if (!repeated || (near_symmetric && !asked))
      out.push_back({k, pose, 0.0, near_symmetric, repeated});
  };
  for (const OtherPose& alternative : alternatives)
    add(alternative.object, alternative.scene_from_object, false);
  for (const NearSymmetry& near : object.near_symmetries) {
    for (const Rigid3& turn : TurnsOf(near.axis, acceptance.turns))
      add(answer.object, answer.scene_from_object * turn, true);
  }
  return out;
}

// A rim's middle and diameter, where a circle of the model lies at the place.
bool IsCircle(const ObjectModel& model, const Eigen::Vector3d& place, double* diameter_m) {
  for (const ModelEdge& e : model.edges) {
    if (e.kind != CurveKind::kCircle || e.polyline.size() < 3) continue;
    Eigen::Vector3d low = e.polyline[0], high = low;
    for (const Eigen::Vector3d& p : e.polyline) low = low.cwiseMin(p), high = high.cwiseMax(p);
    const double size = (high - low).maxCoeff();
    if ((0.5 * (low + high) - place).norm() > kCircleReach * model.diameter_m ||
        size > 0.3 * model.diameter_m) {
      continue;
    }
    *diameter_m = size;
    return true;
  }
  return false;
}

// How much of a feature's edge one image shows, most of all of them (working px).
double VisibleIn(std::span<const EdgeDifference> views,
                 const Rigid3& a_from_b,
                 double reach_m,
                 const DistinguishingFeature& feature) {
  double most = 0.0;
  for (const EdgeDifference& view : views) {
    double length = 0.0;
    for (const DifferingPoint& d : view.points) {
      if (d.of_a != feature.of_a) continue;
      const Eigen::Vector3d own = d.point.point.cast<double>();
      const Eigen::Vector3d at = d.of_a ? own : a_from_b * own;
      if ((at - feature.place).norm() <= reach_m) length += d.length_px;
    }
    most = std::max(most, length);
  }
  return most;
}

PoseChoice MakeChoice(const JointContext& context,
                      std::span<const AspectImage> images,
                      const Views& views,
                      const SceneObject& answer,
                      const RenderMesh& a,
                      const RatedPose& c,
                      double probability) {
  PoseChoice choice;
  choice.object = c.object;
  choice.object_from_alternative = answer.scene_from_object.Inverse() * c.scene_from_object;
  choice.probability = probability;
  const PreparedObject &own = *context.objects[answer.object], &other = *context.objects[c.object];
  const RenderMesh& b = context.objects[c.object]->aspects->object.mesh;
  std::vector<EdgeDifference> in_views;
  for (std::size_t v = 0; v < views.size(); ++v) {
    if (!views[v]) continue;
    const Rigid3& camera_from_scene = views[v]->camera_from_scene;
    in_views.push_back(CompareEdges(a,
                                    camera_from_scene * answer.scene_from_object,
                                    b,
                                    camera_from_scene * c.scene_from_object,
                                    WorkingCamera(images[v], views[v]->camera)));
  }
  DistinguishingFeatures differing =
      FindDistinguishingFeatures(a, b, choice.object_from_alternative);
  choice.views = std::move(differing.views);
  for (const DistinguishingFeature& f : differing.features) {
    DecidingFeature& out = choice.features.emplace_back();
    out.only_in_alternative = !f.of_a;
    out.place = f.place;
    out.size_m = f.size_m;
    out.kind = f.kind == VisibleEdgeKind::kCrease ? DecidingFeature::Kind::kCrease
                                                  : DecidingFeature::Kind::kOutline;
    const Eigen::Vector3d in_own =
        f.of_a ? f.place : choice.object_from_alternative.Inverse() * f.place;
    if (IsCircle(f.of_a ? own.model : other.model, in_own, &out.size_m))
      out.kind = DecidingFeature::Kind::kCircle;
    const double reach_m = std::max(0.6 * f.size_m, 0.05 * a.diameter_m);
    out.visible_px = VisibleIn(in_views, choice.object_from_alternative, reach_m, f);
  }
  return choice;
}

// The pose adjusted to the edges of all views, which keep their cameras.
Rigid3 Settled(std::span<const AspectImage> images,
               const RenderMesh& mesh,
               const Views& views,
               const Rigid3& scene_from_object) {
  return SettleInViews(images, mesh, SceneViews(views), {0, scene_from_object}, kFineRenderPx)
      ->placed.scene_from_object;
}

// End for end and upside down: half turns about the principal axes of the mesh.
std::vector<Rigid3> HalfTurns(const RenderMesh& mesh) {
  Eigen::Matrix3d scatter = Eigen::Matrix3d::Zero();
  for (const Eigen::Vector3f& v : mesh.vertices) {
    const Eigen::Vector3d d = (v - mesh.center).cast<double>();
    scatter += d * d.transpose();
  }
  const Eigen::Matrix3d axes =
      Eigen::SelfAdjointEigenSolver<Eigen::Matrix3d>(scatter).eigenvectors();
  std::vector<Rigid3> out;
  for (int k = 0; k < 3; ++k)
    out.push_back(TurnAbout({axes.col(k), mesh.center.cast<double>(), 2}, std::numbers::pi));
  return out;
}

// The answer's object number `place` turned end for end and upside down, adjusted to the images:
// what is no near symmetry, no rule before has asked for. None of what is sure; in a hurry as well,
// as what was not asked for would look certain.
std::vector<OtherPose> FlippedPoses(const JointContext& context,
                                    std::span<const AspectImage> images,
                                    const RecognitionResult& result,
                                    int place) {
  const SceneObject& answer = result.objects[place];
  if (!context.options.aspects.half_turns || answer.support >= kSureSupport ||
      IsStopRequested(context.stop))
    return {};
  const PreparedObject& object = *context.objects[answer.object];
  const RenderMesh& mesh = object.aspects->object.mesh;
  const auto fixed = SceneViews(result.views);
  const std::vector<Rigid3> turns = HalfTurns(mesh);
  std::vector<std::optional<SettledObject>> settled(turns.size());
  ParallelFor(static_cast<int>(turns.size()), context.options.threads, [&](int i) {
    settled[i] = SettleInViews(images,
                               mesh,
                               fixed,
                               {0, answer.scene_from_object * turns[i]},
                               kFlippedRenderPx,
                               kFlippedLeastMet);
  });
  std::vector<OtherPose> out;
  for (const auto& s : settled) {
    if (s && !IsSamePose(
                 object, answer.scene_from_object, s->placed.scene_from_object, kSamePlacement)) {
      out.push_back({answer.object, s->placed.scene_from_object});
    }
  }
  return out;
}

// The pose takes the answer's place, adjusted to the images.
void TurnTo(const JointContext& context,
            std::span<const AspectImage> images,
            const Rigid3& scene_from_object,
            int place,
            RecognitionResult* result) {
  SceneObject& answer = result->objects[place];
  answer.scene_from_object = Settled(images,
                                     context.objects[answer.object]->aspects->object.mesh,
                                     result->views,
                                     scene_from_object);
}

}  // namespace

RatedPoses RatePoses(const JointContext& context,
                     std::span<const AspectImage> images,
                     const RecognitionResult& result,
                     int place,
                     std::span<const OtherPose> alternatives) {
  const SceneObject& answer = result.objects[place];
  if (context.objects[answer.object]->aspects == nullptr) return {};
  RatedPoses candidates = CandidatesFor(context, answer, alternatives);
  if (candidates.empty()) return candidates;
  const RenderMesh& mesh = context.objects[answer.object]->aspects->object.mesh;
  const std::vector<DepthBuffer> hidden = DepthOfOthers(context, images, result, place);
  const std::vector<VisibleEdges> own =
      EdgesInViews(images, result.views, mesh, answer.scene_from_object);
  ParallelFor(static_cast<int>(candidates.size()), context.options.threads, [&](int i) {
    RatedPose& c = candidates[i];
    const RenderMesh& other = context.objects[c.object]->aspects->object.mesh;
    c.log_odds = LogOddsBetween(images,
                                result.views,
                                {mesh, answer.scene_from_object, own},
                                {other,
                                 c.scene_from_object,
                                 EdgesInViews(images, result.views, other, c.scene_from_object)},
                                hidden,
                                context.options.acceptance.pose_choices);
    c.log_odds += PrintLogOdds(context.objects[answer.object]->model,
                               SightsOf(images, result.views, answer.scene_from_object, hidden),
                               context.objects[c.object]->model,
                               SightsOf(images, result.views, c.scene_from_object, hidden),
                               context.options.acceptance.pose_choices.most_log_odds);
  });
  std::stable_sort(candidates.begin(), candidates.end(), [](const auto& a, const auto& b) {
    return a.log_odds < b.log_odds;
  });
  return candidates;
}

RatedPoses RateTurns(const JointContext& context,
                     std::span<const AspectImage> images,
                     const RecognitionResult& result,
                     int place) {
  if (context.objects[result.objects[place].object]->aspects == nullptr) return {};
  return RatePoses(context, images, result, place, FlippedPoses(context, images, result, place));
}

std::vector<PoseChoice> FindPoseAlternatives(const JointContext& context,
                                             std::span<const AspectImage> images,
                                             const RecognitionResult& result,
                                             int place,
                                             const RatedPoses& rated) {
  const PoseChoiceAcceptance& acceptance = context.options.acceptance.pose_choices;
  const SceneObject& answer = result.objects[place];
  std::vector<PoseChoice> out;
  double sum = 1.0;
  for (const RatedPose& c : rated) sum += c.repeated ? 0.0 : std::exp(-c.log_odds);
  for (const RatedPose& c : rated) {
    if (c.repeated) continue;
    const double probability = std::exp(-c.log_odds) / sum;
    if (probability < acceptance.min_probability || static_cast<int>(out.size()) >= acceptance.most)
      break;
    const RenderMesh& mesh = context.objects[answer.object]->aspects->object.mesh;
    out.push_back(MakeChoice(context, images, result.views, answer, mesh, c, probability));
  }
  return out;
}

std::string DescribeChoice(const std::string& object_id, const PoseChoice& choice) {
  const double cosine = 0.5 * (choice.object_from_alternative.R.trace() - 1.0);
  const double degrees = std::acos(std::clamp(cosine, -1.0, 1.0)) * 180.0 / std::numbers::pi;
  std::string text = absl::StrFormat(
      "%s: %.2f that it is turned by %.0f degrees", object_id, choice.probability, degrees);
  if (choice.features.empty()) return text;
  const DecidingFeature& f = choice.features.front();
  const char* kind = f.kind == DecidingFeature::Kind::kCircle   ? "a circle"
                     : f.kind == DecidingFeature::Kind::kCrease ? "an edge"
                                                                : "an outline";
  absl::StrAppendFormat(&text,
                        "; %s of %.1f mm at (%.1f, %.1f, %.1f) mm decides%s",
                        kind,
                        f.size_m * 1e3,
                        f.place.x() * 1e3,
                        f.place.y() * 1e3,
                        f.place.z() * 1e3,
                        f.visible_px > 0 ? "" : ", which no image shows");
  return text;
}

std::vector<RatedPoses> TurnToLikeliest(const JointContext& context,
                                        std::span<const AspectImage> images,
                                        RecognitionResult* result) {
  const PoseChoiceAcceptance& acceptance = context.options.acceptance.pose_choices;
  std::vector<RatedPoses> rated(result->objects.size());
  for (int k = 0; k < static_cast<int>(rated.size()); ++k) {
    rated[k] = RateTurns(context, images, *result, k);
    // Clear turns first: about a round part's axis a second one may be better still.
    const auto likeliest = std::find_if(
        rated[k].begin(), rated[k].end(), [](const RatedPose& c) { return !c.repeated; });
    if (likeliest != rated[k].end() && -likeliest->log_odds >= kFlippedLogOdds) {
      TurnTo(context, images, likeliest->scene_from_object, k, result);
      rated[k] = RateTurns(context, images, *result, k);
    }
    const auto turn = std::find_if(
        rated[k].begin(), rated[k].end(), [](const auto& c) { return c.near_symmetric; });
    if (turn == rated[k].end() || -turn->log_odds < acceptance.turned_log_odds) continue;
    TurnTo(context, images, turn->scene_from_object, k, result);
    rated[k] = RateTurns(context, images, *result, k);
  }
  return rated;
}

void SayPoseAlternatives(const JointContext& context,
                         std::span<const AspectImage> images,
                         std::span<const RatedPoses> rated,
                         RecognitionResult* result) {
  const PoseChoiceAcceptance& acceptance = context.options.acceptance.pose_choices;
  for (std::size_t k = 0; k < std::min(rated.size(), result->objects.size()); ++k) {
    SceneObject& answer = result->objects[k];
    double open = 0.0;
    if (context.objects[answer.object]->aspects == nullptr) continue;
    const std::vector<PoseChoice> choices =
        FindPoseAlternatives(context, images, *result, static_cast<int>(k), rated[k]);
    for (const PoseChoice& choice : choices) {
      open += choice.probability;
      SceneAlternative& a = answer.left_open.emplace_back();
      a.kind = choice.object == answer.object ? AlternativeKind::kPose : AlternativeKind::kObject;
      a.object = choice.object;
      a.probability = choice.probability;
      a.object_from_alternative = choice.object_from_alternative;
      a.views = choice.views;
    }
    answer.pose_probability = 1.0 - open;
    if (open < acceptance.ambiguous_share) continue;
    AddAlternative(answer.object, &answer, result);
    Tell(DescribeChoice(context.objects[answer.object]->model.id, choices.front()), result);
  }
}

}  // namespace horopter
