#include "server/vision/recognition/initialization/view_linking.h"

#include <Eigen/Dense>
#include <algorithm>
#include <cmath>
#include <functional>
#include <utility>

#include "server/base/parallel_for.h"
#include "server/vision/recognition/scoring/pose_refine.h"

namespace horopter {
namespace {

constexpr int kHypothesesPerView = 18;  // best first; for time
constexpr double kMinViewScore = 0.40;  // of one view; below it nothing is started from
// A stable pose needs the camera above its plane by this much (sine of the elevation).
constexpr double kMinElevationSine = 0.10;
// Footprint transfer error (working pixels) at which two views' hypotheses agree with the plane.
constexpr double kFootprintPx = 9.0;
constexpr int kCandidatesPerView = 6;
// Score of a part in one view below which it is not shown: half hidden parts at their true place
// reach it, parts projected to a wrong place do not.
constexpr double kShownScore = 0.3;

constexpr double kMinCandidateScore = 0.30;  // of one view, to join a hypothesis of another one
// Transferred alternatives scoring above this speak for a relative camera pose.
constexpr double kTransferScore = 0.45;
constexpr double kTransferWeight = 0.4;
constexpr double kMinLinkScore = 0.35;

struct Link {
  PinholeCamera camera;
  Rigid3 camera_from_object;
  double score = -1.0;
};

double MaxFootprintError(const std::vector<Eigen::Vector3d>& footprint,
                         const Link& a,
                         const Eigen::Matrix3d& b_from_a,
                         const PinholeCamera& camera_b,
                         const Rigid3& pose_b) {
  double worst = 0.0;
  for (const auto& x : footprint) {
    const Eigen::Vector3d pa = a.camera_from_object * x, pb = pose_b * x;
    if (pa.z() <= 0 || pb.z() <= 0) return 1e9;
    const Eigen::Vector3d moved = b_from_a * Project(a.camera, pa).homogeneous();
    worst = std::max(worst, (moved.hnormalized() - Project(camera_b, pb)).norm());
  }
  return worst;
}

class Linker {
 public:
  Linker(const JointContext& context, const HypothesisTable& hypotheses, int object)
      : context_(context), hypotheses_(hypotheses), object_index_(object) {}

  // Links via the plane for one stable pose; empty links where a view does not follow.
  std::vector<Link> ThroughPlane(const ViewHypothesis& start,
                                 const StablePose& stable,
                                 VerifyScratch* scratch) {
    std::vector<Link> links(context_.views.size());
    links[start.view] = {start.camera, start.camera_from_object, start.score};
    const std::vector<Eigen::Vector3d> footprint = Footprint(object(), stable);
    if (footprint.size() < 3) return links;
    for (int j = 0; j < static_cast<int>(links.size()); ++j) {
      if (j == start.view) continue;
      const auto transfer = PlaneTransfer(*context_.matching, start.view, j);
      if (!transfer) continue;
      const double limit = kFootprintPx / context_.views[j].maps.working_from_image;
      for (const ViewHypothesis& h : Candidates(j)) {
        ForEachSymmetry(h.camera_from_object, [&](const Rigid3& pose) {
          if (h.score > links[j].score &&
              MaxFootprintError(footprint, links[start.view], *transfer, h.camera, pose) < limit) {
            links[j] = {h.camera, pose, h.score};
          }
        });
      }
      if (links[j].score < 0)
        links[j] = FollowPlane(links[start.view], stable, *transfer, j, scratch);
      if (links[j].score < kMinLinkScore) links[j] = {};
    }
    return links;
  }

  // Fills the views that have no link with that view's own hypotheses of the object; the other
  // objects' hypotheses of its view, carried over, decide between them.
  void ThroughHypotheses(const ViewHypothesis& start, std::vector<Link>* links) {
    for (int j = 0; j < static_cast<int>(links->size()); ++j) {
      if ((*links)[j].score >= 0) continue;
      double best = -1.0;
      for (const ViewHypothesis& h : Candidates(j)) {
        ForEachSymmetry(h.camera_from_object, [&](const Rigid3& pose) {
          const double vote = h.score + kTransferWeight * TransferVotes(start, j, h.camera, pose);
          if (h.score >= kMinLinkScore && vote > best) {
            best = vote;
            (*links)[j] = {h.camera, pose, h.score};
          }
        });
      }
    }
  }

 private:
  const PreparedObject& object() const { return *context_.objects[object_index_]; }

  std::span<const ViewHypothesis> Candidates(int view) const {
    const auto& best = hypotheses_[view][object_index_].best;
    std::size_t n = 0;
    while (n < best.size() && n < kCandidatesPerView && best[n].score >= kMinCandidateScore) ++n;
    return std::span(best.data(), n);
  }

  template <typename F>
  void ForEachSymmetry(const Rigid3& pose, F f) const {
    f(pose);
    for (const Rigid3& s : object().model.symmetries) f(pose * s);
  }

  Link FollowPlane(const Link& start,
                   const StablePose& stable,
                   const Eigen::Matrix3d& transfer,
                   int view,
                   VerifyScratch* scratch) const {
    Rigid3 object_from_plane;
    object_from_plane.R.col(2) = stable.up;
    object_from_plane.R.col(0) = stable.up.unitOrthogonal();
    object_from_plane.R.col(1) = stable.up.cross(object_from_plane.R.col(0));
    object_from_plane.t =
        object().center - stable.up * (stable.up.dot(object().center) + stable.height_m);
    const Rigid3 camera_from_plane = start.camera_from_object * object_from_plane;
    Eigen::Matrix3d M;
    M << camera_from_plane.R.col(0), camera_from_plane.R.col(1), camera_from_plane.t;
    const auto plane =
        CameraFromPlane(transfer * start.camera.K() * M, context_.start_cameras[view]);
    if (!plane) return {};
    RefineOptions refine = context_.options.search.linking;
    refine.focal_log_sigma = context_.focal_log_sigma[view];
    refine.focal_prior_px = context_.start_cameras[view].focal_px;
    const auto refined = RefineInView(object(),
                                      context_.views[view].maps,
                                      plane->camera,
                                      plane->camera_from_plane * object_from_plane.Inverse(),
                                      refine);
    if (!refined) return {};
    const double score = ViewScore(VerifyPose(object(),
                                              context_.views[view],
                                              refined->camera,
                                              refined->camera_from_object,
                                              nullptr,
                                              scratch));
    return {refined->camera, refined->camera_from_object, score};
  }

  double TransferVotes(const ViewHypothesis& start,
                       int view,
                       const PinholeCamera& camera,
                       const Rigid3& pose) const {
    const Rigid3 j_from_initial = pose * start.camera_from_object.Inverse();
    double votes = 0.0;
    for (std::size_t k = 0; k < context_.objects.size(); ++k) {
      if (static_cast<int>(k) == object_index_) continue;
      double best = 0.0;
      const auto& alternatives = hypotheses_[start.view][k].best;
      for (std::size_t i = 0; i < alternatives.size() && i < 3 && alternatives[i].score > 0.5;
           ++i) {
        const Rigid3 here = WithFocal(alternatives[i].camera_from_object,
                                      alternatives[i].camera.focal_px,
                                      start.camera.focal_px);
        const float s = QuickScore(*context_.objects[k],
                                   context_.views[view].maps,
                                   camera,
                                   j_from_initial * here,
                                   8.0f,
                                   0.3f);
        best = std::max(best, static_cast<double>(s));
      }
      votes += std::max(0.0, best - kTransferScore);
    }
    return votes;
  }

  const JointContext& context_;
  const HypothesisTable& hypotheses_;
  int object_index_;
};

SceneModel ToScene(const JointContext& context,
                   int object,
                   const std::vector<Link>& links,
                   VerifyScratch* scratch) {
  SceneModel scene;
  scene.views.resize(links.size());
  for (std::size_t v = 0; v < links.size(); ++v) {
    if (links[v].score < 0) continue;
    scene.views[v] = CalibratedCamera{links[v].camera, links[v].camera_from_object};
  }
  PlacedObject placed;
  placed.object = object;
  EvaluatePlacement(context, scene.views, {}, scratch, &placed);
  scene.objects.push_back(placed);
  scene.description_gain = placed.description_gain;
  return scene;
}

struct ViewGain {
  double sum = 0.0;  // over the scene's objects
  int shown = 0;     // objects that the image shows where the camera puts them

  // A wrong camera shows one part, most likely in another pose, and loses the others.
  bool Convinces(const SceneModel& scene) const {
    return sum > 0 && 2 * shown >= static_cast<int>(scene.objects.size());
  }
};

// Description-length gain of the scene's objects in one view under a camera.
ViewGain GainOfView(const JointContext& context,
                    const SceneModel& scene,
                    int v,
                    const CalibratedCamera& view,
                    VerifyScratch* scratch) {
  ViewGain gain;
  for (const PlacedObject& o : scene.objects) {
    const EdgeSupport support = VerifyPose(*context.objects[o.object],
                                           context.views[v],
                                           view.camera,
                                           view.camera_from_scene * o.scene_from_object,
                                           nullptr,
                                           scratch);
    gain.sum += DescriptionGain(support);
    gain.shown += support.visible > 0 && ViewScore(support) >= kShownScore;
  }
  return gain;
}

// The best few of each view, of all objects.
std::vector<ViewHypothesis> BestViewHypotheses(const HypothesisTable& hypotheses) {
  std::vector<ViewHypothesis> starts;
  for (const auto& view : hypotheses) {
    std::vector<ViewHypothesis> of_view;
    for (const ViewHypotheses& object : view) {
      for (std::size_t i = 0; i < object.best.size() && i < 3; ++i) {
        if (object.best[i].score >= kMinViewScore) of_view.push_back(object.best[i]);
      }
    }
    std::stable_sort(of_view.begin(), of_view.end(), [](const auto& x, const auto& y) {
      return x.score > y.score;
    });
    if (of_view.size() > kHypothesesPerView) of_view.resize(kHypothesesPerView);
    starts.insert(starts.end(), of_view.begin(), of_view.end());
  }
  return starts;
}

// The scenes, at most two, that one hypothesis of a view gives; none where a plane links the view
// and it was not asked for, or the other way round.
std::vector<SceneModel> ScenesFrom(const JointContext& context,
                                   const HypothesisTable& hypotheses,
                                   const ViewHypothesis& start,
                                   bool through_plane) {
  std::vector<SceneModel> scenes;
  const PreparedObject& object = *context.objects[start.object];
  Linker linker(context, hypotheses, start.object);
  VerifyScratch scratch;
  std::vector<std::vector<Link>> alternatives;
  bool has_mate = false;
  for (int j = 0; j < static_cast<int>(context.views.size()); ++j) {
    has_mate = has_mate ||
               (j != start.view && PlaneTransfer(*context.matching, start.view, j).has_value());
  }
  if (has_mate != through_plane) return {};
  const Eigen::Vector3d to_camera =
      (start.camera_from_object.R.transpose() * -start.camera_from_object.t - object.center)
          .normalized();
  for (const StablePose& stable : object.stable_poses) {
    if (!has_mate || stable.up.dot(to_camera) < kMinElevationSine) continue;
    std::vector<Link> links = linker.ThroughPlane(start, stable, &scratch);
    const auto linked =
        std::count_if(links.begin(), links.end(), [](const Link& l) { return l.score >= 0; });
    if (linked >= 2) alternatives.push_back(std::move(links));
  }
  if (!has_mate) {
    std::vector<Link> alone(context.views.size());
    alone[start.view] = {start.camera, start.camera_from_object, start.score};
    linker.ThroughHypotheses(start, &alone);
    alternatives.push_back(std::move(alone));
  }
  for (const std::vector<Link>& links : alternatives) {
    scenes.push_back(ToScene(context, start.object, links, &scratch));
  }
  std::stable_sort(scenes.begin(), scenes.end(), [](const auto& x, const auto& y) {
    return x.description_gain > y.description_gain;
  });
  if (scenes.size() > 2) scenes.resize(2);
  return scenes;
}

}  // namespace

std::optional<Eigen::Matrix3d> PlaneTransfer(const MatchingResult& matching, int a, int b) {
  const int n = static_cast<int>(matching.component.size());
  if (a >= n || b >= n || matching.component[a] < 0 ||
      matching.component[a] != matching.component[b]) {
    return std::nullopt;
  }
  return Eigen::Matrix3d(matching.view_from_plane[b] * matching.view_from_plane[a].inverse());
}

std::optional<PlaneCamera> CameraFromPlane(const Eigen::Matrix3d& M, const PinholeCamera& start) {
  Eigen::Matrix3d centered = M;
  centered.row(0) -= start.cx * M.row(2);
  centered.row(1) -= start.cy * M.row(2);
  // With q = 1/f^2 the axes are orthogonal and of equal length: two equations a q + b = 0.
  const Eigen::Vector3d m1 = centered.col(0), m2 = centered.col(1);
  const double a1 = m1.head<2>().dot(m2.head<2>()), b1 = m1.z() * m2.z();
  const double a2 = m1.head<2>().squaredNorm() - m2.head<2>().squaredNorm(),
               b2 = m1.z() * m1.z() - m2.z() * m2.z();
  const double q = -(a1 * b1 + a2 * b2) / (a1 * a1 + a2 * a2);
  PlaneCamera out{start, {}};
  if (q > 0) {
    const double f = 1.0 / std::sqrt(q);
    if (f > start.focal_px / 1.5 && f < start.focal_px * 1.5) out.camera.focal_px = f;
  }
  Eigen::Matrix3d E = centered;
  E.topRows<2>() /= out.camera.focal_px;
  const double scale = 0.5 * (E.col(0).norm() + E.col(1).norm());
  if (!(scale > 0) || !E.allFinite()) return std::nullopt;
  E /= E(2, 2) < 0 ? -scale : scale;
  Eigen::Matrix3d R;
  R << E.col(0), E.col(1), E.col(0).cross(E.col(1));
  const Eigen::JacobiSVD<Eigen::Matrix3d> svd(R, Eigen::ComputeFullU | Eigen::ComputeFullV);
  R = svd.matrixU() * svd.matrixV().transpose();
  if (R.determinant() < 0) return std::nullopt;
  out.camera_from_plane = {R, E.col(2)};
  return out;
}

std::vector<SceneModel> LinkedInitialScenes(const JointContext& context,
                                            const HypothesisTable& hypotheses,
                                            bool through_plane) {
  const std::vector<ViewHypothesis> starts = BestViewHypotheses(hypotheses);
  std::vector<std::vector<SceneModel>> scenes(starts.size());
  ParallelFor(static_cast<int>(starts.size()), context.options.threads, [&](int i) {
    if (!IsStopRequested(context.stop))
      scenes[i] = ScenesFrom(context, hypotheses, starts[i], through_plane);
  });
  std::vector<SceneModel> out;
  for (auto& list : scenes) {
    for (SceneModel& s : list) out.push_back(std::move(s));
  }
  std::stable_sort(out.begin(), out.end(), [](const auto& x, const auto& y) {
    return x.description_gain > y.description_gain;
  });
  return out;
}

bool LinkedByPlane(const JointContext& context, const SceneModel& scene, int v) {
  for (int other = 0; other < static_cast<int>(scene.views.size()); ++other) {
    if (other != v && scene.views[other] && PlaneTransfer(*context.matching, v, other)) return true;
  }
  return false;
}

int DropContradictedViews(const JointContext& context, SceneModel* scene) {
  int dropped = 0;
  VerifyScratch scratch;
  const int views = static_cast<int>(scene->views.size());
  for (int v = 0; v < views && scene->registered() > 2; ++v) {
    // The plane's texture links a view surer than a part that others may hide in it.
    if (LinkedByPlane(context, *scene, v)) continue;
    if (!scene->views[v] ||
        GainOfView(context, *scene, v, *scene->views[v], &scratch).Convinces(*scene)) {
      continue;
    }
    scene->views[v].reset();
    ++dropped;
  }
  return dropped;
}

int RegisterMissingViews(const JointContext& context,
                         const HypothesisTable& table,
                         SceneModel* scene) {
  int added = 0;
  VerifyScratch scratch;
  for (int v = 0; v < static_cast<int>(scene->views.size()); ++v) {
    if (scene->views[v]) continue;
    std::optional<CalibratedCamera> best;
    double best_gain = 0.0;
    for (const PlacedObject& placed : scene->objects) {
      const auto& hypotheses = table[v][placed.object].best;
      for (std::size_t i = 0; i < hypotheses.size() && i < kCandidatesPerView; ++i) {
        std::vector<Rigid3> poses{hypotheses[i].camera_from_object};
        for (const Rigid3& s : context.objects[placed.object]->model.symmetries)
          poses.push_back(poses[0] * s);
        for (const Rigid3& pose : poses) {
          const CalibratedCamera view{hypotheses[i].camera,
                                      pose * placed.scene_from_object.Inverse()};
          const ViewGain gain = GainOfView(context, *scene, v, view, &scratch);
          if (gain.Convinces(*scene) && gain.sum > best_gain) {
            best_gain = gain.sum;
            best = view;
          }
        }
      }
    }
    if (!best) continue;
    scene->views[v] = best;
    ++added;
  }
  return added;
}

}  // namespace horopter
