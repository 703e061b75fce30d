#include "server/vision/recognition/aspect_scenes/scene_completion.h"

#include <algorithm>
#include <cmath>
#include <numeric>
#include <utility>

#include "server/base/parallel_for.h"
#include "server/vision/recognition/aspect_scenes/doubtful_views.h"
#include "server/vision/recognition/aspect_scenes/faint_objects.h"
#include "server/vision/recognition/aspect_scenes/standing_planes.h"
#include "server/vision/recognition/aspect_scenes/standing_search.h"

namespace horopter {
namespace {

constexpr int kMostCarried = 24;  // hypotheses carried into all views of a scene
// In which parts that are added move the cameras: linked by parts, and known.
constexpr int kRounds[] = {2, 3};
constexpr double kSureObject = 0.45;  // score of one whose place is taken
// Cameras that know nothing of the parts leave chance little: the best wrong places of photographs
// score .10 - .20 in the mean of their views, right ones of scanned parts .35.
constexpr double kChanceOfView = 0.2;
// Of the score that a part has where it is best: what has less is what it reaches where it is not.
constexpr double kAgainShare = 0.7;
constexpr double kTrustedReachPx = 5.0;  // working px that cameras are off once a part moved them
constexpr double kRowSigmaPx = 3.0;      // neighbouring rows err together

// What a view should show, of what the middle one does; what shows less of all parts is no view.
constexpr double kOddShare = 0.35;

// Views whose known cameras are somewhere else: they show next to nothing of what they should.
std::vector<bool> OddViews(const LinkedScene& scene) {
  std::vector<bool> should(scene.views.size(), false), does(scene.views.size(), false);
  for (const LinkedObject& o : scene.objects) {
    std::vector<double> scores;
    for (std::size_t v = 0; v < o.views.size(); ++v) {
      if (o.shown[v]) scores.push_back(o.views[v].score);
    }
    if (scores.empty()) continue;
    std::nth_element(scores.begin(), scores.begin() + scores.size() / 2, scores.end());
    const double least = kOddShare * scores[scores.size() / 2];
    for (std::size_t v = 0; v < o.views.size(); ++v) {
      should[v] = should[v] || o.shown[v];
      does[v] = does[v] || (o.shown[v] && o.views[v].score >= least);
    }
  }
  std::vector<bool> out(scene.views.size());
  for (std::size_t v = 0; v < out.size(); ++v)
    out[v] = scene.views[v].has_value() && should[v] && !does[v];
  return out;
}

constexpr std::size_t kJudged = 4;  // of a place, best ones that are judged in full; for time

// The best hypothesis of each other part near an object, best first.
std::vector<AspectSceneObject> Competing(const AspectLinkInput& input,
                                         const ViewLinks& links,
                                         const LinkedScene& scene,
                                         const LinkedObject& o) {
  const auto mesh_of = [&](int object) -> const RenderMesh& {
    return input.models[object].object->mesh;
  };
  const auto is_accepted = [&](int object, const Eigen::Vector3d& center) {
    return std::any_of(scene.objects.begin(), scene.objects.end(), [&](const LinkedObject& other) {
      const RenderMesh& mesh = mesh_of(other.object);
      return other.object == object &&
             (other.scene_from_object * mesh.center.cast<double>() - center).norm() <
                 kOnePlaceShare * mesh.diameter_m;
    });
  };
  const Eigen::Vector3d center = o.scene_from_object * mesh_of(o.object).center.cast<double>();
  std::vector<double> best(input.models.size(), 0.0);
  std::vector<AspectSceneObject> candidates(input.models.size());
  for (std::size_t v = 0; v < scene.views.size(); ++v) {
    if (!scene.views[v]) continue;
    const Rigid3 scene_from_camera = scene.views[v]->camera_from_scene.Inverse();
    for (const AspectHypothesis& h : links.Hypotheses(static_cast<int>(v))) {
      if (h.object == o.object || h.score <= best[h.object]) continue;
      const Rigid3 placed =
          scene_from_camera *
          WithFocal(h.camera_from_object, h.camera.focal_px, scene.views[v]->camera.focal_px);
      const Eigen::Vector3d there = placed * mesh_of(h.object).center.cast<double>();
      const double size = std::min(mesh_of(h.object).diameter_m, mesh_of(o.object).diameter_m);
      if ((there - center).norm() > size || is_accepted(h.object, there)) continue;
      best[h.object] = h.score;
      candidates[h.object] = {h.object, placed};
    }
  }
  std::vector<int> order(best.size());
  std::iota(order.begin(), order.end(), 0);
  std::stable_sort(order.begin(), order.end(), [&](int a, int b) { return best[a] > best[b]; });
  std::vector<AspectSceneObject> out;
  for (const int k : order) {
    if (out.size() >= kJudged || best[k] <= 0.0) break;
    out.push_back(candidates[k]);
  }
  return out;
}

// Notes the best score that another part's hypothesis of a single image, settled in all views, has
// in the place of each object: LinkedObject::competing_object.
void FindBestCompeting(const AspectLinkInput& input,
                       const AspectLinkOptions& options,
                       const ViewLinks& links,
                       const SceneObjects& objects,
                       LinkedScene* scene) {
  if (!options.competing_parts) return;
  for (LinkedObject& o : scene->objects) {
    const std::vector<AspectSceneObject> candidates = Competing(input, links, *scene, o);
    std::vector<double> scores(candidates.size(), 0.0);
    ParallelFor(static_cast<int>(candidates.size()), options.threads, [&](int i) {
      auto settled = objects.Settled(scene->views, candidates[i]);
      if (settled)
        scores[i] = objects.JudgeOne(scene->views, settled->placed, {}, settled->rendered).score;
    });
    const auto most = std::max_element(scores.begin(), scores.end());
    if (most == scores.end() || *most <= 0.0) continue;
    o.competing_score = *most;
    o.competing_object = candidates[most - scores.begin()].object;
  }
}

}  // namespace

double WorthOf(const LinkedScene& scene) {
  double worth = 0.0;
  for (const LinkedObject& o : scene.objects) {
    for (std::size_t v = 0; v < o.views.size(); ++v) {
      if (o.shown[v]) worth += o.views[v].score - kChanceOfView;
    }
  }
  return worth;
}

SceneCompletion::SceneCompletion(const AspectLinkInput& input,
                                 const AspectLinkOptions& options,
                                 const ViewLinks& links,
                                 const SceneObjects& objects,
                                 const StopRequested& stop,
                                 const PriorCameras& known)
    : in_(input),
      options_(options),
      links_(links),
      objects_(objects),
      stop_(stop),
      known_(known.prior),
      contours_(known.contours) {
  for (const AspectModel& model : in_.models) meshes_.push_back(&model.object->mesh);
}

LinkedScene SceneCompletion::Finish(AspectScene scene, double unit_m) const {
  SpendEffort(in_, kCompletionEffort);
  std::optional<CamerasPrior> known;
  if (known_ != nullptr) {
    known = *known_;
    known->unit_m = unit_m;
  } else {
    objects_.Sift(&scene);
  }
  for (int round = 0; round < kRounds[known_ != nullptr]; ++round) {
    const std::size_t before = scene.objects.size();
    if (before == 0 || IsStopRequested(stop_)) break;
    AddCarried(kMostCarried, &scene);
    const bool added = scene.objects.size() > before;
    if (added || (round == 0 && !known)) Adjust(&scene, known ? &*known : nullptr);
    if (!known) objects_.Sift(&scene);
    if (scene.objects.size() <= before) break;
  }
  return Verified(scene);
}

LinkedScene SceneCompletion::Verified(const AspectScene& scene) const {
  LinkedScene out = objects_.Result(scene);
  if (known_ == nullptr) return out;
  const std::vector<bool> odd = OddViews(out);
  if (std::find(odd.begin(), odd.end(), true) != odd.end()) {
    AspectScene rest = SceneOf(out);
    for (std::size_t v = 0; v < odd.size(); ++v) {
      if (odd[v]) rest.views[v].reset();
    }
    out = objects_.Result(rest);
    if (out.registered() < 2) out.objects.clear();
  }
  const std::vector<LinkedObject> all = out.objects;
  std::erase_if(out.objects, [&](const LinkedObject& o) {
    return std::any_of(all.begin(), all.end(), [&](const LinkedObject& p) {
      return p.object == o.object && o.score < kAgainShare * p.score;
    });
  });
  out.score = WorthOf(out);
  return out;
}

void SceneCompletion::Adjust(AspectScene* scene, CamerasPrior* known) const {
  AspectAdjustmentOptions adjustment = options_.adjustment;
  if (known != nullptr) adjustment.sigma_px = kRowSigmaPx;
  AdjustToEdges(in_.images, meshes_, adjustment, options_.threads, scene, known);
}

void SceneCompletion::AddCarried(int most, AspectScene* scene) const {
  objects_.Place(FreeCarried(most, *scene), scene);
}

// Best first.
std::vector<AspectSceneObject> SceneCompletion::Carried(const AspectScene& scene) const {
  return known_ != nullptr ? Transferred(scene) : links_.Carried(scene.views);
}

// What the searched views show, each at the depth that the other views bear out.
std::vector<AspectSceneObject> SceneCompletion::Transferred(const AspectScene& scene) const {
  CamerasPrior in_metres = *known_;
  in_metres.unit_m = 1.0;
  TransferOptions transferring;
  transferring.reach_px = kTrustedReachPx;
  const Transfer transfer(in_, scene.views, in_metres, *contours_, transferring);
  std::vector<TransferredObject> candidates;
  for (int v = 0; v < static_cast<int>(scene.views.size()); ++v) {
    if (!scene.views[v]) continue;
    const std::vector<AspectHypothesis>& list = links_.Hypotheses(v);
    std::vector<std::vector<TransferredObject>> of(list.size());
    ParallelFor(static_cast<int>(list.size()), options_.threads, [&](int i) {
      const UnitRange range{1.0 / kDepthError, kDepthError, true};
      of[i] = transfer.Place(v, list[i], range, 1, 1);
      for (TransferredObject& t : of[i]) t.support += list[i].score;
    });
    for (auto& found : of) candidates.insert(candidates.end(), found.begin(), found.end());
  }
  SortBySupport(&candidates);
  std::vector<AspectSceneObject> out;
  for (const TransferredObject& c : candidates) out.push_back(c.scene.objects.front());
  return out;
}

// The best in places where the scene has no object.
std::vector<AspectSceneObject> SceneCompletion::FreeCarried(int most,
                                                            const AspectScene& scene) const {
  std::vector<AspectSceneObject> candidates = Carried(scene);
  std::erase_if(candidates, [&](const AspectSceneObject& c) {
    return !objects_.IsFree(scene.views, scene.objects, c);
  });
  if (static_cast<int>(candidates.size()) > most) candidates.resize(most);
  return candidates;
}

// What stands in free places of the planes.
std::vector<AspectSceneObject> SceneCompletion::Standing(std::span<const StandingPlane> planes,
                                                         const AspectScene& scene) const {
  std::vector<AspectSceneObject> candidates;
  for (const StandingPlane& plane : planes) {
    int of_plane = 0;
    for (const StandingCandidate& c : FindStanding(
             in_.images, scene.views, in_.models, plane, scene.objects, options_.threads, stop_)) {
      if (of_plane >= options_.standing) break;
      if (!objects_.IsFree(scene.views, scene.objects, c.placed)) continue;
      candidates.push_back(c.placed);
      ++of_plane;
    }
  }
  return candidates;
}

bool SceneCompletion::AddStanding(LinkedScene* best) {
  if (options_.standing <= 0 || best->registered() < 2 || best->objects.empty() ||
      IsStopRequested(stop_))
    return false;
  SpendEffort(in_, kStandingEffort);
  AspectScene scene = SceneOf(*best);
  std::vector<StandingPlane> planes = PlanesUnder(scene.objects, in_.models, scene.views);
  // Parts that stand on one plane of known cameras say which it is.
  if (known_ != nullptr) {
    std::erase_if(planes,
                  [&](const StandingPlane& p) { return p.objects < planes.front().objects; });
  }
  // A doubtful object does not keep its place from others.
  std::vector<AspectSceneObject> doubtful;
  for (std::size_t o = scene.objects.size(); known_ == nullptr && o-- > 1;) {
    if (best->objects[o].score >= kSureObject) continue;
    doubtful.push_back(scene.objects[o]);
    scene.objects.erase(scene.objects.begin() + static_cast<std::ptrdiff_t>(o));
  }
  std::vector<AspectSceneObject> candidates = Standing(planes, scene);
  stood_ = {scene.objects.front(), candidates};
  const std::size_t before = scene.objects.size();
  objects_.Place(std::move(candidates), &scene);
  if (scene.objects.size() == before) return false;
  scene.objects.insert(scene.objects.end(), doubtful.begin(), doubtful.end());
  LinkedScene more = known_ != nullptr ? Verified(scene) : Finish(std::move(scene));
  if (more.score <= best->score) return false;
  *best = std::move(more);
  return true;
}

// What was looked at on planes last, where that lies by the object that it was looked for beside.
std::vector<AspectSceneObject> SceneCompletion::StandingAgain(const AspectScene& scene) const {
  const auto same =
      std::find_if(scene.objects.begin(), scene.objects.end(), [&](const AspectSceneObject& o) {
        return o.object == stood_.beside.object;
      });
  if (same == scene.objects.end())
    return Standing(PlanesUnder(scene.objects, in_.models, scene.views), scene);
  const Rigid3 moved = same->scene_from_object * stood_.beside.scene_from_object.Inverse();
  std::vector<AspectSceneObject> out = stood_.candidates;
  for (AspectSceneObject& o : out) o.scene_from_object = moved * o.scene_from_object;
  return out;
}

void SceneCompletion::AddFaint(LinkedScene* best) const {
  if (!options_.faint_parts || options_.standing <= 0 || !MayShowFaintObjects(*best) ||
      IsStopRequested(stop_))
    return;
  const AspectScene scene = SceneOf(*best);
  std::vector<AspectSceneObject> candidates = FreeCarried(kMostCarried, scene);
  const std::vector<AspectSceneObject> standing = StandingAgain(scene);
  candidates.insert(candidates.end(), standing.begin(), standing.end());
  AddFaintObjects(in_, options_, objects_, std::move(candidates), best);
}

void SceneCompletion::LeaveOutPoorViews(LinkedScene* best) const {
  const std::vector<bool> poor = PoorViews(*best, kPoorShare);
  if (best->objects.empty() || std::none_of(poor.begin(), poor.end(), [](bool p) { return p; }))
    return;
  AspectScene rest = SceneOf(*best);
  for (std::size_t v = 0; v < poor.size(); ++v) {
    if (poor[v]) rest.views[v].reset();
  }
  LinkedScene out = Finish(std::move(rest));
  if (!out.objects.empty()) *best = std::move(out);
}

void SceneCompletion::Conclude(LinkedScene* best) const {
  if (best->objects.empty()) return;
  AddFaint(best);
  SortBestFirst(best);
  FindBestCompeting(in_, options_, links_, objects_, best);
  best->agreement = objects_.WithGround(*best);
}

}  // namespace horopter
