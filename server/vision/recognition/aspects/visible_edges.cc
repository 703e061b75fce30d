#include "server/vision/recognition/aspects/visible_edges.h"

#include <algorithm>
#include <cmath>
#include <utility>

#include "server/vision/recognition/aspects/screen_edges.h"

namespace horopter {
namespace {

// Normals that turn by more within four rendered pixels make a crease: 25 degrees.
constexpr double kCreaseTurnRad = 0.436;
constexpr int kMinVisibleChainPx = 4;  // shorter chains are dropped

using Eigen::Vector2d;
using Eigen::Vector2f;
using Eigen::Vector3f;

constexpr float kLeastSpacingPx = 0.4f;  // rendered; contours cross rows and columns close together
constexpr float kTangentReachPx = 2.0f;  // a tangent is a chord over so much to both sides
constexpr int kSmoothings = 2;           // of points that lie on no edge of the mesh

// Where chains go: from rendered pixels into the image and the object's frame.
class ChainPlacer {
 public:
  ChainPlacer(const RenderMesh& mesh,
              const PinholeCamera& camera,
              const Rigid3& camera_from_object,
              const Rendering& rendering,
              const VisibleEdgeOptions& options)
      : camera_(camera),
        rendering_(rendering),
        options_(options),
        object_from_camera_(camera_from_object.R.transpose().cast<float>()),
        center_(mesh.center),
        center_in_camera_((camera_from_object * mesh.center.cast<double>()).cast<float>()) {}

  void Append(const ScreenEdges& edges, VisibleEdges* out) {
    for (std::size_t c = 0; c < edges.ends.size(); ++c) {
      const int first = c == 0 ? 0 : edges.ends[c - 1];
      std::vector<ScreenEdgePoint> chain;
      for (int i = first; i < edges.ends[c]; ++i) {
        const ScreenEdgePoint& p = edges.points[i];
        if (!chain.empty() &&
            std::hypot(p.u - chain.back().u, p.v - chain.back().v) < kLeastSpacingPx) {
          continue;
        }
        chain.push_back(p);
      }
      Smooth(&chain);
      AppendInside(chain, out);
    }
  }

 private:
  static void Smooth(std::vector<ScreenEdgePoint>* chain) {
    for (int round = 0; round < kSmoothings; ++round) {
      ScreenEdgePoint before = chain->front();
      for (std::size_t i = 1; i + 1 < chain->size(); ++i) {
        ScreenEdgePoint& p = (*chain)[i];
        const ScreenEdgePoint here = p, after = (*chain)[i + 1];
        if (!here.exact) {
          p.u = 0.25f * (before.u + 2.0f * here.u + after.u);
          p.v = 0.25f * (before.v + 2.0f * here.v + after.v);
        }
        before = here;
      }
    }
  }

  // The parts of a chain that are inside the image.
  void AppendInside(const std::vector<ScreenEdgePoint>& chain, VisibleEdges* out) const {
    std::vector<VisibleEdgePoint> part;
    std::vector<Vector2f> screen;
    for (const ScreenEdgePoint& p : chain) {
      const VisibleEdgePoint placed = Place(p);
      const bool inside = placed.image.x() >= -0.5f && placed.image.y() >= -0.5f &&
                          placed.image.x() <= static_cast<float>(camera_.width) - 0.5f &&
                          placed.image.y() <= static_cast<float>(camera_.height) - 0.5f;
      if (!inside) {
        Finish(&part, &screen, out);
        continue;
      }
      part.push_back(placed);
      screen.emplace_back(p.u, p.v);
    }
    Finish(&part, &screen, out);
  }

  VisibleEdgePoint Place(const ScreenEdgePoint& p) const {
    VisibleEdgePoint out;
    const float z = 1.0f / p.inverse_depth;
    const Vector3f in_camera((p.u - rendering_.principal.x()) / rendering_.focal_px * z,
                             (p.v - rendering_.principal.y()) / rendering_.focal_px * z,
                             z);
    out.point = object_from_camera_ * (in_camera - center_in_camera_) + center_;
    out.image = Project(camera_, in_camera.cast<double>()).cast<float>();
    out.kind = p.kind;
    out.turn_rad = p.turn_rad;
    return out;
  }

  void Finish(std::vector<VisibleEdgePoint>* part,
              std::vector<Vector2f>* screen,
              VisibleEdges* out) const {
    float length = 0.0f;
    for (std::size_t i = 1; i < screen->size(); ++i) {
      length += ((*screen)[i] - (*screen)[i - 1]).norm();
    }
    if (length >= static_cast<float>(kMinVisibleChainPx)) {
      SetDirections(*screen, part);
      for (VisibleEdgePoint& p : *part) {
        p.chain = out->chains;
        out->points.push_back(p);
      }
      ++out->chains;
    }
    part->clear();
    screen->clear();
  }

  static void SetDirections(const std::vector<Vector2f>& screen,
                            std::vector<VisibleEdgePoint>* part) {
    const int count = static_cast<int>(screen.size());
    const bool closed = count > 8 && (screen.front() - screen.back()).norm() < 2.0f;
    const auto reach = [&](int i, int step) {
      int j = i;
      for (int k = 0; k < count / 3; ++k) {
        int next = j + step;
        if (closed) next = (next + count) % count;
        if (next < 0 || next >= count) break;
        j = next;
        if ((screen[j] - screen[i]).norm() >= kTangentReachPx) break;
      }
      return j;
    };
    for (int i = 0; i < count; ++i) {
      int before = reach(i, -1), after = reach(i, 1);
      if (before == after) {
        before = std::max(0, i - 1);
        after = std::min(count - 1, i + 1);
      }
      (*part)[i].tangent = ((*part)[after].image - (*part)[before].image).normalized();
      (*part)[i].direction = ((*part)[after].point - (*part)[before].point).normalized();
    }
  }

  const PinholeCamera& camera_;
  const Rendering& rendering_;
  const VisibleEdgeOptions& options_;
  const Eigen::Matrix3f object_from_camera_;
  const Vector3f center_;
  const Vector3f center_in_camera_;
};

Rendering RenderFor(const RenderMesh& mesh,
                    const PinholeCamera& camera,
                    const Rigid3& camera_from_object,
                    const VisibleEdgeOptions& options) {
  return Render(mesh, camera, camera_from_object, {options.render_px, options.max_scale});
}

}  // namespace

RenderedView RenderView(const RenderMesh& mesh,
                        const PinholeCamera& camera,
                        const Rigid3& camera_from_object,
                        const VisibleEdgeOptions& options) {
  return std::move(RenderFor(mesh, camera, camera_from_object, options).view);
}

VisibleEdges FindVisibleEdges(const RenderMesh& mesh,
                              const PinholeCamera& camera,
                              const Rigid3& camera_from_object,
                              const VisibleEdgeOptions& options) {
  VisibleEdges out;
  Rendering rendering = RenderFor(mesh, camera, camera_from_object, options);
  if (rendering.view.width == 0) return out;
  const DepthSteps steps = FindDepthSteps(rendering, mesh, options.occlusion_jump_px);
  ChainPlacer placer(mesh, camera, camera_from_object, rendering, options);
  placer.Append(OccludingContours(rendering, mesh, steps), &out);
  if (options.creases) {
    placer.Append(Creases(rendering, mesh, steps, {kCreaseTurnRad}), &out);
  }
  out.view = std::move(rendering.view);
  return out;
}

}  // namespace horopter
