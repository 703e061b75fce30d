#include "tests/diagnose/object_report.h"

#include <algorithm>
#include <cmath>
#include <set>

#include "tests/diagnose/camera_report.h"

namespace horopter {
namespace {

constexpr double kHypothesisPx = 20.0;
constexpr double kPosePx = 10.0;
constexpr double kTargetVisible = 0.1;
constexpr double kCountedVisible = 0.3;
constexpr double kEnoughEdges =
    0.5;  // below this recall of its edges, an object counts as lost by the features
constexpr double kNever = 1e6;

// An object placed in a metric scene with cameras.
struct NamedPlacement {
  std::string id;
  Rigid3 scene_from_object;
};

struct PlacedView {
  PinholeCamera camera;
  Rigid3 camera_from_scene;
};

using PlacedViews = std::vector<std::optional<PlacedView>>;

struct TruePose {
  const ObjectModel* model = nullptr;
  int instance = -1;
  int obj_id = 0;
};

std::vector<int> CountedViews(const BopScene& scene, int instance) {
  for (double limit : {kCountedVisible, kTargetVisible}) {
    std::vector<int> views;
    for (size_t v = 0; v < scene.images.size(); ++v) {
      if (scene.images[v].instances[instance].visib_fract >= limit) {
        views.push_back(static_cast<int>(v));
      }
    }
    if (!views.empty()) {
      return views;
    }
  }
  return {};
}

// Errors in the counted views; kNever where the camera is missing.
std::vector<double> ErrorsOf(const NamedPlacement& object,
                             const PlacedViews& views,
                             const BopScene& scene,
                             const TruePose& truth) {
  std::vector<double> errors;
  for (int v : CountedViews(scene, truth.instance)) {
    const BopImage& image = scene.images[v];
    errors.push_back(static_cast<size_t>(v) < views.size() && views[v]
                         ? ProjectionError(*truth.model,
                                           views[v]->camera,
                                           views[v]->camera_from_scene * object.scene_from_object,
                                           image,
                                           image.instances[truth.instance].camera_from_object)
                         : kNever);
  }
  return errors;
}

// Smallest median error of the objects with the right id.
std::optional<double> BestError(const std::vector<NamedPlacement>& objects,
                                const PlacedViews& views,
                                const BopScene& scene,
                                const TruePose& truth) {
  std::optional<double> best;
  for (const NamedPlacement& object : objects) {
    if (object.id == truth.model->id) {
      const double error = Median(ErrorsOf(object, views, scene, truth));
      best = std::min(best.value_or(kNever), error);
    }
  }
  return best;
}

// One answer serves one instance: best pairs first. Fills final and final_px.
void AssignAnswers(const std::vector<NamedPlacement>& answers,
                   const PlacedViews& views,
                   const BopScene& scene,
                   const std::vector<TruePose>& truths,
                   std::vector<ObjectFate>* fates) {
  struct Pair {
    double median;
    size_t answer, truth;
    bool majority;
  };
  std::vector<Pair> pairs;
  for (size_t a = 0; a < answers.size(); ++a) {
    for (size_t t = 0; t < truths.size(); ++t) {
      if (answers[a].id == truths[t].model->id) {
        const std::vector<double> errors = ErrorsOf(answers[a], views, scene, truths[t]);
        const auto good =
            std::count_if(errors.begin(), errors.end(), [](double e) { return e < kPosePx; });
        pairs.push_back({Median(errors), a, t, 2 * good > static_cast<long>(errors.size())});
      }
    }
  }
  std::sort(
      pairs.begin(), pairs.end(), [](const Pair& x, const Pair& y) { return x.median < y.median; });
  std::set<size_t> used_answers, used_truths;
  for (const Pair& pair : pairs) {
    if (used_answers.count(pair.answer) > 0 || used_truths.count(pair.truth) > 0) {
      continue;
    }
    used_answers.insert(pair.answer);
    used_truths.insert(pair.truth);
    (*fates)[pair.truth].final_px = pair.median;
    (*fates)[pair.truth].final = pair.majority;
  }
}

std::optional<double> BestHypothesis(const PipelineResult& result,
                                     const std::vector<std::string>& object_ids,
                                     const BopScene& scene,
                                     const TruePose& truth) {
  std::optional<double> best;
  for (const ViewHypothesis& hypothesis : result.trace.recognition.hypotheses) {
    if (hypothesis.object < 0 || object_ids.at(hypothesis.object) != truth.model->id) {
      continue;
    }
    const BopImage& image = scene.images.at(hypothesis.view);
    const double error = ProjectionError(*truth.model,
                                         hypothesis.camera,
                                         hypothesis.camera_from_object,
                                         image,
                                         image.instances[truth.instance].camera_from_object);
    best = std::min(best.value_or(kNever), error);
  }
  return best;
}

// Best recall of the instance's edges over the views.
double EdgeRecallOf(int instance,
                    const std::vector<TrueView>& truth,
                    const std::vector<FeatureFinding>& findings) {
  double best = 0.0;
  for (size_t v = 0; v < truth.size(); ++v) {
    double edges = 0, found = 0;
    for (size_t e = 0; e < truth[v].edges.size(); ++e) {
      if (truth[v].edges[e].instance == instance) {
        edges += 1;
        found += findings[v].edges[e].covered >= kFoundEdgeShare ? 1 : 0;
      }
    }
    best = std::max(best, edges > 0 ? found / edges : 0.0);
  }
  return best;
}

std::string LostAt(const ObjectFate& fate,
                   int instance,
                   const PipelineResult& result,
                   const BopScene& scene) {
  if (fate.final) {
    return "none";
  }
  if (fate.verified) {
    return "consolidation";
  }
  if (!fate.hypothesised) {
    return fate.edge_recall < kEnoughEdges ? "features" : "hypothesis";
  }
  int registered = 0;
  for (int v : CountedViews(scene, instance)) {
    registered += static_cast<size_t>(v) < result.trace.recognition.views.size() &&
                          result.trace.recognition.views[v]
                      ? 1
                      : 0;
  }
  if (registered >= 2) {
    return "verification";
  }
  const MatchingResult& matching = result.trace.matching;
  const bool any_link = !matching.planes.empty() ||
                        std::any_of(matching.pairs.begin(),
                                    matching.pairs.end(),
                                    [](const PairGeometry& pair) { return pair.F.has_value(); });
  return any_link ? "reconstruction" : "matching";
}

}  // namespace

double ProjectionError(const ObjectModel& model,
                       const PinholeCamera& camera,
                       const Rigid3& camera_from_object,
                       const BopImage& image,
                       const Rigid3& true_camera_from_object) {
  double best = kNever;
  for (size_t s = 0; s <= model.symmetries.size(); ++s) {
    const Rigid3 truth =
        s == 0 ? true_camera_from_object : true_camera_from_object * model.symmetries[s - 1];
    double worst = 0.0;
    for (const Eigen::Vector3d& vertex : model.mesh.vertices) {
      const Eigen::Vector3d estimated = camera_from_object * vertex;
      const Eigen::Vector3d expected = truth * vertex;
      worst = std::max(worst,
                       estimated.z() > 1e-6 && expected.z() > 1e-6
                           ? (Project(camera, estimated) - ProjectTrue(image, expected)).norm()
                           : kNever);
      if (worst >= best) {
        break;
      }
    }
    best = std::min(best, worst);
  }
  return best * 640.0 / std::max(image.camera.width, 1);
}

std::vector<ObjectFate> FollowObjects(const PipelineResult& result,
                                      const std::vector<std::string>& object_ids,
                                      const BopScene& scene,
                                      const TrueModels& models,
                                      const std::vector<TrueView>& truth,
                                      const std::vector<FeatureFinding>& findings) {
  PlacedViews recognition_views, answer_views;
  for (const auto& view : result.trace.recognition.views) {
    recognition_views.push_back(
        view ? std::optional<PlacedView>({view->camera, view->camera_from_scene}) : std::nullopt);
  }
  for (const auto& view : result.answer.cameras) {
    answer_views.push_back(view ? std::optional<PlacedView>({view->camera, view->camera_from_scene})
                                : std::nullopt);
  }
  std::vector<NamedPlacement> verified, answers;
  for (const SceneObject& object : result.trace.recognition.verified) {
    verified.push_back({object_ids.at(object.object), object.scene_from_object});
  }
  for (const AnswerObject& object : result.answer.objects) {
    answers.push_back({object.object_id, object.scene_from_object});
  }
  std::vector<TruePose> truths;
  std::vector<ObjectFate> fates;
  for (size_t i = 0; i < scene.images.at(0).instances.size(); ++i) {
    const int obj_id = scene.images[0].instances[i].obj_id;
    const auto visible =
        std::count_if(scene.images.begin(), scene.images.end(), [i](const BopImage& image) {
          return image.instances[i].visib_fract >= kTargetVisible;
        });
    if (models.count(obj_id) == 0 || visible < 2) {
      continue;
    }
    const TruePose pose = {&models.at(obj_id), static_cast<int>(i), obj_id};
    ObjectFate fate;
    fate.obj_id = obj_id;
    fate.instance = static_cast<int>(i);
    fate.edge_recall = EdgeRecallOf(pose.instance, truth, findings);
    fate.best_hypothesis_px = BestHypothesis(result, object_ids, scene, pose);
    fate.best_verified_px = BestError(verified, recognition_views, scene, pose);
    fate.verified = fate.best_verified_px.value_or(kNever) < kPosePx;
    fate.hypothesised = fate.verified || fate.best_hypothesis_px.value_or(kNever) < kHypothesisPx;
    truths.push_back(pose);
    fates.push_back(fate);
  }
  AssignAnswers(answers, answer_views, scene, truths, &fates);
  for (ObjectFate& fate : fates) {
    fate.verified |= fate.final;
    fate.hypothesised |= fate.final;
    fate.lost_at = LostAt(fate, fate.instance, result, scene);
  }
  return fates;
}

}  // namespace horopter
