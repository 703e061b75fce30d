#include "server/vision/recognition/interpretation/shape_rivals.h"

#include <algorithm>
#include <cmath>
#include <memory>
#include <optional>
#include <string>
#include <utility>

#include "absl/strings/str_format.h"
#include "server/base/parallel_for.h"
#include "server/vision/recognition/aspect_scenes/scene_objects.h"
#include "server/vision/recognition/aspects/edge_difference.h"
#include "server/vision/recognition/interpretation/aspect_answer.h"
#include "server/vision/recognition/interpretation/aspect_route.h"
#include "server/vision/recognition/interpretation/log_odds.h"
#include "server/vision/recognition/interpretation/pose_odds.h"
#include "server/vision/recognition/interpretation/strangers.h"
#include "server/vision/recognition/interpretation/surface_print.h"
#include "server/vision/recognition/object/look_alikes.h"
#include "server/vision/recognition/object/prepared_object.h"
#include "server/vision/recognition/object/shape_alignment.h"

namespace horopter {
namespace {

constexpr double kRenderPx = 110.0;
// Of the visible edges of both that a shape must have for itself to be another; chosen.
constexpr double kDifferingShare = 0.04;
// How likely a mirror image that is not enrolled is before the images are looked at; chosen.
constexpr double kMirrorPrior = 0.3;
constexpr double kBetterScore = 0.01;  // of what the images show rather than the answer
constexpr double kNoStranger = 3.0;    // log odds
constexpr double kReplacing = 2.0;     // log odds with which a part of the catalog takes the place
constexpr double kRefused = 0.1;       // probability

const RenderMesh& MeshOf(const JointContext& context, int object) {
  return context.objects[object]->aspects->object.mesh;
}

struct ShapeRival {
  int object = -1;        // index into the prepared objects: of the answer's own its mirror image
  bool mirrored = false;  // whether it is a mirror image that is not enrolled
  Rigid3 scene_from_object;
  double log_odds = 0.0;        // of the answer against it, by the edges that only one of them has,
                                // and by their prints
  double print_log_odds = 0.0;  // ... by these alone
  double differing_share = 0.0;  // of the visible edges of both in the images
};

struct Shape {
  int object = -1;
  bool mirrored = false;
  const RenderMesh* mesh = nullptr;
  std::vector<ShapeAlignment> alignments;
};

const RenderMesh& TwinOf(const JointContext& context, int object) {
  const PreparedObject& own = *context.objects[object];
  return own.twin->Of(own.model.mesh, own.model.diameter_m, MeshOf(context, object)).mesh;
}

const std::string& IdOf(const JointContext& context, int object) {
  return context.objects[object]->model.id;
}

// What looks like a part: its mirror image, and parts of the catalog; without alignments what does
// not.
std::vector<Shape> ShapesLike(const JointContext& context, int object) {
  const auto& own = context.objects[object];
  const RenderMesh& mesh = MeshOf(context, object);
  const MirrorTwin& twin = own->twin->Of(own->model.mesh, own->model.diameter_m, mesh);
  std::vector<Shape> shapes(context.objects.size());
  ParallelFor(static_cast<int>(shapes.size()), context.options.threads, [&](int i) {
    if (i == object || context.objects[i]->aspects == nullptr) return;
    shapes[i] = {i, false, &MeshOf(context, i), LookAlikeAlignments(own, context.objects[i])};
  });
  shapes.push_back({object, true, &twin.mesh, twin.alignments});
  return shapes;
}

void SortByOdds(std::vector<ShapeRival>* rivals) {
  std::stable_sort(rivals->begin(), rivals->end(), [](const auto& a, const auto& b) {
    return a.log_odds < b.log_odds;
  });
}

// What the prints of the answer and of a rival in its place say, where both have one; the rival in
// the likeliest of its symmetries.
void TakePrint(const JointContext& context,
               std::span<const AspectImage> images,
               const RecognitionResult& result,
               const SceneObject& answer,
               std::span<const DepthBuffer> hidden,
               ShapeRival* rival) {
  const ObjectModel& own = context.objects[answer.object]->model;
  const ObjectModel& other = context.objects[rival->object]->model;
  if (own.print.places.empty() || other.print.places.empty()) return;
  const double most = context.options.acceptance.pose_choices.most_log_odds;
  const auto sights = [&](const Rigid3& pose) {
    return SightsOf(images, result.views, pose, hidden);
  };
  rival->scene_from_object =
      rival->scene_from_object *
      TurnOfPrint(other, sights(rival->scene_from_object), 0.0, most).value_or(Rigid3());
  rival->print_log_odds = PrintLogOdds(
      own, sights(answer.scene_from_object), other, sights(rival->scene_from_object), most);
  rival->log_odds += rival->print_log_odds;
}

// Every alignment of every shape, adjusted to the images; none that looks like the answer there.
std::vector<ShapeRival> RateAlignments(const JointContext& context,
                                       std::span<const AspectImage> images,
                                       const RecognitionResult& result,
                                       int place,
                                       std::span<const Shape> shapes,
                                       std::span<const DepthBuffer> hidden) {
  const SceneObject& answer = result.objects[place];
  std::vector<std::pair<const Shape*, Rigid3>> tried;
  for (const Shape& s : shapes) {
    for (const ShapeAlignment& a : s.alignments) tried.emplace_back(&s, a.a_from_b);
  }
  if (tried.empty()) return {};
  const auto fixed = SceneViews(result.views);
  const RenderMesh& mesh = MeshOf(context, answer.object);
  const std::vector<VisibleEdges> own =
      EdgesInViews(images, result.views, mesh, answer.scene_from_object);
  std::vector<ShapeRival> rated(tried.size());
  ParallelFor(static_cast<int>(tried.size()), context.options.threads, [&](int i) {
    const Shape& shape = *tried[i].first;
    ShapeRival& out = rated[i];
    out = {shape.object, shape.mirrored, answer.scene_from_object * tried[i].second};
    const auto settled =
        SettleInViews(images, *shape.mesh, fixed, {0, out.scene_from_object}, kRenderPx);
    if (settled) out.scene_from_object = settled->placed.scene_from_object;
    out.log_odds =
        LogOddsBetween(images,
                       result.views,
                       {mesh, answer.scene_from_object, own},
                       {*shape.mesh,
                        out.scene_from_object,
                        EdgesInViews(images, result.views, *shape.mesh, out.scene_from_object)},
                       hidden,
                       context.options.acceptance.pose_choices,
                       &out.differing_share);
    if (shape.mirrored) return;
    TakePrint(context, images, result, answer, hidden, &out);
  });
  std::erase_if(rated, [](const auto& r) {
    return r.differing_share < kDifferingShare && r.print_log_odds == 0.0;
  });
  return rated;
}

std::vector<ShapeRival> BestOfEach(std::vector<ShapeRival> rated) {
  SortByOdds(&rated);
  std::vector<ShapeRival> best;
  for (const ShapeRival& r : rated) {
    if (std::none_of(best.begin(), best.end(), [&](const ShapeRival& b) {
          return b.object == r.object && b.mirrored == r.mirrored;
        }))
      best.push_back(r);
  }
  return best;
}

// Where the answer is off, anything that differs from it is likelier, and nothing fits: that says
// nothing.
void DropMisfits(const JointContext& context,
                 std::span<const AspectImage> images,
                 const RecognitionResult& result,
                 int place,
                 std::vector<ShapeRival>* rivals) {
  const SceneObject& answer = result.objects[place];
  const RenderMesh& mesh = MeshOf(context, answer.object);
  const auto views = SceneViews(result.views);
  SceneJudgementOptions judging;
  judging.threads = context.options.threads;
  const auto score_of = [&](const RenderMesh& of, const Rigid3& pose) {
    return JudgeInViews(images, of, views, {0, pose}, judging).score;
  };
  std::optional<double> own_score;
  for (ShapeRival& r : *rivals) {
    if (r.log_odds >= 0.0) continue;
    if (!own_score) own_score = score_of(mesh, answer.scene_from_object);
    const RenderMesh& rival =
        r.mirrored ? TwinOf(context, answer.object) : MeshOf(context, r.object);
    if (score_of(rival, r.scene_from_object) < *own_score + kBetterScore)
      r.log_odds = r.print_log_odds;
  }
}

// A mirror image that is enrolled is no stranger. Rivals are best first as they were rated.
void DropKnownStranger(std::vector<ShapeRival>* rivals) {
  const auto enrolled =
      std::find_if(rivals->begin(), rivals->end(), [](const auto& r) { return !r.mirrored; });
  if (enrolled == rivals->end()) return;
  const double least = enrolled->log_odds - kNoStranger;
  std::erase_if(*rivals, [&](const auto& r) { return r.mirrored && r.log_odds > least; });
}

// Of the answer's object number `place`, likeliest first: each adjusted to the images in the
// answer's cameras.
std::vector<ShapeRival> RateShapes(const JointContext& context,
                                   std::span<const AspectImage> images,
                                   const RecognitionResult& result,
                                   int place,
                                   std::span<const DepthBuffer> hidden) {
  const std::vector<Shape> shapes = ShapesLike(context, result.objects[place].object);
  std::vector<ShapeRival> best =
      BestOfEach(RateAlignments(context, images, result, place, shapes, hidden));
  DropMisfits(context, images, result, place, &best);
  DropKnownStranger(&best);
  SortByOdds(&best);
  return best;
}

// The same as rivals of the answer.
std::vector<Rival> AsRivals(const JointContext& context,
                            const SceneObject& answer,
                            std::span<const ShapeRival> shapes) {
  const RenderMesh& mesh = MeshOf(context, answer.object);
  std::vector<Rival> out;
  for (const ShapeRival& r : shapes) {
    Rival& rival = out.emplace_back();
    const double prior =
        r.mirrored ? kMirrorPrior * UnknownOdds(context.options.unknown_share) : 1.0;
    rival.weight = prior * std::exp(-kEdgeBelief * r.log_odds);
    rival.words = r.mirrored ? "its mirror image" : IdOf(context, r.object);
    rival.what.kind = r.mirrored ? AlternativeKind::kMirrorImage : AlternativeKind::kObject;
    rival.what.object = r.object;
    const Rigid3 a_from_b = answer.scene_from_object.Inverse() * r.scene_from_object;
    rival.what.object_from_alternative = a_from_b;
    const RenderMesh& other =
        r.mirrored ? TwinOf(context, answer.object) : MeshOf(context, r.object);
    rival.views = [&mesh, &other, a_from_b] {
      return FindDistinguishingFeatures(mesh, other, a_from_b).views;
    };
  }
  return out;
}

// What stays open of an object goes into the answer: as probabilities, and where these are large
// in words. probability: of the answer, against all rivals.
void Open(const JointContext& context,
          std::span<const Rival> rivals,
          double probability,
          SceneObject* answer,
          RecognitionResult* result) {
  const PoseChoiceAcceptance& acceptance = context.options.acceptance.pose_choices;
  answer->pose_probability *= probability;
  for (SceneAlternative& a : answer->left_open) a.probability *= probability;
  const bool is_said = 1.0 - probability >= acceptance.ambiguous_share;
  for (const Rival& rival : rivals) {
    const double share = rival.weight * probability;
    if (share < acceptance.min_probability) continue;
    SceneAlternative& a = answer->left_open.emplace_back(rival.what);
    a.probability = share;
    if (rival.views) a.views = rival.views();
    if (!is_said) continue;
    AddAlternative(a.object, answer, result);
    Tell(absl::StrFormat(
             "%s: %.2f that it is %s", IdOf(context, answer->object), share, rival.words),
         result);
  }
}

// The part of the catalog that the images show rather than the answer takes its place.
bool Replace(const JointContext& context,
             const ShapeRival& rival,
             SceneObject* answer,
             RecognitionResult* result) {
  if (rival.mirrored || rival.log_odds >= -kReplacing) return false;
  Tell(absl::StrFormat("%s stands where %s fits less well",
                       IdOf(context, rival.object),
                       IdOf(context, answer->object)),
       result);
  answer->object = rival.object;
  answer->scene_from_object = rival.scene_from_object;
  answer->left_open.clear();
  return true;
}

// One answered object against all that it may be taken for. Returns whether it is rather its mirror
// image, which is not enrolled.
bool WeighShape(const JointContext& context,
                std::span<const AspectImage> images,
                int place,
                RecognitionResult* result) {
  const std::vector<DepthBuffer> hidden = DepthOfOthers(context, images, *result, place);
  std::vector<ShapeRival> shapes = RateShapes(context, images, *result, place, hidden);
  SceneObject& answer = result->objects[place];
  if (!shapes.empty() && Replace(context, shapes.front(), &answer, result))
    shapes = RateShapes(context, images, *result, place, hidden);
  std::vector<Rival> rivals = AsRivals(context, answer, shapes);
  const double mirrored = !shapes.empty() && shapes.front().mirrored ? rivals.front().weight : 0.0;
  for (Rival& stranger : FindStrangers(context, images, *result, place, hidden))
    rivals.push_back(std::move(stranger));
  double others = 0.0;
  for (const Rival& rival : rivals) others += rival.weight;
  const double probability = 1.0 / (1.0 + others);
  if (probability < kRefused && mirrored > 0.5 * others) {
    Tell(absl::StrFormat("%s: its mirror image fits better", IdOf(context, answer.object)), result);
    return true;
  }
  Open(context, rivals, probability, &answer, result);
  return false;
}

}  // namespace

void WeighShapes(const JointContext& context,
                 std::span<const AspectImage> images,
                 RecognitionResult* result) {
  BeginStep(context, "shapes");
  std::vector<bool> refused(result->objects.size(), false);
  for (std::size_t k = 0; k < result->objects.size(); ++k) {
    if (context.objects[result->objects[k].object]->aspects == nullptr) continue;
    if (IsStopRequested(context.stop)) break;
    refused[k] = WeighShape(context, images, static_cast<int>(k), result);
  }
  std::size_t k = 0;
  std::erase_if(result->objects, [&](const SceneObject&) { return refused[k++]; });
  if (result->objects.empty() && k > 0) result->state = RecognitionState::kNothingFound;
}

}  // namespace horopter
