#include <algorithm>
#include <array>
#include <bit>
#include <cmath>

#include "server/vision/recognition/aspects/screen_edges.h"

namespace horopter {
namespace {

using Eigen::Vector3f;

// A point of the mesh's contour differs in depth from the surface a pixel away by less, in pixel
// footprints: a ball of 200 px falls off by 14 in its last pixel. Only a face seen edge-on, less
// than a pixel wide, goes deeper.
constexpr float kSameSurfacePx = 25.0f;

constexpr std::array<int, 4> kDx = {1, 0, -1, 0};  // right, down, left, up
constexpr std::array<int, 4> kDy = {0, 1, 0, -1};  // the same

bool ShareVertex(const Eigen::Vector3i& a, const Eigen::Vector3i& b) {
  return std::any_of(a.begin(), a.end(), [&](int v) { return (b.array() == v).any(); });
}

// Whether pixels i and j beside each other, with a step in depth, see one surface.
bool Explained(const Rendering& r, const RenderMesh& mesh, int i, int j, float tolerance) {
  const RenderedView& view = r.view;
  const int ti = view.triangle[i], tj = view.triangle[j];
  if (ti == tj) return true;
  const int w = view.width;
  const auto xi = static_cast<float>(i % w), yi = static_cast<float>(i / w);
  const auto xj = static_cast<float>(j % w), yj = static_cast<float>(j / w);
  const InverseDepthPlane pi = PlaneOf(r, mesh, ti), pj = PlaneOf(r, mesh, tj);
  // The planes' difference in depth at both pixels.
  const float at_i = view.inverse_depth[i] - pj.At(xi, yi);
  const float at_j = pi.At(xj, yj) - view.inverse_depth[j];
  // A crease of a steep face: neighbours that meet between the pixels.
  if (at_i * at_j <= 0.0f && ShareVertex(mesh.triangles[ti], mesh.triangles[tj])) return true;
  // Curved surfaces bend between pixels, the more the steeper they are.
  const Eigen::Vector2f step(xj - xi, yj - yi);
  const float slope = std::min(std::abs(pi.gradient.dot(step)), std::abs(pj.gradient.dot(step)));
  return std::min(std::abs(at_i), std::abs(at_j)) < tolerance + 0.5f * slope;
}

// The side of a pixel where something farther begins, as a piece of the line between two pixels: it
// runs in direction d + 1.
struct Side {
  int pixel = 0;
  int direction = 0;
  float along = -1.0f;  // of the contour, from the near pixel's centre (0) to the far one's (1)
  float inverse_depth = 0.0f;
  bool same_surface = false;
  int next = -1;
};

class ContourTracer {
 public:
  ContourTracer(const Rendering& rendering, const RenderMesh& mesh, const DepthSteps& steps)
      : r_(rendering), mesh_(mesh), steps_(steps), view_(rendering.view) {
    first_.resize(steps.farther.size());
    for (int i = 0; i < static_cast<int>(steps.farther.size()); ++i) {
      if (steps.farther[i] == 0) continue;
      first_[i] = static_cast<int>(sides_.size());
      for (int d = 0; d < 4; ++d) {
        if (steps.farther[i] >> d & 1) sides_.push_back({i, d});
      }
    }
  }

  ScreenEdges Trace() {
    for (const RenderMeshEdge& e : mesh_.edges) {
      if (TurnsAway(e)) Cross(r_.screen[e.a], r_.screen[e.b]);
    }
    std::vector<char> has_previous(sides_.size(), 0);
    for (Side& s : sides_) {
      s.next = Next(s);
      if (s.next >= 0) has_previous[s.next] = 1;
    }
    std::vector<char> done(sides_.size(), 0);
    ScreenEdges out;
    out.points.reserve(sides_.size());
    for (const bool open : {true, false}) {
      for (int i = 0; i < static_cast<int>(sides_.size()); ++i) {
        if (done[i] || (open && has_previous[i])) continue;
        for (int s = i; s >= 0 && !done[s]; s = sides_[s].next) {
          done[s] = 1;
          out.points.push_back(PointOf(sides_[s]));
        }
        out.ends.push_back(static_cast<std::int32_t>(out.points.size()));
      }
    }
    return out;
  }

 private:
  bool TurnsAway(const RenderMeshEdge& e) const {
    if (!(r_.screen[e.a].z() > 0.0f && r_.screen[e.b].z() > 0.0f)) return false;
    if (e.right < 0) return true;
    return ((r_.facing[e.left] > 0) != (r_.facing[e.right] > 0)) != e.same_winding;
  }

  // Every line of pixel centres that the edge crosses, rows and columns.
  void Cross(const Vector3f& p, const Vector3f& q) {
    for (const int axis : {0, 1}) {
      const Vector3f& low = p[1 - axis] <= q[1 - axis] ? p : q;
      const Vector3f& high = p[1 - axis] <= q[1 - axis] ? q : p;
      const float extent = high[1 - axis] - low[1 - axis];
      if (!(extent > 0.0f)) continue;
      const int lines = axis == 0 ? view_.height : view_.width;
      const int cells = axis == 0 ? view_.width : view_.height;
      const int first = std::max(0, static_cast<int>(std::ceil(low[1 - axis])));
      const int last = std::min(lines - 1, static_cast<int>(std::floor(high[1 - axis])));
      for (int line = first; line <= last; ++line) {
        const float t = (static_cast<float>(line) - low[1 - axis]) / extent;
        const float at = low[axis] + t * (high[axis] - low[axis]);
        const int cell = static_cast<int>(std::floor(at));
        if (cell < 0 || cell + 1 >= cells) continue;
        const float depth = low.z() + t * (high.z() - low.z());
        const int pixel = axis == 0 ? line * view_.width + cell : cell * view_.width + line;
        const int beyond = pixel + (axis == 0 ? 1 : view_.width);
        const float along = at - static_cast<float>(cell);
        if (steps_.farther[pixel] >> axis & 1) Offer(pixel, axis, beyond, along, depth);
        if (steps_.farther[beyond] >> (axis + 2) & 1) {
          Offer(beyond, axis + 2, pixel, 1.0f - along, depth);
        }
      }
    }
  }

  int Index(int pixel, int direction) const {
    const unsigned below = steps_.farther[pixel] & ((1u << direction) - 1u);
    return first_[pixel] + std::popcount(below);
  }

  // The outermost crossing on the near surface is the contour.
  void Offer(int near, int direction, int far, float along, float depth) {
    Side& side = sides_[Index(near, direction)];
    const float to_near = std::abs(depth - view_.inverse_depth[near]);
    const float to_far = std::abs(depth - view_.inverse_depth[far]);
    const bool same = to_near < kSameSurfacePx * view_.inverse_depth[near] / r_.focal_px;
    if (to_near > to_far || same < side.same_surface) return;
    if (same == side.same_surface && along <= side.along) return;
    side.along = along;
    side.inverse_depth = depth;
    side.same_surface = same;
  }

  // Around the near pixel, straight on, or around the far one; nowhere if a nearer surface comes.
  int Next(const Side& s) const {
    const int d = s.direction, d1 = (d + 1) % 4, d2 = (d + 2) % 4, d3 = (d + 3) % 4;
    const auto has = [&](int pixel, int direction) {
      return (steps_.farther[pixel] >> direction & 1) != 0;
    };
    if (has(s.pixel, d1)) return Index(s.pixel, d1);
    const int x = s.pixel % view_.width + kDx[d1], y = s.pixel / view_.width + kDy[d1];
    if (x < 0 || y < 0 || x >= view_.width || y >= view_.height) return -1;
    const int ahead = y * view_.width + x;
    if (has(ahead, d3)) return -1;
    if (has(ahead, d)) return Index(ahead, d);
    const int beyond = ahead + kDy[d] * view_.width + kDx[d];
    if (has(beyond, d2)) return -1;
    return has(beyond, d3) ? Index(beyond, d3) : -1;
  }

  ScreenEdgePoint PointOf(const Side& s) const {
    ScreenEdgePoint p;
    p.exact = s.along >= 0.0f;
    const float along = p.exact ? s.along : 0.5f;
    p.u = static_cast<float>(s.pixel % view_.width) + along * static_cast<float>(kDx[s.direction]);
    p.v = static_cast<float>(s.pixel / view_.width) + along * static_cast<float>(kDy[s.direction]);
    p.inverse_depth = p.exact ? s.inverse_depth : view_.inverse_depth[s.pixel];
    const int far = s.pixel + kDx[s.direction] + kDy[s.direction] * view_.width;
    p.kind = view_.inverse_depth[far] > 0.0f ? VisibleEdgeKind::kOcclusion
                                             : VisibleEdgeKind::kSilhouette;
    return p;
  }

  const Rendering& r_;
  const RenderMesh& mesh_;
  const DepthSteps& steps_;
  const RenderedView& view_;
  std::vector<Side> sides_;
  std::vector<int> first_;  // side of each pixel that has one
};

}  // namespace

DepthSteps FindDepthSteps(const Rendering& rendering, const RenderMesh& mesh, double jump_px) {
  const RenderedView& view = rendering.view;
  DepthSteps out;
  out.width = view.width;
  out.farther.assign(view.inverse_depth.size(), 0);
  const float* depth = view.inverse_depth.data();
  const float share = static_cast<float>(jump_px) / rendering.focal_px;
  const auto compare = [&](int i, int j, int direction) {
    const float near = std::max(depth[i], depth[j]);
    const float difference = depth[i] - depth[j];
    if (std::abs(difference) <= share * near) return;
    if (std::min(depth[i], depth[j]) > 0.0f && Explained(rendering, mesh, i, j, share * near)) {
      return;
    }
    if (difference > 0.0f) {
      out.farther[i] = static_cast<std::uint8_t>(out.farther[i] | 1 << direction);
    } else {
      out.farther[j] = static_cast<std::uint8_t>(out.farther[j] | 1 << (direction + 2));
    }
  };
  for (int y = 0; y < view.height; ++y) {
    for (int x = 0; x < view.width; ++x) {
      const int i = y * view.width + x;
      if (x + 1 < view.width) compare(i, i + 1, 0);
      if (y + 1 < view.height) compare(i, i + view.width, 1);
    }
  }
  return out;
}

ScreenEdges OccludingContours(const Rendering& rendering,
                              const RenderMesh& mesh,
                              const DepthSteps& steps) {
  return ContourTracer(rendering, mesh, steps).Trace();
}

}  // namespace horopter
