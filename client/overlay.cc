#include "client/overlay.h"

#include <algorithm>
#include <cmath>
#include <opencv2/imgproc.hpp>
#include <optional>

#include "server/vision/geometry/depth_buffer.h"

namespace horopter {
namespace {

constexpr double kNearM = 1e-3;
constexpr double kStepPx = 1.5;

cv::Scalar ColorOf(int index) {
  static const cv::Scalar kColors[] = {{60, 220, 60},
                                       {255, 120, 40},
                                       {60, 60, 255},
                                       {0, 210, 255},
                                       {255, 60, 220},
                                       {230, 230, 40},
                                       {140, 90, 255},
                                       {40, 160, 255}};
  return kColors[static_cast<size_t>(index) % std::size(kColors)];
}

cv::Point ToPoint(const Eigen::Vector2d& p) {
  constexpr double kFixed = 16.0;  // sub-pixel drawing with 4 fractional bits
  return {static_cast<int>(std::lround(p.x() * kFixed)),
          static_cast<int>(std::lround(p.y() * kFixed))};
}

struct Painter {
  PinholeCamera camera;
  PinholeCamera straight;  // without distortion, as the depth buffer sees
  const DepthBuffer* depth;
  cv::Mat* image;
  int thickness = 1;

  // Draws the visible runs of a straight piece between two points of the camera frame.
  void Piece(const Eigen::Vector3d& a,
             const Eigen::Vector3d& b,
             double tolerance_m,
             const cv::Scalar& color) const {
    if (a.z() < kNearM || b.z() < kNearM) return;
    const double length = (Project(straight, a) - Project(straight, b)).norm();
    const double limit = 4.0 * (camera.width + camera.height);  // far outside: not worth walking
    if (!(length < limit)) return;
    const int n = std::max(1, static_cast<int>(std::ceil(length / kStepPx)));
    for (int i = 0; i < n; ++i) {
      const Eigen::Vector3d p = a + (b - a) * (i / static_cast<double>(n));
      const Eigen::Vector3d q = a + (b - a) * ((i + 1) / static_cast<double>(n));
      const Eigen::Vector3d m = 0.5 * (p + q);
      if (!IsVisible(*depth, Project(straight, m), m.z(), tolerance_m)) continue;
      cv::line(*image,
               ToPoint(Project(camera, p)),
               ToPoint(Project(camera, q)),
               color,
               thickness,
               cv::LINE_AA,
               4);
    }
  }
};

void PutText(
    const std::string& text, cv::Point at, double scale, const cv::Scalar& color, cv::Mat* image) {
  if (text.empty()) return;
  int baseline = 0;
  const cv::Size size = cv::getTextSize(text, cv::FONT_HERSHEY_SIMPLEX, scale, 1, &baseline);
  cv::rectangle(*image,
                at + cv::Point(-2, baseline),
                at + cv::Point(size.width + 2, -size.height - 2),
                {25, 25, 25},
                cv::FILLED);
  cv::putText(*image, text, at, cv::FONT_HERSHEY_SIMPLEX, scale, color, 1, cv::LINE_AA);
}

// Lowest point of the object in the image: the label goes below it. Nothing when it is behind the
// camera or wholly outside the image.
std::optional<cv::Point> LabelPosition(const PinholeCamera& camera,
                                       const OverlayObject& o,
                                       cv::Size size) {
  std::optional<cv::Point> lowest;
  bool inside = false;
  for (const Eigen::Vector3d& v : o.model->mesh.vertices) {
    const Eigen::Vector3d p = o.camera_from_object * v;
    if (p.z() < kNearM) return std::nullopt;
    const Eigen::Vector2d pixel = Project(camera, p);
    if (!(pixel.cwiseAbs().maxCoeff() < 1e6)) return std::nullopt;
    inside = inside || (pixel.x() >= 0 && pixel.y() >= 0 && pixel.x() < size.width &&
                        pixel.y() < size.height);
    if (!lowest || pixel.y() > lowest->y) {
      lowest = cv::Point(static_cast<int>(pixel.x()), static_cast<int>(pixel.y()));
    }
  }
  return inside ? lowest : std::nullopt;
}

}  // namespace

void DrawOverlay(const PinholeCamera& camera,
                 std::span<const OverlayObject> objects,
                 cv::Mat* image) {
  PinholeCamera straight = camera;
  straight.k1 = 0.0;
  DepthBuffer depth = MakeDepthBuffer(image->cols, image->rows);
  for (const OverlayObject& o : objects) {
    RenderDepth(o.model->mesh, straight, o.camera_from_object, &depth);
  }
  const Painter painter{camera, straight, &depth, image, image->cols > 1000 ? 2 : 1};
  const double text_scale = std::max(0.4, image->cols / 1600.0);
  for (const OverlayObject& o : objects) {
    constexpr double kDepthShare =
        0.01;  // of the diameter: an edge lies on the surface it must not be hidden by
    const double tolerance = kDepthShare * o.model->diameter_m;
    for (const ModelEdge& e : o.model->edges) {
      for (size_t i = 1; i < e.polyline.size(); ++i) {
        painter.Piece(o.camera_from_object * e.polyline[i - 1],
                      o.camera_from_object * e.polyline[i],
                      tolerance,
                      ColorOf(o.color));
      }
    }
    const auto at = LabelPosition(camera, o, image->size());
    if (!at) continue;
    const int x = std::clamp(at->x, 2, std::max(2, image->cols - 80));
    const int y = std::clamp(at->y + static_cast<int>(30 * text_scale), 12, image->rows - 4);
    PutText(o.label, {x, y}, text_scale, ColorOf(o.color), image);
  }
}

void DrawGripper(const PinholeCamera& camera,
                 const Rigid3& camera_from_gripper,
                 double opening_m,
                 double finger_m,
                 const cv::Scalar& color,
                 cv::Mat* image) {
  const double half = 0.5 * opening_m;
  const Eigen::Vector3d ends[4][2] = {{{-half, 0, 0}, {-half, 0, -finger_m}},
                                      {{half, 0, 0}, {half, 0, -finger_m}},
                                      {{-half, 0, -finger_m}, {half, 0, -finger_m}},
                                      {{0, 0, -finger_m}, {0, 0, -1.5 * finger_m}}};
  for (const auto& line : ends) {
    for (const Eigen::Vector3d& end : line) {
      if ((camera_from_gripper * end).z() < kNearM) return;
    }
  }
  for (const auto& line : ends) {
    cv::line(*image,
             ToPoint(Project(camera, camera_from_gripper * line[0])),
             ToPoint(Project(camera, camera_from_gripper * line[1])),
             color,
             image->cols > 1000 ? 3 : 2,
             cv::LINE_AA,
             4);
  }
}

void DrawCaption(const std::string& text, cv::Mat* image) {
  const double scale = std::max(0.45, image->cols / 1400.0);
  PutText(text, {8, image->rows - 10}, scale, {255, 255, 255}, image);
}

cv::Mat Tile(std::span<const cv::Mat> images, int tile_width) {
  if (images.empty()) return {};
  std::vector<cv::Mat> tiles;
  cv::Size cell(0, 0);
  for (const cv::Mat& image : images) {
    const double scale = std::min(1.0, static_cast<double>(tile_width) / image.cols);
    cv::Mat tile;
    cv::resize(image, tile, {}, scale, scale, cv::INTER_AREA);
    cell.width = std::max(cell.width, tile.cols);
    cell.height = std::max(cell.height, tile.rows);
    tiles.push_back(tile);
  }
  const int n = static_cast<int>(tiles.size());
  const int columns = static_cast<int>(std::ceil(std::sqrt(n)));
  const int rows = (n + columns - 1) / columns;
  cv::Mat out(rows * cell.height, columns * cell.width, CV_8UC3, cv::Scalar(30, 30, 30));
  for (int i = 0; i < n; ++i) {
    tiles[i].copyTo(
        out({i % columns * cell.width, i / columns * cell.height, tiles[i].cols, tiles[i].rows}));
  }
  return out;
}

}  // namespace horopter
