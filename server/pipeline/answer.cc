#include "server/pipeline/answer.h"

#include <algorithm>
#include <cmath>
#include <map>

#include "absl/strings/str_cat.h"
#include "server/base/status_macros.h"
#include "server/vision/recognition/prepared_object.h"

namespace horopter {
namespace {

// References that are exact contradict a scene when they miss it by more than its covariance allows
// (0.1 % of chi square with six degrees of freedom) and by more than this.
constexpr double kGapChiSquare = 22.46;
constexpr double kGapRad = 0.0087;
constexpr double kGapM = 0.002;
// Distances of reference cameras contradict the objects' scale beyond this.
constexpr double kScaleSigmas = 4.0;
constexpr double kScaleLog = 0.01;

// Everything the answer is drawn from. Objects of the answer are ordered by score: metric index of
// answer object i is order[i].
struct Drawing {
  const MetricScene& metric;
  TransformGraph graph;
  SceneFrames frames;
  int base = -1;
  std::vector<std::size_t> order;
};

struct Reference {
  int frame = -1;
  Rigid3 base_from_frame;
  std::string name;
};

std::size_t AnswerIndex(const Drawing& d, int metric_object) {
  return static_cast<std::size_t>(
      std::find(d.order.begin(), d.order.end(), static_cast<std::size_t>(metric_object)) -
      d.order.begin());
}

void AddFinding(const Finding& f,
                const Drawing& d,
                std::span<const std::shared_ptr<const PreparedObject>> objects,
                SceneAnswer* answer) {
  AnswerFinding out;
  out.kind = f.kind;
  if (f.kind == FindingKind::kObjectRejected) {
    out.object_id = objects[f.object]->model.id;
  } else if (f.object >= 0) {
    const AnswerObject& o = answer->objects[AnswerIndex(d, f.object)];
    out.object_id = o.object_id;
    out.instance = o.instance;
  }
  out.image = f.view;
  out.direction = f.direction;
  out.value = f.value;
  out.detail = f.detail;
  answer->findings.push_back(std::move(out));
}

// The distance between two reference cameras against the one the objects imply.
absl::Status CompareBaselines(const SceneRequest& request, const Drawing& d, SceneAnswer* answer) {
  const ReferenceCamera* first = nullptr;
  for (const ReferenceCamera& camera : request.reference_cameras) {
    if (d.frames.cameras[camera.image] < 0) continue;
    if (first == nullptr) {
      first = &camera;
      continue;
    }
    HOROPTER_ASSIGN_OR_RETURN(
        const UncertainPose between,
        d.graph.Between(d.frames.cameras[first->image], d.frames.cameras[camera.image]));
    const double estimated = between.pose.t.norm();
    const double known = (first->base_from_camera.t - camera.base_from_camera.t).norm();
    if (estimated < 1e-6 || known < 1e-6) continue;
    const Eigen::Vector3d along = between.pose.t / estimated;
    AnswerScale scale;
    scale.kind = ScaleSourceKind::kReferenceCameras;
    scale.image = camera.image;
    scale.log_ratio = std::log(known / estimated);
    scale.log_sigma =
        std::sqrt(along.dot(between.covariance.bottomRightCorner<3, 3>() * along)) / estimated;
    scale.agrees = std::abs(scale.log_ratio) < std::max(kScaleLog, kScaleSigmas * scale.log_sigma);
    answer->scales.push_back(scale);
    if (!scale.agrees) {
      AnswerFinding f;
      f.kind = FindingKind::kScaleConflict;
      f.image = camera.image;
      f.value = scale.log_ratio;
      f.detail = absl::StrCat("by the reference cameras the objects are ",
                              std::exp(scale.log_ratio),
                              " times as large as enrolled");
      answer->findings.push_back(f);
    }
  }
  return absl::OkStatus();
}

// Ties the base to the scene, unless references contradict each other.
absl::Status FindBase(const SceneRequest& request, Drawing* d, SceneAnswer* answer) {
  std::vector<Reference> references;
  if (request.reference) {
    for (std::size_t i = 0; i < answer->objects.size(); ++i) {
      if (answer->objects[i].object_id != request.reference->object_id) continue;
      references.push_back({d->frames.objects[d->order[i]],
                            request.reference->base_from_object,
                            request.reference->object_id});
      break;
    }
    if (references.empty()) {
      answer->state = SceneState::kReferenceNotFound;
      answer->detail = absl::StrCat(
          "reference ", request.reference->object_id, " is not among the recognised objects");
    }
  }
  for (const ReferenceCamera& camera : request.reference_cameras) {
    if (d->frames.cameras[camera.image] < 0) continue;
    references.push_back({d->frames.cameras[camera.image],
                          camera.base_from_camera,
                          absl::StrCat("camera of image ", camera.image)});
  }
  if (references.empty()) return absl::OkStatus();
  const int base = d->graph.AddFrame("base");
  HOROPTER_RETURN_IF_ERROR(
      d->graph.Connect(base, references[0].frame, references[0].base_from_frame));
  bool agree = true;
  for (std::size_t i = 1; i < references.size(); ++i) {
    HOROPTER_ASSIGN_OR_RETURN(
        const LoopGap gap, d->graph.Gap(base, references[i].frame, references[i].base_from_frame));
    const double turn = gap.gap.head<3>().norm(), shift = gap.gap.tail<3>().norm();
    if (gap.chi_square < kGapChiSquare || (turn < kGapRad && shift < kGapM)) continue;
    agree = false;
    AnswerFinding f;
    f.kind = FindingKind::kReferenceConflict;
    f.value = shift;
    f.detail = absl::StrCat(references[0].name,
                            " and ",
                            references[i].name,
                            " put the base ",
                            1e3 * shift,
                            " mm and ",
                            turn,
                            " rad apart");
    answer->findings.push_back(f);
  }
  if (!agree) return absl::OkStatus();
  d->base = base;
  HOROPTER_ASSIGN_OR_RETURN(const UncertainPose base_from_scene,
                            d->graph.Between(base, d->frames.scene));
  answer->base_from_scene = base_from_scene.pose;
  return absl::OkStatus();
}

absl::Status FillCovariances(const Drawing& d, SceneAnswer* answer) {
  const int n = static_cast<int>(answer->objects.size());
  answer->joint_covariance = Eigen::MatrixXd::Zero(6 * n, 6 * n);
  for (int i = 0; i < n; ++i) {
    AnswerObject& o = answer->objects[i];
    const int frame = d.frames.objects[d.order[i]];
    for (const int camera : d.frames.cameras) {
      o.camera_covariances.emplace_back();
      if (camera < 0) continue;
      HOROPTER_ASSIGN_OR_RETURN(const UncertainPose pose, d.graph.Between(camera, frame));
      o.camera_covariances.back() = pose.covariance;
    }
    if (d.base >= 0) {
      HOROPTER_ASSIGN_OR_RETURN(o.base_from_object, d.graph.Between(d.base, frame));
    }
    for (int j = 0; j < n; ++j) {
      HOROPTER_ASSIGN_OR_RETURN(
          const Matrix6d block,
          d.graph.CrossCovariance(
              d.frames.scene, frame, d.frames.scene, d.frames.objects[d.order[j]]));
      answer->joint_covariance.block<6, 6>(6 * i, 6 * j) = block;
    }
  }
  return absl::OkStatus();
}

void FillGrasps(const Drawing& d,
                std::span<const std::shared_ptr<const PreparedObject>> objects,
                const GraspOptions& options,
                SceneAnswer* answer) {
  GraspScene scene;
  scene.plane = d.metric.plane;
  for (std::size_t i = 0; i < answer->objects.size(); ++i) {
    const AnswerObject& o = answer->objects[i];
    GraspScene::Object object{
        &objects[d.metric.objects[d.order[i]].object]->model, o.scene_from_object, o.covariance};
    if (o.base_from_object && answer->base_from_scene) {
      // About the scene's axes.
      const Matrix6d turn = SecondInProduct(answer->base_from_scene->Inverse());
      object.covariance = turn * o.base_from_object->covariance * turn.transpose();
    }
    scene.objects.push_back(object);
  }
  for (std::size_t i = 0; i < answer->objects.size(); ++i) {
    AnswerObject& o = answer->objects[i];
    o.grasps = PlanGrasps(scene, static_cast<int>(i), options, &o.grasp_counts);
  }
}

}  // namespace

absl::Status FillAnswer(const MetricScene& metric,
                        std::span<const std::shared_ptr<const PreparedObject>> objects,
                        const SceneRequest& request,
                        const GraspOptions& grasps,
                        SceneAnswer* answer) {
  answer->cameras = metric.cameras;
  Drawing d{metric, {}, {}, -1, {}};
  d.frames = AddSceneFrames(metric, &d.graph);
  for (std::size_t k = 0; k < metric.objects.size(); ++k) d.order.push_back(k);
  std::stable_sort(d.order.begin(), d.order.end(), [&](std::size_t a, std::size_t b) {
    return metric.objects[a].score > metric.objects[b].score;
  });
  std::map<std::string, int> instances;
  for (const std::size_t k : d.order) {
    const PosedObject& posed = metric.objects[k];
    AnswerObject o;
    o.object_id = objects[posed.object]->model.id;
    o.instance = instances[o.object_id]++;
    o.score = posed.score;
    o.scene_from_object = posed.scene_from_object;
    o.covariance = posed.covariance;
    o.view_scores = posed.view_scores;
    for (int a : posed.alternatives) o.alternatives.push_back(objects[a]->model.id);
    answer->objects.push_back(std::move(o));
  }
  for (const ScaleSource& s : metric.scales) {
    AnswerScale scale;
    scale.kind = s.kind;
    if (s.kind == ScaleSourceKind::kObject) {
      const AnswerObject& o = answer->objects[AnswerIndex(d, s.index)];
      scale.object_id = o.object_id;
      scale.instance = o.instance;
    } else {
      scale.image = s.index;
    }
    scale.log_ratio = s.log_ratio;
    scale.log_sigma = s.log_sigma;
    scale.agrees = s.agrees;
    answer->scales.push_back(scale);
  }
  for (const Finding& f : metric.findings) AddFinding(f, d, objects, answer);
  HOROPTER_RETURN_IF_ERROR(CompareBaselines(request, d, answer));
  HOROPTER_RETURN_IF_ERROR(FindBase(request, &d, answer));
  HOROPTER_RETURN_IF_ERROR(FillCovariances(d, answer));
  FillGrasps(d, objects, grasps, answer);
  return absl::OkStatus();
}

}  // namespace horopter
