#include "server/vision/euclidean/euclidean.h"

#include <algorithm>
#include <cmath>
#include <optional>

#include "absl/strings/str_cat.h"
#include "server/base/parallel_for.h"
#include "server/base/status_macros.h"
#include "server/vision/euclidean/edge_observations.h"
#include "server/vision/euclidean/representative.h"
#include "server/vision/euclidean/scene_bundle.h"
#include "server/vision/recognition/object/prepared_object.h"

namespace horopter {
namespace {

constexpr double kK1Sigma = 0.03;             // of a lens nobody knows
constexpr double kHintedCenterSigmaPx = 1.0;  // of a calibrated camera
constexpr double kHintedK1Sigma = 0.002;      // of a calibrated camera
constexpr double kUnknownSigma = 1e6;         // of what another prior says
constexpr std::size_t kFewestEdges = 8;       // one over a pose with its focal length
// Of the rotation between two poses: below it they are different representatives (2.6 degrees; an
// axis of revolution turns by the pose's own noise).
constexpr double kSameTurnTrace = 2.998;
// Hidden lines are recomputed once the objects have moved this far in some image.
constexpr double kRecomputeHiddenPx = 1.0;

CameraPrior PriorOf(const RecognitionInput& input, const EuclideanOptions& options, int v) {
  const ImageFeatures& f = input.features[v];
  CameraPrior prior;
  prior.log_focal = std::log(options.focal_start_widths * f.width);
  prior.log_focal_sigma = options.focal_log_sigma;
  prior.cx = 0.5 * (f.width - 1);
  prior.cy = 0.5 * (f.height - 1);
  prior.center_sigma_px = options.principal_point_sigma * f.width;
  prior.k1_sigma = kK1Sigma;
  if (input.hints.empty()) return prior;
  const CameraHint& hint = input.hints[v];
  if (hint.focal_px) {
    prior.log_focal = std::log(*hint.focal_px);
    prior.log_focal_sigma = FocalLogSigma(hint);
  }
  if (hint.principal_point) {
    prior.cx = hint.principal_point->x();
    prior.cy = hint.principal_point->y();
    prior.center_sigma_px = kHintedCenterSigmaPx;
  }
  if (hint.principal_point_sigma_px) prior.center_sigma_px = *hint.principal_point_sigma_px;
  if (hint.k1) {
    prior.k1 = *hint.k1;
    prior.k1_sigma = kHintedK1Sigma;
  }
  return prior;
}

// Everything one refinement works on.
struct Refinement {
  SceneBundle bundle;
  std::vector<EdgeGrid> grids;
  std::vector<VisibleSamples> visible;
  std::vector<AdjustedView> seen_views;  // when `visible` was found
  std::vector<AdjustedObject> seen_objects;
  std::vector<AdjustedView> first_views;  // before anything was adjusted
  std::vector<AdjustedObject> first_objects;
  ObservationOptions observation;
};

std::vector<std::optional<CalibratedCamera>> CamerasOf(const SceneBundle& bundle) {
  std::vector<std::optional<CalibratedCamera>> known(bundle.views.size());
  for (std::size_t v = 0; v < known.size(); ++v) {
    const AdjustedView& view = bundle.views[v];
    if (view.known) known[v] = CalibratedCamera{view.camera, view.camera_from_scene};
  }
  return known;
}

// objects: of recognition.objects, those that take part.
Refinement Begin(const RecognitionInput& input,
                 const RecognitionResult& recognition,
                 const std::vector<int>& objects,
                 const CameraGroupPrior& group,
                 const EuclideanOptions& options) {
  Refinement r;
  SceneBundle& b = r.bundle;
  const int views = static_cast<int>(recognition.views.size());
  const auto first = std::find_if(recognition.views.begin(),
                                  recognition.views.end(),
                                  [](const auto& view) { return view.has_value(); });
  // Symmetric objects: the representative is chosen before the adjustment, which moves it little.
  const Rigid3& camera = (*first)->camera_from_scene;
  std::vector<Rigid3> old_from_object;
  for (const int k : objects) {
    const SceneObject& o = recognition.objects[k];
    old_from_object.push_back(camera.Inverse() * RepresentativePose(input.objects[o.object]->model,
                                                                    camera * o.scene_from_object));
  }
  const Rigid3 old_from_scene = old_from_object[0];
  b.views.resize(views);
  b.priors.resize(views);
  b.working_from_image.assign(views, 1.0);
  b.edge_sigma_px = options.edge_sigma_px;
  r.grids.resize(views);
  for (int v = 0; v < views; ++v) {
    if (!recognition.views[v]) continue;
    b.views[v] = {true,
                  recognition.views[v]->camera,
                  recognition.views[v]->camera_from_scene * old_from_scene};
    b.priors[v] = PriorOf(input, options, v);
  }
  b.group = group;
  for (const int v : group.group.views) {
    CameraPrior& prior = b.priors[v];
    prior.log_focal_sigma = prior.center_sigma_px = prior.k1_sigma = kUnknownSigma;
  }
  ParallelFor(views, options.threads, [&](int v) {
    if (b.views[v].known) r.grids[v] = EdgeGrid(input.features[v]);
  });
  for (int v = 0; v < views; ++v) b.working_from_image[v] = r.grids[v].working_from_image();
  for (std::size_t i = 0; i < objects.size(); ++i) {
    b.objects.push_back({old_from_scene.Inverse() * old_from_object[i],
                         input.objects[recognition.objects[objects[i]].object].get()});
  }
  b.log_scale.assign(b.objects.size(), 0.0);
  // Aspects need no plane, and are asked where the matched one gave no part: it may be the part's
  // own print, or a background that moves against it.
  if (input.matching != nullptr && recognition.plane_confirmed) {
    b.plane = AveragePlaneMatches(*input.matching, CamerasOf(b), options.plane);
  }
  r.observation = {options.search_px, options.samples_per_view, options.threads};
  r.observation.aspects = recognition.route == RecognitionRoute::kAspects;
  r.first_views = b.views;
  r.first_objects = b.objects;
  return r;
}

// Largest move of an object's centre or rim in an image since hidden lines were removed, working
// px.
double MovedPx(const Refinement& r) {
  double largest = 0.0;
  for (std::size_t v = 0; v < r.bundle.views.size(); ++v) {
    if (!r.bundle.views[v].known) continue;
    for (std::size_t k = 0; k < r.bundle.objects.size(); ++k) {
      const PreparedObject& model = *r.bundle.objects[k].model;
      for (int axis = 0; axis < 3; ++axis) {
        const Eigen::Vector3d x = model.center + model.radius_m * Eigen::Vector3d::Unit(axis);
        const auto pixel = [&](const AdjustedView& view, const AdjustedObject& object) {
          return Project(view.camera, view.camera_from_scene * (object.scene_from_object * x));
        };
        const double moved = (pixel(r.bundle.views[v], r.bundle.objects[k]) -
                              pixel(r.seen_views[v], r.seen_objects[k]))
                                 .norm();
        largest = std::max(largest, moved * r.bundle.working_from_image[v]);
      }
    }
  }
  return largest;
}

void Observe(Refinement* r) {
  const SceneBundle& b = r->bundle;
  if (r->visible.empty() || !(MovedPx(*r) < kRecomputeHiddenPx)) {
    r->visible = FindVisibleSamples(b.views, b.objects, r->grids, r->observation);
    r->seen_views = b.views;
    r->seen_objects = b.objects;
  }
  r->bundle.edges = ObserveEdges(b.views, b.objects, r->grids, r->visible, r->observation);
}

absl::Status Adjust(const EuclideanOptions& options, const StopRequested& stop, Refinement* r) {
  SceneBundleOptions bundle = options.bundle;
  bundle.threads = options.threads;
  for (int round = 0; round < options.rounds; ++round) {
    if (IsStopRequested(stop)) return absl::CancelledError("stopped during the metric adjustment");
    Observe(r);
    const int left = options.rounds - 1 - round;
    r->bundle.plane_slack = std::pow(options.plane_slack, left);
    if (r->bundle.edges.size() < kFewestEdges) {
      return absl::FailedPreconditionError("fewer than 8 edge points support the objects");
    }
    if (!AdjustBundle(bundle, &r->bundle)) {
      return absl::FailedPreconditionError("the metric adjustment failed");
    }
  }
  Observe(r);
  return absl::OkStatus();
}

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

double RobustRms(const std::vector<EdgeObservation>& observations) {
  if (observations.empty()) return 0.0;
  std::vector<double> r;
  for (const EdgeObservation& o : observations) r.push_back(std::abs(o.residual_px));
  std::nth_element(r.begin(), r.begin() + static_cast<long>(r.size() / 2), r.end());
  return 1.4826 * r[r.size() / 2];
}

// Where the views come from one camera the scene is adjusted once more with one set of intrinsics.
// Their priors are one for all then, but that of the principal point counts for every view: what
// the views say against it errs in common, because the part's own errors are the same in all.
absl::Status ShareCameras(const RecognitionInput& input,
                          const EuclideanOptions& options,
                          const StopRequested& stop,
                          Refinement* r) {
  SceneBundle& b = r->bundle;
  std::vector<bool> hinted(b.views.size(), false);
  for (std::size_t v = 0; v < input.hints.size(); ++v) {
    const CameraHint& hint = input.hints[v];
    hinted[v] = (hint.focal_px && !hint.presumed) || hint.principal_point || hint.k1;
  }
  for (const int v : b.group.group.views) hinted[v] = true;
  std::vector<CameraSimilarity> alike =
      JudgeCameras(b, ComputeSceneCovariance(b, options.noise), hinted, options.cameras);
  if (alike.empty()) return absl::OkStatus();
  const bool unbelievable = std::any_of(alike.begin(), alike.end(), [&](const auto& group) {
    return AreUnbelievable(b, group.views, options.cameras);
  });
  std::optional<Refinement> apart;
  if (unbelievable) apart = *r;
  b.alike = std::move(alike);
  for (const CameraSimilarity& group : b.alike) {
    const double share = std::sqrt(static_cast<double>(group.views.size()));
    for (const int v : group.views) {
      b.priors[v].log_focal_sigma *= share;
      b.priors[v].k1_sigma *= share;
    }
  }
  if (!apart) return Adjust(options, stop, r);
  // Each on its own went far from what recognition saw.
  b.views = r->first_views;
  b.objects = r->first_objects;
  const absl::Status adjusted = Adjust(options, stop, r);
  if (absl::IsCancelled(adjusted)) return adjusted;
  // They were several cameras after all.
  if (!adjusted.ok() ||
      RobustRms(b.edges) > options.cameras.as_good * RobustRms(apart->bundle.edges))
    *r = *std::move(apart);
  return absl::OkStatus();
}

Finding Rejected(int catalog_object) {
  Finding f;
  f.kind = FindingKind::kObjectRejected;
  f.object = catalog_object;
  f.detail = "its edges do not fit the cameras of the other objects";
  return f;
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

// Cameras and objects as they are adjusted. kept: of recognition.objects, those in the bundle.
void TakeAdjusted(const SceneBundle& b,
                  const RecognitionResult& recognition,
                  const std::vector<int>& kept,
                  const NoiseOptions& noise,
                  MetricScene* out) {
  out->rms_px = RobustRms(b.edges);
  out->covariance = ComputeSceneCovariance(b, noise);
  const bool known = out->covariance.matrix.size() > 0;
  out->cameras.resize(b.views.size());
  for (std::size_t v = 0; v < b.views.size(); ++v) {
    if (!b.views[v].known) continue;
    PosedCamera c{{b.views[v].camera, b.views[v].camera_from_scene}, 0.0};
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
    recognition.objects.push_back(
        {o.object, o.scene_from_object, o.score, 0.0, o.view_scores, o.alternatives});
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
  Refinement r = Begin(input, recognition, kept, group, options);
  HOROPTER_RETURN_IF_ERROR(Adjust(options, stop, &r));
  const std::vector<int> misfits = Misfits(r, options.misfits);
  if (!misfits.empty()) {
    for (const int k : misfits) out.findings.push_back(Rejected(recognition.objects[k].object));
    std::erase_if(
        kept, [&](int k) { return std::find(misfits.begin(), misfits.end(), k) != misfits.end(); });
    if (kept.empty()) return absl::FailedPreconditionError("no object fits the cameras");
    r = Begin(input, recognition, kept, group, options);
    HOROPTER_RETURN_IF_ERROR(Adjust(options, stop, &r));
  }
  if (RecognitionResult adjusted = recognition;
      IsAnotherRepresentative(input, r, &adjusted, kept)) {
    r = Begin(input, adjusted, kept, group, options);
    HOROPTER_RETURN_IF_ERROR(Adjust(options, stop, &r));
  }
  HOROPTER_RETURN_IF_ERROR(ShareCameras(input, options, stop, &r));

  const SceneBundle& b = r.bundle;
  TakeAdjusted(b, recognition, kept, options.noise, &out);
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
