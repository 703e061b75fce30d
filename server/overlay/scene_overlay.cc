#include "server/overlay/scene_overlay.h"

#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <map>
#include <optional>
#include <utility>

#include "server/vision/geometry/depth_buffer.h"

namespace horopter {
namespace {

constexpr double kNearM = 1e-3;
constexpr double kStepPx = 1.5;
constexpr DrawingColor kGrid{150, 150, 170};
constexpr DrawingColor kCaption{255, 255, 255};

struct Painter {
  PinholeCamera camera;
  PinholeCamera straight;  // without distortion, as the depth buffer sees
  const DepthBuffer* depth;
  Drawing* drawing;

  // The visible runs of a straight piece between two points of the camera frame.
  void Piece(const Eigen::Vector3d& a,
             const Eigen::Vector3d& b,
             double tolerance_m,
             const DrawingColor& color) const {
    if (a.z() < kNearM || b.z() < kNearM) return;
    const double length = (Project(straight, a) - Project(straight, b)).norm();
    const double limit = 4.0 * (camera.width + camera.height);  // far outside: not worth walking
    if (!(length < limit)) return;
    const int n = std::max(1, static_cast<int>(std::ceil(length / kStepPx)));
    bool going_on = false;
    for (int i = 0; i < n; ++i) {
      const Eigen::Vector3d p = a + (b - a) * (i / static_cast<double>(n));
      const Eigen::Vector3d q = a + (b - a) * ((i + 1) / static_cast<double>(n));
      const Eigen::Vector3d m = 0.5 * (p + q);
      const bool seen = IsVisible(*depth, Project(straight, m), m.z(), tolerance_m);
      if (seen && !going_on) {
        drawing->strokes.push_back({{Project(camera, p)}, color, LineWidthPx(*drawing)});
      }
      if (seen) drawing->strokes.back().points.push_back(Project(camera, q));
      going_on = seen;
    }
  }
};

// Lowest point of the object in the image: the label goes below it. Nothing when it is behind the
// camera or wholly outside the image.
std::optional<Eigen::Vector2d> LowestPoint(const PinholeCamera& camera,
                                           const OverlayObject& o,
                                           const Drawing& drawing) {
  std::optional<Eigen::Vector2d> lowest;
  bool inside = false;
  for (const Eigen::Vector3d& v : o.model->mesh.vertices) {
    const Eigen::Vector3d p = o.camera_from_object * v;
    if (p.z() < kNearM) return std::nullopt;
    const Eigen::Vector2d pixel = Project(camera, p);
    if (!(pixel.cwiseAbs().maxCoeff() < 1e6)) return std::nullopt;
    inside = inside || (pixel.x() >= 0 && pixel.y() >= 0 && pixel.x() < drawing.width &&
                        pixel.y() < drawing.height);
    if (!lowest || pixel.y() > lowest->y()) lowest = pixel;
  }
  return inside ? lowest : std::nullopt;
}

// Edges of the mesh between a face that is seen and one that is not.
void DrawOutline(const OverlayObject& o, double tolerance_m, const Painter& painter) {
  const TriangleMesh& mesh = o.model->mesh;
  const Eigen::Vector3d eye = o.camera_from_object.Inverse().t;
  std::map<std::pair<int, int>, int> sides;  // bit 0: seen from the front, bit 1: from the back
  for (const Eigen::Vector3i& t : mesh.triangles) {
    const Eigen::Vector3d& a = mesh.vertices[static_cast<size_t>(t[0])];
    const Eigen::Vector3d normal = (mesh.vertices[static_cast<size_t>(t[1])] - a)
                                       .cross(mesh.vertices[static_cast<size_t>(t[2])] - a);
    const int side = normal.dot(eye - a) > 0.0 ? 1 : 2;
    for (int k = 0; k < 3; ++k) sides[std::minmax(int{t[k]}, int{t[(k + 1) % 3]})] |= side;
  }
  for (const auto& [edge, seen] : sides) {
    if (seen != 3) continue;
    painter.Piece(o.camera_from_object * mesh.vertices[static_cast<size_t>(edge.first)],
                  o.camera_from_object * mesh.vertices[static_cast<size_t>(edge.second)],
                  tolerance_m,
                  o.color);
  }
}

void DrawObject(const OverlayObject& o, const Painter& painter) {
  // Of the diameter: an edge lies on the surface it must not be hidden by.
  constexpr double kDepthShare = 0.01;
  const double tolerance = kDepthShare * o.model->diameter_m;
  for (const ModelEdge& e : o.model->edges) {
    for (size_t i = 1; i < e.polyline.size(); ++i) {
      painter.Piece(o.camera_from_object * e.polyline[i - 1],
                    o.camera_from_object * e.polyline[i],
                    tolerance,
                    o.color);
    }
  }
  if (o.model->edges.empty()) DrawOutline(o, tolerance, painter);
}

// Lines in the gripper's frame. Left out when a part of them is behind the camera.
void DrawTool(const PinholeCamera& camera,
              const Rigid3& camera_from_gripper,
              std::span<const std::vector<Eigen::Vector3d>> lines,
              const DrawingColor& color,
              Drawing* drawing) {
  for (const auto& line : lines) {
    for (const Eigen::Vector3d& p : line) {
      if ((camera_from_gripper * p).z() < kNearM) return;
    }
  }
  for (const auto& line : lines) {
    Stroke stroke{{}, color, LineWidthPx(*drawing) + 1.0};
    for (const Eigen::Vector3d& p : line) {
      stroke.points.push_back(Project(camera, camera_from_gripper * p));
    }
    drawing->strokes.push_back(std::move(stroke));
  }
}

}  // namespace

DrawingColor ObjectColor(int k) {
  static constexpr DrawingColor kColors[] = {{60, 220, 60},
                                             {40, 120, 255},
                                             {255, 60, 60},
                                             {255, 210, 0},
                                             {220, 60, 255},
                                             {40, 230, 230},
                                             {255, 90, 140},
                                             {255, 160, 40}};
  return kColors[static_cast<size_t>(k) % std::size(kColors)];
}

double LineWidthPx(const Drawing& drawing) {
  return drawing.width > 1000 ? 2.0 : 1.0;
}

double TextHeightPx(const Drawing& drawing) {
  return std::max(9.0, drawing.width / 72.0);
}

void DrawWireframes(const PinholeCamera& camera,
                    std::span<const OverlayObject> objects,
                    Drawing* drawing) {
  PinholeCamera straight = camera;
  straight.k1 = 0.0;
  DepthBuffer depth = MakeDepthBuffer(drawing->width, drawing->height);
  for (const OverlayObject& o : objects) {
    RenderDepth(o.model->mesh, straight, o.camera_from_object, &depth);
  }
  const Painter painter{camera, straight, &depth, drawing};
  const double height = TextHeightPx(*drawing);
  for (const OverlayObject& o : objects) {
    DrawObject(o, painter);
    const auto at = LowestPoint(camera, o, *drawing);
    if (!at || o.label.empty()) continue;
    const double x = std::clamp(at->x(), 2.0, std::max(2.0, drawing->width - 80.0));
    const double y =
        std::clamp(at->y() + 1.4 * height, 12.0, std::max(12.0, drawing->height - 4.0));
    drawing->labels.push_back({{x, y}, o.label, o.color, height});
  }
}

void DrawGripper(const PinholeCamera& camera,
                 const Rigid3& camera_from_gripper,
                 double opening_m,
                 double finger_m,
                 const DrawingColor& color,
                 Drawing* drawing) {
  const double half = 0.5 * opening_m;
  const std::vector<Eigen::Vector3d> lines[] = {
      {{-half, 0, 0}, {-half, 0, -finger_m}, {half, 0, -finger_m}, {half, 0, 0}},
      {{0, 0, -finger_m}, {0, 0, -1.5 * finger_m}}};
  DrawTool(camera, camera_from_gripper, lines, color, drawing);
}

void DrawSuctionCup(const PinholeCamera& camera,
                    const Rigid3& camera_from_gripper,
                    double radius_m,
                    double length_m,
                    const DrawingColor& color,
                    Drawing* drawing) {
  constexpr int kSides = 24;
  std::vector<Eigen::Vector3d> lines[2];
  for (int i = 0; i <= kSides; ++i) {
    const double angle = 2.0 * M_PI * i / kSides;
    lines[0].emplace_back(radius_m * std::cos(angle), radius_m * std::sin(angle), 0.0);
  }
  lines[1] = {{0, 0, 0}, {0, 0, -length_m}};
  DrawTool(camera, camera_from_gripper, lines, color, drawing);
}

void DrawGrid(const PinholeCamera& camera,
              const Rigid3& camera_from_scene,
              const GridPlane& plane,
              const Eigen::Vector3d& middle,
              double cell_m,
              int cells,
              Drawing* drawing) {
  const Eigen::Vector3d origin =
      middle + (plane.offset_m - plane.normal.dot(middle)) * plane.normal;
  const Eigen::Vector3d u = plane.normal.unitOrthogonal(), v = plane.normal.cross(u);
  const auto line = [&](const Eigen::Vector3d& from, const Eigen::Vector3d& along) {
    Stroke stroke{{}, kGrid, 1.0};
    const auto finish = [&] {
      if (stroke.points.size() > 1) drawing->strokes.push_back(stroke);
      stroke.points.clear();
    };
    for (int i = -cells; i <= cells; ++i) {
      const Eigen::Vector3d p = camera_from_scene * (from + i * cell_m * along);
      const Eigen::Vector2d pixel = p.z() < kNearM ? Eigen::Vector2d::Zero() : Project(camera, p);
      const double reach = 2.0 * (camera.width + camera.height);
      if (p.z() < kNearM || !(pixel.cwiseAbs().maxCoeff() < reach)) {
        finish();
      } else {
        stroke.points.push_back(pixel);
      }
    }
    finish();
  };
  for (int k = -cells; k <= cells; ++k) {
    line(origin + k * cell_m * u, v);
    line(origin + k * cell_m * v, u);
  }
}

void DrawCaption(const std::string& text, Drawing* drawing) {
  const double height = 1.1 * TextHeightPx(*drawing);
  drawing->labels.push_back({{8.0, drawing->height - 0.6 * height}, text, kCaption, height});
}

}  // namespace horopter
