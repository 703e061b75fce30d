#include "server/vision/recognition/aspects/edge_difference.h"

#include <Eigen/Geometry>
#include <algorithm>
#include <array>
#include <cmath>
#include <cstdint>

#include "server/vision/recognition/aspects/aspect_image.h"

namespace horopter {
namespace {

constexpr double kViewDistance = 4.0;  // diameters
constexpr double kSamePlace = 0.12;    // diameters: differing edges nearer than this are one place

// Bits of the directions of edges within the tolerance of each pixel.
class DirectionRaster {
 public:
  DirectionRaster(const PinholeCamera& camera, const VisibleEdges& edges, double tolerance_px)
      : width_(camera.width), height_(camera.height) {
    bits_.assign(static_cast<std::size_t>(width_) * height_, 0);
    const int reach = static_cast<int>(std::floor(tolerance_px));
    const double squared = tolerance_px * tolerance_px;
    for (const VisibleEdgePoint& p : edges.points) {
      const int bin = AspectBin(p.tangent.x(), p.tangent.y());
      // Its own direction and the neighbours': within 22.5 degrees at least.
      const unsigned like =
          1u << bin | 1u << (bin + 1) % kAspectBins | 1u << (bin + kAspectBins - 1) % kAspectBins;
      const int u = static_cast<int>(std::lround(p.image.x()));
      const int v = static_cast<int>(std::lround(p.image.y()));
      for (int dv = -reach; dv <= reach; ++dv) {
        for (int du = -reach; du <= reach; ++du) {
          if (du * du + dv * dv > squared || !Inside(u + du, v + dv)) continue;
          bits_[Cell(u + du, v + dv)] |= static_cast<std::uint16_t>(like);
        }
      }
    }
  }

  bool HasLike(const VisibleEdgePoint& p) const {
    const int u = static_cast<int>(std::lround(p.image.x()));
    const int v = static_cast<int>(std::lround(p.image.y()));
    return Inside(u, v) && (bits_[Cell(u, v)] >> AspectBin(p.tangent.x(), p.tangent.y()) & 1u) != 0;
  }

 private:
  bool Inside(int u, int v) const { return u >= 0 && v >= 0 && u < width_ && v < height_; }
  std::size_t Cell(int u, int v) const { return static_cast<std::size_t>(v) * width_ + u; }

  int width_, height_;
  std::vector<std::uint16_t> bits_;
};

void AddDiffering(const VisibleEdges& edges,
                  const DirectionRaster& other,
                  bool of_a,
                  EdgeDifference* out) {
  double& all = of_a ? out->length_a_px : out->length_b_px;
  double& only = of_a ? out->only_a_px : out->only_b_px;
  for (std::size_t i = 0; i < edges.points.size(); ++i) {
    const VisibleEdgePoint& p = edges.points[i];
    const float length = LengthAt(edges, i);
    all += length;
    if (other.HasLike(p)) continue;
    only += length;
    out->points.push_back({p, of_a, length});
  }
}

// The differing edges of one place, over all views.
struct Place {
  DistinguishingFeature feature;
  double weight = 0.0;                       // length, all views
  std::array<double, 3> kinds{};             // ... by kind
  Eigen::Vector3d low, high;                 // extent
  std::array<double, 2> in_view{0.0, -1.0};  // length in the view looked at last, and which
};

void AddToPlaces(const DifferingPoint& d,
                 const Eigen::Vector3d& at,
                 int view,
                 double reach,
                 std::vector<Place>* places) {
  Place* place = nullptr;
  for (Place& p : *places) {
    if (p.feature.of_a == d.of_a && (p.feature.place - at).norm() < reach) {
      place = &p;
      break;
    }
  }
  if (place == nullptr) {
    place = &places->emplace_back();
    place->feature.of_a = d.of_a;
    place->feature.place = place->low = place->high = at;
  }
  const double length = std::max(1e-3f, d.length_px);
  place->weight += length;
  place->kinds[static_cast<int>(d.point.kind)] += length;
  place->feature.place += (length / place->weight) * (at - place->feature.place);
  place->low = place->low.cwiseMin(at);
  place->high = place->high.cwiseMax(at);
  if (place->in_view[1] != view) place->in_view = {0.0, static_cast<double>(view)};
  place->in_view[0] += length;
  place->feature.length_px = std::max(place->feature.length_px, place->in_view[0]);
}

struct ViewAround {
  Eigen::Vector3d toward_camera;  // unit, frame of the part
  Rigid3 camera_from_object;
};

// From the corners, edges' middles and faces of a cube.
std::vector<ViewAround> ViewsAround(const RenderMesh& mesh) {
  std::vector<ViewAround> out;
  for (int x = -1; x <= 1; ++x) {
    for (int y = -1; y <= 1; ++y) {
      for (int z = -1; z <= 1; ++z) {
        if (x == 0 && y == 0 && z == 0) continue;
        ViewAround& view = out.emplace_back();
        view.toward_camera = Eigen::Vector3d(x, y, z).normalized();
        Rigid3& pose = view.camera_from_object;
        const Eigen::Vector3d right = view.toward_camera.unitOrthogonal();
        pose.R.row(0) = right;
        pose.R.row(1) = (-view.toward_camera).cross(right);
        pose.R.row(2) = -view.toward_camera;
        pose.t = Eigen::Vector3d(0, 0, kViewDistance * mesh.diameter_m) -
                 pose.R * mesh.center.cast<double>();
      }
    }
  }
  return out;
}

PinholeCamera CameraAround(double render_px) {
  const int size = 2 * static_cast<int>(render_px);
  return CenteredCamera(size, size, kViewDistance * render_px);
}

}  // namespace

float LengthAt(const VisibleEdges& edges, std::size_t i) {
  const VisibleEdgePoint& p = edges.points[i];
  float length = 0.0f;
  if (i > 0 && edges.points[i - 1].chain == p.chain)
    length += 0.5f * (p.image - edges.points[i - 1].image).norm();
  if (i + 1 < edges.points.size() && edges.points[i + 1].chain == p.chain)
    length += 0.5f * (edges.points[i + 1].image - p.image).norm();
  return length;
}

EdgeDifference CompareEdges(const RenderMesh& a,
                            const Rigid3& camera_from_a,
                            const RenderMesh& b,
                            const Rigid3& camera_from_b,
                            const PinholeCamera& camera,
                            const EdgeDifferenceOptions& options) {
  VisibleEdgeOptions rendering;
  rendering.render_px = options.render_px;
  const VisibleEdges of_a = FindVisibleEdges(a, camera, camera_from_a, rendering);
  const VisibleEdges of_b = FindVisibleEdges(b, camera, camera_from_b, rendering);
  return CompareEdges(of_a, of_b, camera, options);
}

EdgeDifference CompareEdges(const VisibleEdges& a,
                            const VisibleEdges& b,
                            const PinholeCamera& camera,
                            const EdgeDifferenceOptions& options) {
  EdgeDifference out;
  AddDiffering(a, DirectionRaster(camera, b, options.tolerance_px), true, &out);
  AddDiffering(b, DirectionRaster(camera, a, options.tolerance_px), false, &out);
  return out;
}

DistinguishingFeatures FindDistinguishingFeatures(const RenderMesh& a,
                                                  const RenderMesh& b,
                                                  const Rigid3& a_from_b,
                                                  int most,
                                                  double min_length_px) {
  const EdgeDifferenceOptions options;
  const PinholeCamera camera = CameraAround(options.render_px);
  DistinguishingFeatures out;
  std::vector<Place> places;
  const std::vector<ViewAround> views = ViewsAround(a);
  for (int v = 0; v < static_cast<int>(views.size()); ++v) {
    const Rigid3& pose = views[v].camera_from_object;
    const EdgeDifference difference = CompareEdges(a, pose, b, pose * a_from_b, camera, options);
    for (const DifferingPoint& d : difference.points) {
      const Eigen::Vector3d own = d.point.point.cast<double>();
      AddToPlaces(d, d.of_a ? own : a_from_b * own, v, kSamePlace * a.diameter_m, &places);
    }
    out.views.push_back({views[v].toward_camera, difference.only_a_px + difference.only_b_px});
    const double share = (difference.only_a_px + difference.only_b_px) /
                         std::max(1.0, difference.length_a_px + difference.length_b_px);
    out.differing_share += share / static_cast<double>(views.size());
    out.most_in_a_view = std::max(out.most_in_a_view, share);
  }
  std::stable_sort(places.begin(), places.end(), [](const Place& p, const Place& q) {
    return p.feature.length_px > q.feature.length_px;
  });
  for (Place& p : places) {
    if (static_cast<int>(out.features.size()) >= most || p.feature.length_px < min_length_px) break;
    p.feature.size_m = (p.high - p.low).norm();
    const auto kind = std::max_element(p.kinds.begin(), p.kinds.end()) - p.kinds.begin();
    p.feature.kind = static_cast<VisibleEdgeKind>(kind);
    out.features.push_back(p.feature);
  }
  return out;
}

std::vector<VisibleEdges> FindEdgesAround(const RenderMesh& mesh) {
  VisibleEdgeOptions rendering;
  rendering.render_px = EdgeDifferenceOptions{}.render_px;
  const PinholeCamera camera = CameraAround(rendering.render_px);
  std::vector<VisibleEdges> out;
  for (const ViewAround& view : ViewsAround(mesh))
    out.push_back(FindVisibleEdges(mesh, camera, view.camera_from_object, rendering));
  return out;
}

std::vector<ViewDifference> FindVisibleLength(
    const RenderMesh& a, const std::function<bool(const VisibleEdgePoint&)>& is_asked) {
  const std::vector<ViewAround> views = ViewsAround(a);
  const std::vector<VisibleEdges> around = FindEdgesAround(a);
  std::vector<ViewDifference> out;
  for (std::size_t v = 0; v < views.size(); ++v) {
    ViewDifference& seen = out.emplace_back();
    seen.toward_camera = views[v].toward_camera;
    for (std::size_t i = 0; i < around[v].points.size(); ++i) {
      if (is_asked(around[v].points[i])) seen.differing_px += LengthAt(around[v], i);
    }
  }
  return out;
}

}  // namespace horopter
