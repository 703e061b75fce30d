#include "server/pipeline/answer.h"

#include <Eigen/Eigenvalues>
#include <algorithm>
#include <cmath>
#include <map>

#include "absl/strings/str_cat.h"
#include "server/base/status_macros.h"
#include "server/pipeline/deciding_view.h"
#include "server/pipeline/reference_base.h"
#include "server/vision/recognition/object/prepared_object.h"

namespace horopter {
namespace {

// Distances of reference cameras contradict the objects' scale beyond this.
constexpr double kScaleSigmas = 4.0;
constexpr double kScaleLog = 0.01;

// Everything the answer is drawn from.
struct Drawing : AnswerFrames {
  explicit Drawing(const MetricScene& scene) : metric(scene) {}
  const MetricScene& metric;
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

// The distance between two cameras in the base against the one the objects imply.
absl::Status CompareBaselines(const SceneRequest& request, const Drawing& d, SceneAnswer* answer) {
  int first = -1;
  for (int v = 0; v < static_cast<int>(request.camera_poses.size()); ++v) {
    if (!request.camera_poses[v] || d.frames.cameras[v] < 0) continue;
    if (first < 0) {
      first = v;
      continue;
    }
    const CameraPoseHint &a = *request.camera_poses[first], &b = *request.camera_poses[v];
    HOROPTER_ASSIGN_OR_RETURN(const UncertainPose between,
                              d.graph.Between(d.frames.cameras[first], d.frames.cameras[v]));
    const double estimated = between.pose.t.norm();
    const double known = (a.camera_from_base.Inverse().t - b.camera_from_base.Inverse().t).norm();
    if (estimated < 1e-6 || known < 1e-6) continue;
    const Eigen::Vector3d along = between.pose.t / estimated;
    const double variance = along.dot(between.covariance.bottomRightCorner<3, 3>() * along) +
                            a.position_sigma_m * a.position_sigma_m +
                            b.position_sigma_m * b.position_sigma_m;
    AnswerScale scale;
    scale.kind = ScaleSourceKind::kReferenceCameras;
    scale.image = v;
    scale.log_ratio = std::log(known / estimated);
    scale.log_sigma = std::sqrt(variance) / estimated;
    scale.agrees = std::abs(scale.log_ratio) < std::max(kScaleLog, kScaleSigmas * scale.log_sigma);
    answer->scales.push_back(scale);
    if (scale.agrees) continue;
    AnswerFinding f;
    f.kind = FindingKind::kScaleConflict;
    f.image = v;
    f.value = scale.log_ratio;
    f.detail = absl::StrCat("by the cameras in the base the objects are ",
                            std::exp(scale.log_ratio),
                            " times as large as enrolled");
    answer->findings.push_back(f);
  }
  return absl::OkStatus();
}

// Ties the base to camera v with the uncertainty of its hint.
absl::Status TieToCamera(const SceneRequest& request, int base, int v, Drawing* d) {
  const CameraPoseHint& hint = *request.camera_poses[v];
  return d->graph.Connect(
      base,
      d->frames.cameras[v],
      hint.camera_from_base.Inverse(),
      d->graph.AddUncertainty(DiagonalCovariance(hint.rotation_sigma_rad, hint.position_sigma_m)));
}

// The recovered camera whose pose in the base is known best; -1: none.
int SurestCamera(const SceneRequest& request, const Drawing& d) {
  int surest = -1;
  for (int v = 0; v < static_cast<int>(request.camera_poses.size()); ++v) {
    const auto& hint = request.camera_poses[v];
    if (!hint || d.frames.cameras[v] < 0) continue;
    if (surest < 0 || hint->position_sigma_m < request.camera_poses[surest]->position_sigma_m)
      surest = v;
  }
  return surest;
}

// Ties the base to the scene, unless references contradict each other or leave it open.
absl::Status FindBase(const SceneRequest& request,
                      std::span<const std::shared_ptr<const PreparedObject>> objects,
                      Drawing* d,
                      SceneAnswer* answer) {
  if (request.reference) {
    HOROPTER_ASSIGN_OR_RETURN(const ReferenceVerdict verdict,
                              BaseFromReferences(request, objects, d, answer));
    if (verdict != ReferenceVerdict::kOpen) return absl::OkStatus();
  }
  const BaseFrame frame = BaseFromCameras(request.camera_poses, answer->cameras);
  if (!frame.conflict.empty()) AddReferenceConflict(frame.conflict, 0.0, answer);
  if (!frame.base_from_scene) return absl::OkStatus();
  answer->base_from_scene = frame.base_from_scene;
  // The mean of several cameras is at least as sure as one of them.
  const int surest = SurestCamera(request, *d);
  if (surest < 0) return absl::OkStatus();
  const int base = d->graph.AddFrame("base");
  HOROPTER_RETURN_IF_ERROR(TieToCamera(request, base, surest, d));
  d->base = base;
  return absl::OkStatus();
}

// Whose metre is right the images do not say: nobody may act on such an answer unawares.
void TellScaleConflicts(SceneAnswer* answer) {
  for (const AnswerFinding& f : answer->findings) {
    if (f.kind == FindingKind::kScaleConflict) {
      AddReason(ReasonKind::kScaleConflict, f.detail, answer);
    }
  }
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
      HOROPTER_ASSIGN_OR_RETURN(const UncertainPose pose, d.graph.Between(d.base, frame));
      o.base_from_object =
          UncertainPose{*answer->base_from_scene * o.scene_from_object, pose.covariance};
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

GraspOptions WithTools(GraspOptions options, const std::optional<GripperTools>& tools) {
  if (!tools) return options;
  options.parallel_jaw = tools->parallel_jaw;
  options.suction = tools->suction;
  options.approach_m = tools->approach_m.value_or(options.approach_m);
  return options;
}

// Grasps that the images allow and the base does not.
void TellUncertainBase(double least_success, std::size_t object, SceneAnswer* answer) {
  const AnswerObject& o = answer->objects[object];
  const auto missed = std::count_if(o.grasps.begin(), o.grasps.end(), [&](const SceneGrasp& g) {
    return g.success < least_success;
  });
  if (missed == 0 || !o.base_from_object) return;
  const auto widest = [&](const Eigen::Matrix3d& block) {
    return std::sqrt(std::max(
        0.0, Eigen::SelfAdjointEigenSolver<Eigen::Matrix3d>(block).eigenvalues().maxCoeff()));
  };
  const Matrix6d& C = o.base_from_object->covariance;
  AnswerFinding f;
  f.kind = FindingKind::kBaseUncertain;
  f.object_id = o.object_id;
  f.instance = o.instance;
  f.value = widest(C.bottomRightCorner<3, 3>());
  f.turn_rad = widest(C.topLeftCorner<3, 3>());
  f.detail = absl::StrCat("the robot's base is known to ",
                          1e3 * f.value,
                          " mm and ",
                          f.turn_rad,
                          " rad there: ",
                          missed,
                          " of ",
                          o.grasps.size(),
                          " grasps may miss");
  answer->findings.push_back(std::move(f));
}

void FillGrasps(const Drawing& d,
                std::span<const std::shared_ptr<const PreparedObject>> objects,
                const GraspOptions& options,
                SceneAnswer* answer) {
  GraspScene scene;
  scene.plane = d.metric.plane;
  scene.joint_covariance = answer->joint_covariance;
  for (std::size_t i = 0; i < answer->objects.size(); ++i) {
    const AnswerObject& o = answer->objects[i];
    GraspScene::Object object{
        &objects[d.metric.objects[d.order[i]].object]->model, o.scene_from_object, o.covariance};
    if (o.base_from_object && answer->base_from_scene) {
      // About the scene's axes.
      const Matrix6d turn = SecondInProduct(answer->base_from_scene->Inverse());
      object.covariance_in_base = turn * o.base_from_object->covariance * turn.transpose();
    }
    scene.objects.push_back(object);
  }
  for (std::size_t i = 0; i < answer->objects.size(); ++i) {
    AnswerObject& o = answer->objects[i];
    o.grasps = PlanGrasps(scene, static_cast<int>(i), options, &o.grasp_counts);
    TellUncertainBase(options.least_success, i, answer);
  }
}

std::vector<AnswerAlternative> LeftOpen(
    const MetricScene& metric,
    std::span<const std::shared_ptr<const PreparedObject>> objects,
    const PosedObject& posed) {
  std::vector<AnswerAlternative> out;
  for (const SceneAlternative& a : posed.left_open) {
    AnswerAlternative& o = out.emplace_back();
    o.kind = a.kind;
    o.object_id = objects[a.object]->model.id;
    o.probability = a.probability;
    if (a.object_from_alternative)
      o.scene_from_object = posed.scene_from_object * *a.object_from_alternative;
    o.feature_place = a.feature_place;
    o.feature_size_m = a.feature_size_m;
    const auto view =
        FindDecidingView(a.views, posed.scene_from_object, objects[posed.object]->center, metric);
    if (!view) continue;
    o.scene_from_camera = view->scene_from_camera;
    o.differing_px = view->differing_px;
  }
  return out;
}

}  // namespace

void AddReason(ReasonKind kind, const std::string& detail, SceneAnswer* answer) {
  std::vector<AnswerReason>& reasons = answer->reasons;
  const auto at = std::lower_bound(
      reasons.begin(), reasons.end(), kind, [](const auto& r, ReasonKind k) { return r.kind < k; });
  if (at == reasons.end() || at->kind != kind) {
    reasons.insert(at, {kind, detail});
  } else if (!detail.empty()) {
    absl::StrAppend(&at->detail, at->detail.empty() ? "" : "; ", detail);
  }
}

bool HasReason(const SceneAnswer& answer, ReasonKind kind) {
  return std::any_of(answer.reasons.begin(), answer.reasons.end(), [&](const AnswerReason& r) {
    return r.kind == kind;
  });
}

std::string ReasonsText(const SceneAnswer& answer) {
  std::string text;
  for (const AnswerReason& r : answer.reasons) {
    absl::StrAppend(&text, text.empty() || r.detail.empty() ? "" : "; ", r.detail);
  }
  return text;
}

absl::Status FillAnswer(const MetricScene& metric,
                        std::span<const std::shared_ptr<const PreparedObject>> objects,
                        const SceneRequest& request,
                        const GraspOptions& grasps,
                        SceneAnswer* answer) {
  answer->cameras = metric.cameras;
  Drawing d(metric);
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
    o.left_open = LeftOpen(metric, objects, posed);
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
  TellScaleConflicts(answer);
  HOROPTER_RETURN_IF_ERROR(FindBase(request, objects, &d, answer));
  HOROPTER_RETURN_IF_ERROR(FillCovariances(d, answer));
  FillGrasps(d, objects, WithTools(grasps, request.gripper), answer);
  answer->plane = metric.plane;
  return absl::OkStatus();
}

}  // namespace horopter
