#include "server/vision/recognition/candidates/view_hypotheses.h"

#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <initializer_list>
#include <numbers>

#include "server/vision/recognition/scoring/circle_sighting.h"
#include "server/vision/recognition/scoring/pose_refine.h"

namespace horopter {
namespace {

constexpr double kMinCircleVisible = 0.25;  // of a circle: arcs of this length are looked at
constexpr double kSameVertex = 1e-3;        // diameters
// Support that clutter gives a pose by chance.
constexpr float kChanceScore = 0.35f;

// How little chance explains a quick score: small poses fit into texture and letters anywhere, and
// the samples that count grow with the part's size in the image.
float Significance(float quick_score, double radius_px) {
  return (quick_score - kChanceScore) * static_cast<float>(std::sqrt(radius_px));
}

double RadiusPx(const PreparedObject& object,
                const PinholeCamera& camera,
                const Rigid3& camera_from_object,
                double working_from_image) {
  const double depth = (camera_from_object * object.center).z();
  return object.radius_m * camera.focal_px * working_from_image / depth;
}

struct ScoredPose {
  float score;
  float significance;
  Rigid3 pose;
};

bool BySignificance(const ScoredPose& x, const ScoredPose& y) {
  return x.significance > y.significance;
}

// A bounded pool of the best poses of an object in a view.
class ViewPool {
 public:
  ViewPool(const PreparedObject& object,
           const ViewEvidence& view,
           const PinholeCamera& camera,
           const ViewHypothesisOptions& options)
      : object_(object),
        view_(view),
        camera_(camera),
        options_(options),
        limit_(static_cast<std::size_t>(options.pool)),
        threshold_(Significance(kMinScore, options.min_radius_px)) {}

  // Edges that the view must show to `min_visible` in the pose; it is dropped otherwise, or where
  // the part would be too large or small, or where its score is none of the best.
  void Offer(const Rigid3& pose, std::initializer_list<int> edges, double min_visible) {
    if ((pose * object_.center).z() <= object_.radius_m) return;
    const double radius_px = RadiusPx(object_, camera_, pose, view_.maps.working_from_image);
    if (radius_px < options_.min_radius_px || radius_px > options_.max_radius_px) return;
    const Eigen::Vector3d to_camera = pose.R.transpose() * -pose.t - object_.center;
    const int aspect = AspectIndex(to_camera.cast<float>());
    for (const int edge : edges) {
      if (object_.EdgeVisible(aspect, edge) < min_visible) return;
    }
    const float needed =
        std::max(kMinScore, kChanceScore + threshold_ / static_cast<float>(std::sqrt(radius_px)));
    const float score = QuickScore(object_,
                                   view_.maps,
                                   camera_,
                                   pose,
                                   options_.quick_reach_px,
                                   std::max(options_.give_up, 0.75f * needed));
    if (score < needed) return;
    pool_.push_back({score, Significance(score, radius_px), pose});
    if (pool_.size() < 2 * limit_) return;
    std::nth_element(pool_.begin(), pool_.begin() + limit_, pool_.end(), BySignificance);
    pool_.resize(limit_);
    threshold_ = std::max_element(pool_.begin(), pool_.end(), BySignificance)->significance;
  }

  std::vector<ScoredPose> Sorted() && {
    std::sort(pool_.begin(), pool_.end(), BySignificance);
    return std::move(pool_);
  }

 private:
  static constexpr float kMinScore = 0.3f;  // least quick score of a pose, however large
  const PreparedObject& object_;
  const ViewEvidence& view_;
  const PinholeCamera& camera_;
  const ViewHypothesisOptions& options_;
  std::size_t limit_;
  float threshold_;
  std::vector<ScoredPose> pool_;
};

void OfferPathPoses(const PreparedObject& object,
                    const std::vector<ImagePath>& paths,
                    const PinholeCamera& camera,
                    const StopRequested& stop,
                    ViewPool* pool) {
  for (const ImagePath& image_path : paths) {
    if (IsStopRequested(stop)) return;
    for (const int index : object.distinct_paths) {
      const VertexPath& path = object.paths[index];
      for (const bool reversed : {false, true}) {
        const PathPoses poses = PosesFromPath(object.model, path, reversed, camera, image_path);
        for (int k = 0; k < poses.count; ++k) {
          pool->Offer(poses.camera_from_object[k], {path.edge_ab, path.edge_bc}, kMinPathVisible);
        }
      }
    }
  }
}

// The circles that no symmetry of the object takes onto an earlier one.
std::vector<ModelCircle> DistinctCircles(const ObjectModel& model) {
  const double near = kSameVertex * model.diameter_m;
  std::vector<ModelCircle> distinct;
  for (const ModelCircle& c : CirclesOf(model)) {
    const auto same = [&](const ModelCircle& d, const Eigen::Vector3d& center) {
      return (d.center - center).norm() < near && std::abs(d.radius_m - c.radius_m) < near;
    };
    if (std::none_of(distinct.begin(), distinct.end(), [&](const ModelCircle& d) {
          return same(d, c.center) ||
                 std::any_of(model.symmetries.begin(),
                             model.symmetries.end(),
                             [&](const Rigid3& s) { return same(d, s * c.center); });
        })) {
      distinct.push_back(c);
    }
  }
  return distinct;
}

// Each arc compared with each circle of the part: two attitudes, the circle seen from either side,
// and turns about its axis.
void OfferCirclePoses(const PreparedObject& object,
                      const ViewEvidence& view,
                      const PinholeCamera& camera,
                      const ViewHypothesisOptions& options,
                      const StopRequested& stop,
                      ViewPool* pool) {
  const std::vector<ModelCircle> circles = DistinctCircles(object.model);
  if (circles.empty()) return;
  for (const EllipseArc& arc : view.features->arcs) {
    if (IsStopRequested(stop)) return;
    if (!(arc.sweep_rad >= options.min_sweep_rad)) continue;
    if (!(arc.semi_minor_px * view.maps.working_from_image >= options.min_minor_px)) continue;
    const std::optional<SightedCircle> sighted = SightCircle(camera, arc);
    if (!sighted) continue;
    for (const ModelCircle& circle : circles) {
      const Eigen::Vector3d center =
          sighted->ray / sighted->ray.z() * circle.radius_m / sighted->radius_over_depth;
      for (const Eigen::Vector3d& normal : sighted->normal) {
        for (const double side : {1.0, -1.0}) {
          for (int turn = 0; turn < options.turns; ++turn) {
            pool->Offer(
                PoseFromCircle(
                    circle, center, side * normal, 2 * std::numbers::pi * turn / options.turns),
                {circle.edge},
                kMinCircleVisible);
          }
        }
      }
    }
  }
}

// Whether none of those kept shows the object, up to its symmetries, in nearly the same pose.
bool IsNew(const PreparedObject& object,
           const std::vector<ViewHypothesis>& kept,
           const ViewHypothesis& h,
           double working_from_image,
           double distinct_px) {
  const auto near = [&](const ViewHypothesis& k, const Rigid3& pose) {
    return ProjectionDistance(
               object, k.camera, k.camera_from_object, h.camera, pose, working_from_image) <
           distinct_px;
  };
  return std::none_of(kept.begin(), kept.end(), [&](const ViewHypothesis& k) {
    return near(k, h.camera_from_object) ||
           std::any_of(object.model.symmetries.begin(),
                       object.model.symmetries.end(),
                       [&](const Rigid3& s) { return near(k, h.camera_from_object * s); });
  });
}

// With its own focal length; where that fails it stays as it is.
void RefineHypothesis(const PreparedObject& object,
                      const ViewEvidence& view,
                      const PinholeCamera& start,
                      const ViewHypothesisOptions& options,
                      ViewHypothesis* h) {
  RefineOptions refine = options.refine;
  refine.focal_prior_px = start.focal_px;
  const auto refined = RefineInView(object, view.maps, h->camera, h->camera_from_object, refine);
  if (!refined) return;
  h->camera = refined->camera;
  h->camera_from_object = refined->camera_from_object;
  h->score = QuickScore(
      object, view.maps, h->camera, h->camera_from_object, 0.5f * options.quick_reach_px, 0.0f);
}

}  // namespace

ViewHypotheses FindViewHypotheses(const PreparedObject& object,
                                  int object_index,
                                  const ViewEvidence& view,
                                  int view_index,
                                  const std::vector<ImagePath>& paths,
                                  const PinholeCamera& start,
                                  const ViewHypothesisOptions& options,
                                  const StopRequested& stop) {
  const double scale = view.maps.working_from_image;
  const auto is_new = [&](const std::vector<ViewHypothesis>& kept, const ViewHypothesis& h) {
    return IsNew(object, kept, h, scale, options.distinct_px);
  };
  std::vector<ViewHypothesis> distinct;
  ViewPool pool(object, view, start, options);
  OfferPathPoses(object, paths, start, stop, &pool);
  OfferCirclePoses(object, view, start, options, stop, &pool);
  for (const ScoredPose& pooled : std::move(pool).Sorted()) {
    if (static_cast<int>(distinct.size()) >= options.refined) break;
    ViewHypothesis h{object_index, view_index, start, pooled.pose, pooled.score};
    if (is_new(distinct, h)) distinct.push_back(h);
  }

  ViewHypotheses out;
  for (ViewHypothesis& h : distinct) {
    if (IsStopRequested(stop)) return {};
    RefineHypothesis(object, view, start, options, &h);
  }
  const auto significance = [&](const ViewHypothesis& h) {
    return Significance(static_cast<float>(h.score),
                        RadiusPx(object, h.camera, h.camera_from_object, scale));
  };
  std::stable_sort(distinct.begin(), distinct.end(), [&](const auto& x, const auto& y) {
    return significance(x) > significance(y);
  });
  for (const ViewHypothesis& h : distinct) {
    if (is_new(out.pool, h)) out.pool.push_back(h);
  }

  VerifyScratch scratch;
  for (const ViewHypothesis& h : out.pool) {
    if (static_cast<int>(out.best.size()) >= options.verified || IsStopRequested(stop)) break;
    out.best.push_back(h);
    out.best.back().score =
        ViewScore(VerifyPose(object, view, h.camera, h.camera_from_object, nullptr, &scratch));
  }
  std::stable_sort(out.best.begin(), out.best.end(), [](const auto& x, const auto& y) {
    return x.score > y.score;
  });
  return out;
}

}  // namespace horopter
