#include "server/vision/recognition/view_hypotheses.h"

#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>

#include "server/vision/recognition/pose_refine.h"

namespace horopter {
namespace {

constexpr int kPerspectiveIterations = 4;
// A path edge must be visible to this share in the pose's aspect.
constexpr double kMinPathVisible = 0.45;
// Ends that are no junction make a path less likely to end at a model vertex.
constexpr double kFreeEndFactor = 0.55;

// A corner of two edges on the table is texture or shadow more often than the foot of a part.
constexpr double kOnPlaneFactor = 0.4;

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

struct PooledPose {
  float score;
  float significance;
  Rigid3 pose;
};

bool BySignificance(const PooledPose& x, const PooledPose& y) {
  return x.significance > y.significance;
}

// Rotation that takes the ray of a pixel to the optical axis.
Eigen::Matrix3d AxisFromRay(const Eigen::Vector3d& ray) {
  return Eigen::Quaterniond::FromTwoVectors(ray, Eigen::Vector3d::UnitZ()).toRotationMatrix();
}

Eigen::Vector3d Ray(const PinholeCamera& camera, const Eigen::Vector2d& pixel) {
  return {
      (pixel.x() - camera.cx) / camera.focal_px, (pixel.y() - camera.cy) / camera.focal_px, 1.0};
}

// Collects poses over the image and model paths into a bounded pool of the best.
std::vector<PooledPose> CollectPool(const PreparedObject& object,
                                    const ViewEvidence& view,
                                    const std::vector<ImagePath>& paths,
                                    const PinholeCamera& camera,
                                    const ViewHypothesisOptions& options,
                                    const StopRequested& stop) {
  std::vector<PooledPose> pool;
  const double scale = view.maps.working_from_image;
  constexpr float kMinScore = 0.3f;
  float threshold = Significance(kMinScore, options.min_radius_px);
  const std::size_t limit = static_cast<std::size_t>(options.pool) * 2;
  for (const ImagePath& image_path : paths) {
    if (IsStopRequested(stop)) return {};
    for (const int index : object.distinct_paths) {
      const VertexPath& path = object.paths[index];
      for (int reversed = 0; reversed < 2; ++reversed) {
        const PathPoses poses =
            PosesFromPath(object.model, path, reversed != 0, camera, image_path);
        for (int k = 0; k < poses.count; ++k) {
          const Rigid3& pose = poses.camera_from_object[k];
          if ((pose * object.center).z() <= object.radius_m) continue;
          const double radius_px = RadiusPx(object, camera, pose, scale);
          if (radius_px < options.min_radius_px || radius_px > options.max_radius_px) continue;
          const Eigen::Vector3d to_camera = pose.R.transpose() * -pose.t - object.center;
          const int aspect = AspectIndex(to_camera.cast<float>());
          if (object.EdgeVisible(aspect, path.edge_ab) < kMinPathVisible ||
              object.EdgeVisible(aspect, path.edge_bc) < kMinPathVisible) {
            continue;
          }
          const float needed = std::max(
              kMinScore, kChanceScore + threshold / static_cast<float>(std::sqrt(radius_px)));
          const float score = QuickScore(object,
                                         view.maps,
                                         camera,
                                         pose,
                                         options.quick_reach_px,
                                         std::max(options.give_up, 0.75f * needed));
          if (score < needed) continue;
          pool.push_back({score, Significance(score, radius_px), pose});
          if (pool.size() >= limit) {
            std::nth_element(pool.begin(), pool.begin() + options.pool, pool.end(), BySignificance);
            pool.resize(options.pool);
            threshold = std::max_element(pool.begin(), pool.end(), BySignificance)->significance;
          }
        }
      }
    }
  }
  std::sort(pool.begin(), pool.end(), BySignificance);
  return pool;
}

}  // namespace

std::vector<ImagePath> FindImagePaths(const ImageFeatures& features,
                                      const std::vector<bool>& on_plane,
                                      double working_from_image,
                                      int max_paths) {
  std::vector<std::vector<int>> junction_at(features.segments.size(), std::vector<int>(2, -1));
  for (int j = 0; j < static_cast<int>(features.junctions.size()); ++j) {
    for (const Junction::End& end : features.junctions[j].ends) {
      junction_at[end.segment][end.at_start ? 0 : 1] = j;
    }
  }
  auto other_end = [&](const Junction::End& end, bool* is_junction) {
    const Segment& s = features.segments[end.segment];
    const int j = junction_at[end.segment][end.at_start ? 1 : 0];
    *is_junction = j >= 0;
    if (j >= 0) return features.junctions[j].point;
    return end.at_start ? s.end : s.start;
  };
  std::vector<ImagePath> paths;
  for (const Junction& junction : features.junctions) {
    for (std::size_t i = 0; i < junction.ends.size(); ++i) {
      if (features.segments[junction.ends[i].segment].in_texture) continue;
      for (std::size_t k = i + 1; k < junction.ends.size(); ++k) {
        if (features.segments[junction.ends[k].segment].in_texture) continue;
        if (junction.ends[i].segment == junction.ends[k].segment) continue;
        bool a_junction, c_junction;
        ImagePath path;
        path.b = junction.point;
        path.segment_ab = junction.ends[i].segment;
        path.segment_bc = junction.ends[k].segment;
        path.a = other_end(junction.ends[i], &a_junction);
        path.c = other_end(junction.ends[k], &c_junction);
        const double la = (path.a - path.b).norm() * working_from_image;
        const double lc = (path.c - path.b).norm() * working_from_image;
        if (la < 6 || lc < 6) continue;
        path.rank = std::sqrt(la * lc) * (a_junction ? 1.0 : kFreeEndFactor) *
                    (c_junction ? 1.0 : kFreeEndFactor);
        if (!on_plane.empty() && on_plane[junction.ends[i].segment] &&
            on_plane[junction.ends[k].segment]) {
          path.rank *= kOnPlaneFactor;
        }
        paths.push_back(path);
      }
    }
  }
  std::stable_sort(
      paths.begin(), paths.end(), [](const auto& x, const auto& y) { return x.rank > y.rank; });
  if (static_cast<int>(paths.size()) > max_paths) paths.resize(max_paths);
  return paths;
}

PathPoses PosesFromPath(const ObjectModel& model,
                        const VertexPath& path,
                        bool reversed,
                        const PinholeCamera& camera,
                        const ImagePath& image_path) {
  PathPoses out;
  // In a camera turned so that b lies on its axis: w (R U)_xy = a' (1 + w (R U)_z), w = 1 / depth
  // of b.
  const Eigen::Matrix3d axis_from_camera = AxisFromRay(Ray(camera, image_path.b));
  auto turned = [&](const Eigen::Vector2d& pixel) -> Eigen::Vector2d {
    const Eigen::Vector3d r = axis_from_camera * Ray(camera, pixel);
    return r.head<2>() / r.z();
  };
  const Eigen::Vector2d p1 = turned(reversed ? image_path.c : image_path.a);
  const Eigen::Vector2d p2 = turned(reversed ? image_path.a : image_path.c);
  const double uu = path.length_ab * path.length_ab;
  const double vv = path.length_bc * path.length_bc;
  const double uv = 0.5 * (uu + vv - path.length_ac * path.length_ac);
  const double quadratic = uu * vv - uv * uv;
  if (!(quadratic > 1e-12 * uu * vv)) return out;

  for (int sign = -1; sign <= 1; sign += 2) {
    double e1 = 0, e2 = 0, w = 0, h1 = 0, h2 = 0;
    Eigen::Vector2d q1 = p1, q2 = p2;
    for (int iteration = 0; iteration < kPerspectiveIterations; ++iteration) {
      q1 = p1 * (1 + e1);
      q2 = p2 * (1 + e2);
      const double b = uu * q2.squaredNorm() + vv * q1.squaredNorm() - 2 * uv * q1.dot(q2);
      const double cross = q1.x() * q2.y() - q1.y() * q2.x();
      const double root = std::sqrt(std::max(0.0, b * b - 4 * quadratic * cross * cross));
      const double w2 = (b + root) / (2 * quadratic);
      w = std::sqrt(w2);
      h1 = sign * std::sqrt(std::max(0.0, w2 * uu - q1.squaredNorm()));
      h2 = std::sqrt(std::max(0.0, w2 * vv - q2.squaredNorm()));
      const double product = w2 * uv - q1.dot(q2);  // h1 h2
      if ((h1 < 0) != (product < 0)) h2 = -h2;
      if (std::abs(h1) < 1e-12) h2 = sign * std::abs(h2);
      e1 = h1;
      e2 = h2;
    }
    if (!(w > 1e-9) || e1 < -0.8 || e2 < -0.8) continue;
    const Eigen::Vector3d u(q1.x() / w, q1.y() / w, h1 / w);
    const Eigen::Vector3d v(q2.x() / w, q2.y() / w, h2 / w);
    Eigen::Matrix3d image_frame;
    image_frame << u, v, u.cross(v);
    const Eigen::Matrix3d R = axis_from_camera.transpose() * (image_frame * path.inverse_frame);
    if (!R.allFinite()) continue;
    const Eigen::Vector3d b_in_camera = axis_from_camera.transpose() * Eigen::Vector3d(0, 0, 1 / w);
    out.camera_from_object[out.count++] = {R, b_in_camera - R * model.vertices[path.b]};
  }
  return out;
}

ViewHypotheses FindViewHypotheses(const PreparedObject& object,
                                  int object_index,
                                  const ViewEvidence& view,
                                  int view_index,
                                  const std::vector<ImagePath>& paths,
                                  const PinholeCamera& start,
                                  const ViewHypothesisOptions& options,
                                  const StopRequested& stop) {
  const double scale = view.maps.working_from_image;
  auto is_new = [&](const std::vector<ViewHypothesis>& kept, const ViewHypothesis& h) {
    const auto near = [&](const ViewHypothesis& k, const Rigid3& pose) {
      return ProjectionDistance(object, k.camera, k.camera_from_object, h.camera, pose, scale) <
             options.distinct_px;
    };
    return std::none_of(kept.begin(), kept.end(), [&](const ViewHypothesis& k) {
      return near(k, h.camera_from_object) ||
             std::any_of(object.model.symmetries.begin(),
                         object.model.symmetries.end(),
                         [&](const Rigid3& s) { return near(k, h.camera_from_object * s); });
    });
  };

  std::vector<ViewHypothesis> distinct;
  for (const PooledPose& pooled : CollectPool(object, view, paths, start, options, stop)) {
    if (static_cast<int>(distinct.size()) >= options.refined) break;
    ViewHypothesis h{object_index, view_index, start, pooled.pose, pooled.score};
    if (is_new(distinct, h)) distinct.push_back(h);
  }

  ViewHypotheses out;
  RefineOptions refine;
  refine.focal_log_sigma = options.focal_log_sigma;
  refine.focal_prior_px = start.focal_px;
  for (ViewHypothesis& h : distinct) {
    if (IsStopRequested(stop)) return {};
    const auto refined = RefineInView(object, view.maps, h.camera, h.camera_from_object, refine);
    if (!refined) continue;
    h.camera = refined->camera;
    h.camera_from_object = refined->camera_from_object;
    h.score = QuickScore(
        object, view.maps, h.camera, h.camera_from_object, 0.5f * options.quick_reach_px, 0.0f);
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
