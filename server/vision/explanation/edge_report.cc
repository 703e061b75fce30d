#include "server/vision/explanation/edge_report.h"

#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <cstdint>
#include <limits>
#include <optional>

#include "server/vision/geometry/depth_buffer.h"
#include "server/vision/geometry/hidden_tolerance.h"
#include "server/vision/recognition/aspect_search/aspect_score.h"
#include "server/vision/recognition/aspects/render_mesh.h"
#include "server/vision/recognition/aspects/visible_edges.h"

namespace horopter {
namespace {

constexpr double kEdgeRenderPx = 260.0;  // a diameter
constexpr double kOnEdge = 0.012;        // share of the diameter: a point of an enrolled edge
constexpr double kExplainedPx = 4.0;     // working pixels beside a visible edge
constexpr double kWorkingWidth = 640.0;  // of the cells of what is explained

// What is rendered of a part: enrolled parts bring it with their aspects.
const RenderMesh* MeshOf(const PreparedObject& object, std::optional<RenderMesh>* made) {
  if (object.aspects != nullptr) return &object.aspects->object.mesh;
  auto mesh = MakeRenderMesh(object.model.mesh, object.model.diameter_m);
  if (!mesh.ok()) return nullptr;
  *made = *std::move(mesh);
  return &**made;
}

std::vector<VisibleEdgePoint> VisiblePoints(const ExplainedObject& placed,
                                            const PinholeCamera& camera) {
  std::optional<RenderMesh> made;
  const RenderMesh* mesh = MeshOf(*placed.object, &made);
  if (mesh == nullptr) return {};
  VisibleEdgeOptions options;
  options.render_px = kEdgeRenderPx;
  return FindVisibleEdges(*mesh, camera, placed.camera_from_object, options).points;
}

double DistanceToPiece(const Eigen::Vector3d& p,
                       const Eigen::Vector3d& a,
                       const Eigen::Vector3d& b) {
  const Eigen::Vector3d along = b - a;
  const double length = along.squaredNorm();
  const double s = length > 0.0 ? std::clamp((p - a).dot(along) / length, 0.0, 1.0) : 0.0;
  return (p - a - s * along).norm();
}

// The enrolled edges with their bounding boxes.
class EnrolledEdges {
 public:
  explicit EnrolledEdges(const ObjectModel& model) : model_(model) {
    for (const ModelEdge& e : model.edges) {
      Eigen::AlignedBox3d& box = boxes_.emplace_back();
      for (const Eigen::Vector3d& p : e.polyline) box.extend(p);
    }
  }
  // Index of the nearest one within kOnEdge; -1: none.
  int At(const Eigen::Vector3d& p) const {
    double least = kOnEdge * model_.diameter_m;
    int best = -1;
    for (std::size_t e = 0; e < boxes_.size(); ++e) {
      if (boxes_[e].exteriorDistance(p) >= least) continue;
      const auto& line = model_.edges[e].polyline;
      for (std::size_t i = 1; i < line.size(); ++i) {
        const double d = DistanceToPiece(p, line[i - 1], line[i]);
        if (d < least) least = d, best = static_cast<int>(e);
      }
    }
    return best;
  }

 private:
  const ObjectModel& model_;
  std::vector<Eigen::AlignedBox3d> boxes_;
};

// Depth of the parts in the image's working pixels, without its lens.
DepthBuffer DepthOf(std::span<const ExplainedObject> placed,
                    const AspectImage& image,
                    const PinholeCamera& straight) {
  DepthBuffer depth = MakeDepthBuffer(image.width, image.height);
  for (const ExplainedObject& p : placed) {
    RenderDepth(p.object->model.mesh, straight, p.camera_from_object, &depth);
  }
  return depth;
}

}  // namespace

EdgeReport ReportEdges(const AspectImage& image,
                       const PinholeCamera& camera,
                       const ExplainedObject& placed,
                       std::span<const ExplainedObject> others) {
  EdgeReport report;
  if (image.width == 0) return report;
  const PinholeCamera working = WorkingCamera(image, camera);
  PinholeCamera straight = working;
  straight.k1 = 0.0;
  const DepthBuffer depth = DepthOf(others, image, straight);
  const EnrolledEdges enrolled(placed.object->model);
  const double hidden_by = kHiddenShareFound * placed.object->model.diameter_m;
  // Where AspectScore's support is one half.
  const double reach =
      AspectScoreOptions{}.tolerance_px * (2.0 / 3.0) * AspectImage::kDistanceScale;
  const std::vector<VisibleEdgePoint> points = VisiblePoints(placed, working);
  for (std::size_t i = 0; i < points.size(); ++i) {
    const VisibleEdgePoint& p = points[i];
    const Eigen::Vector3d x = placed.camera_from_object * p.point.cast<double>();
    const bool hidden = !IsVisible(depth, Project(straight, x), x.z(), hidden_by);
    const int bin = AspectBin(p.tangent.x(), p.tangent.y());
    const EdgeState state = hidden ? EdgeState::kHidden
                            : image.DistanceAt(p.image.x(), p.image.y(), bin) < reach
                                ? EdgeState::kSupported
                                : EdgeState::kUnsupported;
    const int edge = enrolled.At(p.point.cast<double>());
    const Eigen::Vector2d pixel = OriginalPixel(image, p.image.cast<double>());
    const bool joined = i > 0 && points[i - 1].chain == p.chain;
    if (joined) {
      // The piece between two points is what the second one is.
      const double length = (pixel - report.runs.back().points.back()).norm();
      (hidden ? report.hidden_px : report.visible_px) += length;
      if (state == EdgeState::kSupported) report.supported_px += length;
    }
    if (!joined || report.runs.back().state != state || report.runs.back().edge != edge) {
      EdgeRun run{edge, state, {}};
      if (joined) run.points.push_back(report.runs.back().points.back());
      report.runs.push_back(std::move(run));
    }
    report.runs.back().points.push_back(pixel);
  }
  return report;
}

std::vector<std::vector<Eigen::Vector2d>> UnexplainedEdges(const ImageFeatures& features,
                                                           const PinholeCamera& camera,
                                                           std::span<const ExplainedObject> placed,
                                                           double least_px) {
  const double scale = std::min(1.0, kWorkingWidth / std::max(1, features.width));
  const int width = static_cast<int>(features.width * scale) + 1;
  const int height = static_cast<int>(features.height * scale) + 1;
  std::vector<std::uint8_t> explained(static_cast<std::size_t>(width) * height, 0);
  const int reach = static_cast<int>(kExplainedPx);
  for (const ExplainedObject& one : placed) {
    for (const VisibleEdgePoint& p : VisiblePoints(one, camera)) {
      const int cx = static_cast<int>(p.image.x() * scale);
      const int cy = static_cast<int>(p.image.y() * scale);
      for (int y = std::max(0, cy - reach); y <= std::min(height - 1, cy + reach); ++y) {
        for (int x = std::max(0, cx - reach); x <= std::min(width - 1, cx + reach); ++x)
          explained[static_cast<std::size_t>(y) * width + x] = 1;
      }
    }
  }
  std::vector<std::vector<Eigen::Vector2d>> out;
  for (const EdgeChain& chain : features.chains) {
    std::vector<Eigen::Vector2d> run;
    double length = 0.0;
    const auto finish = [&] {
      if (length >= least_px) out.push_back(run);
      run.clear();
      length = 0.0;
    };
    for (const Eigen::Vector2f& p : chain.points) {
      const int x = std::clamp(static_cast<int>(p.x() * scale), 0, width - 1);
      const int y = std::clamp(static_cast<int>(p.y() * scale), 0, height - 1);
      if (explained[static_cast<std::size_t>(y) * width + x]) {
        finish();
        continue;
      }
      if (!run.empty()) length += (p.cast<double>() - run.back()).norm();
      run.push_back(p.cast<double>());
    }
    finish();
  }
  return out;
}

}  // namespace horopter
