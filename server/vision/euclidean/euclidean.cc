#include "server/vision/euclidean/euclidean.h"

#include <algorithm>
#include <cmath>
#include <optional>

#include "absl/strings/str_cat.h"
#include "server/base/status_macros.h"
#include "server/vision/euclidean/refinement.h"
#include "server/vision/euclidean/representative.h"
#include "server/vision/euclidean/scene_bundle.h"
#include "server/vision/recognition/object/prepared_object.h"

namespace horopter {
namespace {

// Of the rotation between two poses: below it they are different representatives (2.6 degrees; an
// axis of revolution turns by the pose's own noise).
constexpr double kSameTurnTrace = 2.998;

// Whether the representative of an adjusted symmetric object is another than the one that was
// adjusted: recognition's pose lay near the border between two. If so, `adjusted` is what to begin
// from again.
bool IsAnotherRepresentative(const RecognitionInput& input,
                             const Refinement& r,
                             RecognitionResult* adjusted,
                             const std::vector<int>& objects) {
  const SceneBundle& b = r.bundle;
  const auto first = std::find_if(
      b.views.begin(), b.views.end(), [](const AdjustedView& view) { return view.known; });
  bool another = false;
  for (std::size_t k = 0; k < objects.size(); ++k) {
    SceneObject& o = adjusted->objects[objects[k]];
    o.scene_from_object = b.objects[k].scene_from_object;
    const Rigid3 pose = first->camera_from_scene * o.scene_from_object;
    const Rigid3 wanted = RepresentativePose(input.objects[o.object]->model, pose);
    another = another || (wanted.R * pose.R.transpose()).trace() < kSameTurnTrace;
  }
  for (std::size_t v = 0; v < b.views.size(); ++v) {
    if (!b.views[v].known) continue;
    adjusted->views[v]->camera = b.views[v].camera;
    adjusted->views[v]->camera_from_scene = b.views[v].camera_from_scene;
  }
  return another;
}

void AddRejected(int catalog_object, std::vector<Finding>* findings) {
  Finding& f = findings->emplace_back();
  f.kind = FindingKind::kObjectRejected;
  f.object = catalog_object;
  f.detail = "its edges do not fit the cameras of the other objects";
}

// What the scene leaves open, and where its metres come from.
void AddFindings(const SceneBundle& bundle,
                 const RecognitionInput& input,
                 const EuclideanOptions& options,
                 MetricScene* out) {
  const auto add = [&](FindingKind kind, int object, double value, std::string detail) {
    out->findings.push_back({kind, object, -1, Eigen::Vector3d::Zero(), value, std::move(detail)});
  };
  if (bundle.objects.size() == 1) {
    add(FindingKind::kSingleObject, 0, 0.0, "scale and frame hang on one object");
  }
  if (std::all_of(bundle.objects.begin(), bundle.objects.end(), [](const AdjustedObject& o) {
        return !o.model->model.symmetries.empty();
      })) {
    add(FindingKind::kFrameBySymmetry,
        0,
        1.0 + static_cast<double>(bundle.objects[0].model->model.symmetries.size()),
        "every object is symmetric: the frame is one of several equivalent ones");
  }
  out->scales = EstimateScales(bundle, options.noise, options.findings, options.threads);
  for (const ScaleSource& s : out->scales) {
    if (s.agrees) continue;
    add(FindingKind::kScaleConflict,
        s.index,
        s.log_ratio,
        absl::StrCat("object ",
                     s.index,
                     " looks ",
                     std::exp(s.log_ratio),
                     " times as large as enrolled, measured by the others"));
  }
  for (int v = 0; v < static_cast<int>(input.hints.size()); ++v) {
    if (input.hints[v].focal_px && !input.hints[v].presumed && bundle.views[v].known) {
      out->scales.push_back({ScaleSourceKind::kKnownFocalLength,
                             v,
                             std::log(bundle.views[v].camera.focal_px / *input.hints[v].focal_px),
                             FocalLogSigma(input.hints[v]),
                             true});
    }
  }
  for (Finding& f : FindWeakDirections(bundle, out->covariance, options.findings)) {
    out->findings.push_back(std::move(f));
  }
}

std::vector<ViewFit> FitsOf(const SceneBundle& b) {
  std::vector<ViewFit> fits(b.views.size());
  for (const EdgeObservation& e : b.edges) {
    ++fits[e.view].edge_points;
    fits[e.view].rms_px += e.residual_px * e.residual_px;
  }
  for (ViewFit& fit : fits) {
    if (fit.edge_points > 0) fit.rms_px = std::sqrt(fit.rms_px / fit.edge_points);
  }
  return fits;
}

// Cameras and objects as they are adjusted. kept: of recognition.objects, those in the bundle.
void TakeAdjusted(const SceneBundle& b,
                  const std::vector<LensTerms>& lens,
                  const RecognitionResult& recognition,
                  const std::vector<int>& kept,
                  const NoiseOptions& noise,
                  MetricScene* out) {
  out->rms_px = RobustRms(b.edges);
  out->view_fits = FitsOf(b);
  out->covariance = ComputeSceneCovariance(b, noise);
  const bool known = out->covariance.matrix.size() > 0;
  out->cameras.resize(b.views.size());
  for (std::size_t v = 0; v < b.views.size(); ++v) {
    if (!b.views[v].known) continue;
    PosedCamera c{{b.views[v].camera, b.views[v].camera_from_scene}, 0.0, lens[v]};
    const int at = out->covariance.layout.view[v] + 6;
    if (known) c.focal_log_sigma = std::sqrt(out->covariance.matrix(at, at));
    out->cameras[v] = c;
  }
  for (std::size_t k = 0; k < b.objects.size(); ++k) {
    const SceneObject& source = recognition.objects[kept[k]];
    PosedObject o;
    o.object = source.object;
    o.scene_from_object = b.objects[k].scene_from_object;
    o.score = source.score;
    o.view_scores = source.view_scores;
    o.alternatives = source.alternatives;
    o.left_open = source.left_open;
    double squares = 0.0;
    for (const EdgeObservation& e : b.edges) {
      if (e.object != static_cast<int>(k)) continue;
      ++o.edge_observations;
      squares += e.residual_px * e.residual_px;
    }
    o.rms_px = o.edge_observations > 0 ? std::sqrt(squares / o.edge_observations) : 0.0;
    out->objects.push_back(std::move(o));
  }
}

absl::Status CheckInput(const RecognitionInput& input,
                        const RecognitionResult& recognition,
                        const CameraGroupPrior& group) {
  if (recognition.objects.empty()) return absl::FailedPreconditionError("no recognised object");
  if (std::none_of(recognition.views.begin(), recognition.views.end(), [](const auto& v) {
        return v.has_value();
      })) {
    return absl::FailedPreconditionError("no recovered camera");
  }
  if (recognition.views.size() != input.features.size()) {
    return absl::InvalidArgumentError("views and features differ in number");
  }
  for (const int v : group.group.views) {
    if (v < 0 || v >= static_cast<int>(recognition.views.size()) || !recognition.views[v])
      return absl::InvalidArgumentError("the group of cameras has a view that was not recovered");
  }
  return absl::OkStatus();
}

std::vector<int> Misfits(const Refinement& r, MisfitAcceptance acceptance) {
  // Aspects were judged by the edges that others leave to see: hidden ones are no misfit.
  if (r.observation.aspects) {
    acceptance.least_found = 0.0;
    acceptance.least_px *= acceptance.aspect_scatter;
  }
  return FindMisfits(r.bundle, r.visible, acceptance);
}

void CountScene(const SceneBundle& b, MetricScene* out) {
  out->counts["edge_observations"] = static_cast<double>(b.edges.size());
  out->counts["views_of_one_camera"] = 0.0;
  for (const CameraSimilarity& alike : b.alike)
    out->counts["views_of_one_camera"] += static_cast<double>(alike.views.size());
  out->counts["plane_cells"] = static_cast<double>(b.plane.cells.size());
  out->counts["plane_sigmas"] = PlaneDeviation(b);
  out->counts["texture_points"] = static_cast<double>(b.texture.points.size());
  out->counts["texture_sigmas"] = TextureDeviation(b.views, b.texture);
}

}  // namespace

absl::StatusOr<MetricScene> RefineMetricScene(const RecognitionInput& input,
                                              const RecognitionResult& recognition,
                                              const EuclideanOptions& options,
                                              const StopRequested& stop) {
  return RefineMetricScene(input, recognition, CameraGroupPrior{}, options, stop);
}

RecognitionResult AsRecognized(const MetricScene& metric, RecognitionResult recognition) {
  for (std::size_t v = 0; v < metric.cameras.size(); ++v) {
    recognition.views[v].reset();
    if (metric.cameras[v]) {
      recognition.views[v] =
          CalibratedCamera{metric.cameras[v]->camera, metric.cameras[v]->camera_from_scene};
    }
  }
  recognition.objects.clear();
  for (const PosedObject& o : metric.objects) {
    SceneObject& out = recognition.objects.emplace_back();
    out.object = o.object;
    out.scene_from_object = o.scene_from_object;
    out.score = o.score;
    out.view_scores = o.view_scores;
    out.alternatives = o.alternatives;
    out.left_open = o.left_open;
  }
  return recognition;
}

absl::StatusOr<MetricScene> RefineMetricScene(const RecognitionInput& input,
                                              const RecognitionResult& recognition,
                                              const CameraGroupPrior& group,
                                              const EuclideanOptions& options,
                                              const StopRequested& stop) {
  HOROPTER_RETURN_IF_ERROR(CheckInput(input, recognition, group));
  MetricScene out;
  std::vector<int> kept;
  for (int k = 0; k < static_cast<int>(recognition.objects.size()); ++k) kept.push_back(k);
  Refinement r = BeginRefinement(input, recognition, kept, group, options);
  HOROPTER_RETURN_IF_ERROR(Adjust(options, stop, &r));
  const std::vector<int> misfits = Misfits(r, options.misfits);
  if (!misfits.empty()) {
    for (const int k : misfits) AddRejected(recognition.objects[k].object, &out.findings);
    std::erase_if(
        kept, [&](int k) { return std::find(misfits.begin(), misfits.end(), k) != misfits.end(); });
    if (kept.empty()) return absl::FailedPreconditionError("no object fits the cameras");
    r = BeginRefinement(input, recognition, kept, group, options);
    HOROPTER_RETURN_IF_ERROR(Adjust(options, stop, &r));
  }
  if (RecognitionResult adjusted = recognition;
      IsAnotherRepresentative(input, r, &adjusted, kept)) {
    r = BeginRefinement(input, adjusted, kept, group, options);
    HOROPTER_RETURN_IF_ERROR(Adjust(options, stop, &r));
  }
  HOROPTER_RETURN_IF_ERROR(ShareCameras(input, options, stop, &r));
  HOROPTER_RETURN_IF_ERROR(AdjustLenses(input, options, stop, &r));

  const SceneBundle& b = r.bundle;
  TakeAdjusted(b, r.lens, recognition, kept, options.noise, &out);
  if (options.camera_evidence) out.evidence = ComputeCameraEvidence(b, options.noise);
  TransformGraph graph;
  const SceneFrames frames = AddSceneFrames(out, &graph);
  for (std::size_t k = 1; k < out.objects.size(); ++k) {
    HOROPTER_ASSIGN_OR_RETURN(const UncertainPose pose,
                              graph.Between(frames.scene, frames.objects[k]));
    out.objects[k].covariance = pose.covariance;
  }
  out.plane = FindSupportingPlane(b);
  AddFindings(b, input, options, &out);
  CountScene(b, &out);
  out.counts["lens_terms"] = static_cast<double>(
      std::count_if(r.lens.begin(), r.lens.end(), [](const LensTerms& l) { return !l.none(); }));
  out.counts["rejected_objects"] = static_cast<double>(misfits.size());
  return out;
}

SceneFrames AddSceneFrames(const MetricScene& metric, TransformGraph* graph) {
  SceneFrames out;
  // The first known camera holds the coordinates in which the covariance is stated; the scene frame
  // is fixed to the first object.
  const int origin = graph->AddFrame("adjustment");
  const bool known = metric.covariance.matrix.size() > 0;
  const int first = known ? graph->AddUncertainty(metric.covariance.matrix) : 0;
  const auto connect = [&](int a, int b, const Rigid3& a_from_b, int column) {
    // New frames on a tree: nothing can be connected twice.
    (void)graph->Connect(a, b, a_from_b, known ? first + column : TransformGraph::kExact);
  };
  for (std::size_t v = 0; v < metric.cameras.size(); ++v) {
    out.cameras.push_back(-1);
    if (!metric.cameras[v]) continue;
    out.cameras[v] = graph->AddFrame("camera " + std::to_string(v));
    connect(out.cameras[v],
            origin,
            metric.cameras[v]->camera_from_scene,
            known ? metric.covariance.layout.view[v] : 0);
  }
  for (std::size_t k = 0; k < metric.objects.size(); ++k) {
    out.objects.push_back(graph->AddFrame("object " + std::to_string(k)));
    connect(origin,
            out.objects[k],
            metric.objects[k].scene_from_object,
            known ? metric.covariance.layout.object[k] : 0);
  }
  out.scene = graph->AddFrame("scene");
  if (!metric.objects.empty()) {
    (void)graph->Connect(out.scene, out.objects[0], metric.objects[0].scene_from_object);
  } else {
    (void)graph->Connect(out.scene, origin, Rigid3{});
  }
  return out;
}

}  // namespace horopter
