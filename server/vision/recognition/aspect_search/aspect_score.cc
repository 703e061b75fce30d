#include "server/vision/recognition/aspect_search/aspect_score.h"

#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <cstdint>
#include <optional>
#include <vector>

#include "server/base/rounded.h"
#include "server/base/target_clones.h"
#include "server/vision/recognition/aspect_search/object_layers.h"
#include "server/vision/recognition/aspects/visible_edges.h"

namespace horopter {
namespace {

constexpr double kScoreTurnRad = 0.45;   // between directions of model and image edge
constexpr double kHalfLengthPx = 200.0;  // supported px at which the size factor is one half
// Of the size: image edges so near the silhouette must be explained as well
constexpr double kMarginShare = 0.10;
// An image edge is print on the surface when the siblings that see its place, at least two, show a
// like-directed edge there with this support above chance.
constexpr double kPrintSupport = 0.5;
// How the part stands among others.
struct Seen {
  const Rigid3& camera_from_object;
  std::span<const ObjectLayer* const> others;
  double hidden_m = 0.0;
  std::span<const SiblingView> siblings;
};

// Nearest model edge point of each working pixel near the part, within the tolerance.
struct ModelRaster {
  int x0 = 0, y0 = 0, width = 0, height = 0;
  std::vector<std::int32_t> nearest;
  std::vector<float> squared;
};

ModelRaster RasterEdges(const VisibleEdges& edges, const AspectImage& image, double tolerance) {
  ModelRaster raster;
  float low_x = 1e9f, low_y = 1e9f, high_x = -1e9f, high_y = -1e9f;
  for (const VisibleEdgePoint& p : edges.points) {
    low_x = std::min(low_x, p.image.x());
    low_y = std::min(low_y, p.image.y());
    high_x = std::max(high_x, p.image.x());
    high_y = std::max(high_y, p.image.y());
  }
  const int reach = static_cast<int>(std::ceil(tolerance));
  raster.x0 = std::max(0, static_cast<int>(low_x) - reach);
  raster.y0 = std::max(0, static_cast<int>(low_y) - reach);
  raster.width = std::min(image.width, static_cast<int>(high_x) + reach + 2) - raster.x0;
  raster.height = std::min(image.height, static_cast<int>(high_y) + reach + 2) - raster.y0;
  if (raster.width <= 0 || raster.height <= 0) return {};
  raster.nearest.assign(static_cast<std::size_t>(raster.width) * raster.height, -1);
  raster.squared.assign(raster.nearest.size(), static_cast<float>(tolerance * tolerance));
  for (std::size_t i = 0; i < edges.points.size(); ++i) {
    const Eigen::Vector2f& p = edges.points[i].image;
    const int cx = Rounded(p.x()) - raster.x0;
    const int cy = Rounded(p.y()) - raster.y0;
    for (int y = std::max(0, cy - reach); y <= std::min(raster.height - 1, cy + reach); ++y) {
      for (int x = std::max(0, cx - reach); x <= std::min(raster.width - 1, cx + reach); ++x) {
        const float dx = static_cast<float>(x + raster.x0) - p.x();
        const float dy = static_cast<float>(y + raster.y0) - p.y();
        const std::size_t cell = static_cast<std::size_t>(y) * raster.width + x;
        if (dx * dx + dy * dy >= raster.squared[cell]) continue;
        raster.squared[cell] = dx * dx + dy * dy;
        raster.nearest[cell] = static_cast<std::int32_t>(i);
      }
    }
  }
  return raster;
}

// Distance of every rendered pixel to the part, rendered pixels (3-4 chamfer, thirds of pixels),
// in a window widened by `margin`.
struct SilhouetteDistance {
  int margin = 0, width = 0, height = 0;
  std::vector<std::int16_t> thirds;  // with a cell more, far away, around the window

  std::int16_t* Row(int y) { return thirds.data() + Cell(0, y); }
  std::size_t Cell(int x, int y) const {
    return (static_cast<std::size_t>(y) + 1) * (static_cast<std::size_t>(width) + 2) +
           static_cast<std::size_t>(x) + 1;
  }
};

// What a row is told by the one before it, which is read one beyond its ends: a step straight on is
// 3, one across 4.
HOROPTER_TARGET_CLONES
void RelaxFromRow(const std::int16_t* before, int width, std::int16_t* row) {
  for (int x = 0; x < width; ++x) {
    const auto across = static_cast<std::int16_t>(std::min(before[x - 1], before[x + 1]) + 4);
    const auto straight = static_cast<std::int16_t>(before[x] + 3);
    row[x] = std::min(row[x], std::min(across, straight));
  }
}

SilhouetteDistance DistanceToSilhouette(const RenderedView& view, int margin) {
  constexpr std::int16_t kFar = 30000;  // more than any distance, and not the most of 16 bits
  SilhouetteDistance out;
  out.margin = margin;
  out.width = view.width + 2 * margin;
  out.height = view.height + 2 * margin;
  const int w = out.width, h = out.height;
  out.thirds.assign((static_cast<std::size_t>(w) + 2) * (static_cast<std::size_t>(h) + 2), kFar);
  for (int y = 0; y < view.height; ++y) {
    std::int16_t* at = out.Row(y + margin) + margin;
    for (int x = 0; x < view.width; ++x) at[x] = view.Covered(x, y) ? 0 : kFar;
  }
  for (int y = 0; y < h; ++y) {
    std::int16_t* d = out.Row(y);
    RelaxFromRow(out.Row(y - 1), w, d);
    for (int x = 1; x < w; ++x) d[x] = std::min<std::int16_t>(d[x], d[x - 1] + 3);
  }
  for (int y = h - 1; y >= 0; --y) {
    std::int16_t* d = out.Row(y);
    RelaxFromRow(out.Row(y + 1), w, d);
    for (int x = w - 2; x >= 0; --x) d[x] = std::min<std::int16_t>(d[x], d[x + 1] + 3);
  }
  return out;
}

// How much more than is free a place and direction support anything.
double ExcessChance(const AspectImage& image,
                    const Eigen::Vector2f& at,
                    int bin,
                    const AspectScoreOptions& options) {
  if (!(at.x() >= 0 && at.y() >= 0 && at.x() < image.width && at.y() < image.height)) return 0.0;
  const int level = AspectImage::ChanceLevel(static_cast<float>(options.tolerance_px));
  return std::max(0.0, image.ChanceAt(at.x(), at.y(), bin, level) / 255.0 - options.free_chance);
}

// Precision, supported and visible length.
void ScoreModelEdges(const AspectImage& image,
                     const VisibleEdges& edges,
                     const Seen& seen,
                     const AspectScoreOptions& options,
                     AspectScore* score) {
  const float tolerance = static_cast<float>(options.tolerance_px * AspectImage::kDistanceScale);
  const std::size_t n = edges.points.size();
  double chance_px = 0.0;
  for (std::size_t i = 0; i < n; ++i) {
    const VisibleEdgePoint& p = edges.points[i];
    // Length it stands for: half the way to both neighbours on its chain.
    float length = 0.0f;
    if (i > 0 && edges.points[i - 1].chain == p.chain) {
      length += 0.5f * (p.image - edges.points[i - 1].image).norm();
    }
    if (i + 1 < n && edges.points[i + 1].chain == p.chain) {
      length += 0.5f * (edges.points[i + 1].image - p.image).norm();
    }
    const int x = Rounded(p.image.x());
    const int y = Rounded(p.image.y());
    if (!seen.others.empty()) {
      const double depth = (seen.camera_from_object * p.point.cast<double>()).z();
      if (IsCovered(seen.others, x, y, static_cast<float>(1.0 / (depth - seen.hidden_m)))) {
        score->hidden_px += length;
        continue;
      }
    }
    const int bin = AspectBin(p.tangent.x(), p.tangent.y());
    const float d = image.DistanceAt(p.image.x(), p.image.y(), bin);
    // Full within a third of the tolerance: poses are that exact, not more.
    const float supported = length * std::clamp(1.5f * (1.0f - d / tolerance), 0.0f, 1.0f);
    // What another part explains says nothing of this one: small parts fit into large ones' edges.
    if (supported > 0.0f && IsEdgeOf(seen.others, x, y, bin)) {
      score->claimed_px += length;
      continue;
    }
    score->visible_px += length;
    chance_px += length * ExcessChance(image, p.image, bin, options);
    score->support_px += supported;
  }
  if (!(score->visible_px > 0)) return;
  const double chance = std::min(0.9, chance_px / score->visible_px);
  score->precision = std::max(0.0, (score->support_px / score->visible_px - chance) / (1 - chance));
}

bool IsExplained(const ModelRaster& raster,
                 const VisibleEdges& edges,
                 const ImageEdgePoint& edge,
                 int x,
                 int y,
                 float least_cosine) {
  const int rx = x - raster.x0, ry = y - raster.y0;
  if (rx < 0 || ry < 0 || rx >= raster.width || ry >= raster.height) return false;
  const std::int32_t m = raster.nearest[static_cast<std::size_t>(ry) * raster.width + rx];
  if (m < 0) return false;
  const Eigen::Vector2f& tangent = edges.points[m].tangent;
  return std::abs(tangent.x() * edge.normal.y() - tangent.y() * edge.normal.x()) >= least_cosine;
}

// Of a place in the rendering, 0 where the part is not.
float InverseDepthAt(const RenderedView& view, const Eigen::Vector2d& at) {
  const int x = Rounded(at.x()), y = Rounded(at.y());
  if (x < 0 || y < 0 || x >= view.width || y >= view.height) return 0.0f;
  return view.inverse_depth[static_cast<std::size_t>(y) * view.width + x];
}

// Where the ray of a working pixel meets the part; nullopt where the part is not.
std::optional<Eigen::Vector3d> SurfaceAt(const RenderedView& view,
                                         const RenderedFromImage& rendered_from_image,
                                         const PinholeCamera& working,
                                         const Rigid3& object_from_camera,
                                         const Eigen::Vector2d& pixel) {
  const float inverse_depth = InverseDepthAt(view, rendered_from_image(pixel));
  if (inverse_depth <= 0) return std::nullopt;
  return object_from_camera *
         Eigen::Vector3d(NormalizedPoint(working, pixel).homogeneous() / inverse_depth);
}

// Whether the siblings show an image edge at the same place of the part's surface.
bool IsPrint(const PinholeCamera& working,
             const RenderedView& rendered,
             const RenderedFromImage& rendered_from_image,
             const Seen& seen,
             const ImageEdgePoint& edge,
             const AspectScoreOptions& options) {
  const Rigid3 object_from_camera = seen.camera_from_object.Inverse();
  const Eigen::Vector2d pixel = edge.point.cast<double>();
  const Eigen::Vector2d along(-edge.normal.y(), edge.normal.x());
  const auto surface = [&](const Eigen::Vector2d& at) {
    return SurfaceAt(rendered, rendered_from_image, working, object_from_camera, at);
  };
  const auto here = surface(pixel), next = surface(pixel + 2.0 * along);
  if (!here || !next) return false;
  const float tolerance = static_cast<float>(options.tolerance_px * AspectImage::kDistanceScale);
  int asked = 0;
  double support = 0.0, chance = 0.0;
  for (const SiblingView& sibling : seen.siblings) {
    const PinholeCamera camera = WorkingCamera(*sibling.image, sibling.camera);
    const Eigen::Vector3d a = sibling.camera_from_object * *here;
    const Eigen::Vector3d b = sibling.camera_from_object * *next;
    if (a.z() <= 0 || b.z() <= 0) continue;
    const Eigen::Vector2f at = Project(camera, a).cast<float>();
    const int x = Rounded(at.x()), y = Rounded(at.y());
    if (x < 0 || y < 0 || x >= sibling.image->width || y >= sibling.image->height) continue;
    if (!sibling.layer->Has(x, y)) continue;
    const float front = sibling.layer->inverse_depth[sibling.layer->Cell(x, y)];
    if (front <= 0 || std::abs(1.0 / front - a.z()) > seen.hidden_m) continue;
    const Eigen::Vector2f turn = Project(camera, b).cast<float>() - at;
    const int bin = AspectBin(turn.x(), turn.y());
    const float d = sibling.image->DistanceAt(at.x(), at.y(), bin);
    ++asked;
    support += std::clamp(1.5f * (1.0f - d / tolerance), 0.0f, 1.0f);
    chance += sibling.image->ChanceAt(
                  at.x(),
                  at.y(),
                  bin,
                  AspectImage::ChanceLevel(static_cast<float>(options.tolerance_px))) /
              255.0;
  }
  if (asked < 2) return false;
  const double expected = std::min(0.9, chance / asked);
  return (support / asked - expected) / (1.0 - expected) >= kPrintSupport;
}

// Recall, and what of the edges on the surface that are not the part's is print.
void ScoreImageEdges(const AspectImage& image,
                     const PinholeCamera& working,
                     const VisibleEdges& edges,
                     const Seen& seen,
                     double size_px,
                     const AspectScoreOptions& options,
                     AspectScore* score) {
  const ModelRaster raster = RasterEdges(edges, image, options.tolerance_px);
  if (raster.nearest.empty()) return;
  const RenderedFromImage rendered_from_image(edges.view, working);
  const int margin_px =
      static_cast<int>(std::ceil(std::min(options.max_margin_px, kMarginShare * size_px)));
  const double margin_rendered = margin_px * edges.view.scale;
  const SilhouetteDistance silhouette =
      DistanceToSilhouette(edges.view, static_cast<int>(std::ceil(margin_rendered)) + 1);
  const int limit = static_cast<int>(3.0 * margin_rendered);
  const float least_cosine = static_cast<float>(std::cos(kScoreTurnRad));
  double all = 0.0, explained = 0.0, print = 0.0, foreign = 0.0;
  const int y1 = std::min(image.height, raster.y0 + raster.height + margin_px);
  const int x0 = std::max(0, raster.x0 - margin_px);
  const int x1 = std::min(image.width, raster.x0 + raster.width + margin_px);
  for (int y = std::max(0, raster.y0 - margin_px); y < y1; ++y) {
    for (int x = x0; x < x1; ++x) {
      const std::int32_t e = image.edge_at[image.Cell(x, y)];
      if (e < 0) continue;
      const ImageEdgePoint& edge = image.edges[e];
      const Eigen::Vector2d at = rendered_from_image(edge.point.cast<double>());
      const int sx = Rounded(at.x()) + silhouette.margin;
      const int sy = Rounded(at.y()) + silhouette.margin;
      if (sx < 0 || sy < 0 || sx >= silhouette.width || sy >= silhouette.height) continue;
      const int outside = silhouette.thirds[silhouette.Cell(sx, sy)];
      if (outside > limit) continue;
      const int bin = AspectBin(-edge.normal.y(), edge.normal.x());
      const bool own = IsExplained(raster, edges, edge, x, y, least_cosine);
      if (!seen.others.empty() &&
          (IsEdgeOf(seen.others, x, y, bin) ||
           (!own && IsCovered(seen.others, x, y, InverseDepthAt(edges.view, at))))) {
        continue;
      }
      // Where half of all places are supported, an edge says nothing.
      const double telling =
          std::max(0.0, 1.0 - 2.0 * ExcessChance(image, edge.point, bin, options));
      const double strength = telling * std::min(edge.strength, AspectImage::kMaxStrength);
      if (!own && !seen.siblings.empty()) {
        if (IsPrint(working, edges.view, rendered_from_image, seen, edge, options)) {
          print += strength;
          continue;
        }
        if (outside == 0) foreign += strength;
      }
      all += strength;
      if (own) explained += strength;
    }
  }
  if (all > 0) score->recall = explained / all;
  if (print > 0) score->print = print / (print + foreign);
}

}  // namespace

double ScoreOf(double precision, double recall, double support_px) {
  const double sum = precision + recall;
  if (!(sum > 0)) return 0.0;
  return 2 * precision * recall / sum * support_px / (support_px + kHalfLengthPx);
}

double PresumedScore(double precision, double recall, double support_px, double presumed_recall) {
  const double presumed = precision >= kPrintPrecision ? std::max(recall, presumed_recall) : recall;
  return ScoreOf(precision, presumed, support_px);
}

AspectScore ScorePose(const AspectImage& image,
                      const RenderMesh& mesh,
                      const PinholeCamera& camera,
                      const Rigid3& camera_from_object,
                      const AspectScoreOptions& options,
                      std::span<const ObjectLayer* const> others,
                      std::span<const SiblingView> siblings) {
  if (image.width == 0) return {};
  return ScoreEdges(image,
                    mesh,
                    WorkingEdges(image, mesh, camera, camera_from_object, options.render_px),
                    camera,
                    camera_from_object,
                    options,
                    others,
                    siblings);
}

VisibleEdges WorkingEdges(const AspectImage& image,
                          const RenderMesh& mesh,
                          const PinholeCamera& camera,
                          const Rigid3& camera_from_object,
                          double render_px) {
  VisibleEdgeOptions rendering;
  rendering.render_px = render_px;
  return FindVisibleEdges(mesh, WorkingCamera(image, camera), camera_from_object, rendering);
}

AspectScore ScoreEdges(const AspectImage& image,
                       const RenderMesh& mesh,
                       const VisibleEdges& edges,
                       const PinholeCamera& camera,
                       const Rigid3& camera_from_object,
                       const AspectScoreOptions& options,
                       std::span<const ObjectLayer* const> others,
                       std::span<const SiblingView> siblings) {
  AspectScore score;
  if (image.width == 0 || edges.points.empty()) return score;
  const PinholeCamera working = WorkingCamera(image, camera);
  const Seen seen{camera_from_object, others, kHiddenShare * mesh.diameter_m, siblings};
  ScoreModelEdges(image, edges, seen, options, &score);
  const double depth = (camera_from_object * mesh.center.cast<double>()).z();
  const double size_px = working.focal_px * mesh.diameter_m / std::max(depth, 1e-6);
  ScoreImageEdges(image, working, edges, seen, size_px, options, &score);
  score.score = ScoreOf(score.precision, score.recall, score.support_px);
  return score;
}

ObjectLayer MakeObjectLayer(const AspectImage& image,
                            const VisibleEdges& edges,
                            const PinholeCamera& camera,
                            const AspectScoreOptions& options) {
  ObjectLayer out;
  if (image.width == 0) return out;
  const PinholeCamera working = WorkingCamera(image, camera);
  const ModelRaster raster = RasterEdges(edges, image, options.tolerance_px);
  if (edges.points.empty() || raster.nearest.empty()) return out;
  out.x0 = raster.x0;
  out.y0 = raster.y0;
  out.width = raster.width;
  out.height = raster.height;
  out.inverse_depth.resize(raster.nearest.size());
  out.edge_bin.assign(raster.nearest.size(), ObjectLayer::kNoEdge);
  const RenderedFromImage rendered_from_image(edges.view, working);
  for (int y = out.y0; y < out.y0 + out.height; ++y) {
    for (int x = out.x0; x < out.x0 + out.width; ++x) {
      const std::size_t cell = out.Cell(x, y);
      out.inverse_depth[cell] =
          InverseDepthAt(edges.view, rendered_from_image(Eigen::Vector2d(x, y)));
      if (raster.nearest[cell] < 0) continue;
      const Eigen::Vector2f& tangent = edges.points[raster.nearest[cell]].tangent;
      out.edge_bin[cell] = static_cast<std::uint8_t>(AspectBin(tangent.x(), tangent.y()));
    }
  }
  return out;
}

ObjectLayer MakeObjectLayer(const AspectImage& image,
                            const RenderMesh& mesh,
                            const PinholeCamera& camera,
                            const Rigid3& camera_from_object,
                            double render_px) {
  return MakeObjectLayer(
      image, WorkingEdges(image, mesh, camera, camera_from_object, render_px), camera);
}

double PointSupport(const AspectImage& image,
                    std::span<const ModelEdgePoint> points,
                    const PinholeCamera& camera,
                    const Rigid3& camera_from_object,
                    double free_chance,
                    double reach_px) {
  if (points.empty()) return 0.0;
  const PinholeCamera working = WorkingCamera(image, camera);
  const int level = reach_px > 4.0 ? AspectImage::ChanceLevel(static_cast<float>(reach_px)) : 0;
  // Floats, from a point of the part on, so that they are exact enough far from the origin.
  const Eigen::Vector3f from = points.front().point;
  const Eigen::Matrix3f R = camera_from_object.R.cast<float>();
  const Eigen::Vector3f t = (camera_from_object * from.cast<double>()).cast<float>();
  const auto f = static_cast<float>(working.focal_px), k1 = static_cast<float>(working.k1);
  const auto cx = static_cast<float>(working.cx), cy = static_cast<float>(working.cy);
  const float reach = static_cast<float>(reach_px) * AspectImage::kDistanceScale;
  float sum = 0.0f;
  int chance = 0;
  for (const ModelEdgePoint& p : points) {
    const Eigen::Vector3f x = R * (p.point - from) + t;
    if (x.z() <= 0) continue;
    const Eigen::Vector3f d = R * p.direction;
    const float u = x.x() / x.z(), v = x.y() / x.z(), scale = f * (1.0f + k1 * (u * u + v * v));
    const float px = scale * u + cx, py = scale * v + cy;
    if (!(px >= 0 && py >= 0 && px < image.width && py < image.height)) continue;
    const int bin = AspectBin(d.x() * x.z() - x.x() * d.z(), d.y() * x.z() - x.y() * d.z());
    sum += std::max(0.0f, 1.0f - image.DistanceAt(px, py, bin) / reach);
    chance += image.ChanceAt(px, py, bin, level);
  }
  const double n = static_cast<double>(points.size());
  const double excess = std::max(0.0, chance / (255.0 * n) - free_chance);
  return (sum / n - excess) / (1.0 - excess);
}

}  // namespace horopter
