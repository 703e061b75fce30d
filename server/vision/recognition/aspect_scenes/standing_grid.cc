#include "server/vision/recognition/aspect_scenes/standing_grid.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdint>

#include "server/base/lanes.h"
#include "server/base/rounded.h"
#include "server/base/target_clones.h"
#include "server/vision/recognition/aspect_search/near_plane.h"

namespace horopter {
namespace {

constexpr int kMaxPlaces = 12000;  // of a part; larger planes are cut around the parts
// Support of what views show at first; half of it may be hidden
constexpr double kMinFirst = 0.50;
constexpr int kTiles = 3;            // of the plane, a side: each has its own aspects
constexpr float kFarPx = 8000.0f;    // no point lies farther from the image, for all that counts
constexpr double kEdgeHalf = 0.35;   // of the size: half the square whose edges are counted ...
constexpr double kEdgeLength = 0.4;  // ... and how long they must be
constexpr double kMostGround = 0.8;  // of that square: where it is seen, no part is
constexpr int kSectors = 3;          // of turns: each keeps its best at every place
constexpr int kBlock = 4;            // places a side over which a part looks the same
constexpr std::size_t kFirstPoints = 8;  // points that refuse a place
constexpr double kFirstSlack = 0.12;     // by which their support may be below what is needed
constexpr double kViewSlack = 0.14;  // ... and that of the views asked so far, over their number

// Points of an aspect in the half map of a view's image.
struct MapPoints {
  std::array<std::int16_t, kGridPoints> u{}, v{};
  std::array<std::int32_t, kGridPoints> map{};       // where the bin's map begins
  std::array<float, kGridPoints> depth_m{};          // up to the place's
  std::array<std::int32_t, kGridPoints> left_out{};  // -1: no point
  std::size_t count = 0;
  std::int32_t reach = 0;  // 1/8 px
  Eigen::Vector2d center = Eigen::Vector2d::Zero();
  bool may_be_hidden = false;  // in a place of the block
};

static_assert(kFirstPoints % kLanes == 0 && kGridPoints % kLanes == 0);

struct HalfMaps {
  const std::uint8_t* distance;
  std::int32_t width, height;
};

// Sum over points [from, to), multiples of the lanes, moved by (du, dv): how far the nearest edge
// is, 1/8 px and at most the reach, which it is outside the map. Nothing of those left out (-1).
HOROPTER_TARGET_CLONES
std::int32_t SumAway(const HalfMaps& maps,
                     const MapPoints& points,
                     const std::int32_t* left_out,
                     std::int32_t du,
                     std::int32_t dv,
                     std::size_t from,
                     std::size_t to) {
  IntLanes sum = {};
  for (std::size_t i = from; i < to; i += kLanes) {
    ShortLanes us, vs;
    IntLanes map, out;
    LoadLanes(points.u.data() + i, &us);
    LoadLanes(points.v.data() + i, &vs);
    LoadLanes(points.map.data() + i, &map);
    LoadLanes(left_out + i, &out);
    const IntLanes u = __builtin_convertvector(us, IntLanes) + du;
    const IntLanes v = __builtin_convertvector(vs, IntLanes) + dv;
    const IntLanes inside = (u >= 0) & (u < maps.width) & (v >= 0) & (v < maps.height);
    const IntLanes cell = (map + v * maps.width + u) & inside;
    IntLanes away;
    for (int k = 0; k < kLanes; ++k) away[k] = maps.distance[cell[k]];
    away = (inside != 0) & (away < points.reach) ? away : IntLanes{} + points.reach;
    sum += away & ~out;
  }
  std::int32_t all = 0;
  for (int k = 0; k < kLanes; ++k) all += sum[k];
  return all;
}

class FaceSearch {
 public:
  FaceSearch(const ObjectOnPlane& object, int face)
      : object_(object), ground_(object.ground()), face_(face) {
    MakeGrid();
  }

  std::vector<StandingPlace> Run(const StopRequested& stop) const {
    const int yaws = std::max(
        1, static_cast<int>(std::ceil(object_.faces()[face_].yaw_range / kStandingYawStepRad)));
    std::vector<StandingPlace> best(grid_.open.size() * kSectors);
    for (int k = 0; k < yaws; ++k) {
      if (IsStopRequested(stop)) return {};
      const double yaw = object_.faces()[face_].yaw_range * k / yaws;
      const Turned turned{yaw, object_.CenterOf(face_, ground_.low.x(), ground_.low.y(), yaw)};
      StandingPlace* of_sector = best.data() + grid_.open.size() * (kSectors * k / yaws);
      for (int tile = 0; tile < kTiles * kTiles; ++tile) {
        const int x0 = grid_.columns * (tile % kTiles) / kTiles;
        const int x1 = grid_.columns * (tile % kTiles + 1) / kTiles;
        const int y0 = grid_.rows * (tile / kTiles) / kTiles;
        const int y1 = grid_.rows * (tile / kTiles + 1) / kTiles;
        if (!IsOpen({x0, x1, y0, y1})) continue;
        const Eigen::Vector3d middle = PlaceOf(0.5 * (x0 + x1), 0.5 * (y0 + y1), turned);
        std::vector<TurnedPoints> looks;
        for (std::size_t v = 0; v < ground_.images.size(); ++v)
          looks.push_back(object_.Look(v, object_.RotationOf(face_, yaw), middle, kGridPoints));
        for (int y = y0; y < y1; y += kBlock) {
          for (int x = x0; x < x1; x += kBlock) {
            const Block block{x, std::min(x + kBlock, x1), y, std::min(y + kBlock, y1)};
            if (IsOpen(block)) SearchBlock(block, turned, looks, of_sector);
          }
        }
      }
    }
    best.erase(
        std::remove_if(
            best.begin(), best.end(), [](const StandingPlace& p) { return p.support <= 0.0; }),
        best.end());
    return best;
  }

 private:
  // Places of a grid, and whether enough views show edges there that are still unexplained.
  struct Grid {
    double step = 0.0;
    int columns = 0, rows = 0;
    std::vector<std::uint8_t> open;
  };

  struct Block {
    int x0, x1, y0, y1;
  };

  struct Turned {
    double yaw = 0.0;
    Eigen::Vector3d first = Eigen::Vector3d::Zero();  // centre in the first place of the grid
  };

  struct MapSum {
    double support = 0.0;
    std::size_t points = 0;  // that nothing hides
  };

  void MakeGrid() {
    const Eigen::Vector2d size = ground_.high - ground_.low;
    grid_.step = std::max(kStandingStepShare * object_.diameter_m(),
                          std::sqrt(size.x() * size.y() / kMaxPlaces));
    grid_.columns = static_cast<int>(size.x() / grid_.step) + 1;
    grid_.rows = static_cast<int>(size.y() / grid_.step) + 1;
    grid_.open.resize(static_cast<std::size_t>(grid_.columns) * grid_.rows);
    const Turned unturned{0.0, object_.CenterOf(face_, ground_.low.x(), ground_.low.y(), 0.0)};
    for (int j = 0; j < grid_.rows; ++j) {
      for (int i = 0; i < grid_.columns; ++i) {
        const Eigen::Vector3d center = PlaceOf(i, j, unturned);
        std::size_t open = 0;
        for (std::size_t v = 0; v < ground_.images.size(); ++v) {
          const Eigen::Vector3d there = ground_.camera_from_scene[v] * center;
          if (!IsShown(ground_, v, there)) continue;
          const double px = ground_.cameras[v].focal_px * object_.diameter_m() / there.z();
          const Eigen::Vector2d at = Project(ground_.cameras[v], there);
          open += px >= kLeastStandingPx &&
                  UnexplainedNear(ground_, v, at, kEdgeHalf * px) >= kEdgeLength * px &&
                  GroundShareNear(ground_, v, at, kEdgeHalf * px) <= kMostGround;
        }
        grid_.open[static_cast<std::size_t>(j) * grid_.columns + i] = open >= ground_.least_views;
      }
    }
  }

  // Whether any of its places is.
  bool IsOpen(const Block& block) const {
    for (int y = block.y0; y < block.y1; ++y) {
      const auto row = grid_.open.begin() + static_cast<std::ptrdiff_t>(y) * grid_.columns;
      if (std::find(row + block.x0, row + block.x1, 1) != row + block.x1) return true;
    }
    return false;
  }

  Eigen::Vector3d PlaceOf(double i, double j, const Turned& turned) const {
    return turned.first + grid_.step * (i * ground_.e1 + j * ground_.e2);
  }

  // Support of each open place of a block; the part looks the same from all of them, only moved.
  void SearchBlock(const Block& block,
                   const Turned& turned,
                   const std::vector<TurnedPoints>& looks,
                   StandingPlace* best) const {
    std::array<double, kBlock * kBlock> sums{}, points_shown{};
    std::array<std::uint8_t, kBlock * kBlock> shown{}, refused{};
    const auto index = [&](int x, int y) { return (y - block.y0) * kBlock + x - block.x0; };
    const auto cell = [&](int x, int y) { return static_cast<std::size_t>(y) * grid_.columns + x; };
    int open = 0;
    for (int y = block.y0; y < block.y1; ++y) {
      for (int x = block.x0; x < block.x1; ++x) {
        refused[index(x, y)] = !grid_.open[cell(x, y)];
        open += grid_.open[cell(x, y)];
      }
    }
    const Eigen::Vector3d middle =
        PlaceOf(0.5 * (block.x0 + block.x1 - 1), 0.5 * (block.y0 + block.y1 - 1), turned);
    const Eigen::Vector3d first = PlaceOf(block.x0, block.y0, turned);
    const Eigen::Vector3d along_x = grid_.step * ground_.e1, along_y = grid_.step * ground_.e2;
    for (std::size_t v = 0; v < looks.size() && open > 0; ++v) {
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
          const double least = kMinFirst - kViewSlack / (1.0 + shown[i]);
          const MapSum sum = MapSupport(v, points, moved, there.z(), least - kFirstSlack);
          if (sum.points == 0) continue;
          sums[i] += sum.support;
          points_shown[i] += static_cast<double>(sum.points);
          ++shown[i];
          if (sums[i] >= least * points_shown[i]) continue;
          refused[i] = 1;
          --open;
        }
      }
    }
    if (open == 0) return;
    for (int y = block.y0; y < block.y1; ++y) {
      for (int x = block.x0; x < block.x1; ++x) {
        const int i = index(x, y);
        if (refused[i] || shown[i] < ground_.least_views) continue;
        StandingPlace& here = best[cell(x, y)];
        const double support = Expected(sums[i], points_shown[i], kGridPoints);
        if (support <= here.support) continue;
        here = {ground_.low.x() + x * grid_.step,
                ground_.low.y() + y * grid_.step,
                turned.yaw,
                face_,
                support};
      }
    }
  }

  bool OnMap(std::size_t v,
             const TurnedPoints& look,
             const Eigen::Vector3d& center,
             MapPoints* out) const {
    const PinholeCamera& camera = ground_.cameras[v];
    const AspectImage& image = ground_.images[v];
    const Eigen::Vector3d there = ground_.camera_from_scene[v] * center;
    if (there.z() < kNearM) return false;
    const double size_px = camera.focal_px * object_.diameter_m() / there.z();
    if (size_px < kLeastStandingPx) return false;
    // Places of the block are up to kBlock / 2 steps off, along both axes.
    const double around = 0.5 * size_px * (1.0 + 1.5 * kBlock * grid_.step / object_.diameter_m());
    out->may_be_hidden = IsCoveredNear(ground_, v, Project(camera, there), around);
    out->center = Project(camera, there);
    out->count = look.count;
    out->reach = static_cast<std::int32_t>(
        AspectImage::kDistanceScale * std::clamp(static_cast<float>(kStandingReachShare * size_px),
                                                 kMinStandingReachPx,
                                                 kMaxStandingReachPx));
    const float f = 0.5f * static_cast<float>(camera.focal_px), k1 = static_cast<float>(camera.k1);
    const float cx = 0.5f * static_cast<float>(camera.cx);
    const float cy = 0.5f * static_cast<float>(camera.cy);
    const Eigen::Vector3f at = there.cast<float>();
    const float slack_m = object_.HiddenSlackM();
    const std::int32_t cells = image.half_width * image.half_height;
    for (std::size_t i = 0; i < out->count; ++i) {
      const float z = 1.0f / (look.z[i] + at.z());
      const float x = (look.x[i] + at.x()) * z, y = (look.y[i] + at.y()) * z;
      const float scale = f * (1.0f + k1 * (x * x + y * y));
      out->u[i] = static_cast<std::int16_t>(std::clamp(scale * x + cx, -kFarPx, kFarPx));
      out->v[i] = static_cast<std::int16_t>(std::clamp(scale * y + cy, -kFarPx, kFarPx));
      out->depth_m[i] = look.z[i] - slack_m;
      out->map[i] = look.bin[i] * cells;
    }
    std::fill(
        out->left_out.begin() + static_cast<std::ptrdiff_t>(out->count), out->left_out.end(), -1);
    return out->count >= kFirstPoints;
  }

  // Of the points that nothing hides; refused where the first find less than `least` in the mean.
  MapSum MapSupport(std::size_t v,
                    const MapPoints& points,
                    const Eigen::Vector2d& moved,
                    double depth_m,
                    double least) const {
    const AspectImage& image = ground_.images[v];
    const HidingMap& hiding = ground_.hiding[v];
    const int du = Rounded(0.5 * moved.x());
    const int dv = Rounded(0.5 * moved.y());
    const HalfMaps maps{image.half_distance.data(), image.half_width, image.half_height};
    std::array<std::int32_t, kGridPoints> left_out = points.left_out;
    std::int32_t away = 0;
    std::size_t shown = 0;
    const auto add = [&](std::size_t from, std::size_t to) {
      shown += std::min(to, points.count) - from;
      for (std::size_t i = from; points.may_be_hidden && i < std::min(to, points.count); ++i) {
        const float depth = points.depth_m[i] + static_cast<float>(depth_m);
        if (!hiding.Hides(points.u[i] + du, points.v[i] + dv, depth)) continue;
        left_out[i] = -1;
        --shown;
      }
      away += SumAway(maps, points, left_out.data(), du, dv, from, to);
    };
    add(0, kFirstPoints);
    if (away > (1.0 - least) * static_cast<double>(shown) * points.reach)
      return {0.0, kFirstPoints};
    add(kFirstPoints, kGridPoints);
    if (shown < kShownPoints) return {};
    return {static_cast<double>(shown) - static_cast<double>(away) / points.reach, shown};
  }

  const ObjectOnPlane& object_;
  const StandingGround& ground_;
  const int face_;
  Grid grid_;
};

}  // namespace

std::vector<StandingPlace> SearchFace(const ObjectOnPlane& object,
                                      int face,
                                      const StopRequested& stop) {
  return FaceSearch(object, face).Run(stop);
}

}  // namespace horopter
