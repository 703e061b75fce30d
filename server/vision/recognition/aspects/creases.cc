#include <Eigen/Dense>
#include <algorithm>
#include <array>
#include <cmath>
#include <cstdint>
#include <cstring>

#include "server/base/lanes.h"
#include "server/base/rounded.h"
#include "server/base/target_clones.h"
#include "server/vision/recognition/aspects/screen_edges.h"

namespace horopter {
namespace {

using Eigen::Vector2f;
using Eigen::Vector3f;

constexpr float kLowShare = 0.7f;      // of the turn, for a chain to go on
constexpr float kSharpShare = 0.6f;    // such an edge explains turns up to its own / this
constexpr float kOnSurfacePx = 3.0f;   // it is as deep as the surface, in footprints
constexpr float kSnapAcrossPx = 1.3f;  // and so near the ridge
constexpr float kSnapAlongPx = 0.8f;   // ... and so near along it; chosen
constexpr float kSteepShare = 0.5f;    // squared turn along a line against that across it
constexpr float kLinkPx = 1.8f;        // between points of a chain
constexpr int kBorderPx = 4;           // of the window, which every search stays in
constexpr float kLeastCosine = 0.5f;   // a chain bends by less from point to point

// A peak of the turning of the normals along a row or column of pixels.
struct Ridge {
  Vector2f across = Vector2f::UnitX();  // unit, the direction in which the normal turns
  bool beside_contour = false;          // the window was cut off: what turns may be a limb
  ScreenEdgePoint point;
  int next = -1;  // at the same pixel
};

// Where an edge of the mesh crosses a row or column.
struct Crossing {
  Vector3f at;     // u, v, inverse depth
  Vector2f along;  // unit
  float turn_rad;
  int next;  // at the same pixel
};

// Between two neighbouring pixels: over their two normals and the two beyond, so that it is largest
// at a step.
struct Turn {
  Vector3f weighted;
  float wide = 0.0f;  // squared, over all four
};

constexpr float kCut = -1.0f;  // no turn: a contour runs between the pixels

// The normals' coordinates, and for each pixel whether a contour runs to the one a stride on.
struct TurnInput {
  std::array<const float*, 3> normal;
  const std::int32_t* cut;
  const std::int32_t* triangle;  // -1: background
};

// Squared turn between pixels [begin, end) and those a stride on: kCut where a contour runs
// between, 0 on the background. Reads and writes up to kLanes - 1 pixels more.
HOROPTER_TARGET_CLONES
void FillTurnPower(const TurnInput& in, int stride, int begin, int end, float* power) {
  for (int i = begin; i < end; i += kLanes) {
    const int j = i + stride;
    IntLanes cut, cut_before, cut_after, triangle;
    LoadLanes(in.cut + i, &cut);
    LoadLanes(in.cut + i - stride, &cut_before);
    LoadLanes(in.cut + j, &cut_after);
    LoadLanes(in.triangle + i, &triangle);
    FloatLanes squares[3];
    for (int k = 0; k < 3; ++k) {
      FloatLanes before, here, next, after;
      LoadLanes(in.normal[k] + i - stride, &before);
      LoadLanes(in.normal[k] + i, &here);
      LoadLanes(in.normal[k] + j, &next);
      LoadLanes(in.normal[k] + j + stride, &after);
      const FloatLanes wide = (cut_after != 0 ? next : after) - (cut_before != 0 ? here : before);
      const FloatLanes turn = (2.0f * (next - here) + wide) / 3.0f;
      squares[k] = turn * turn;
    }
    FloatLanes out = squares[0] + (squares[1] + squares[2]);
    out = cut != 0 ? FloatLanes{} + kCut : out;
    out = triangle < 0 ? FloatLanes{} : out;
    std::memcpy(power + i, &out, sizeof(out));
  }
}

bool AllBelow(const float* values, float least) {
  bool any = false;
  for (int k = 0; k < kLanes; ++k) any |= values[k] > least;
  return !any;
}

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
    for (const int axis : {0, 1}) FillTurns(axis);
    for (const int axis : {0, 1}) FindRidges(axis);
    CrossSharpEdges();
    PlaceRidges();
    return Link();
  }

 private:
  void FillNormals() {
    for (std::vector<float>& n : normals_) n.assign(view_.triangle.size(), 0.0f);
    int last = -1;  // triangle, if it is flat: the same for many pixels
    Vector3f of_last = Vector3f::Zero();
    for (int y = 0, i = 0; y < view_.height; ++y) {
      for (int x = 0; x < view_.width; ++x, ++i) {
        const int t = view_.triangle[i];
        if (t < 0) continue;
        if (t != last) {
          const bool flat = mesh_.flat[t] != 0;
          const Vector3f n = flat ? mesh_.face_normals[t]
                                  : Interpolated(t, static_cast<float>(x), static_cast<float>(y));
          of_last = r_.facing[t] < 0 ? Vector3f(-n) : n;
          last = flat ? t : -1;
        }
        for (int k = 0; k < 3; ++k) normals_[k][i] = of_last[k];
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

  int Stride(int axis) const { return axis == 0 ? 1 : view_.width; }

  Vector3f NormalAt(int i) const { return {normals_[0][i], normals_[1][i], normals_[2][i]}; }

  // Pixels i and i + stride must belong to one surface.
  Turn TurnAt(int i, int stride) const {
    const int j = i + stride;
    const int before = steps_.Between(i - stride, i) ? i : i - stride;
    const int after = steps_.Between(j, j + stride) ? j : j + stride;
    const Vector3f wide = NormalAt(after) - NormalAt(before);
    return {(2.0f * (NormalAt(j) - NormalAt(i)) + wide) / 3.0f, wide.squaredNorm()};
  }

  void FillTurns(int axis) {
    std::vector<float>& power = power_[axis];
    power.assign(view_.triangle.size(), 0.0f);
    const int stride = Stride(axis);
    cut_.assign(view_.triangle.size(), 0);
    const int last = static_cast<int>(cut_.size()) - stride;
    // DepthSteps::Between along one axis, without its choice.
    const std::uint8_t* farther = steps_.farther.data();
    for (int i = 0; i < last; ++i)
      cut_[i] = (farther[i] >> axis & 1) | (farther[i + stride] >> (axis + 2) & 1);
    const TurnInput in{{normals_[0].data(), normals_[1].data(), normals_[2].data()},
                       cut_.data(),
                       view_.triangle.data()};
    const int w = view_.width, first = kBorderPx * w, end = (view_.height - kBorderPx) * w;
    FillTurnPower(in, stride, first, end, power.data());
    // Nothing turns at the border, and nothing that was written beyond the last row.
    for (int i = first; i < end; i += w) {
      std::fill_n(power.begin() + i, kBorderPx, 0.0f);
      std::fill_n(power.begin() + i + w - kBorderPx, kBorderPx, 0.0f);
    }
    std::fill_n(power.begin() + std::max(first, end), kLanes, 0.0f);
  }

  void FindRidges(int axis) {
    const std::vector<float>& power = power_[axis];
    const std::vector<float>& other = power_[1 - axis];
    const int stride = Stride(axis), side = Stride(1 - axis);
    const float low = 2.0f * std::sin(0.5f * kLowShare * high_);
    // Weights of the turn add up to at most the widest one within.
    const float least = 0.1f * low * low;
    const int size = static_cast<int>(power.size());
    for (int i = 0; i < size; ++i) {
      if (i + kLanes <= size && AllBelow(power.data() + i, least)) {
        i += kLanes - 1;
        continue;
      }
      const float here = power[i];
      if (here <= least || power[i - stride] >= here || power[i + stride] > here) {
        continue;
      }
      const Turn turn = TurnAt(i, stride);
      if (turn.wide < low * low) continue;
      int steepest = i;
      for (const int k : {i - side, i + stride, i + stride - side}) {
        if (other[k] > other[steepest]) steepest = k;
      }
      if (here < kSteepShare * other[steepest]) continue;
      ridges_.push_back(RidgeAt(i, axis, turn, steepest));
    }
  }

  Ridge RidgeAt(int i, int axis, const Turn& turn, int steepest) const {
    const std::vector<float>& power = power_[axis];
    const int stride = Stride(axis), side = Stride(1 - axis);
    Ridge ridge;
    Vector2f across = Vector2f::Zero();
    across[axis] = turn.weighted.norm();
    if (power_[1 - axis][steepest] > 0.0f) {
      const Vector3f sideways = TurnAt(steepest, side).weighted;
      across[1 - axis] = sideways.norm() * (sideways.dot(turn.weighted) < 0.0f ? -1.0f : 1.0f);
    }
    ridge.across = across.normalized();
    ridge.beside_contour = power[i - stride] < 0.0f || power[i + stride] < 0.0f ||
                           power[i - 2 * stride] < 0.0f || power[i + 2 * stride] < 0.0f;
    const float before = std::sqrt(std::max(0.0f, power[i - stride]));
    const float after = std::sqrt(std::max(0.0f, power[i + stride]));
    const float bend = before - 2.0f * std::sqrt(power[i]) + after;
    Vector2f at(static_cast<float>(i % view_.width), static_cast<float>(i / view_.width));
    at[axis] += 0.5f;
    if (bend < 0.0f) at[axis] += std::clamp(0.5f * (before - after) / bend, -0.5f, 0.5f);
    ridge.point.u = at.x();
    ridge.point.v = at.y();
    ridge.point.kind = VisibleEdgeKind::kCrease;
    ridge.point.turn_rad = 2.0f * std::asin(std::min(1.0f, 0.5f * std::sqrt(turn.wide)));
    return ridge;
  }

  int PixelOf(float u, float v) const { return Rounded(v) * view_.width + Rounded(u); }

  void CrossSharpEdges() {
    at_pixel_.assign(view_.triangle.size(), kIdle);
    for (const Ridge& r : ridges_) {
      const int pixel = PixelOf(r.point.u, r.point.v);
      for (int dy = -1; dy <= 1; ++dy) {
        for (int dx = -1; dx <= 1; ++dx) at_pixel_[pixel + dy * view_.width + dx] = kWanted;
      }
    }
    for (const auto& [e, turn_rad] : mesh_.sharp_edges) {
      if (!(r_.screen[e.a].z() > 0.0f && r_.screen[e.b].z() > 0.0f)) continue;
      if (r_.facing[e.left] == 0 || r_.facing[e.right] == 0) continue;
      if (((r_.facing[e.left] > 0) != (r_.facing[e.right] > 0)) != e.same_winding) continue;
      if (mesh_.closed && r_.facing[e.left] < 0) continue;
      Cross(e, turn_rad);
    }
  }

  void Cross(const RenderMeshEdge& e, float turn_rad) {
    const Vector3f& p = r_.screen[e.a];
    const Vector3f& q = r_.screen[e.b];
    const Vector2f along = (q - p).head<2>().normalized();
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
        if (!(at.x() > -0.5f && at.y() > -0.5f && at.x() < static_cast<float>(view_.width) - 0.5f &&
              at.y() < static_cast<float>(view_.height) - 0.5f)) {
          continue;
        }
        const int pixel = PixelOf(at.x(), at.y());
        if (at_pixel_[pixel] == kIdle || !OnSurface(at, pixel, e)) continue;
        crossings_.push_back({at, along, turn_rad, at_pixel_[pixel]});
        at_pixel_[pixel] = static_cast<int>(crossings_.size()) - 1;
      }
    }
  }

  bool OnSurface(const Vector3f& at, int pixel, const RenderMeshEdge& e) const {
    const int t = view_.triangle[pixel];
    if (t < 0) return false;
    if (t == e.left || t == e.right) return true;
    const float allowed = kOnSurfacePx * at.z() / r_.focal_px;
    return std::abs(at.z() - view_.inverse_depth[pixel]) < allowed ||
           std::abs(at.z() - PlaneOf(r_, mesh_, t).At(at.x(), at.y())) < allowed;
  }

  // Onto the sharp edge that makes the ridge, if one does; otherwise where the turn peaks.
  void PlaceRidges() {
    std::vector<Ridge> kept;
    kept.reserve(ridges_.size());
    for (Ridge& r : ridges_) {
      const int pixel = PixelOf(r.point.u, r.point.v);
      const int crossing = SharpEdgeAt(r, pixel);
      if (crossing >= 0) {
        const Crossing& c = crossings_[crossing];
        r.point.u = c.at.x();
        r.point.v = c.at.y();
        r.point.inverse_depth = c.at.z();
        r.point.exact = true;
        r.across = {-c.along.y(), c.along.x()};
      } else if (r.beside_contour || view_.triangle[pixel] < 0) {
        continue;
      } else {
        const float here = view_.inverse_depth[pixel];
        const float limit = kOnSurfacePx * here / r_.focal_px;
        const float plane = PlaneOf(r_, mesh_, view_.triangle[pixel]).At(r.point.u, r.point.v);
        r.point.inverse_depth = std::clamp(plane, here - limit, here + limit);
      }
      kept.push_back(r);
    }
    ridges_ = std::move(kept);
  }

  int SharpEdgeAt(const Ridge& r, int pixel) const {
    const Vector2f from(r.point.u, r.point.v);
    int found = -1;
    float best = kSnapAcrossPx;
    for (int dy = -1; dy <= 1; ++dy) {
      for (int dx = -1; dx <= 1; ++dx) {
        for (int c = at_pixel_[pixel + dy * view_.width + dx]; c >= 0; c = crossings_[c].next) {
          const Vector2f off = crossings_[c].at.head<2>() - from;
          const float along = std::abs(off.dot(crossings_[c].along));
          const float distance = off.norm();
          if (crossings_[c].turn_rad < kSharpShare * r.point.turn_rad || distance >= best ||
              along > kSnapAlongPx) {
            continue;
          }
          best = distance;
          found = c;
        }
      }
    }
    return found;
  }

  // Whether no ridge is left within two pixels in the row.
  bool NoneWithin2(int pixel) const {
    std::uint64_t around = 0;
    std::memcpy(&around, left_.data() + pixel - 2, 5);
    return around == 0;
  }

  void Done(int ridge) {
    done_[ridge] = 1;
    --left_[PixelOf(ridges_[ridge].point.u, ridges_[ridge].point.v)];
  }

  // The point that goes on best in a direction; -1: none.
  int Follow(int from, const Vector2f& heading) const {
    const ScreenEdgePoint& p = ridges_[from].point;
    const int pixel = PixelOf(p.u, p.v);
    int found = -1;
    float least = kLinkPx;
    for (int dy = -2; dy <= 2; ++dy) {
      const int row = pixel + dy * view_.width;
      if (NoneWithin2(row)) continue;
      for (int dx = -2; dx <= 2; ++dx) {
        for (int k = at_pixel_[row + dx]; k >= 0; k = ridges_[k].next) {
          if (done_[k]) continue;
          const Vector2f off(ridges_[k].point.u - p.u, ridges_[k].point.v - p.v);
          const float length = off.norm();
          if (length >= kLinkPx) continue;
          const float cosine = length < 0.3f ? 1.0f : heading.dot(off) / length;
          if (cosine < kLeastCosine) continue;
          const float cost = length * (2.0f - cosine);
          if (cost < least) {
            least = cost;
            found = k;
          }
        }
      }
    }
    return found;
  }

  std::vector<int> Walk(int from, Vector2f heading) {
    std::vector<int> out;
    for (int at = from;;) {
      const int next = Follow(at, heading);
      if (next < 0) return out;
      Done(next);
      out.push_back(next);
      const Ridge& r = ridges_[next];
      Vector2f along(-r.across.y(), r.across.x());
      if (along.dot(heading) < 0.0f) along = -along;
      heading = r.point.exact ? along : Vector2f((along + heading).normalized());
      at = next;
    }
  }

  ScreenEdges Link() {
    std::fill(at_pixel_.begin(), at_pixel_.end(), -1);
    left_.assign(at_pixel_.size(), 0);
    const int count = static_cast<int>(ridges_.size());
    for (int i = count - 1; i >= 0; --i) {
      int& head = at_pixel_[PixelOf(ridges_[i].point.u, ridges_[i].point.v)];
      ridges_[i].next = head;
      head = i;
      ++left_[PixelOf(ridges_[i].point.u, ridges_[i].point.v)];
    }
    done_.assign(ridges_.size(), 0);
    ScreenEdges out;
    for (int i = 0; i < count; ++i) {
      if (done_[i]) continue;
      Done(i);
      const Vector2f along(-ridges_[i].across.y(), ridges_[i].across.x());
      const std::vector<int> forward = Walk(i, along);
      std::vector<int> chain = Walk(i, -along);
      std::reverse(chain.begin(), chain.end());
      chain.push_back(i);
      chain.insert(chain.end(), forward.begin(), forward.end());
      const bool sharp = std::any_of(
          chain.begin(), chain.end(), [&](int k) { return ridges_[k].point.turn_rad >= high_; });
      if (!sharp) continue;
      for (const int k : chain) out.points.push_back(ridges_[k].point);
      out.ends.push_back(static_cast<std::int32_t>(out.points.size()));
    }
    return out;
  }

  static constexpr int kIdle = -1;    // a pixel that no ridge is near
  static constexpr int kWanted = -2;  // a pixel near a ridge, without a crossing so far

  const Rendering& r_;
  const RenderMesh& mesh_;
  const DepthSteps& steps_;
  const RenderedView& view_;
  const float high_;
  std::array<std::vector<float>, 3> normals_;  // x, y, z, towards the camera, object frame
  std::vector<std::int32_t> cut_;              // a contour runs to the next pixel of the axis
  std::array<std::vector<float>, 2> power_;    // squared turn to the right and lower neighbour
  std::vector<Ridge> ridges_;
  std::vector<Crossing> crossings_;
  std::vector<int> at_pixel_;  // crossing or ridge there
  std::vector<char> done_;
  std::vector<std::uint8_t> left_;  // ridges of each pixel that are on no chain yet
};

}  // namespace

ScreenEdges Creases(const Rendering& rendering,
                    const RenderMesh& mesh,
                    const DepthSteps& steps,
                    const CreaseOptions& options) {
  return CreaseFinder(rendering, mesh, steps, options).Find();
}

}  // namespace horopter
