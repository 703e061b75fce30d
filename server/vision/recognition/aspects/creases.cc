#include <Eigen/Dense>
#include <algorithm>
#include <array>
#include <cmath>

#include "server/vision/recognition/aspects/screen_edges.h"

namespace horopter {
namespace {

using Eigen::Vector2f;
using Eigen::Vector3f;

constexpr float kLowShare = 0.7f;        // of the turn, for a chain to go on
constexpr float kSharpCosine = 0.966f;   // edges of the mesh of more than 15 degrees are sharp
constexpr float kSharpShare = 0.6f;      // a sharp edge explains a crease of less than its turn / this
constexpr float kOnSurfacePx = 4.0f;     // such an edge is as deep as the pixel, in footprints
constexpr float kSnapAcrossPx = 1.3f;    // and so near the ridge
constexpr float kSnapAlongPx = 0.8f;
constexpr float kLeastCosine = 0.35f;    // a chain bends by less from pixel to pixel

struct Ridge {
  int pixel = 0;
  Vector2f across = Vector2f::UnitX();  // unit, the direction in which the normal turns
  float power = 0.0f;                   // squared turn per pixel, weighted
  float turn_rad = 0.0f;
  bool beside_contour = false;  // the window was cut off: what is seen may be a limb
  ScreenEdgePoint point;
};

// Where an edge of the mesh crosses a line of pixel centres.
struct Crossing {
  Vector3f at;  // u, v, inverse depth
  float turn_rad;
  int next;  // at the same pixel
};

class CreaseFinder {
 public:
  CreaseFinder(const Rendering& rendering,
               const RenderMesh& mesh,
               const DepthSteps& steps,
               const CreaseOptions& options)
      : r_(rendering),
        mesh_(mesh),
        steps_(steps),
        view_(rendering.view),
        high_(static_cast<float>(options.turn_rad)) {}

  ScreenEdges Find() {
    FillNormals();
    FindTurns();
    KeepRidges();
    CrossSharpEdges();
    PlaceRidges();
    return Link();
  }

 private:
  bool Inside(int x, int y, int border) const {
    return x >= border && y >= border && x < view_.width - border && y < view_.height - border;
  }

  void FillNormals() {
    normals_.resize(view_.triangle.size());
    for (int y = 0, i = 0; y < view_.height; ++y) {
      for (int x = 0; x < view_.width; ++x, ++i) {
        const int t = view_.triangle[i];
        if (t < 0) continue;
        Vector3f n = mesh_.flat[t]
                         ? mesh_.face_normals[t]
                         : Interpolated(t, static_cast<float>(x), static_cast<float>(y));
        if (r_.facing[t] < 0) n = -n;
        normals_[i] = n;
      }
    }
  }

  // Linear over the screen: a facet is small against its distance.
  Vector3f Interpolated(int t, float u, float v) const {
    const Eigen::Vector3i& c = mesh_.triangles[t];
    const Vector3f& p = r_.screen[c[0]];
    const Vector3f pq = r_.screen[c[1]] - p, pr = r_.screen[c[2]] - p;
    const float area = pq.x() * pr.y() - pr.x() * pq.y();
    const auto& n = mesh_.normals[t];
    if (std::abs(area) < 1e-6f) return n[0];
    const float du = u - p.x(), dv = v - p.y();
    const float b = std::clamp((du * pr.y() - pr.x() * dv) / area, 0.0f, 1.0f);
    const float c2 = std::clamp((pq.x() * dv - du * pq.y()) / area, 0.0f, 1.0f - b);
    return (n[0] + b * (n[1] - n[0]) + c2 * (n[2] - n[0])).normalized();
  }

  struct Turn {
    Vector3f weighted;  // over two pixels and over four, so that it is largest at a step
    float wide;         // over four, squared
    bool cut;           // by a contour
  };

  Turn TurnAlong(int i, int stride) const {
    int a1 = i, b1 = i;
    bool cut = false;
    const auto step = [&](int from, int to) {
      return steps_.Between(std::min(from, to), std::max(from, to)) ? (cut = true, from) : to;
    };
    a1 = step(i, i + stride);
    b1 = step(i, i - stride);
    const int a2 = a1 == i ? i : step(a1, a1 + stride);
    const int b2 = b1 == i ? i : step(b1, b1 - stride);
    const Vector3f wide = normals_[a2] - normals_[b2];
    return {(2.0f * (normals_[a1] - normals_[b1]) + wide) / 3.0f, wide.squaredNorm(), cut};
  }

  void FindTurns() {
    power_.assign(view_.triangle.size(), 0.0f);
    cut_.assign(view_.triangle.size(), 0);
    const float low = 2.0f * std::sin(0.5f * kLowShare * high_);
    const int w = view_.width;
    for (int y = 2; y < view_.height - 2; ++y) {
      for (int x = 2; x < w - 2; ++x) {
        const int i = y * w + x;
        const int t = view_.triangle[i];
        if (t < 0) continue;
        const std::int32_t* id = view_.triangle.data() + i;
        if (mesh_.flat[t] && id[-2] == t && id[2] == t && id[-2 * w] == t && id[2 * w] == t) {
          continue;
        }
        const Turn h = TurnAlong(i, 1), v = TurnAlong(i, w);
        cut_[i] = h.cut || v.cut;
        const float widest = std::max(h.wide, v.wide);
        if (widest < low * low) continue;
        // The direction of the largest turn: first eigenvector of J'J, J = [h v].
        const float hh = h.weighted.squaredNorm(), vv = v.weighted.squaredNorm();
        const float hv = h.weighted.dot(v.weighted);
        const float angle = 0.5f * std::atan2(2.0f * hv, hh - vv);
        Ridge ridge;
        ridge.pixel = i;
        ridge.across = {std::cos(angle), std::sin(angle)};
        ridge.power = 0.5f * (hh + vv + std::hypot(hh - vv, 2.0f * hv));
        ridge.turn_rad = 2.0f * std::asin(std::min(1.0f, 0.5f * std::sqrt(widest)));
        power_[i] = ridge.power;
        ridges_.push_back(ridge);
      }
    }
  }

  // Those that turn faster than their neighbours across.
  void KeepRidges() {
    std::vector<Ridge> kept;
    for (Ridge& r : ridges_) {
      const float ax = std::abs(r.across.x()), ay = std::abs(r.across.y());
      const int dx = ax > 0.38f ? (r.across.x() > 0 ? 1 : -1) : 0;
      const int dy = ay > 0.38f ? (r.across.y() > 0 ? 1 : -1) : 0;
      const int offset = dy * view_.width + dx;
      // Ties go one way, whatever the sign of the direction.
      const int forward = offset > 0 ? offset : -offset;
      if (power_[r.pixel] <= power_[r.pixel - forward] ||
          power_[r.pixel] < power_[r.pixel + forward]) {
        continue;
      }
      r.beside_contour =
          cut_[r.pixel] || cut_[r.pixel + forward] || cut_[r.pixel - forward];
      const float before = std::sqrt(power_[r.pixel - offset]);
      const float here = std::sqrt(power_[r.pixel]);
      const float after = std::sqrt(power_[r.pixel + offset]);
      const float bend = before - 2.0f * here + after;
      const float peak = bend < 0.0f ? std::clamp(0.5f * (before - after) / bend, -0.5f, 0.5f) : 0;
      const float length = static_cast<float>(dx * dx + dy * dy) > 1.5f ? 1.41421356f : 1.0f;
      const float shift = peak * length;
      r.point.u = static_cast<float>(r.pixel % view_.width) + shift * r.across.x();
      r.point.v = static_cast<float>(r.pixel / view_.width) + shift * r.across.y();
      kept.push_back(r);
    }
    ridges_ = std::move(kept);
  }

  void CrossSharpEdges() {
    at_pixel_.assign(view_.triangle.size(), -1);
    for (const Ridge& r : ridges_) {
      for (int dy = -1; dy <= 1; ++dy) {
        for (int dx = -1; dx <= 1; ++dx) at_pixel_[r.pixel + dy * view_.width + dx] = kWanted;
      }
    }
    for (const RenderMeshEdge& e : mesh_.edges) {
      if (e.right < 0 || !(r_.screen[e.a].z() > 0.0f && r_.screen[e.b].z() > 0.0f)) continue;
      if (r_.facing[e.left] == 0 || r_.facing[e.right] == 0) continue;
      if (((r_.facing[e.left] > 0) != (r_.facing[e.right] > 0)) != e.same_winding) continue;
      if (mesh_.closed && r_.facing[e.left] < 0) continue;
      float cosine = mesh_.face_normals[e.left].dot(mesh_.face_normals[e.right]);
      if (e.same_winding) cosine = -cosine;
      if (cosine > kSharpCosine) continue;
      Cross(r_.screen[e.a], r_.screen[e.b], std::acos(std::max(-1.0f, cosine)));
    }
  }

  void Cross(const Vector3f& p, const Vector3f& q, float turn_rad) {
    for (const int axis : {0, 1}) {
      const Vector3f& low = p[1 - axis] <= q[1 - axis] ? p : q;
      const Vector3f& high = p[1 - axis] <= q[1 - axis] ? q : p;
      const float extent = high[1 - axis] - low[1 - axis];
      if (!(extent > 0.0f)) continue;
      const int lines = axis == 0 ? view_.height : view_.width;
      const int first = std::max(0, static_cast<int>(std::ceil(low[1 - axis])));
      const int last = std::min(lines - 1, static_cast<int>(std::floor(high[1 - axis])));
      for (int line = first; line <= last; ++line) {
        const float t = (static_cast<float>(line) - low[1 - axis]) / extent;
        const Vector3f at = low + t * (high - low);
        const int x = static_cast<int>(std::lround(at.x()));
        const int y = static_cast<int>(std::lround(at.y()));
        if (!Inside(x, y, 0)) continue;
        const int pixel = y * view_.width + x;
        if (at_pixel_[pixel] == -1) continue;
        const float depth = view_.inverse_depth[pixel];
        if (std::abs(at.z() - depth) * r_.focal_px > kOnSurfacePx * depth) continue;
        crossings_.push_back({at, turn_rad, at_pixel_[pixel]});
        at_pixel_[pixel] = static_cast<int>(crossings_.size()) - 1;
      }
    }
  }

  // Onto the sharp edge that makes the ridge, if one does; otherwise where the turn peaks.
  void PlaceRidges() {
    std::vector<Ridge> kept;
    for (Ridge& r : ridges_) {
      const Vector2f from(r.point.u, r.point.v);
      const Vector2f along(-r.across.y(), r.across.x());
      float best = kSnapAcrossPx;
      for (int dy = -1; dy <= 1; ++dy) {
        for (int dx = -1; dx <= 1; ++dx) {
          for (int c = at_pixel_[r.pixel + dy * view_.width + dx]; c >= 0; c = crossings_[c].next) {
            const Crossing& crossing = crossings_[c];
            const Vector2f off = crossing.at.head<2>() - from;
            const float distance = std::abs(off.dot(r.across)) + 0.3f * std::abs(off.dot(along));
            if (crossing.turn_rad < kSharpShare * r.turn_rad || distance >= best ||
                std::abs(off.dot(along)) > kSnapAlongPx) {
              continue;
            }
            best = distance;
            r.point.u = crossing.at.x();
            r.point.v = crossing.at.y();
            r.point.inverse_depth = crossing.at.z();
            r.point.exact = true;
          }
        }
      }
      if (!r.point.exact) {
        if (r.beside_contour) continue;
        const int t = view_.triangle[r.pixel];
        const InverseDepthPlane plane = PlaneOf(r_, mesh_, t);
        const float here = view_.inverse_depth[r.pixel];
        const float limit = kOnSurfacePx * here / r_.focal_px;
        r.point.inverse_depth = std::clamp(plane.At(r.point.u, r.point.v), here - limit, here + limit);
      }
      r.point.kind = VisibleEdgeKind::kCrease;
      r.point.turn_rad = r.turn_rad;
      kept.push_back(r);
    }
    ridges_ = std::move(kept);
  }

  // The neighbour that goes on best in a direction; -1: none.
  int Follow(int ridge, const Vector2f& heading) const {
    const int pixel = ridges_[ridge].pixel;
    int best = -1;
    float most = kLeastCosine;
    for (int dy = -1; dy <= 1; ++dy) {
      for (int dx = -1; dx <= 1; ++dx) {
        const int other = at_pixel_[pixel + dy * view_.width + dx];
        if (other < 0 || other == ridge || done_[other]) continue;
        const Vector2f off(static_cast<float>(dx), static_cast<float>(dy));
        // The next pixel before the next but one, where a staircase offers both.
        const float score = heading.dot(off.normalized()) + (dx == 0 || dy == 0 ? 0.1f : 0.0f);
        if (score > most) {
          most = score;
          best = other;
        }
      }
    }
    return best;
  }

  std::vector<int> Walk(int from, Vector2f heading) {
    std::vector<int> out;
    for (int at = from;;) {
      const int next = Follow(at, heading);
      if (next < 0) return out;
      done_[next] = 1;
      out.push_back(next);
      Vector2f along(-ridges_[next].across.y(), ridges_[next].across.x());
      heading = along.dot(heading) < 0.0f ? Vector2f(-along) : along;
      at = next;
    }
  }

  ScreenEdges Link() {
    std::fill(at_pixel_.begin(), at_pixel_.end(), -1);
    const int count = static_cast<int>(ridges_.size());
    for (int i = 0; i < count; ++i) at_pixel_[ridges_[i].pixel] = i;
    done_.assign(ridges_.size(), 0);
    ScreenEdges out;
    for (int i = 0; i < count; ++i) {
      if (done_[i]) continue;
      done_[i] = 1;
      const Vector2f along(-ridges_[i].across.y(), ridges_[i].across.x());
      const std::vector<int> forward = Walk(i, along);
      std::vector<int> chain = Walk(i, -along);
      std::reverse(chain.begin(), chain.end());
      chain.push_back(i);
      chain.insert(chain.end(), forward.begin(), forward.end());
      const bool sharp = std::any_of(chain.begin(), chain.end(), [&](int k) {
        return ridges_[k].turn_rad >= high_;
      });
      if (!sharp) continue;
      for (const int k : chain) out.points.push_back(ridges_[k].point);
      out.ends.push_back(static_cast<std::int32_t>(out.points.size()));
    }
    return out;
  }

  static constexpr int kWanted = -2;  // a pixel near a ridge, without a crossing so far

  const Rendering& r_;
  const RenderMesh& mesh_;
  const DepthSteps& steps_;
  const RenderedView& view_;
  const float high_;
  std::vector<Vector3f> normals_;  // towards the camera, object frame
  std::vector<float> power_;
  std::vector<char> cut_;
  std::vector<Ridge> ridges_;
  std::vector<Crossing> crossings_;
  std::vector<int> at_pixel_;  // crossing or ridge there
  std::vector<char> done_;
};

}  // namespace

ScreenEdges Creases(const Rendering& rendering,
                    const RenderMesh& mesh,
                    const DepthSteps& steps,
                    const CreaseOptions& options) {
  return CreaseFinder(rendering, mesh, steps, options).Find();
}

}  // namespace horopter
