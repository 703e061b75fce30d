#include "server/vision/explanation/explanation.h"

#include <algorithm>
#include <cmath>
#include <utility>

#include "absl/strings/str_cat.h"
#include "absl/strings/str_format.h"
#include "server/base/parallel_for.h"
#include "server/base/status_macros.h"
#include "server/vision/recognition/aspect_scenes/aspect_linking.h"
#include "server/vision/recognition/aspect_scenes/scene_objects.h"
#include "server/vision/recognition/aspect_scenes/standing_planes.h"
#include "server/vision/recognition/aspect_search/find_aspects.h"
#include "server/vision/recognition/aspects/fragment_index.h"
#include "server/vision/recognition/interpretation/aspect_decision.h"
#include "server/vision/recognition/interpretation/aspect_route.h"
#include "server/vision/recognition/object/aspect_model.h"
#include "server/vision/recognition/object/aspect_options.h"
#include "server/vision/recognition/object/prepared_object.h"

namespace horopter {
namespace {

constexpr double kRenderPx = 200.0;  // as scores that are answered
constexpr std::size_t kSettled = 4;  // hypotheses adjusted to all views
// Of right objects beside others, lying on a plane with them or not, alone in several views or in
// one, and more of it of the share of views that show none.
constexpr double kLyingScore = 0.35, kBesideScore = 0.49, kAloneScore = 0.55;
constexpr double kOneViewScore = 0.60, kMissingScore = 0.16;
constexpr double kSamePlace = 0.4;       // of the smaller diameter: nearer centres are one place
constexpr double kSureFocalSigma = 0.1;  // a focal length known better is not searched for

// A pose of the object under cameras of one scene.
struct Placement {
  Rigid3 scene_from_object;
  double score = 0.0;
};

// All edges but those of fine texture.
AspectImageOptions ComparedWith(const RecognitionInput& input) {
  AspectImageOptions out = input.aspects != nullptr ? input.aspects->images : AspectImageOptions();
  out.drop_pattern = false;
  return out;
}

class Explainer {
 public:
  Explainer(const RecognitionInput& input,
            const RefusalLog& log,
            const RecognitionResult& recognition,
            const MetricScene* metric,
            const RecognitionOptions& options,
            const StopRequested& stop)
      : in_(input),
        log_(log),
        found_(recognition),
        metric_(metric),
        options_(options),
        stop_(stop),
        object_(*input.objects[log.object]),
        images_(MakeAspectImagesOnGround(
            input.images, {}, ComparedWith(input), options.threads, input.searched)) {
    out_.views.resize(images_.size());
    cameras_.resize(images_.size());
    for (std::size_t v = 0; v < images_.size(); ++v) {
      if (metric_ != nullptr && v < metric_->cameras.size() && metric_->cameras[v]) {
        cameras_[v] =
            CalibratedCamera{metric_->cameras[v]->camera, metric_->cameras[v]->camera_from_scene};
      } else if (metric_ == nullptr && v < found_.views.size()) {
        cameras_[v] = found_.views[v];
      }
    }
  }

  absl::StatusOr<Explanation> Run() {
    if (FromAnswer() || FromRefusals()) return Told();
    HOROPTER_ASSIGN_OR_RETURN(const std::vector<ViewHypothesis> hypotheses, Hypotheses());
    if (hypotheses.empty()) {
      out_.failed = AcceptanceTest::kHypothesis;
    } else if (Registered() > 0) {
      JudgeInScene(hypotheses);
    } else {
      ShowSingleViews(hypotheses);
    }
    return Told();
  }

 private:
  int Registered() const {
    return static_cast<int>(std::count_if(
        cameras_.begin(), cameras_.end(), [](const auto& c) { return c.has_value(); }));
  }

  const RenderMesh* Mesh() {
    if (object_.aspects != nullptr) return &object_.aspects->object.mesh;
    if (!mesh_) {
      auto made = MakeRenderMesh(object_.model.mesh, object_.model.diameter_m);
      if (!made.ok()) return nullptr;
      mesh_ = *std::move(made);
    }
    return &*mesh_;
  }

  // The object is answered, or was left out by the adjustment.
  bool FromAnswer() {
    if (metric_ == nullptr) return false;
    const PosedObject* best = nullptr;
    for (const PosedObject& o : metric_->objects) {
      if (o.object == log_.object && (best == nullptr || o.score > best->score)) best = &o;
    }
    if (best != nullptr) {
      out_.value = best->score;
      Show(best->scene_from_object, cameras_);
      return true;
    }
    for (const Finding& f : metric_->findings) {
      if (f.kind != FindingKind::kObjectRejected || f.object != log_.object) continue;
      out_.failed = AcceptanceTest::kCommonCameras;
      for (const SceneObject& o : found_.objects) {
        if (o.object != log_.object) continue;
        Show(o.scene_from_object, found_.views);
        return true;
      }
    }
    return false;
  }

  // Of what was refused, what came furthest.
  bool FromRefusals() {
    const Refusal* best = nullptr;
    for (const Refusal& r : log_.refusals) {
      if (best == nullptr || std::pair(r.test, r.value) > std::pair(best->test, best->value))
        best = &r;
    }
    if (best == nullptr) return false;
    out_.failed = best->test;
    out_.value = best->value;
    out_.needed = best->needed;
    if (best->test == AcceptanceTest::kPlace) out_.other = Occupant(best->scene_from_object);
    if (best->test != AcceptanceTest::kFeatures) Show(best->scene_from_object, best->views);
    return true;
  }

  // What recognition kept; where it kept nothing, what a search for this object alone finds.
  absl::StatusOr<std::vector<ViewHypothesis>> Hypotheses() {
    std::vector<ViewHypothesis> kept = log_.hypotheses;
    if (!kept.empty() || object_.aspects == nullptr) return kept;
    const AspectModel model = AspectModelOf(object_);
    const FragmentIndex index = BuildFragmentIndex({&model, 1});
    FindAspectOptions search = in_.aspects != nullptr ? in_.aspects->find : FindAspectOptions();
    search.threads = search.votes.threads = options_.threads;
    for (std::size_t v = 0; v < images_.size(); ++v) {
      const std::optional<PinholeCamera> known = KnownCamera(v);
      for (const AspectHypothesis& h :
           FindAspectHypotheses(images_[v], index, search, known ? &*known : nullptr, stop_)
               .hypotheses) {
        kept.push_back({log_.object, static_cast<int>(v), h.camera, h.camera_from_object, h.score});
      }
      if (IsStopRequested(stop_)) return absl::CancelledError("stopped during the explanation");
    }
    return kept;
  }

  std::optional<PinholeCamera> KnownCamera(std::size_t v) const {
    if (cameras_[v]) return cameras_[v]->camera;
    if (in_.hints.empty() || !in_.hints[v].focal_px ||
        FocalLogSigma(in_.hints[v]) > kSureFocalSigma)
      return std::nullopt;
    PinholeCamera camera = NominalCamera(images_[v]);
    camera.focal_px = *in_.hints[v].focal_px;
    return camera;
  }

  double Score(const Rigid3& scene_from_object, double render_px) {
    SceneJudgementOptions options =
        in_.aspects != nullptr ? in_.aspects->judging : SceneJudgementOptions();
    options.render_px = render_px;
    return JudgeInViews(
               images_, *Mesh(), SceneViews(cameras_), {log_.object, scene_from_object}, options)
        .score;
  }

  // Every hypothesis carried into the cameras of the scene; the best one after adjustment.
  void JudgeInScene(const std::vector<ViewHypothesis>& hypotheses) {
    if (Mesh() == nullptr) return;
    std::vector<Placement> placements;
    for (const ViewHypothesis& h : hypotheses) {
      if (!cameras_[h.view]) continue;
      const Rigid3 pose =
          WithFocal(h.camera_from_object, h.camera.focal_px, cameras_[h.view]->camera.focal_px);
      placements.push_back({cameras_[h.view]->camera_from_scene.Inverse() * pose, 0.0});
    }
    if (placements.empty()) return ShowSingleViews(hypotheses);
    const auto judge_all = [&](double render_px) {
      ParallelFor(static_cast<int>(placements.size()), options_.threads, [&](int i) {
        placements[i].score = Score(placements[i].scene_from_object, render_px);
      });
      std::stable_sort(placements.begin(), placements.end(), [](const auto& a, const auto& b) {
        return a.score > b.score;
      });
    };
    judge_all(kQuickRenderPx);
    if (placements.size() > kSettled) placements.resize(kSettled);
    const auto views = SceneViews(cameras_);
    ParallelFor(static_cast<int>(placements.size()), options_.threads, [&](int i) {
      placements[i].scene_from_object =
          SettleInViews(images_,
                        *Mesh(),
                        views,
                        {log_.object, placements[i].scene_from_object},
                        kQuickRenderPx)
              ->placed.scene_from_object;
    });
    judge_all(kRenderPx);
    const Placement& best = placements.front();
    out_.value = best.score;
    out_.needed = NeededScore(Lies(best.scene_from_object));
    out_.other = Occupant(best.scene_from_object);
    out_.failed = out_.other >= 0            ? AcceptanceTest::kPlace
                  : best.score < out_.needed ? AcceptanceTest::kSupport
                                             : AcceptanceTest::kSearch;
    if (out_.other >= 0) out_.needed = 0.0;
    Show(best.scene_from_object, cameras_);
  }

  // Whether the object lies on a plane with the answered ones or on them.
  bool Lies(const Rigid3& scene_from_object) const {
    if (metric_ == nullptr) return false;
    std::vector<AspectModel> models;
    std::vector<AspectSceneObject> answered;
    for (const PosedObject& o : metric_->objects) {
      if (in_.objects[o.object]->aspects == nullptr) continue;
      answered.push_back({static_cast<int>(models.size()), o.scene_from_object});
      models.push_back(AspectModelOf(*in_.objects[o.object]));
    }
    return LiesOn(PlanesToLieOn(answered, models, SceneViews(cameras_)),
                  scene_from_object,
                  AspectModelOf(object_));
  }

  // Score from which on most objects are answered.
  double NeededScore(bool lies) const {
    const bool beside = metric_ != nullptr && !metric_->objects.empty();
    if (Registered() > 1 && beside) return lies ? kLyingScore : kBesideScore;
    const double missing = 1.0 - Registered() / static_cast<double>(cameras_.size());
    return (Registered() < 2 ? kOneViewScore : kAloneScore) + missing * kMissingScore;
  }

  // The answered object that stands where this one would; -1: none.
  int Occupant(const Rigid3& scene_from_object) const {
    if (metric_ == nullptr) return -1;
    const Eigen::Vector3d center = scene_from_object * object_.center;
    for (const PosedObject& o : metric_->objects) {
      const PreparedObject& other = *in_.objects[o.object];
      const double size = std::min(object_.model.diameter_m, other.model.diameter_m);
      if (o.object != log_.object &&
          (o.scene_from_object * other.center - center).norm() < kSamePlace * size)
        return o.object;
    }
    return -1;
  }

  // Without common cameras each image shows its own best pose.
  void ShowSingleViews(const std::vector<ViewHypothesis>& hypotheses) {
    out_.failed = images_.size() > 1 ? AcceptanceTest::kLink : AcceptanceTest::kSupport;
    std::vector<const ViewHypothesis*> best(images_.size(), nullptr);
    for (const ViewHypothesis& h : hypotheses) {
      if (best[h.view] == nullptr || h.score > best[h.view]->score) best[h.view] = &h;
    }
    for (std::size_t v = 0; v < best.size(); ++v) {
      if (best[v] == nullptr) continue;
      ShowIn(v, best[v]->camera, best[v]->camera_from_object);
      out_.value = std::max(out_.value, out_.views[v]->score);
    }
    if (out_.failed == AcceptanceTest::kSupport) out_.needed = NeededScore(false);
  }

  void Show(const Rigid3& scene_from_object,
            const std::vector<std::optional<CalibratedCamera>>& cameras) {
    for (std::size_t v = 0; v < cameras.size(); ++v) {
      if (cameras[v])
        ShowIn(v, cameras[v]->camera, cameras[v]->camera_from_scene * scene_from_object);
    }
  }

  void ShowIn(std::size_t v, const PinholeCamera& camera, const Rigid3& camera_from_object) {
    ExplainedView& view = out_.views[v].emplace();
    view.camera = camera;
    view.camera_from_object = camera_from_object;
    if (Mesh() != nullptr)
      view.score = ScorePose(images_[v], *Mesh(), camera, camera_from_object).score;
    std::vector<ExplainedObject> others;
    if (metric_ != nullptr && metric_->cameras[v]) {
      for (const PosedObject& o : metric_->objects) {
        if (o.object == log_.object) continue;
        others.push_back({in_.objects[o.object].get(),
                          metric_->cameras[v]->camera_from_scene * o.scene_from_object});
      }
    }
    view.edges = ReportEdges(images_[v], camera, {&object_, camera_from_object}, others);
  }

  Explanation Told() {
    out_.detail = absl::StrCat(object_.model.id, " ", Reason());
    if (out_.needed > 0.0)
      absl::StrAppend(&out_.detail, absl::StrFormat(": %.2f, need %.2f", out_.value, out_.needed));
    return std::move(out_);
  }

  std::string Reason() const {
    switch (out_.failed) {
      case AcceptanceTest::kNone:
        return "is answered";
      case AcceptanceTest::kFeatures:
        return "is not looked for: the images have too few edges";
      case AcceptanceTest::kHypothesis:
        return "fits no image in any pose";
      case AcceptanceTest::kLink:
        return "fits single images, but no two of them agree on a pose";
      case AcceptanceTest::kSearch:
        return "would be accepted where it is shown, but the search did not come upon it";
      case AcceptanceTest::kSupport:
        return "has too few of its edges in the images";
      case AcceptanceTest::kPlace:
        return out_.other < 0 ? "has to give way to what explains its place better"
                              : absl::StrCat("has to give way to ",
                                             in_.objects[out_.other]->model.id,
                                             ", which explains its place better");
      case AcceptanceTest::kChance:
        return "fits, but so may chance";
      case AcceptanceTest::kFocal:
        return "asks for focal lengths that contradict what is known of them";
      case AcceptanceTest::kParallax:
        return "is seen from one side only (angle in radians)";
      case AcceptanceTest::kContradiction:
        return "belongs to a scene of which the cameras should see edges that are not there";
      case AcceptanceTest::kCommonCameras:
        return "does not fit the cameras that the other objects fit";
    }
    return "";
  }

  const RecognitionInput& in_;
  const RefusalLog& log_;
  const RecognitionResult& found_;
  const MetricScene* metric_;
  const RecognitionOptions& options_;
  const StopRequested& stop_;
  const PreparedObject& object_;
  const std::vector<AspectImage> images_;
  std::vector<std::optional<CalibratedCamera>> cameras_;  // of the scene that is answered
  std::optional<RenderMesh> mesh_;
  Explanation out_;
};

}  // namespace

absl::StatusOr<Explanation> ExplainObject(const RecognitionInput& input,
                                          const RefusalLog& log,
                                          const RecognitionResult& recognition,
                                          const MetricScene* metric,
                                          const RecognitionOptions& options,
                                          const StopRequested& stop) {
  if (log.object < 0 || log.object >= static_cast<int>(input.objects.size()))
    return absl::InvalidArgumentError("no object is to be explained");
  return Explainer(input, log, recognition, metric, options, stop).Run();
}

}  // namespace horopter
