#include "server/vision/recognition/table_search.h"

#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>

#include "absl/container/inlined_vector.h"
#include "server/base/parallel_for.h"
#include "server/vision/recognition/scene_refine.h"
#include "server/vision/recognition/view_linking.h"

namespace horopter {
namespace {

// A model edge whose horizontal extent is below this share of its length fixes no yaw.
constexpr double kUprightShare = 0.15;
constexpr double kMinPathVisible = 0.45;
constexpr double kMinRadiusPx = 10.0;  // projected, working pixels
constexpr double kMaxRadiusPx = 420.0;
constexpr double kDistinctPx = 14.0;     // working pixels, all views
constexpr double kDistinctScale = 0.05;  // of log scale
constexpr std::size_t kPool = 500;
// Full edges must agree in length within this share plus kEndPx.
constexpr double kLengthShare = 0.04;
constexpr double kEndPx = 3.0;
// Edges above this height (metres) do not move with the table.
constexpr double kOnPlaneHeight = 0.004;
constexpr double kPartialWeight = 0.5;  // vote of an edge of which one end is hidden
constexpr double kMinSeedScore = 0.42;
constexpr double kTwinCos = 0.9999;
// Parts are looked for up to this share of the lowest camera's height.
constexpr double kMaxHeightShare = 0.5;
constexpr float kHeightReachPx = 7.0f;   // working pixels
constexpr float kHeightSupport = 0.45f;  // mean support of a segment in another view
constexpr double kLevel = 1e-6;          // metres, model edges

Eigen::Vector2d Turned(double c, double s, const Eigen::Vector2d& v) {
  return {c * v.x() - s * v.y(), s * v.x() + c * v.y()};
}

// The standing part turned and moved on the table, metres.
Rigid3 PlaceOnTable(const StandingPart& part, const TableYaw& yaw) {
  Rigid3 turn;
  turn.R << yaw.cos_yaw, -yaw.sin_yaw, 0, yaw.sin_yaw, yaw.cos_yaw, 0, 0, 0, 1;
  turn.t << yaw.position / yaw.units_per_metre, 0.0;
  return turn * part.table_from_object;
}

struct Pooled {
  Rigid3 table_from_object;  // metres
  double units_per_metre = 1.0;
  double quick = 0.0;
  double votes = 0.0;
};

// Keeps the best of many poses.
class Pool {
 public:
  explicit Pool(double floor) : floor_(floor) {}
  // Poses below it need not be added.
  double floor() const { return floor_; }
  void Add(const Pooled& p) {
    if (p.quick < floor_) return;
    poses_.push_back(p);
    if (poses_.size() < 2 * kPool) return;
    std::nth_element(poses_.begin(), poses_.begin() + kPool, poses_.end(), Better);
    floor_ = poses_[kPool].quick;
    poses_.resize(kPool);
  }
  std::vector<Pooled> Sorted() && {
    std::stable_sort(poses_.begin(), poses_.end(), Better);
    return std::move(poses_);
  }

 private:
  static bool Better(const Pooled& a, const Pooled& b) { return a.quick > b.quick; }
  std::vector<Pooled> poses_;
  double floor_;
};

// Mean quick score over the views that show the part's centre, at least two.
double MeanQuick(const PreparedObject& object,
                 std::span<const KnownView> views,
                 double units_per_metre,
                 const Rigid3& table_from_object,
                 float reach_px,
                 double give_up) {
  absl::InlinedVector<QuickView, 8> seen;
  for (const KnownView& view : views) {
    Rigid3 camera_from_table = view.camera_from_scene;
    camera_from_table.t /= units_per_metre;
    const Rigid3 pose = camera_from_table * table_from_object;
    const Eigen::Vector3d c = pose * object.center;
    if (c.z() <= object.radius_m) return 0.0;
    const double radius =
        object.radius_m * view.camera.focal_px * view.maps->working_from_image / c.z();
    if (radius < kMinRadiusPx || radius > kMaxRadiusPx) return 0.0;
    const Eigen::Vector2d u = Project(view.camera, c);
    if (u.x() >= 0 && u.y() >= 0 && u.x() < view.camera.width && u.y() < view.camera.height)
      seen.push_back({view.maps, &view.camera, pose});
  }
  if (seen.size() < 2) return 0.0;
  return QuickScoreOverViews(object, seen, reach_px, static_cast<float>(give_up));
}

// Largest displacement in any view, over the symmetry that makes it smallest.
double LargestShift(const PreparedObject& object,
                    std::span<const KnownView> views,
                    const Pooled& a,
                    const Pooled& b) {
  auto shift = [&](const Rigid3& turned_b) {
    double largest = 0.0;
    for (const KnownView& view : views) {
      Rigid3 of_a = view.camera_from_scene, of_b = view.camera_from_scene;
      of_a.t /= a.units_per_metre;
      of_b.t /= b.units_per_metre;
      largest = std::max(largest,
                         ProjectionDistance(object,
                                            view.camera,
                                            of_a * a.table_from_object,
                                            view.camera,
                                            of_b * turned_b,
                                            view.maps->working_from_image));
    }
    return largest;
  };
  double smallest = shift(b.table_from_object);
  for (const Rigid3& s : object.model.symmetries)
    smallest = std::min(smallest, shift(b.table_from_object * s));
  return smallest;
}

std::vector<Pooled> Distinct(const PreparedObject& object,
                             std::span<const KnownView> views,
                             std::vector<Pooled> sorted,
                             int kept) {
  std::vector<Pooled> out;
  for (const Pooled& p : sorted) {
    if (static_cast<int>(out.size()) >= kept) break;
    if (std::none_of(out.begin(), out.end(), [&](const Pooled& o) {
          return std::abs(std::log(o.units_per_metre / p.units_per_metre)) < kDistinctScale &&
                 LargestShift(object, views, o, p) < kDistinctPx;
        })) {
      out.push_back(p);
    }
  }
  return out;
}

// The best by quick score and the best by votes in turn: a cell's mean may lie some pixels off,
// where fine texture scores as well, and votes of texture may outnumber those of a part.
std::vector<Pooled> InTurn(std::vector<Pooled> by_quick) {
  std::vector<Pooled> by_votes = by_quick;
  std::stable_sort(by_votes.begin(), by_votes.end(), [](const Pooled& a, const Pooled& b) {
    return a.votes > b.votes;
  });
  std::vector<Pooled> out;
  for (std::size_t i = 0; i < by_quick.size(); ++i) {
    out.push_back(by_votes[i]);
    out.push_back(by_quick[i]);
  }
  return out;
}

bool EdgesVisible(const PreparedObject& object,
                  const Rigid3& camera_from_object,
                  int first,
                  int second) {
  const Eigen::Vector3d to_camera =
      camera_from_object.R.transpose() * -camera_from_object.t - object.center;
  const int aspect = AspectIndex(to_camera.cast<float>());
  return object.EdgeVisible(aspect, first) >= kMinPathVisible &&
         object.EdgeVisible(aspect, second) >= kMinPathVisible;
}

struct SightedPath {
  TableSighting points[3];
  HeightMask heights_ab;
  HeightMask heights_bc;
};

double MaxHeight(std::span<const KnownView> views) {
  double lowest = 1e300;
  for (const KnownView& view : views)
    lowest = std::min(lowest, view.camera_from_scene.Inverse().t.z());
  return kMaxHeightShare * lowest;
}

// Level edges between the two sightings of view `own` that other views show as well: two of them,
// or one where there are only two views.
HeightMask SupportedHeights(std::span<const KnownView> views,
                            std::size_t own,
                            const TableSighting& from,
                            const TableSighting& to,
                            double max_height) {
  constexpr int kPoints = 5;
  HeightMask mask;
  const int needed = views.size() > 2 ? 2 : 1;
  for (int bin = 0; bin < HeightMask::kBins; ++bin) {
    const double z = (bin + 0.5) * max_height / HeightMask::kBins;
    const Eigen::Vector2d a = from.base + z * from.shift, b = to.base + z * to.shift;
    const Eigen::Vector3d tangent(b.x() - a.x(), b.y() - a.y(), 0.0);
    int seen = 0;
    for (std::size_t v = 0; v < views.size() && seen < needed; ++v) {
      if (v == own) continue;
      const KnownView& view = views[v];
      const Eigen::Vector3d q = view.camera_from_scene.R * tangent;
      float sum = 0.0f;
      for (int k = 0; k < kPoints; ++k) {
        const double w = (k + 0.5) / kPoints;
        const Eigen::Vector3d p =
            view.camera_from_scene *
            Eigen::Vector3d((1 - w) * a.x() + w * b.x(), (1 - w) * a.y() + w * b.y(), z);
        if (p.z() <= 0) break;
        const Eigen::Vector2d u = Project(view.camera, p);
        const int o = OrientationBin(static_cast<float>(q.x() * p.z() - p.x() * q.z()),
                                     static_cast<float>(q.y() * p.z() - p.y() * q.z()));
        const float d =
            view.maps->DistanceAt(static_cast<float>(u.x()), static_cast<float>(u.y()), o);
        sum += std::max(0.0f, 1.0f - d / kHeightReachPx);
      }
      seen += sum > kHeightSupport * kPoints;
    }
    if (seen < needed) continue;
    for (int k = std::max(0, bin - 1); k <= std::min(HeightMask::kBins - 1, bin + 1); ++k)
      mask.Set(k);
  }
  return mask;
}

// Votes of one view's paths for a standing part.
void VoteByPaths(const PreparedObject& object,
                 const StandingPart& part,
                 std::span<const KnownView> views,
                 std::size_t own_view,
                 const std::vector<SightedPath>& paths,
                 double max_height,
                 double tolerance,
                 PoseVotes* votes) {
  for (const VertexPath& path : object.paths) {
    for (const bool reversed : {false, true}) {
      const Eigen::Vector3d vertices[3] = {part.vertices[reversed ? path.c : path.a],
                                           part.vertices[path.b],
                                           part.vertices[reversed ? path.a : path.c]};
      const bool level_ab = std::abs(vertices[0].z() - vertices[1].z()) < kLevel;
      const bool level_bc = std::abs(vertices[2].z() - vertices[1].z()) < kLevel;
      for (const SightedPath& seen : paths) {
        TableYaw yaws[2];
        const int n = PosesFromSightings(vertices, seen.points, tolerance, yaws);
        for (int i = 0; i < n; ++i) {
          const double share = yaws[i].units_per_metre / max_height;
          if (level_ab && !seen.heights_ab.At(share * vertices[1].z())) continue;
          if (level_bc && !seen.heights_bc.At(share * vertices[1].z())) continue;
          Rigid3 camera_from_table = views[own_view].camera_from_scene;
          camera_from_table.t /= yaws[i].units_per_metre;
          if (EdgesVisible(object,
                           camera_from_table * PlaceOnTable(part, yaws[i]),
                           path.edge_ab,
                           path.edge_bc)) {
            votes->Add(yaws[i], 1.0);
          }
        }
      }
    }
  }
}

// Holds the suggested poses against the edge maps of all views.
void ScorePeaks(const PreparedObject& object,
                const StandingPart& part,
                std::span<const KnownView> views,
                const std::vector<PoseVotes::Peak>& peaks,
                float reach_px,
                Pool* pool) {
  for (const PoseVotes::Peak& peak : peaks) {
    const Rigid3 pose = PlaceOnTable(part, peak.pose);
    const double quick =
        MeanQuick(object, views, peak.pose.units_per_metre, pose, reach_px, pool->floor());
    if (quick >= pool->floor()) pool->Add({pose, peak.pose.units_per_metre, quick, peak.weight});
  }
}

}  // namespace

std::vector<StandingPart> StandingParts(const PreparedObject& object) {
  std::vector<StandingPart> parts;
  const auto& poses = object.stable_poses;
  for (std::size_t i = 0; i < poses.size(); ++i) {
    const StablePose& stable = poses[i];
    // One of the poses that the part's symmetry takes into each other is enough.
    const bool twin = std::any_of(poses.begin(), poses.begin() + i, [&](const StablePose& other) {
      return std::any_of(
          object.model.symmetries.begin(), object.model.symmetries.end(), [&](const Rigid3& s) {
            return (s.R * other.up).dot(stable.up) > kTwinCos;
          });
    });
    if (twin) continue;
    StandingPart part;
    const Eigen::Vector3d u = stable.up.unitOrthogonal();
    part.table_from_object.R << u.transpose(), stable.up.cross(u).transpose(),
        stable.up.transpose();
    part.table_from_object.t << 0.0, 0.0, stable.height_m;
    for (const Eigen::Vector3d& v : object.model.vertices)
      part.vertices.push_back(part.table_from_object * v);
    parts.push_back(std::move(part));
  }
  return parts;
}

bool SightTable(const PinholeCamera& camera,
                const Rigid3& camera_from_table,
                const Eigen::Vector2d& pixel,
                TableSighting* sighting) {
  const Eigen::Vector3d ray =
      camera_from_table.R.transpose() * NormalizedPoint(camera, pixel).homogeneous();
  if (ray.z() > -0.02 * ray.norm()) return false;
  const Eigen::Vector3d eye = -(camera_from_table.R.transpose() * camera_from_table.t);
  sighting->shift = ray.head<2>() / ray.z();
  sighting->base = eye.head<2>() - eye.z() * sighting->shift;
  return true;
}

int PosesFromSightings(const Eigen::Vector3d vertices[3],
                       const TableSighting sightings[3],
                       double tolerance,
                       TableYaw out[2]) {
  const Eigen::Vector3d &a = vertices[0], &b = vertices[1], &c = vertices[2];
  const Eigen::Vector2d ab = (b - a).head<2>(), bc = (c - b).head<2>();
  const double length_ab = (b - a).norm(), length_bc = (c - b).norm();
  // The sighting of b minus that of a, at their heights, is A + scale * B.
  const Eigen::Vector2d A = sightings[1].base - sightings[0].base;
  const Eigen::Vector2d B = b.z() * sightings[1].shift - a.z() * sightings[0].shift;
  const double limit = tolerance * (length_ab + length_bc);
  const bool upright = ab.norm() < kUprightShare * length_ab;
  double scales[2];
  int found = 0;
  if (upright) {
    const double bb = B.squaredNorm();
    if (bb <= 0) return 0;
    scales[found++] = -A.dot(B) / bb;
  } else {
    const double q2 = B.squaredNorm() - ab.squaredNorm(), q1 = A.dot(B), q0 = A.squaredNorm();
    const double d = q1 * q1 - q2 * q0;
    if (d < 0 || std::abs(q2) < 1e-15) return 0;
    const double root = std::sqrt(d);
    scales[found++] = (-q1 + root) / q2;
    scales[found++] = (-q1 - root) / q2;
  }
  int n = 0;
  for (int i = 0; i < found; ++i) {
    const double scale = scales[i];
    if (!(scale > 1e-9)) continue;
    const Eigen::Vector2d at_b = sightings[1].base + scale * b.z() * sightings[1].shift;
    const Eigen::Vector2d at_c = sightings[2].base + scale * c.z() * sightings[2].shift;
    // Rotation from whichever edge lies flatter, as a complex number seen / model.
    const bool use_c = upright;
    const Eigen::Vector2d seen =
        use_c ? Eigen::Vector2d(at_c - at_b) : Eigen::Vector2d(A + scale * B);
    const Eigen::Vector2d model = use_c ? bc : ab;
    const double seen_norm = seen.norm(), model_norm = model.norm();
    if (seen_norm <= 0 || model_norm < kUprightShare * (use_c ? length_bc : length_ab)) continue;
    if (upright && (A + scale * B).norm() > limit * scale) continue;
    TableYaw yaw;
    yaw.units_per_metre = scale;
    yaw.cos_yaw = model.dot(seen) / (seen_norm * model_norm);
    yaw.sin_yaw = (model.x() * seen.y() - model.y() * seen.x()) / (seen_norm * model_norm);
    yaw.position = at_b - scale * Turned(yaw.cos_yaw, yaw.sin_yaw, b.head<2>());
    const Eigen::Vector2d miss =
        yaw.position + scale * Turned(yaw.cos_yaw, yaw.sin_yaw, c.head<2>()) - at_c;
    if (miss.norm() > limit * scale) continue;
    out[n++] = yaw;
  }
  return n;
}

std::optional<SceneModel> RefinedSeed(const JointContext& context,
                                      const Reconstruction& reconstruction,
                                      double units_per_metre,
                                      int object,
                                      const Rigid3& world_from_object) {
  SceneModel scene;
  scene.views.resize(reconstruction.views.size());
  for (std::size_t v = 0; v < scene.views.size(); ++v) {
    if (!reconstruction.views[v]) continue;
    RecognizedView view{reconstruction.views[v]->camera,
                        reconstruction.views[v]->camera_from_world};
    view.camera_from_scene.t /= units_per_metre;
    scene.views[v] = view;
  }
  PlacedObject placed;
  placed.object = object;
  placed.scene_from_object = world_from_object;
  scene.objects.push_back(placed);
  SceneRefineOptions refine;
  refine.start_reach_px = 12.0;
  if (!RefineScene(context, refine, &scene)) return std::nullopt;
  VerifyScratch scratch;
  EvaluatePlacement(context, scene.views, {}, &scratch, &scene.objects[0]);
  scene.gain = scene.objects[0].gain;
  return scene;
}

std::vector<SceneModel> TableSeeds(const JointContext& context,
                                   const Reconstruction& reconstruction,
                                   const TableSearchOptions& options,
                                   int max_scales) {
  std::vector<KnownView> views;
  std::vector<int> index;
  for (std::size_t v = 0; v < reconstruction.views.size(); ++v) {
    if (!reconstruction.views[v]) continue;
    const ReconstructedView& view = *reconstruction.views[v];
    views.push_back({&context.views[v].maps, view.camera, view.camera_from_world});
    index.push_back(static_cast<int>(v));
  }
  if (views.size() < 2) return {};
  const double max_height = MaxHeight(views);
  if (!(max_height > 0)) return {};
  std::vector<std::vector<SightedPath>> paths(views.size());
  ParallelFor(static_cast<int>(views.size()), context.options.threads, [&](int i) {
    const int v = index[i];
    const auto& flags = context.matching->segment_on_plane;
    for (const ImagePath& p :
         FindImagePaths(*context.views[v].features,
                        v < static_cast<int>(flags.size()) ? flags[v] : std::vector<bool>{},
                        context.views[v].maps.working_from_image,
                        options.max_paths)) {
      SightedPath seen;
      const PinholeCamera& camera = views[i].camera;
      const Rigid3& pose = views[i].camera_from_scene;
      if (!SightTable(camera, pose, p.a, &seen.points[0]) ||
          !SightTable(camera, pose, p.b, &seen.points[1]) ||
          !SightTable(camera, pose, p.c, &seen.points[2])) {
        continue;
      }
      seen.heights_ab = SupportedHeights(views, i, seen.points[0], seen.points[1], max_height);
      seen.heights_bc = SupportedHeights(views, i, seen.points[1], seen.points[2], max_height);
      paths[i].push_back(seen);
    }
  });

  const int objects = static_cast<int>(context.objects.size());
  std::vector<std::vector<Pooled>> found(objects);
  ParallelFor(objects, context.options.threads, [&](int k) {
    const PreparedObject& object = *context.objects[k];
    const std::vector<StandingPart> parts = StandingParts(object);
    Pool pool(options.min_quick);
    for (const StandingPart& part : parts) {
      if (IsStopRequested(context.stop)) return;
      PoseVotes votes;
      for (std::size_t v = 0; v < views.size(); ++v) {
        VoteByPaths(object, part, views, v, paths[v], max_height, options.path_tolerance, &votes);
      }
      ScorePeaks(object,
                 part,
                 views,
                 votes.Peaks(options.min_path_votes, options.peaks),
                 options.quick_reach_px,
                 &pool);
    }
    found[k] = Distinct(object, views, InTurn(std::move(pool).Sorted()), options.kept_per_object);
  });

  std::vector<std::pair<int, Pooled>> best;
  for (int k = 0; k < objects; ++k) {
    for (const Pooled& p : found[k]) best.push_back({k, p});
  }
  std::stable_sort(best.begin(), best.end(), [](const auto& a, const auto& b) {
    return a.second.quick > b.second.quick;
  });
  if (static_cast<int>(best.size()) > options.refined_seeds) best.resize(options.refined_seeds);
  std::vector<SceneModel> scenes(best.size());
  std::vector<double> units(best.size(), 1.0);
  ParallelFor(static_cast<int>(best.size()), context.options.threads, [&](int i) {
    if (IsStopRequested(context.stop)) return;
    auto scene = RefinedSeed(context,
                             reconstruction,
                             best[i].second.units_per_metre,
                             best[i].first,
                             best[i].second.table_from_object);
    if (!scene) return;
    units[i] = best[i].second.units_per_metre;
    scenes[i] = *std::move(scene);
  });
  // A scale is as good as the parts that share it explain; parts of one object vote once.
  std::vector<int> order;
  std::vector<double> votes(scenes.size(), 0.0);
  for (std::size_t i = 0; i < scenes.size(); ++i) {
    if (scenes[i].objects.empty() || scenes[i].objects[0].score < kMinSeedScore) continue;
    order.push_back(static_cast<int>(i));
    std::vector<double> of_object(objects, 0.0);
    for (std::size_t j = 0; j < scenes.size(); ++j) {
      if (scenes[j].objects.empty()) continue;
      if (std::abs(std::log(units[i] / units[j])) > kDistinctScale) continue;
      double& vote = of_object[best[j].first];
      vote = std::max(vote, scenes[j].gain * (scenes[j].objects[0].score > kMinSeedScore));
    }
    for (double v : of_object) votes[i] += v;
  }
  std::stable_sort(order.begin(), order.end(), [&](int a, int b) {
    return votes[a] + scenes[a].gain > votes[b] + scenes[b].gain;
  });
  std::vector<SceneModel> out;
  std::vector<double> chosen;
  for (int i : order) {
    if (static_cast<int>(out.size()) >= max_scales) break;
    if (std::any_of(chosen.begin(), chosen.end(), [&](double u) {
          return std::abs(std::log(u / units[i])) < kDistinctScale;
        })) {
      continue;
    }
    chosen.push_back(units[i]);
    out.push_back(scenes[i]);
  }
  return out;
}

TableSearch::TableSearch(const JointContext& context,
                         const SceneModel& scene,
                         const TableSearchOptions& options)
    : context_(context), options_(options) {
  const Eigen::Vector3d z = scene.plane->normal;
  const Eigen::Vector3d x = z.unitOrthogonal();
  scene_from_table_.R << x, z.cross(x), z;
  scene_from_table_.t = z * scene.plane->offset_m;
  std::vector<std::size_t> index;
  for (std::size_t v = 0; v < scene.views.size(); ++v) {
    if (!scene.views[v]) continue;
    views_.push_back({&context.views[v].maps,
                      scene.views[v]->camera,
                      scene.views[v]->camera_from_scene * scene_from_table_});
    index.push_back(v);
  }
  max_height_ = MaxHeight(views_);
  edges_.resize(views_.size());
  ParallelFor(static_cast<int>(views_.size()), context.options.threads, [&](int i) {
    const std::size_t v = index[i];
    const ViewEvidence& evidence = context.views[v];
    const PinholeCamera& camera = views_[i].camera;
    const Rigid3& camera_from_table = views_[i].camera_from_scene;
    const ImageFeatures& features = *evidence.features;
    const auto& flags = context.matching->segment_on_plane;
    std::vector<Eigen::Vector2d> ends[2];
    std::vector<bool> corner[2];
    for (int e = 0; e < 2; ++e) {
      for (const Segment& s : features.segments) ends[e].push_back(e == 0 ? s.start : s.end);
      corner[e].assign(features.segments.size(), false);
    }
    for (const Junction& j : features.junctions) {
      for (const Junction::End& end : j.ends) {
        if (end.interior) continue;
        const int e = end.at_start ? 0 : 1;
        ends[e][end.segment] = j.point;
        corner[e][end.segment] = true;
      }
    }
    for (std::size_t s = 0; s < features.segments.size(); ++s) {
      if (features.segments[s].in_texture) continue;
      const double length = (ends[0][s] - ends[1][s]).norm();
      if (length * evidence.maps.working_from_image < options.min_edge_px) continue;
      SightedEdge edge;
      bool seen = true;
      for (int e = 0; e < 2 && seen; ++e) {
        seen = SightTable(camera, camera_from_table, ends[e][s], &edge.ends[e]);
        if (!seen) break;
        edge.corner[e] = corner[e][s];
        const Eigen::Vector3d p(edge.ends[e].base.x(), edge.ends[e].base.y(), 0.0);
        const Eigen::Vector3d eye = camera_from_table.Inverse().t;
        const double depth = (camera_from_table * p).z();
        const double elevation = eye.z() / (eye - p).norm();
        edge.pixel[e] = depth / (camera.focal_px * evidence.maps.working_from_image) /
                        std::max(0.25, elevation);
      }
      if (!seen) continue;
      edge.on_plane = v < flags.size() && s < flags[v].size() && flags[v][s];
      edge.heights = SupportedHeights(views_, i, edge.ends[0], edge.ends[1], max_height_);
      edges_[i].push_back(edge);
    }
  });
}

PoseVotes TableSearch::VoteByEdges(const PreparedObject& object, const StandingPart& part) const {
  PoseVotes votes;
  for (std::size_t e = 0; e < object.model.edges.size(); ++e) {
    const ModelEdge& edge = object.model.edges[e];
    if (edge.kind != CurveKind::kLine || edge.start_vertex < 0 || edge.end_vertex < 0) continue;
    const Eigen::Vector3d& p = part.vertices[edge.start_vertex];
    const Eigen::Vector3d& q = part.vertices[edge.end_vertex];
    const Eigen::Vector2d model = (q - p).head<2>();
    const double length = model.norm();
    if (length < kUprightShare * (q - p).norm() || length <= 0) continue;
    const bool level = std::abs(p.z() - q.z()) < kLevel;
    const bool raised = std::max(p.z(), q.z()) > kOnPlaneHeight;
    for (std::size_t v = 0; v < views_.size(); ++v) {
      for (const SightedEdge& sighted : edges_[v]) {
        if (raised && sighted.on_plane) continue;
        if (level && !sighted.heights.At(p.z() / max_height_)) continue;
        for (const bool swapped : {false, true}) {
          const TableSighting& sp = sighted.ends[swapped ? 1 : 0];
          const TableSighting& sq = sighted.ends[swapped ? 0 : 1];
          const Eigen::Vector2d at_p = sp.base + p.z() * sp.shift;
          const Eigen::Vector2d at_q = sq.base + q.z() * sq.shift;
          const Eigen::Vector2d seen = at_q - at_p;
          const double seen_length = seen.norm();
          const double slack =
              kLengthShare * length + kEndPx * (sighted.pixel[0] + sighted.pixel[1]) / 2;
          if (seen_length > length + slack || seen_length < options_.min_partial * length) continue;
          TableYaw yaw;
          yaw.cos_yaw = model.dot(seen) / (length * seen_length);
          yaw.sin_yaw = (model.x() * seen.y() - model.y() * seen.x()) / (length * seen_length);
          Eigen::Vector2d positions[2];
          int n = 0;
          const Eigen::Vector2d from_p = at_p - Turned(yaw.cos_yaw, yaw.sin_yaw, p.head<2>());
          const Eigen::Vector2d from_q = at_q - Turned(yaw.cos_yaw, yaw.sin_yaw, q.head<2>());
          const bool whole = seen_length > length - slack;
          if (whole) {
            positions[n++] = 0.5 * (from_p + from_q);
          } else if (level) {
            // One end is hidden: a tilted edge would then not even give the yaw.
            if (sighted.corner[swapped ? 1 : 0]) positions[n++] = from_p;
            if (sighted.corner[swapped ? 0 : 1]) positions[n++] = from_q;
          }
          for (int i = 0; i < n; ++i) {
            yaw.position = positions[i];
            if (EdgesVisible(object,
                             views_[v].camera_from_scene * PlaceOnTable(part, yaw),
                             static_cast<int>(e),
                             static_cast<int>(e))) {
              votes.Add(yaw, whole ? 1.0 : kPartialWeight);
            }
          }
        }
      }
    }
  }
  return votes;
}

std::vector<TablePose> TableSearch::Find(int k, std::span<const double> base_m) const {
  const PreparedObject& object = *context_.objects[k];
  Pool pool(options_.min_quick);
  for (const StandingPart& on_plane : StandingParts(object)) {
    for (const double base : base_m) {
      if (IsStopRequested(context_.stop)) return {};
      StandingPart part = on_plane;
      part.table_from_object.t.z() += base;
      for (Eigen::Vector3d& v : part.vertices) v.z() += base;
      ScorePeaks(object,
                 part,
                 views_,
                 VoteByEdges(object, part).Peaks(options_.min_edge_votes, options_.peaks),
                 options_.known_reach_px,
                 &pool);
    }
  }
  // Fine texture supports anything within the first reach: settled poses tell truth from chance.
  RefineOptions settle;
  settle.iterations = 6;
  settle.start_reach_px = options_.settle_reach_px;
  std::vector<TablePose> out;
  for (const Pooled& p :
       Distinct(object, views_, InTurn(std::move(pool).Sorted()), options_.settled_per_object)) {
    const auto settled = RefineInScene(object, views_, p.table_from_object, settle);
    if (!settled) continue;
    const double quick = MeanQuick(object, views_, 1.0, *settled, options_.settled_reach_px, 0.0);
    out.push_back({scene_from_table_ * *settled, quick});
  }
  std::stable_sort(out.begin(), out.end(), [](const TablePose& a, const TablePose& b) {
    return a.quick > b.quick;
  });
  if (static_cast<int>(out.size()) > options_.kept_per_object) out.resize(options_.kept_per_object);
  return out;
}

}  // namespace horopter
