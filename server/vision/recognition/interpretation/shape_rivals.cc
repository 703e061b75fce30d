#include "server/vision/recognition/interpretation/shape_rivals.h"

#include <algorithm>
#include <cmath>
#include <memory>
#include <optional>
#include <string>
#include <utility>

#include "absl/strings/str_format.h"
#include "server/base/parallel_for.h"
#include "server/vision/geometry/model_features.h"
#include "server/vision/recognition/aspect_scenes/scene_objects.h"
#include "server/vision/recognition/aspect_scenes/shape_strain.h"
#include "server/vision/recognition/aspects/edge_difference.h"
#include "server/vision/recognition/aspects/quantile.h"
#include "server/vision/recognition/interpretation/aspect_answer.h"
#include "server/vision/recognition/interpretation/aspect_route.h"
#include "server/vision/recognition/interpretation/feature_evidence.h"
#include "server/vision/recognition/interpretation/log_odds.h"
#include "server/vision/recognition/interpretation/pose_odds.h"
#include "server/vision/recognition/object/look_alikes.h"
#include "server/vision/recognition/object/prepared_object.h"
#include "server/vision/recognition/object/shape_alignment.h"

namespace horopter {
namespace {

constexpr double kRenderPx = 110.0;
// Of the visible edges of both that a shape must have for itself to be another; chosen.
constexpr double kDifferingShare = 0.04;
// Edges err together: log odds are believed by so much. Of mirror images and stretched copies that
// are not enrolled, how likely one is before the images are looked at; chosen.
constexpr double kBelief = 0.5, kMirrorPrior = 0.3, kStretchedPrior = 1.0, kFeaturePrior = 0.05;
constexpr double kBetterScore = 0.01;  // of what the images show rather than the answer
constexpr double kNoStranger = 3.0;    // log odds
constexpr double kReplacing = 2.0;     // log odds with which a part of the catalog takes the place
constexpr double kRefused = 0.1;       // probability
// ln of the stretch, and deviations of it, that count. Right parts among clutter are fitted with up
// to .15 and gain less than 250; those of real CAD stretched by a tenth gain 120 - 1,800
// (decision_report).
constexpr double kLeastStrain = 0.015, kStrainSigmas = 4.0;
constexpr double kMostOfStrain = 5.0, kLeastOfStrain = -1.5, kLossOfOdds = 70.0;

const RenderMesh& MeshOf(const JointContext& context, int object) {
  return context.objects[object]->aspects->object.mesh;
}

struct ShapeRival {
  int object = -1;        // index into the prepared objects: of the answer's own its mirror image
  bool mirrored = false;  // whether it is a mirror image that is not enrolled
  Rigid3 scene_from_object;
  double log_odds = 0.0;         // of the answer against it, by the edges that only one of them has
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
  const auto fixed = SceneViews(result.views);
  std::vector<ShapeRival> rated(tried.size());
  ParallelFor(static_cast<int>(tried.size()), context.options.threads, [&](int i) {
    const Shape& shape = *tried[i].first;
    ShapeRival& out = rated[i];
    out = {shape.object, shape.mirrored, answer.scene_from_object * tried[i].second};
    const auto settled =
        SettleInViews(images, *shape.mesh, fixed, {0, out.scene_from_object}, kRenderPx);
    if (settled) out.scene_from_object = settled->placed.scene_from_object;
    out.log_odds = LogOddsOfPose(images,
                                 result.views,
                                 MeshOf(context, answer.object),
                                 answer.scene_from_object,
                                 *shape.mesh,
                                 out.scene_from_object,
                                 hidden,
                                 context.options.acceptance.pose_choices,
                                 &out.differing_share);
  });
  std::erase_if(rated, [](const auto& r) { return r.differing_share < kDifferingShare; });
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
    if (score_of(rival, r.scene_from_object) < *own_score + kBetterScore) r.log_odds = 0.0;
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

// How much likelier than the answer a rival is when nothing but shapes is weighed. unknown: see
// UnknownOdds.
double WeightOf(const ShapeRival& r, double unknown) {
  return (r.mirrored ? kMirrorPrior * unknown : 1.0) * std::exp(-kBelief * r.log_odds);
}

// What a stretch explains better: the fall of ShapeStrain::loss in the middle one of the views, of
// each of them. Clutter that a stretch fits in some views is elsewhere in the others.
double GainOfStrain(const ShapeStrain& rigid, const ShapeStrain& strained) {
  std::vector<double> gains;
  for (std::size_t v = 0; v < std::min(rigid.loss.size(), strained.loss.size()); ++v) {
    if (rigid.points[v] > 0.0) gains.push_back(rigid.loss[v] - strained.loss[v]);
  }
  if (gains.empty()) return 0.0;
  const double views = static_cast<double>(gains.size());
  return views * Median(&gains);
}

// A stretched part in the answer's place, and the log odds of the answer against it: 0 gained says
// nothing.
struct RatedStrain {
  Eigen::Vector3d strain = Eigen::Vector3d::Zero();
  double log_odds = kMostOfStrain;
};

RatedStrain RateStrain(const JointContext& context,
                       std::span<const AspectImage> images,
                       const RecognitionResult& result,
                       int place,
                       std::span<const DepthBuffer> hidden) {
  const SceneObject& answer = result.objects[place];
  const RenderMesh& mesh = MeshOf(context, answer.object);
  const ShapeStrain strained =
      EstimateStrain(images, mesh, result.views, answer.scene_from_object, hidden);
  RatedStrain out{strained.strain, kMostOfStrain};
  bool significant = false;
  for (int i = 0; i < 3; ++i) {
    const double size = std::abs(strained.strain[i]);
    significant = significant || (size > kLeastStrain &&
                                  size > kStrainSigmas * std::sqrt(strained.covariance(i, i)));
  }
  if (!significant) return out;
  const double gain = GainOfStrain(
      EstimateStrain(
          images, mesh, result.views, answer.scene_from_object, hidden, Eigen::Vector3d::Zero()),
      strained);
  out.log_odds = std::clamp(kMostOfStrain - gain / kLossOfOdds, kLeastOfStrain, kMostOfStrain);
  return out;
}

// The answer's features, and what the images say of each.
struct RatedFeatures {
  std::vector<ModelFeature> features;
  std::vector<FeatureEvidence> evidence;  // of each

  // How much likelier than the answer a part without the feature, or with it elsewhere, is.
  double WeightOf(std::size_t f) const {
    return kFeaturePrior / static_cast<double>(features.size()) *
           std::exp(-kBelief * evidence[f].log_odds);
  }
};

RatedFeatures RateOwnFeatures(const JointContext& context,
                              std::span<const AspectImage> images,
                              const RecognitionResult& result,
                              int place,
                              std::span<const DepthBuffer> hidden) {
  const SceneObject& answer = result.objects[place];
  const RenderMesh& mesh = MeshOf(context, answer.object);
  RatedFeatures out;
  out.features = FindModelFeatures(context.objects[answer.object]->model);
  const std::vector<VisibleEdges> edges =
      EdgesInViews(images, result.views, mesh, answer.scene_from_object);
  out.evidence = RateFeatures(images,
                              result.views,
                              {mesh, answer.scene_from_object, edges},
                              out.features,
                              hidden,
                              context.options.acceptance.pose_choices);
  return out;
}

// All that may be instead of one answered object, and how much likelier than it each is.
struct Rivals {
  std::vector<ShapeRival> shapes;
  RatedStrain stretched;
  RatedFeatures features;
  double unknown = 1.0;  // see UnknownOdds

  double OfShape(const ShapeRival& r) const { return WeightOf(r, unknown); }
  double OfStretched() const { return unknown * kStretchedPrior * std::exp(-stretched.log_odds); }
  double OfFeature(std::size_t f) const { return unknown * features.WeightOf(f); }
  double OfAll() const {
    double sum = OfStretched();
    for (const ShapeRival& r : shapes) sum += OfShape(r);
    for (std::size_t f = 0; f < features.features.size(); ++f) sum += OfFeature(f);
    return sum;
  }
};

// What stays open of an object goes into the answer: as probabilities, and where these are large
// in words.
class OpenChoices {
 public:
  OpenChoices(const JointContext& context,
              double probability,
              SceneObject* answer,
              RecognitionResult* result)
      : context_(context),
        acceptance_(context.options.acceptance.pose_choices),
        probability_(probability),
        said_(1.0 - probability >= acceptance_.ambiguous_share),
        mesh_(MeshOf(context, answer->object)),
        answer_(answer),
        result_(result) {
    answer_->pose_probability *= probability_;
    for (SceneAlternative& a : answer_->left_open) a.probability *= probability_;
  }

  void Add(const Rivals& all) {
    for (const ShapeRival& r : all.shapes) Add(r, all.OfShape(r));
    Add(all.stretched, all.OfStretched());
    for (std::size_t f = 0; f < all.features.features.size(); ++f)
      Add(all.features.features[f], all.OfFeature(f));
  }

 private:
  void Add(const ShapeRival& r, double weight) {
    const RenderMesh& rival =
        r.mirrored ? TwinOf(context_, answer_->object) : MeshOf(context_, r.object);
    SceneAlternative a;
    a.kind = r.mirrored ? AlternativeKind::kMirrorImage : AlternativeKind::kObject;
    a.object = r.object;
    a.object_from_alternative = answer_->scene_from_object.Inverse() * r.scene_from_object;
    const auto views = [&] {
      return FindDistinguishingFeatures(mesh_, rival, *a.object_from_alternative).views;
    };
    Add(std::move(a), weight, views, r.mirrored ? "its mirror image" : IdOf(context_, r.object));
  }

  void Add(const RatedStrain& stretched, double weight) {
    SceneAlternative a;
    a.kind = AlternativeKind::kStretched;
    a.object = answer_->object;
    const auto views = [&] {
      return FindDistinguishingFeatures(mesh_, Strained(mesh_, stretched.strain), {}).views;
    };
    Add(std::move(a), weight, views, "like it, but stretched");
  }

  void Add(const ModelFeature& feature, double weight) {
    SceneAlternative a;
    a.kind = AlternativeKind::kFeature;
    a.object = answer_->object;
    a.feature_place = feature.place;
    a.feature_size_m = feature.size_m;
    const auto views = [&] {
      const FeatureMap map({feature}, mesh_.diameter_m);
      return FindVisibleLength(
          mesh_, [&](const VisibleEdgePoint& p) { return map.At(p.point.cast<double>()) >= 0; });
    };
    const Eigen::Vector3d at = feature.place * 1e3;
    Add(std::move(a),
        weight,
        views,
        absl::StrFormat("like it, but without what it has at (%.1f, %.1f, %.1f) mm, %.1f mm large",
                        at.x(),
                        at.y(),
                        at.z(),
                        feature.size_m * 1e3));
  }

  template <typename ViewsOf>
  void Add(SceneAlternative a, double weight, const ViewsOf& views, const std::string& what) {
    a.probability = weight * probability_;
    if (a.probability < acceptance_.min_probability) return;
    a.views = views();
    if (said_) {
      AddAlternative(a.object, answer_, result_);
      Tell(absl::StrFormat(
               "%s: %.2f that it is %s", IdOf(context_, answer_->object), a.probability, what),
           result_);
    }
    answer_->left_open.push_back(std::move(a));
  }

  const JointContext& context_;
  const PoseChoiceAcceptance& acceptance_;
  const double probability_;
  const bool said_;
  const RenderMesh& mesh_;
  SceneObject* answer_;
  RecognitionResult* result_;
};

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

}  // namespace

void WeighShapes(const JointContext& context,
                 std::span<const AspectImage> images,
                 RecognitionResult* result) {
  BeginStep(context, "shapes");
  std::vector<bool> refused(result->objects.size(), false);
  for (std::size_t k = 0; k < result->objects.size(); ++k) {
    if (context.objects[result->objects[k].object]->aspects == nullptr) continue;
    if (IsStopRequested(context.stop)) break;
    const int place = static_cast<int>(k);
    const std::vector<DepthBuffer> hidden = DepthOfOthers(context, images, *result, k);
    std::vector<ShapeRival> rivals = RateShapes(context, images, *result, place, hidden);
    SceneObject& answer = result->objects[k];
    if (!rivals.empty() && !rivals.front().mirrored && rivals.front().log_odds < -kReplacing) {
      Tell(absl::StrFormat("%s stands where %s fits less well",
                           IdOf(context, rivals.front().object),
                           IdOf(context, answer.object)),
           result);
      answer.object = rivals.front().object;
      answer.scene_from_object = rivals.front().scene_from_object;
      answer.left_open.clear();
      rivals = RateShapes(context, images, *result, place, hidden);
    }
    const Rivals all{std::move(rivals),
                     RateStrain(context, images, *result, place, hidden),
                     RateOwnFeatures(context, images, *result, place, hidden),
                     UnknownOdds(context.options.unknown_share)};
    const double others = all.OfAll(), probability = 1.0 / (1.0 + others);
    refused[k] = probability < kRefused && !all.shapes.empty() && all.shapes.front().mirrored &&
                 all.OfShape(all.shapes.front()) > 0.5 * others;
    if (refused[k]) {
      Tell(absl::StrFormat("%s: its mirror image fits better", IdOf(context, answer.object)),
           result);
      continue;
    }
    OpenChoices(context, probability, &answer, result).Add(all);
  }
  std::size_t k = 0;
  std::erase_if(result->objects, [&](const SceneObject&) { return refused[k++]; });
  if (result->objects.empty() && k > 0) result->state = RecognitionState::kNothingFound;
}

}  // namespace horopter
