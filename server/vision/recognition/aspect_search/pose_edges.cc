#include "server/vision/recognition/aspect_search/pose_edges.h"

#include <Eigen/Cholesky>
#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>

#include "server/vision/recognition/aspect_search/near_plane.h"

namespace horopter {
namespace {

constexpr double kMatchTurnRad = 0.5;     // between the directions of model and image edge
constexpr double kResidualSigmaPx = 1.0;  // of a good match, working pixels

using Vector7d = Eigen::Matrix<double, 7, 1>;
using Matrix7d = Eigen::Matrix<double, 7, 7>;

constexpr double kLeastSearchPx = 2.0;         // working px: a search narrows no further; chosen
constexpr int kLeastMatches = 8;               // the seven unknowns and one more
constexpr double kLastSteps[] = {1e-4, 0.02};  // rad, px: smaller steps end the iteration

// A projected edge point: working pixels.
struct Projected {
  Eigen::Vector3d in_camera;
  Eigen::Vector2d pixel;
  Eigen::Vector2d normal;
};

bool ProjectPoint(const PinholeCamera& camera,
                  const Rigid3& pose,
                  const ModelEdgePoint& p,
                  Projected* out) {
  out->in_camera = pose * p.point.cast<double>();
  if (out->in_camera.z() < kNearM) return false;
  out->pixel = Project(camera, out->in_camera);
  const Eigen::Vector3d d = pose.R * p.direction.cast<double>();
  // Derivative of x / z along the edge, up to scale; the lens turns it by less than the tolerance.
  const Eigen::Vector2d tangent(d.x() * out->in_camera.z() - out->in_camera.x() * d.z(),
                                d.y() * out->in_camera.z() - out->in_camera.y() * d.z());
  const double length = tangent.norm();
  if (!(length > 1e-12)) return false;
  out->normal = {-tangent.y() / length, tangent.x() / length};
  return true;
}

// Index of the nearest image edge along the normal whose normal is alike, -1: none.
int NearestAlong(const AspectImage& image, const Projected& p, double search, float least_cosine) {
  const Eigen::Vector2f normal = p.normal.cast<float>();
  // The maps say at once when nothing is near.
  const int bin = AspectBin(-normal.y(), normal.x());
  const float x = static_cast<float>(p.pixel.x()), y = static_cast<float>(p.pixel.y());
  if (image.DistanceAt(x, y, bin) > search * AspectImage::kDistanceScale) return -1;
  const bool steep = std::abs(normal.y()) > std::abs(normal.x());
  const int steps = static_cast<int>(std::ceil(search)) + 1;
  int best = -1;
  float best_offset = static_cast<float>(search);
  const auto look = [&](int cx, int cy) {
    if (cx < 0 || cy < 0 || cx >= image.width || cy >= image.height) return;
    const std::int32_t e = image.edge_at[image.Cell(cx, cy)];
    if (e < 0 || std::abs(image.edges[e].normal.dot(normal)) < least_cosine) return;
    const float offset = std::abs(normal.dot(image.edges[e].point - Eigen::Vector2f(x, y)));
    if (offset < best_offset) {
      best_offset = offset;
      best = e;
    }
  };
  for (int k = 0; k <= steps && static_cast<float>(k) < best_offset + 1.5f; ++k) {
    for (int sign = -1; sign <= (k == 0 ? -1 : 1); sign += 2) {
      const float px = x + static_cast<float>(sign * k) * normal.x();
      const float py = y + static_cast<float>(sign * k) * normal.y();
      const int cx = static_cast<int>(std::floor(px + 0.5f));
      const int cy = static_cast<int>(std::floor(py + 0.5f));
      look(cx, cy);
      // A line of cells can slip through a diagonal of edge cells.
      if (steep) {
        look(cx + (px > static_cast<float>(cx) ? 1 : -1), cy);
      } else {
        look(cx, cy + (py > static_cast<float>(cy) ? 1 : -1));
      }
    }
  }
  return best;
}

// Tukey's biweight.
double RobustWeight(double residual, double reach) {
  const double u = residual / reach;
  const double v = 1.0 - u * u;
  return v > 0 ? v * v : 0.0;
}

struct Normal {
  Matrix7d A = Matrix7d::Zero();
  Vector7d b = Vector7d::Zero();
  double squares = 0.0, weights = 0.0;
  int matches = 0;
};

// Parameters: rotation about the centre (3), image shift as a share of the depth (2), log depth,
// log focal length (the depth follows it, so the size stays).
void AddMatch(const PinholeCamera& camera,
              const Eigen::Vector3d& center_in_camera,
              const Projected& p,
              double residual,
              double weight,
              Normal* normal) {
  const double z = p.in_camera.z();
  const double f = camera.focal_px;
  // Row of n' d(pixel) / d(point in camera).
  const Eigen::RowVector3d row(
      p.normal.x() * f / z,
      p.normal.y() * f / z,
      -f * (p.normal.x() * p.in_camera.x() + p.normal.y() * p.in_camera.y()) / (z * z));
  const Eigen::Vector3d arm = p.in_camera - center_in_camera;
  Vector7d j;
  j.head<3>() = arm.cross(row.transpose());  // d(w x arm)
  j[3] = row[0] * center_in_camera.z();
  j[4] = row[1] * center_in_camera.z();
  j[5] = row.dot(center_in_camera);
  j[6] = p.normal.dot(p.pixel - Eigen::Vector2d(camera.cx, camera.cy)) + j[5];
  normal->A.selfadjointView<Eigen::Lower>().rankUpdate(j, weight);
  normal->b += weight * residual * j;
  normal->squares += weight * residual * residual;
  normal->weights += weight;
  ++normal->matches;
}

// One step; width_px: of the whole image, working pixels. Returns false when it was too small to
// matter or could not be made.
bool Step(const PoseEdgeOptions& options,
          const Eigen::Vector3d& center,
          Normal normal,
          double width_px,
          PinholeCamera* camera,
          Rigid3* pose) {
  const double sigma2 = kResidualSigmaPx * kResidualSigmaPx;
  normal.A /= sigma2;
  normal.b /= sigma2;
  // Of hundreds of neighbouring points few are independent.
  constexpr double kIndependentShare = 0.1;
  normal.A *= kIndependentShare;
  normal.b *= kIndependentShare;
  if (options.refine_focal) {
    const double prior = 1.0 / (options.log_focal_sigma * options.log_focal_sigma);
    normal.A(6, 6) += prior;
    normal.b[6] += prior * std::log(options.nominal_focal_share * width_px / camera->focal_px);
  } else {
    normal.A.row(6).setZero();
    normal.A.col(6).setZero();
    normal.A(6, 6) = 1.0;
    normal.b[6] = 0.0;
  }
  // Directions that no edge holds stay: a sphere may turn.
  normal.A.diagonal().head<3>().array() += 1.0;
  normal.A.diagonal().segment<3>(3).array() += 1.0;
  Vector7d step = normal.A.selfadjointView<Eigen::Lower>().ldlt().solve(normal.b);
  if (!step.allFinite()) return false;
  const double largest = std::max(step.head<3>().norm() / 0.25, step.tail<4>().norm() / 0.25);
  if (largest > 1.0) step /= largest;
  const Eigen::Vector3d old_center = *pose * center;
  Eigen::Vector3d new_center = old_center;
  new_center.x() += step[3] * old_center.z();
  new_center.y() += step[4] * old_center.z();
  new_center *= std::exp(step[5] + step[6]);
  camera->focal_px *= std::exp(step[6]);
  const double angle = step.head<3>().norm();
  if (angle > 1e-12) {
    pose->R = Eigen::AngleAxisd(angle, step.head<3>() / angle).toRotationMatrix() * pose->R;
    // Products drift off the rotations.
    pose->R = Eigen::Quaterniond(pose->R).normalized().toRotationMatrix();
  }
  pose->t = new_center - pose->R * center;
  return step.head<3>().norm() > kLastSteps[0] || step.tail<4>().norm() * width_px > kLastSteps[1];
}

RefinedAspect Iterate(const AspectImage& image,
                      std::span<const ModelEdgePoint> points,
                      const Eigen::Vector3d& center,
                      const PinholeCamera& working,
                      const Rigid3& pose,
                      const PoseEdgeOptions& options,
                      double last_search_px) {
  RefinedAspect out{working, pose, 0, 0.0};
  // Of a cut-out, too: a focal length is nominal in widths of the image.
  const double width_px = std::round(image.image_width * image.working_from_image);
  const float least_cosine = static_cast<float>(std::cos(kMatchTurnRad));
  for (int i = 0; i < options.iterations; ++i) {
    const double share =
        options.iterations > 1 ? static_cast<double>(i) / (options.iterations - 1) : 1.0;
    const double search = options.search_px + share * (last_search_px - options.search_px);
    Normal normal;
    const Eigen::Vector3d center_in_camera = out.camera_from_object * center;
    Projected p;
    for (const ModelEdgePoint& point : points) {
      if (!ProjectPoint(out.camera, out.camera_from_object, point, &p)) continue;
      const int e = NearestAlong(image, p, search, least_cosine);
      if (e < 0) continue;
      const double residual = p.normal.dot(image.edges[e].point.cast<double>() - p.pixel);
      const double weight = point.weight * RobustWeight(residual, search + 0.5);
      AddMatch(out.camera, center_in_camera, p, residual, weight, &normal);
    }
    if (normal.matches < kLeastMatches || !(center_in_camera.z() > kNearM)) break;
    out.matches = normal.matches;
    out.rms_px = std::sqrt(normal.squares / std::max(normal.weights, 1e-9));
    if (!Step(options, center, normal, width_px, &out.camera, &out.camera_from_object)) {
      break;
    }
  }
  return out;
}

}  // namespace

std::vector<ModelEdgePoint> ThinnedEdgePoints(const VisibleEdges& edges, int max_points) {
  std::vector<ModelEdgePoint> points;
  const std::size_t n = edges.points.size();
  const std::size_t keep = std::min<std::size_t>(n, std::max(1, max_points));
  points.reserve(keep);
  for (std::size_t k = 0; k < keep; ++k) {
    const VisibleEdgePoint& p = edges.points[k * n / keep];
    points.push_back({p.point, p.direction, 1.0f});
  }
  return points;
}

std::vector<ModelEdgePoint> RenderedEdgePoints(const RenderMesh& mesh,
                                               const PinholeCamera& camera,
                                               const Rigid3& camera_from_object,
                                               const PoseEdgeOptions& options) {
  VisibleEdgeOptions rendering;
  rendering.render_px = options.render_px;
  return ThinnedEdgePoints(FindVisibleEdges(mesh, camera, camera_from_object, rendering),
                           options.max_points);
}

std::vector<PoseEdgeMatch> MatchPoseEdges(const AspectImage& image,
                                          std::span<const ModelEdgePoint> points,
                                          const PinholeCamera& camera,
                                          const Rigid3& camera_from_object,
                                          const PoseEdgeOptions& options) {
  std::vector<PoseEdgeMatch> matches;
  if (image.width == 0) return matches;
  const PinholeCamera working = WorkingCamera(image, camera);
  const float least_cosine = static_cast<float>(std::cos(kMatchTurnRad));
  const double scale = image.working_from_image;
  Projected p;
  for (const ModelEdgePoint& point : points) {
    if (!ProjectPoint(working, camera_from_object, point, &p)) continue;
    const int e = NearestAlong(image, p, options.search_px, least_cosine);
    if (e < 0) continue;
    PoseEdgeMatch& match = matches.emplace_back();
    const Eigen::Vector2d at = image.edges[e].point.cast<double>();
    const double residual = p.normal.dot(at - p.pixel);
    match.point = point.point.cast<double>();
    match.projected = OriginalPixel(image, p.pixel);
    match.normal = p.normal;
    match.matched = OriginalPixel(image, at);
    match.residual_px = residual / scale;
    match.weight = point.weight * RobustWeight(residual, options.search_px + 0.5);
  }
  return matches;
}

std::vector<PoseEdgeMatch> MatchPoseEdges(const AspectImage& image,
                                          const RenderMesh& mesh,
                                          const PinholeCamera& camera,
                                          const Rigid3& camera_from_object,
                                          const PoseEdgeOptions& options) {
  return MatchPoseEdges(image,
                        RenderedEdgePoints(mesh, camera, camera_from_object, options),
                        camera,
                        camera_from_object,
                        options);
}

RefinedAspect RefinePose(const AspectImage& image,
                         std::span<const ModelEdgePoint> points,
                         const Eigen::Vector3d& center,
                         const PinholeCamera& camera,
                         const Rigid3& camera_from_object,
                         const PoseEdgeOptions& options) {
  if (image.width == 0) return {camera, camera_from_object, 0, 0.0};
  RefinedAspect refined = Iterate(image,
                                  points,
                                  center,
                                  WorkingCamera(image, camera),
                                  camera_from_object,
                                  options,
                                  std::max(kLeastSearchPx, 0.5 * options.search_px));
  refined.camera = OriginalCamera(image, refined.camera);
  return refined;
}

RefinedAspect RefinePose(const AspectImage& image,
                         const RenderMesh& mesh,
                         const PinholeCamera& camera,
                         const Rigid3& camera_from_object,
                         const PoseEdgeOptions& options) {
  VisibleEdgeOptions visible;
  visible.render_px = options.render_px;
  PoseRendering rendering(mesh, visible, 0.0);
  return RefinePose(image, mesh, camera, camera_from_object, options, &rendering);
}

RefinedAspect RefinePose(const AspectImage& image,
                         const RenderMesh& mesh,
                         const PinholeCamera& camera,
                         const Rigid3& camera_from_object,
                         const PoseEdgeOptions& options,
                         PoseRendering* rendering) {
  RefinedAspect refined{camera, camera_from_object, 0, 0.0};
  PoseEdgeOptions now = options;
  for (int i = 0; i < options.renderings && image.width > 0; ++i) {
    const auto points = ThinnedEdgePoints(
        rendering->At(WorkingCamera(image, refined.camera), refined.camera_from_object),
        options.max_points);
    if (points.empty()) break;
    refined = RefinePose(
        image, points, mesh.center.cast<double>(), refined.camera, refined.camera_from_object, now);
    now.search_px = std::max(kLeastSearchPx, 0.6 * now.search_px);
  }
  return refined;
}

}  // namespace horopter
