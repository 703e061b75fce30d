#include "server/vision/recognition/aspects/standing_search.h"

#include <Eigen/Geometry>
#include <algorithm>
#include <array>
#include <cmath>
#include <cstdint>
#include <numbers>

#include "server/base/parallel_for.h"
#include "server/vision/recognition/aspects/aspect_score.h"

namespace horopter {
namespace {

constexpr double kSamePlaneRad = 0.06;    // between the normals of faces on one plane
constexpr double kSamePlaneShare = 0.08;  // of the diameter: between their heights
constexpr int kPlanes = 2;                // of different heights
constexpr double kLevelM = 0.006;         // between these
constexpr double kFarShare = 1.8;         // of the parts' depth: no farther is searched
constexpr double kApartShare = 0.35;      // of the diameter: places that are not improved twice
constexpr double kApartRad = 0.45;        // ... unless turned by more
constexpr double kSymmetric = 0.02;       // between unit vectors that are the same
constexpr std::size_t kPoints = 24;       // of an aspect
constexpr int kTiles = 3;                 // of the plane, a side: each has its own aspects
constexpr int kClimbs = 4;                // rounds, each with half the steps
constexpr double kFreeChance = 0.10;      // as parts have themselves
constexpr float kMinReachPx = 4.0f, kMaxReachPx = 26.0f;
constexpr double kNextPlace = 0.02;  // of support
constexpr double kNearM = 1e-3;
constexpr double kLayerRenderPx = 110.0;
constexpr double kEdgeHalf = 0.35;    // of the size: half the square whose edges are counted ...
constexpr double kEdgeLength = 0.6;   // ... and how long they must be
constexpr int kBlock = 4;             // places a side over which a part looks the same
constexpr std::size_t kFirst = 8;     // points that refuse a place
constexpr double kFirstSlack = 0.12;  // by which their support may be below min_first

// A face that lies on the plane.
struct Face {
  Eigen::Matrix3d scene_from_object = Eigen::Matrix3d::Identity();  // before it is turned
  double height_m = 0.0;                                            // of the origin
  double yaw_range = 2 * std::numbers::pi;                          // until the part looks the same
};

struct Placed {
  double x = 0.0, y = 0.0, yaw = 0.0;  // of the part's centre
  int face = 0;
  double support = 0.0;
};

// The plane in axes of its own, and the cameras over it.
struct Ground {
  StandingPlane plane;
  Eigen::Vector3d origin, e1, e2;
  Eigen::Vector2d low = Eigen::Vector2d::Zero(), high = Eigen::Vector2d::Zero();
  std::vector<const AspectImage*> images;
  std::vector<PinholeCamera> cameras;  // of the working images
  std::vector<Rigid3> camera_from_scene;
  std::size_t least_views = 2;                         // that show a place
  std::vector<std::vector<std::int32_t>> unexplained;  // sums of edge points over the half maps

  Eigen::Vector3d At(double x, double y) const { return origin + x * e1 + y * e2; }
};

bool IsShown(const Ground& ground, std::size_t v, const Eigen::Vector3d& in_camera) {
  if (in_camera.z() < kNearM) return false;
  const Eigen::Vector2d u = Project(ground.cameras[v], in_camera);
  return u.x() >= 0 && u.y() >= 0 && u.x() < ground.images[v]->width &&
         u.y() < ground.images[v]->height;
}

std::size_t Showing(const Ground& ground, const Eigen::Vector3d& x) {
  std::size_t shown = 0;
  for (std::size_t v = 0; v < ground.images.size(); ++v)
    shown += IsShown(ground, v, ground.camera_from_scene[v] * x);
  return shown;
}

// Where enough views see the plane, not much farther than the parts.
void FindRegion(Ground* ground) {
  for (std::size_t v = 0; v < ground->images.size(); ++v) {
    const Rigid3 scene_from_camera = ground->camera_from_scene[v].Inverse();
    const double far = kFarShare * (ground->camera_from_scene[v] * ground->origin).z();
    constexpr int kRays = 9;
    for (int i = 0; i < kRays * kRays; ++i) {
      const Eigen::Vector2d pixel((i % kRays) * (ground->images[v]->width - 1.0) / (kRays - 1),
                                  (i / kRays) * (ground->images[v]->height - 1.0) / (kRays - 1));
      const Eigen::Vector3d ray =
          scene_from_camera.R * NormalizedPoint(ground->cameras[v], pixel).homogeneous();
      const double falls = -ground->plane.normal.dot(ray);
      const double above = ground->plane.normal.dot(scene_from_camera.t) - ground->plane.offset_m;
      if (falls * far < above || above <= 0) continue;
      const Eigen::Vector3d x = scene_from_camera.t + above / falls * ray;
      if (Showing(*ground, x) < ground->least_views) continue;
      const Eigen::Vector2d at((x - ground->origin).dot(ground->e1),
                               (x - ground->origin).dot(ground->e2));
      ground->low = ground->low.cwiseMin(at);
      ground->high = ground->high.cwiseMax(at);
    }
  }
}

// Edge points that no part taken explains: [y][x] holds those above and left of a half map's cell.
std::vector<std::int32_t> SumUnexplained(const AspectImage& image,
                                         const std::vector<PartLayer>& layers) {
  const int w = image.half_width + 1;
  std::vector<std::int32_t> sums(static_cast<std::size_t>(w) * (image.half_height + 1), 0);
  for (const ImageEdgePoint& e : image.edges) {
    const int x = static_cast<int>(std::lround(e.point.x()));
    const int y = static_cast<int>(std::lround(e.point.y()));
    const bool explained = std::any_of(layers.begin(), layers.end(), [&](const PartLayer& l) {
      return l.Has(x, y) &&
             (l.inverse_depth[l.Cell(x, y)] > 0 || l.edge_bin[l.Cell(x, y)] != PartLayer::kNoEdge);
    });
    const int cx = x / 2, cy = y / 2;
    if (explained || cx < 0 || cy < 0 || cx >= image.half_width || cy >= image.half_height)
      continue;
    ++sums[static_cast<std::size_t>(cy + 1) * w + cx + 1];
  }
  for (int y = 1; y <= image.half_height; ++y) {
    for (int x = 1; x < w; ++x) {
      const std::size_t at = static_cast<std::size_t>(y) * w + x;
      sums[at] += sums[at - 1] + sums[at - w] - sums[at - w - 1];
    }
  }
  return sums;
}

// In a square about a pixel.
int UnexplainedNear(const Ground& ground, std::size_t v, const Eigen::Vector2d& at, double half) {
  const AspectImage& image = *ground.images[v];
  const auto cell = [](double pixel, int size) {
    return std::clamp(static_cast<int>(0.5 * pixel), 0, size);
  };
  const int x0 = cell(at.x() - half, image.half_width), x1 = cell(at.x() + half, image.half_width);
  const int y0 = cell(at.y() - half, image.half_height);
  const int y1 = cell(at.y() + half, image.half_height);
  const std::size_t w = image.half_width + 1;
  const std::vector<std::int32_t>& sums = ground.unexplained[v];
  return sums[y1 * w + x1] - sums[y0 * w + x1] - sums[y1 * w + x0] + sums[y0 * w + x0];
}

Ground MakeGround(std::span<const AspectImage> images,
                  const std::vector<std::optional<AspectSceneView>>& views,
                  const StandingPlane& plane,
                  std::span<const AspectSceneObject> taken,
                  std::span<const AspectPart> parts) {
  Ground out;
  out.plane = plane;
  for (std::size_t v = 0; v < views.size(); ++v) {
    if (!views[v]) continue;
    out.images.push_back(&images[v]);
    out.cameras.push_back(WorkingCamera(images[v], views[v]->camera));
    out.camera_from_scene.push_back(views[v]->camera_from_scene);
    std::vector<PartLayer> layers;
    AspectScoreOptions rendering;
    rendering.render_px = kLayerRenderPx;
    for (const AspectSceneObject& o : taken) {
      layers.push_back(MakePartLayer(images[v],
                                     parts[o.object].object->mesh,
                                     views[v]->camera,
                                     views[v]->camera_from_scene * o.scene_from_object,
                                     rendering));
    }
    out.unexplained.push_back(SumUnexplained(images[v], layers));
  }
  out.least_views = std::max<std::size_t>(2, (out.images.size() + 1) / 2);
  out.origin.setZero();
  for (const AspectSceneObject& o : taken)
    out.origin += o.scene_from_object * parts[o.object].object->mesh.center.cast<double>();
  out.origin /= std::max<double>(1.0, static_cast<double>(taken.size()));
  out.origin -= (plane.normal.dot(out.origin) - plane.offset_m) * plane.normal;
  out.e1 = plane.normal.unitOrthogonal();
  out.e2 = plane.normal.cross(out.e1);
  FindRegion(&out);
  return out;
}

// Points of an aspect in a camera's axes, up to the place of the part's centre.
struct TurnedPoints {
  std::array<float, kPoints> x, y, z;
  std::array<std::uint8_t, kPoints> bin;
  std::size_t count = 0;
};

class PartSearch {
 public:
  PartSearch(const Ground& ground,
             const AspectPart& part,
             const StandingSearchOptions& options,
             const StopRequested& stop)
      : ground_(ground), options_(options), stop_(stop) {
    center_ = part.object->mesh.center.cast<double>();
    diameter_m_ = part.object->mesh.diameter_m;
    const AspectSet& set = part.object->aspects;
    for (std::size_t a = 0; a < set.aspects.size(); ++a) {
      directions_.push_back(-set.aspects[a].camera_from_object.row(2).transpose().cast<double>());
      points_.push_back(AspectPoints(set, static_cast<int>(a)));
      if (points_.back().size() > kPoints) points_.back().resize(kPoints);
    }
    turns_.push_back(Rigid3{});
    turns_.insert(turns_.end(), part.symmetries.begin(), part.symmetries.end());
    FindFaces(part);
  }

  std::vector<Placed> Run() const {
    std::vector<Placed> found;
    for (std::size_t f = 0; f < faces_.size(); ++f) {
      if (IsStopRequested(stop_)) break;
      SearchFace(static_cast<int>(f), &found);
    }
    found = Apart(std::move(found), options_.climbed_per_part);
    for (Placed& p : found) {
      if (IsStopRequested(stop_)) break;
      Climb(&p);
    }
    return Apart(std::move(found), options_.kept_per_part);
  }

  Rigid3 PoseOf(const Placed& p) const {
    Rigid3 pose;
    pose.R = RotationOf(p.face, p.yaw);
    pose.t = CenterOf(p.face, p.x, p.y, p.yaw) - pose.R * center_;
    return pose;
  }

 private:
  void FindFaces(const AspectPart& part) {
    std::vector<Eigen::Vector3d> ups;
    for (const RestingFace& rest : part.resting) {
      if (static_cast<int>(faces_.size()) >= options_.max_faces) break;
      const bool known = std::any_of(ups.begin(), ups.end(), [&](const Eigen::Vector3d& up) {
        return std::any_of(turns_.begin(), turns_.end(), [&](const Rigid3& turn) {
          return (turn.R * up - rest.up).norm() < kSymmetric;
        });
      });
      if (known) continue;
      ups.push_back(rest.up);
      Face face;
      face.scene_from_object =
          Eigen::Quaterniond::FromTwoVectors(rest.up, ground_.plane.normal).toRotationMatrix();
      face.height_m = rest.height_m;
      for (const Rigid3& turn : turns_) {
        const double angle = Eigen::AngleAxisd(turn.R).angle();
        if ((turn.R * rest.up - rest.up).norm() < kSymmetric && angle > kSymmetric)
          face.yaw_range = std::min(face.yaw_range, angle);
      }
      faces_.push_back(face);
    }
  }

  Eigen::Matrix3d RotationOf(int face, double yaw) const {
    return Eigen::AngleAxisd(yaw, ground_.plane.normal).toRotationMatrix() *
           faces_[face].scene_from_object;
  }

  Eigen::Vector3d CenterOf(int face, double x, double y, double yaw) const {
    const Eigen::Vector3d above = RotationOf(face, yaw) * center_;
    return ground_.At(x, y) +
           (faces_[face].height_m + ground_.plane.normal.dot(above)) * ground_.plane.normal;
  }

  // The aspect that view v has of the part turned by `rotation` with its centre here.
  TurnedPoints Look(std::size_t v,
                    const Eigen::Matrix3d& rotation,
                    const Eigen::Vector3d& center) const {
    const Eigen::Vector3d eye = ground_.camera_from_scene[v].Inverse().t;
    const Eigen::Vector3d direction = rotation.transpose() * (eye - center).normalized();
    std::size_t aspect = 0, symmetry = 0;
    double nearest = -2.0;
    for (std::size_t t = 0; t < turns_.size(); ++t) {
      const Eigen::Vector3d turned = turns_[t].R.transpose() * direction;
      for (std::size_t a = 0; a < directions_.size(); ++a) {
        if (turned.dot(directions_[a]) > nearest)
          nearest = turned.dot(directions_[a]), aspect = a, symmetry = t;
      }
    }
    const Eigen::Matrix3d camera_from_object = ground_.camera_from_scene[v].R * rotation;
    const Eigen::Matrix3f R = (camera_from_object * turns_[symmetry].R).cast<float>();
    // Symmetries keep the part but not the centre of its box.
    const Eigen::Vector3f offset =
        (camera_from_object * (turns_[symmetry].t - center_)).cast<float>();
    const Eigen::Vector3f there = (ground_.camera_from_scene[v] * center).cast<float>();
    TurnedPoints out;
    for (const AspectPoint& p : points_[aspect]) {
      const Eigen::Vector3f x = R * p.point + offset;
      const Eigen::Vector3f d = R * p.direction;
      const Eigen::Vector3f at = x + there;
      out.x[out.count] = x.x();
      out.y[out.count] = x.y();
      out.z[out.count] = x.z();
      out.bin[out.count] = static_cast<std::uint8_t>(
          AspectBin(d.x() * at.z() - at.x() * d.z(), d.y() * at.z() - at.y() * d.z()));
      ++out.count;
    }
    return out;
  }

  // Support of the points with the part's centre here, 0 .. 1; -1 where the view does not show it.
  double Support(std::size_t v,
                 const TurnedPoints& points,
                 const Eigen::Vector3d& center,
                 double share,
                 bool over_chance) const {
    const PinholeCamera& camera = ground_.cameras[v];
    const AspectImage& image = *ground_.images[v];
    const Eigen::Vector3d there = ground_.camera_from_scene[v] * center;
    if (!IsShown(ground_, v, there)) return -1.0;
    const double size_px = camera.focal_px * diameter_m_ / there.z();
    if (size_px < options_.min_size_px || points.count == 0) return -1.0;
    const float reach_px =
        std::clamp(static_cast<float>(share * size_px), kMinReachPx, kMaxReachPx);
    const float reach = reach_px * AspectImage::kDistanceScale;
    const Eigen::Vector3f c = there.cast<float>();
    const float f = static_cast<float>(camera.focal_px), k1 = static_cast<float>(camera.k1);
    const float cx = static_cast<float>(camera.cx), cy = static_cast<float>(camera.cy);
    const int level = AspectImage::ChanceLevel(reach_px);
    float sum = 0.0f, chance = 0.0f;
    for (std::size_t i = 0; i < points.count; ++i) {
      const float z = 1.0f / (points.z[i] + c.z());
      const float x = (points.x[i] + c.x()) * z, y = (points.y[i] + c.y()) * z;
      const float scale = f * (1.0f + k1 * (x * x + y * y));
      const float u = scale * x + cx, w = scale * y + cy;
      const float d = image.DistanceAt(u, w, points.bin[i]);
      sum += std::max(0.0f, 1.0f - d / reach);
      if (over_chance) chance += image.ChanceAt(u, w, points.bin[i], level);
    }
    const double n = static_cast<double>(points.count);
    const double excess =
        over_chance ? std::clamp(chance / (255.0 * n) - kFreeChance, 0.0, 0.9) : 0.0;
    return (sum / n - excess) / (1.0 - excess);
  }

  // Mean over the views that show it, above chance.
  double Judge(const Placed& p, double share) const {
    const Eigen::Matrix3d rotation = RotationOf(p.face, p.yaw);
    const Eigen::Vector3d center = CenterOf(p.face, p.x, p.y, p.yaw);
    double sum = 0.0;
    std::size_t shown = 0;
    for (std::size_t v = 0; v < ground_.images.size(); ++v) {
      const double s = Support(v, Look(v, rotation, center), center, share, true);
      if (s < 0) continue;
      sum += s;
      ++shown;
    }
    return shown < ground_.least_views ? 0.0 : sum / static_cast<double>(shown);
  }

  // Places of a grid, and whether enough views show edges there that are still unexplained.
  struct Grid {
    double step = 0.0;
    int columns = 0, rows = 0;
    std::vector<std::uint8_t> open;
  };

  Grid MakeGrid(int face) const {
    Grid grid;
    const Eigen::Vector2d size = ground_.high - ground_.low;
    grid.step = std::max(options_.step_share * diameter_m_,
                         std::sqrt(size.x() * size.y() / options_.max_places));
    grid.columns = static_cast<int>(size.x() / grid.step) + 1;
    grid.rows = static_cast<int>(size.y() / grid.step) + 1;
    grid.open.resize(static_cast<std::size_t>(grid.columns) * grid.rows);
    for (int j = 0; j < grid.rows; ++j) {
      for (int i = 0; i < grid.columns; ++i) {
        const Eigen::Vector3d center = PlaceOf(grid, face, i, j, 0.0);
        std::size_t open = 0;
        for (std::size_t v = 0; v < ground_.images.size(); ++v) {
          const Eigen::Vector3d there = ground_.camera_from_scene[v] * center;
          if (!IsShown(ground_, v, there)) continue;
          const double px = ground_.cameras[v].focal_px * diameter_m_ / there.z();
          open += px >= options_.min_size_px &&
                  UnexplainedNear(ground_, v, Project(ground_.cameras[v], there), kEdgeHalf * px) >=
                      kEdgeLength * px;
        }
        grid.open[static_cast<std::size_t>(j) * grid.columns + i] = open >= ground_.least_views;
      }
    }
    return grid;
  }

  Eigen::Vector3d PlaceOf(const Grid& grid, int face, double i, double j, double yaw) const {
    return CenterOf(face, ground_.low.x() + i * grid.step, ground_.low.y() + j * grid.step, yaw);
  }

  void SearchFace(int face, std::vector<Placed>* found) const {
    const Grid grid = MakeGrid(face);
    const int yaws =
        std::max(1, static_cast<int>(std::ceil(faces_[face].yaw_range / options_.yaw_step_rad)));
    std::vector<Placed> best(grid.open.size());
    for (int k = 0; k < yaws; ++k) {
      if (IsStopRequested(stop_)) return;
      const double yaw = faces_[face].yaw_range * k / yaws;
      for (int tile = 0; tile < kTiles * kTiles; ++tile) {
        const int x0 = grid.columns * (tile % kTiles) / kTiles;
        const int x1 = grid.columns * (tile % kTiles + 1) / kTiles;
        const int y0 = grid.rows * (tile / kTiles) / kTiles;
        const int y1 = grid.rows * (tile / kTiles + 1) / kTiles;
        const Eigen::Vector3d middle = PlaceOf(grid, face, 0.5 * (x0 + x1), 0.5 * (y0 + y1), yaw);
        std::vector<TurnedPoints> looks;
        for (std::size_t v = 0; v < ground_.images.size(); ++v)
          looks.push_back(Look(v, RotationOf(face, yaw), middle));
        for (int y = y0; y < y1; y += kBlock) {
          for (int x = x0; x < x1; x += kBlock) {
            SearchBlock(grid,
                        {x, std::min(x + kBlock, x1), y, std::min(y + kBlock, y1)},
                        face,
                        yaw,
                        looks,
                        &best);
          }
        }
      }
    }
    for (const Placed& p : best) {
      if (p.support > 0.0) found->push_back(p);
    }
  }

  struct Block {
    int x0, x1, y0, y1;
  };

  // Points of an aspect in the half map of a view's image.
  struct MapPoints {
    std::array<std::int16_t, kPoints> u, v;
    std::array<std::int32_t, kPoints> map;  // where the bin's map begins
    std::size_t count = 0;
    std::int32_t reach = 0;  // 1/8 px
    Eigen::Vector2d center = Eigen::Vector2d::Zero();
  };

  // Support of each open place of a block; the part looks the same from all of them, only moved.
  void SearchBlock(const Grid& grid,
                   const Block& block,
                   int face,
                   double yaw,
                   const std::vector<TurnedPoints>& looks,
                   std::vector<Placed>* best) const {
    std::array<double, kBlock * kBlock> sums{};
    std::array<std::uint8_t, kBlock * kBlock> shown{}, refused{};
    const auto index = [&](int x, int y) { return (y - block.y0) * kBlock + x - block.x0; };
    const auto cell = [&](int x, int y) { return static_cast<std::size_t>(y) * grid.columns + x; };
    bool open = false;
    for (int y = block.y0; y < block.y1; ++y) {
      for (int x = block.x0; x < block.x1; ++x) {
        refused[index(x, y)] = !grid.open[cell(x, y)];
        open = open || grid.open[cell(x, y)];
      }
    }
    if (!open) return;
    const Eigen::Vector3d middle =
        PlaceOf(grid, face, 0.5 * (block.x0 + block.x1 - 1), 0.5 * (block.y0 + block.y1 - 1), yaw);
    const Eigen::Vector3d first = PlaceOf(grid, face, block.x0, block.y0, yaw);
    const Eigen::Vector3d along_x = grid.step * ground_.e1, along_y = grid.step * ground_.e2;
    for (std::size_t v = 0; v < looks.size(); ++v) {
      MapPoints points;
      if (!OnMap(v, looks[v], middle, &points)) continue;
      for (int y = block.y0; y < block.y1; ++y) {
        for (int x = block.x0; x < block.x1; ++x) {
          const int i = index(x, y);
          if (refused[i]) continue;
          const Eigen::Vector3d there =
              ground_.camera_from_scene[v] *
              Eigen::Vector3d(first + (x - block.x0) * along_x + (y - block.y0) * along_y);
          if (!IsShown(ground_, v, there)) continue;
          const Eigen::Vector2d moved = Project(ground_.cameras[v], there) - points.center;
          const double support = MapSupport(*ground_.images[v], points, moved);
          if (support < options_.min_first) {
            refused[i] = 1;
            continue;
          }
          sums[i] += support;
          ++shown[i];
        }
      }
    }
    for (int y = block.y0; y < block.y1; ++y) {
      for (int x = block.x0; x < block.x1; ++x) {
        const int i = index(x, y);
        if (refused[i] || shown[i] < ground_.least_views) continue;
        Placed& here = (*best)[cell(x, y)];
        const double support = sums[i] / shown[i];
        if (support <= here.support) continue;
        here = {
            ground_.low.x() + x * grid.step, ground_.low.y() + y * grid.step, yaw, face, support};
      }
    }
  }

  bool OnMap(std::size_t v,
             const TurnedPoints& look,
             const Eigen::Vector3d& center,
             MapPoints* out) const {
    const PinholeCamera& camera = ground_.cameras[v];
    const AspectImage& image = *ground_.images[v];
    const Eigen::Vector3d there = ground_.camera_from_scene[v] * center;
    if (there.z() < kNearM) return false;
    const double size_px = camera.focal_px * diameter_m_ / there.z();
    if (size_px < options_.min_size_px) return false;
    out->center = Project(camera, there);
    out->count = look.count;
    out->reach = static_cast<std::int32_t>(
        AspectImage::kDistanceScale *
        std::clamp(static_cast<float>(options_.reach_share * size_px), kMinReachPx, kMaxReachPx));
    for (std::size_t i = 0; i < out->count; ++i) {
      const Eigen::Vector3d x(look.x[i] + there.x(), look.y[i] + there.y(), look.z[i] + there.z());
      const Eigen::Vector2d u = 0.5 * Project(camera, x);
      out->u[i] = static_cast<std::int16_t>(std::clamp(u.x(), -8000.0, 8000.0));
      out->v[i] = static_cast<std::int16_t>(std::clamp(u.y(), -8000.0, 8000.0));
      out->map[i] = look.bin[i] * image.half_width * image.half_height;
    }
    return out->count >= kFirst;
  }

  // 0 when the first points find nothing.
  double MapSupport(const AspectImage& image,
                    const MapPoints& points,
                    const Eigen::Vector2d& moved) const {
    const int du = static_cast<int>(std::lround(0.5 * moved.x()));
    const int dv = static_cast<int>(std::lround(0.5 * moved.y()));
    const std::uint8_t* maps = image.half_distance.data();
    std::int32_t away = 0;
    const auto add = [&](std::size_t i) {
      const int u = points.u[i] + du, w = points.v[i] + dv;
      const bool inside = static_cast<unsigned>(u) < static_cast<unsigned>(image.half_width) &&
                          static_cast<unsigned>(w) < static_cast<unsigned>(image.half_height);
      away += inside ? std::min<std::int32_t>(maps[points.map[i] + w * image.half_width + u],
                                              points.reach)
                     : points.reach;
    };
    for (std::size_t i = 0; i < kFirst; ++i) add(i);
    const double least = options_.min_first - kFirstSlack;
    if (away > (1.0 - least) * kFirst * points.reach) return 0.0;
    for (std::size_t i = kFirst; i < points.count; ++i) add(i);
    return 1.0 - static_cast<double>(away) / (static_cast<double>(points.count) * points.reach);
  }

  void Climb(Placed* p) const {
    double step = options_.step_share * diameter_m_, turn = options_.yaw_step_rad;
    double share = options_.reach_share;
    const double narrower = std::pow(options_.fine_share / options_.reach_share, 1.0 / kClimbs);
    for (int round = 0; round < kClimbs; ++round) {
      step *= 0.5;
      turn *= 0.5;
      share *= narrower;
      p->support = Judge(*p, share);
      for (const auto [dx, dy, dyaw] : {std::array{step, 0.0, 0.0},
                                        std::array{-step, 0.0, 0.0},
                                        std::array{0.0, step, 0.0},
                                        std::array{0.0, -step, 0.0},
                                        std::array{0.0, 0.0, turn},
                                        std::array{0.0, 0.0, -turn}}) {
        Placed moved = *p;
        moved.x += dx;
        moved.y += dy;
        moved.yaw += dyaw;
        moved.support = Judge(moved, share);
        if (moved.support > p->support) *p = moved;
      }
    }
  }

  std::vector<Placed> Apart(std::vector<Placed> list, int count) const {
    std::stable_sort(list.begin(), list.end(), [](const Placed& a, const Placed& b) {
      return a.support > b.support;
    });
    std::vector<Placed> out;
    for (const Placed& p : list) {
      if (static_cast<int>(out.size()) >= count) break;
      const bool known = std::any_of(out.begin(), out.end(), [&](const Placed& o) {
        return o.face == p.face &&
               std::abs(std::remainder(o.yaw - p.yaw, faces_[p.face].yaw_range)) < kApartRad &&
               std::hypot(o.x - p.x, o.y - p.y) < kApartShare * diameter_m_;
      });
      if (!known) out.push_back(p);
    }
    return out;
  }

  const Ground& ground_;
  const StandingSearchOptions& options_;
  const StopRequested& stop_;
  Eigen::Vector3d center_;
  double diameter_m_ = 0.0;
  std::vector<Eigen::Vector3d> directions_;       // to the camera, object frame, of each aspect
  std::vector<std::vector<AspectPoint>> points_;  // of each aspect
  std::vector<Rigid3> turns_;                     // identity and symmetries
  std::vector<Face> faces_;
};

// How many of the objects rest on the plane; -1 when one of them, or a camera, is below it.
int RestingOn(const StandingPlane& plane,
              std::span<const AspectSceneObject> objects,
              std::span<const AspectPart> parts,
              const std::vector<std::optional<AspectSceneView>>& views) {
  for (const auto& view : views) {
    if (view && plane.normal.dot(view->camera_from_scene.Inverse().t) < plane.offset_m) return -1;
  }
  int resting = 0;
  for (const AspectSceneObject& o : objects) {
    const AspectPart& part = parts[o.object];
    const double same = kSamePlaneShare * part.object->mesh.diameter_m;
    const Eigen::Vector3d center = o.scene_from_object * part.object->mesh.center.cast<double>();
    if (plane.normal.dot(center) < plane.offset_m) return -1;
    resting += std::any_of(part.resting.begin(), part.resting.end(), [&](const RestingFace& face) {
      const Eigen::Vector3d up = o.scene_from_object.R * face.up;
      return up.dot(plane.normal) > std::cos(kSamePlaneRad) &&
             std::abs(plane.normal.dot(o.scene_from_object.t) - face.height_m - plane.offset_m) <
                 same;
    });
  }
  return resting;
}

}  // namespace

std::vector<StandingPlane> PlanesUnder(std::span<const AspectSceneObject> objects,
                                       std::span<const AspectPart> parts,
                                       const std::vector<std::optional<AspectSceneView>>& views) {
  StandingPlane best;
  std::vector<StandingPlane> all;
  for (const AspectSceneObject& o : objects) {
    for (const RestingFace& face : parts[o.object].resting) {
      StandingPlane plane;
      plane.normal = o.scene_from_object.R * face.up;
      plane.offset_m = plane.normal.dot(o.scene_from_object.t) - face.height_m;
      plane.objects = RestingOn(plane, objects, parts, views);
      if (plane.objects > best.objects) best = plane;
      all.push_back(plane);
    }
  }
  if (best.objects == 0) return {};
  std::vector<StandingPlane> out = {best};
  for (StandingPlane& plane : all) {
    if (static_cast<int>(out.size()) >= kPlanes) break;
    if (plane.normal.dot(best.normal) < std::cos(kSamePlaneRad)) continue;
    plane.normal = best.normal;
    const bool known = std::any_of(out.begin(), out.end(), [&](const StandingPlane& p) {
      return plane.offset_m < p.offset_m + kLevelM;
    });
    if (known) continue;
    plane.objects = 1;
    out.push_back(plane);
  }
  return out;
}

std::vector<StandingCandidate> FindStanding(
    std::span<const AspectImage> images,
    const std::vector<std::optional<AspectSceneView>>& views,
    std::span<const AspectPart> parts,
    const StandingPlane& plane,
    std::span<const AspectSceneObject> taken,
    const StandingSearchOptions& options,
    const StopRequested& stop) {
  const Ground ground = MakeGround(images, views, plane, taken, parts);
  if (ground.images.size() < 2 || !((ground.high - ground.low).array() > 0.0).all()) return {};
  std::vector<std::vector<StandingCandidate>> of_part(parts.size());
  ParallelFor(static_cast<int>(parts.size()), options.threads, [&](int p) {
    const PartSearch search(ground, parts[p], options, stop);
    for (const Placed& found : search.Run())
      of_part[p].push_back({{p, search.PoseOf(found)}, found.support});
  });
  // A part's second place comes after another part's first that is nearly as good.
  std::vector<std::pair<double, StandingCandidate>> ranked;
  for (const auto& list : of_part) {
    for (std::size_t i = 0; i < list.size(); ++i)
      ranked.emplace_back(list[i].support - kNextPlace * static_cast<double>(i), list[i]);
  }
  std::stable_sort(
      ranked.begin(), ranked.end(), [](const auto& a, const auto& b) { return a.first > b.first; });
  std::vector<StandingCandidate> out;
  for (auto& [rank, candidate] : ranked) out.push_back(candidate);
  return out;
}

}  // namespace horopter
