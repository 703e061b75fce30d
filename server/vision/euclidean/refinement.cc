#include "server/vision/euclidean/refinement.h"

#include <algorithm>
#include <cmath>
#include <map>
#include <optional>
#include <utility>

#include "server/base/parallel_for.h"
#include "server/vision/euclidean/representative.h"
#include "server/vision/euclidean/robust_scatter.h"
#include "server/vision/recognition/object/prepared_object.h"

namespace horopter {
namespace {

constexpr double kK1Sigma = 0.03;             // of a lens nobody knows
constexpr double kHintedCenterSigmaPx = 1.0;  // of a calibrated camera
constexpr double kHintedK1Sigma = 0.002;      // of a calibrated camera
constexpr double kUnknownSigma = 1e6;         // of what another prior says
// Of the first coefficient where the second is proven: several times as much, as lenses have it.
constexpr double kStrongK1Sigma = 0.3;
constexpr std::size_t kFewestEdges = 8;  // one over a pose with its focal length
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

std::vector<std::optional<CalibratedCamera>> CamerasOf(const SceneBundle& bundle) {
  std::vector<std::optional<CalibratedCamera>> known(bundle.views.size());
  for (std::size_t v = 0; v < known.size(); ++v) {
    const AdjustedView& view = bundle.views[v];
    if (view.known) known[v] = CalibratedCamera{view.camera, view.camera_from_scene};
  }
  return known;
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

// What was observed, as lenses without the terms would show it.
void UndoLensTerms(Refinement* r) {
  SceneBundle& b = r->bundle;
  if (std::all_of(r->lens.begin(), r->lens.end(), [](const LensTerms& l) { return l.none(); }))
    return;
  for (EdgeObservation& o : b.edges) {
    const Eigen::Vector2d at = WithoutTerms(b.views[o.view].camera, r->lens[o.view], o.edge_point);
    o.residual_px -= b.working_from_image[o.view] * o.normal.dot(at - o.edge_point);
    o.edge_point = at;
  }
  b.plane.cells = r->matched_cells;
  for (PlaneCell& cell : b.plane.cells) {
    cell.pixel_a = WithoutTerms(b.views[cell.view_a].camera, r->lens[cell.view_a], cell.pixel_a);
    cell.pixel_b = WithoutTerms(b.views[cell.view_b].camera, r->lens[cell.view_b], cell.pixel_b);
  }
  for (std::size_t k = 0; k < b.texture.points.size(); ++k) {
    TexturePoint& point = b.texture.points[k];
    point.seen = r->matched_texture[k].seen;
    for (auto& [view, pixel] : point.seen)
      pixel = WithoutTerms(b.views[view].camera, r->lens[view], pixel);
  }
}

void Observe(Refinement* r) {
  const SceneBundle& b = r->bundle;
  if (r->visible.empty() || !(MovedPx(*r) < kRecomputeHiddenPx)) {
    r->visible = FindVisibleSamples(b.views, b.objects, r->grids, r->observation);
    r->seen_views = b.views;
    r->seen_objects = b.objects;
  }
  r->bundle.edges = ObserveEdges(b.views, b.objects, r->grids, r->visible, r->observation);
  UndoLensTerms(r);
}

LensTerms Sum(const LensTerms& a, const LensTerms& b) {
  return {a.k2 + b.k2, a.p1 + b.p1, a.p2 + b.p2};
}

// Views whose lenses may have terms: those of one camera together, and the others that have images
// of one size: where each has another focal length, one alone says too little, and a lens that
// zooms keeps its kind. Nothing of those whose lens is known, by the request or as a station's.
std::vector<std::vector<int>> LensesOf(const RecognitionInput& input, const SceneBundle& b) {
  std::vector<std::vector<int>> out;
  std::vector<bool> has(b.views.size(), false);
  for (std::size_t v = 0; v < input.hints.size(); ++v) has[v] = input.hints[v].k1.has_value();
  for (const int v : b.group.group.views) has[v] = true;
  for (const CameraSimilarity& alike : b.alike) {
    out.push_back(alike.views);
    for (const int v : alike.views) has[v] = true;
  }
  std::map<std::pair<int, int>, std::vector<int>> of_size;
  for (std::size_t v = 0; v < b.views.size(); ++v) {
    const PinholeCamera& camera = b.views[v].camera;
    if (b.views[v].known && !has[v])
      of_size[{camera.width, camera.height}].push_back(static_cast<int>(v));
  }
  for (auto& [size, views] : of_size) out.push_back(std::move(views));
  return out;
}

}  // namespace

Refinement BeginRefinement(const RecognitionInput& input,
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
  if (input.matching != nullptr) {
    b.plane = AveragePlaneMatches(*input.matching, CamerasOf(b), options.plane);
  }
  if (input.reconstruction != nullptr && input.reconstruction->trusted)
    b.texture = ChooseTexturePoints(*input.reconstruction, CamerasOf(b), options.texture);
  r.observation = {options.search_px, options.samples_per_view, options.threads};
  r.observation.aspects = recognition.route == RecognitionRoute::kAspects;
  r.lens.resize(views);
  r.matched_cells = b.plane.cells;
  r.matched_texture = b.texture.points;
  r.first_views = b.views;
  r.first_objects = b.objects;
  return r;
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

double RobustRms(const std::vector<EdgeObservation>& observations) {
  if (observations.empty()) return 0.0;
  std::vector<double> r;
  for (const EdgeObservation& o : observations) r.push_back(std::abs(o.residual_px));
  std::nth_element(r.begin(), r.begin() + static_cast<long>(r.size() / 2), r.end());
  return kNormalFromMad * r[r.size() / 2];
}

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

absl::Status AdjustLenses(const RecognitionInput& input,
                          const EuclideanOptions& options,
                          const StopRequested& stop,
                          Refinement* r) {
  if (!options.lens.estimate) return absl::OkStatus();
  std::optional<Refinement> without;
  std::vector<std::vector<int>> lenses = LensesOf(input, r->bundle);
  for (int round = 0; round < options.lens.rounds && !lenses.empty(); ++round) {
    std::vector<std::vector<int>> proven;
    for (const std::vector<int>& views : lenses) {
      const std::optional<LensFit> fit = FitLensTerms(r->bundle, views, options.lens);
      if (!fit || (round == 0 && (fit->proof < options.lens.least_proof ||
                                  fit->shift_px < options.lens.least_shift_px)))
        continue;
      if (!without) without = *r;
      for (const int v : views) r->lens[v] = Sum(r->lens[v], fit->terms);
      proven.push_back(views);
    }
    for (const std::vector<int>& views : proven) {
      for (const int v : views)
        r->bundle.priors[v].k1_sigma = std::max(r->bundle.priors[v].k1_sigma, kStrongK1Sigma);
    }
    lenses = std::move(proven);
    if (lenses.empty()) break;
    const absl::Status adjusted = Adjust(options, stop, r);
    if (absl::IsCancelled(adjusted)) return adjusted;
    if (!adjusted.ok() || RobustRms(r->bundle.edges) > RobustRms(without->bundle.edges)) {
      *r = *std::move(without);
      break;
    }
  }
  return absl::OkStatus();
}

}  // namespace horopter
