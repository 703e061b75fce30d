#include "server/vision/recognition/candidates/plane_search.h"

#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>

#include "server/base/parallel_for.h"
#include "server/vision/recognition/candidates/standing_poses.h"

namespace horopter {
namespace {

// Full edges must agree in length within this share plus kEndPx.
constexpr double kLengthShare = 0.04;
constexpr double kEndPx = 3.0;
// Edges above this height (metres) do not move with the supporting plane.
constexpr double kOnPlaneHeight = 0.004;
constexpr double kPartialWeight = 0.5;  // vote of an edge of which one end is hidden

}  // namespace

PlaneSearch::PlaneSearch(const JointContext& context,
                         const SceneModel& scene,
                         const std::vector<SearchSurface>& surfaces,
                         const PlaneSearchOptions& options)
    : context_(context), options_(options) {
  const Eigen::Vector3d z = scene.plane->normal;
  const Eigen::Vector3d x = z.unitOrthogonal();
  scene_from_plane_.R << x, z.cross(x), z;
  scene_from_plane_.t = z * scene.plane->offset_m;
  std::vector<std::size_t> index;
  for (std::size_t v = 0; v < scene.views.size(); ++v) {
    if (!scene.views[v]) continue;
    views_.push_back(
        {{scene.views[v]->camera, scene.views[v]->camera_from_scene * scene_from_plane_},
         &context.views[v].maps});
    index.push_back(v);
  }
  max_height_ = MaxHeight(views_);
  double highest = 0.0;  // of the surfaces
  for (const SearchSurface& s : surfaces) {
    Surface& surface = surfaces_.emplace_back(Surface{s.height_m, {}});
    for (const SearchSurface::Disc& d : s.discs) {
      surface.discs.push_back({(scene_from_plane_.Inverse() * d.center).head<2>(), d.radius_m});
    }
    highest = std::max(highest, s.height_m);
  }
  double tallest = 0.0;  // of the parts, in any pose
  for (const auto& object : context.objects) tallest = std::max(tallest, object->model.diameter_m);
  edges_.resize(views_.size());
  ParallelFor(static_cast<int>(views_.size()), context.options.threads, [&](int i) {
    edges_[i] = SightedEdges(i, index[i], highest + tallest);
  });
}

std::vector<PlaneSearch::SightedEdge> PlaneSearch::SightedEdges(int i,
                                                                std::size_t v,
                                                                double top) const {
  std::vector<SightedEdge> edges;
  const ViewEvidence& evidence = context_.views[v];
  const PinholeCamera& camera = views_[i].camera;
  const Rigid3& camera_from_plane = views_[i].camera_from_scene;
  const ImageFeatures& features = *evidence.features;
  const auto& flags = context_.matching->segment_on_plane;
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
    if (length * evidence.maps.working_from_image < options_.min_edge_px) continue;
    SightedEdge edge;
    bool seen = true;
    for (int e = 0; e < 2 && seen; ++e) {
      seen = SightPlane(camera, camera_from_plane, ends[e][s], &edge.ends[e]);
      if (!seen) break;
      edge.corner[e] = corner[e][s];
      const Eigen::Vector3d p(edge.ends[e].base.x(), edge.ends[e].base.y(), 0.0);
      const Eigen::Vector3d eye = camera_from_plane.Inverse().t;
      const double depth = (camera_from_plane * p).z();
      const double elevation = eye.z() / (eye - p).norm();
      edge.pixel[e] =
          depth / (camera.focal_px * evidence.maps.working_from_image) / std::max(0.25, elevation);
    }
    if (!seen) continue;
    edge.on_plane = v < flags.size() && s < flags[v].size() && flags[v][s];
    edge.heights = SupportedHeights(views_, i, edge.ends[0], edge.ends[1], max_height_, top);
    edges.push_back(edge);
  }
  return edges;
}

std::vector<std::vector<const PlaneSearch::SightedEdge*>> PlaneSearch::EdgesOver(
    const Surface& surface, double diameter_m) const {
  // Whether the edge's end, at some height that the part reaches, comes near enough to a disc.
  const auto near = [&](const PlaneSighting& end) {
    const Eigen::Vector2d low = end.base + surface.height_m * end.shift;
    const Eigen::Vector2d rise = diameter_m * end.shift;
    return std::any_of(surface.discs.begin(), surface.discs.end(), [&](const Disc& disc) {
      const Eigen::Vector2d off = disc.center - low;
      const double square = rise.squaredNorm();
      const double share = square > 0 ? std::clamp(off.dot(rise) / square, 0.0, 1.0) : 0.0;
      return (off - share * rise).norm() < disc.radius_m + diameter_m;
    });
  };
  std::vector<std::vector<const SightedEdge*>> out(views_.size());
  for (std::size_t v = 0; v < views_.size(); ++v) {
    for (const SightedEdge& edge : edges_[v]) {
      if (surface.discs.empty() || near(edge.ends[0]) || near(edge.ends[1]))
        out[v].push_back(&edge);
    }
  }
  return out;
}

PoseVotes PlaneSearch::VoteByEdges(
    const PreparedObject& object,
    const StandingObject& standing,
    const Surface& surface,
    const std::vector<std::vector<const SightedEdge*>>& edges) const {
  PoseVotes votes(options_.votes);
  std::vector<Eigen::Vector3d> eyes;
  for (const KnownView& view : views_) eyes.push_back(view.camera_from_scene.Inverse().t);
  const auto allowed = [&](const PlaneYaw& yaw) {
    if (surface.discs.empty()) return true;
    const Eigen::Vector2d middle =
        yaw.position + Turned(yaw.cos_yaw, yaw.sin_yaw, standing.outline_middle);
    return std::any_of(surface.discs.begin(), surface.discs.end(), [&](const Disc& disc) {
      return (middle - disc.center).squaredNorm() < disc.radius_m * disc.radius_m;
    });
  };
  for (std::size_t e = 0; e < object.model.edges.size(); ++e) {
    const ModelEdge& edge = object.model.edges[e];
    if (edge.kind != CurveKind::kLine || edge.start_vertex < 0 || edge.end_vertex < 0) continue;
    const Eigen::Vector3d& p = standing.vertices[edge.start_vertex];
    const Eigen::Vector3d& q = standing.vertices[edge.end_vertex];
    const Eigen::Vector2d model = (q - p).head<2>();
    const double length = model.norm();
    if (length < kUprightShare * (q - p).norm() || length <= 0) continue;
    const bool level = std::abs(p.z() - q.z()) < kLevel;
    const bool raised = std::max(p.z(), q.z()) > kOnPlaneHeight;
    for (std::size_t v = 0; v < views_.size(); ++v) {
      for (const SightedEdge* sighted : edges[v]) {
        if (raised && sighted->on_plane) continue;
        if (level && !sighted->heights.At(p.z() / max_height_)) continue;
        for (const bool swapped : {false, true}) {
          const PlaneSighting& sp = sighted->ends[swapped ? 1 : 0];
          const PlaneSighting& sq = sighted->ends[swapped ? 0 : 1];
          const Eigen::Vector2d at_p = sp.base + p.z() * sp.shift;
          const Eigen::Vector2d at_q = sq.base + q.z() * sq.shift;
          const Eigen::Vector2d seen = at_q - at_p;
          const double seen_length = seen.norm();
          const double slack =
              kLengthShare * length + kEndPx * (sighted->pixel[0] + sighted->pixel[1]) / 2;
          if (seen_length > length + slack || seen_length < options_.min_partial * length) continue;
          PlaneYaw yaw;
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
            if (sighted->corner[swapped ? 1 : 0]) positions[n++] = from_p;
            if (sighted->corner[swapped ? 0 : 1]) positions[n++] = from_q;
          }
          const int index = static_cast<int>(e);
          for (int i = 0; i < n; ++i) {
            yaw.position = positions[i];
            if (allowed(yaw) && EdgesVisible(object, standing, yaw, eyes[v], index, index))
              votes.Add(yaw, whole ? 1.0 : kPartialWeight);
          }
        }
      }
    }
  }
  return votes;
}

std::vector<PlanePose> PlaneSearch::Find(int k) const {
  const PreparedObject& object = *context_.objects[k];
  PosePool pool(options_.min_quick);
  const std::vector<StandingObject> on_plane = StandingObjects(object);
  for (const Surface& surface : surfaces_) {
    const auto edges = EdgesOver(surface, object.model.diameter_m);
    for (StandingObject standing : on_plane) {
      if (IsStopRequested(context_.stop)) return {};
      standing.plane_from_object.t.z() += surface.height_m;
      for (Eigen::Vector3d& v : standing.vertices) v.z() += surface.height_m;
      ScorePeaks(object,
                 standing,
                 views_,
                 VoteByEdges(object, standing, surface, edges)
                     .Peaks(options_.min_edge_votes,
                            surface.discs.empty() ? options_.peaks : options_.peaks_over),
                 options_.known_reach_px,
                 &pool);
    }
  }
  std::vector<PlanePose> out;
  for (const PooledPose& p :
       SettledPoses(object, views_, std::move(pool).Sorted(), options_.settle)) {
    out.push_back({scene_from_plane_ * p.plane_from_object, p.quick});
  }
  return out;
}

}  // namespace horopter
