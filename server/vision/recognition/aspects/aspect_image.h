// What of one image the search for aspects looks at: edge points of all colour channels, contours
// that run through corners, and oriented distance maps.
#pragma once

#include <Eigen/Core>
#include <algorithm>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <optional>
#include <span>
#include <vector>

#include "absl/status/status.h"
#include "server/vision/geometry/pinhole_camera.h"
#include "server/vision/recognition/aspects/contour_chains.h"
#include "server/vision/recognition/aspects/pattern_edges.h"
#include "server/vision/recognition/aspects/searched_part.h"

namespace cv {
class Mat;
}

namespace horopter {

// Unoriented direction bins of 15 degrees; bin b is centred on b * pi / kAspectBins.
inline constexpr int kAspectBins = 12;

// Chance (AspectImage::chance, 0..1) up to this costs a pose nothing, as parts have it themselves;
// chosen.
inline constexpr double kFreeChance = 0.10;

// What makes an edge one of a textured ground by its motion (plane_edges.h).
struct PlaneEdgeOptions {
  // A ground covers this share of the image (in blocks) with edges. Seen: .29 - .68. ADR 56.
  double min_coverage = 0.3;
  // Where the tests of the image alone drop this share of the ground's edges they are enough. ADR
  // 59.
  double told_alone = 0.95;
};

struct AspectImageOptions {
  // Larger images are scaled down to this, those of less than 0.7 of it, or of 640, enlarged;
  // larger: finer, slower.
  int max_width_px = 640;
  double sigma_px = 1.0;        // of the smoothing; larger: fewer weak edges, rounder corners
  double low_threshold = 1.8;   // grey levels per px an edge must have
  double high_threshold = 4.0;  // ... and its component must reach somewhere
  double noise_factor = 3.0;    // low threshold at least this often the gradient's noise; 0: off
  // Images whose noise lifts the low threshold to more than so many times its value are smoothed
  // more, where it is white (edge_pixels.cc); large: none is. ADR 59.
  double noisy = 2.0;
  // Edges where the chance level of all directions together exceeds this are texture, as granite
  // has, and dropped; 1: none is.
  double max_texture = 0.24;
  bool smooth_figures = true;    // ... and those inside of what has no grain, and its outline
  bool coloured_figures = true;  // ... and those inside of what has another colour than the ground
  bool jpeg_blocks = true;   // steps along the grid of JPEG's blocks are smoothed (jpeg_blocks.h)
  bool drop_pattern = true;  // edges of patterned surfaces are dropped (pattern_edges.h)
  PatternOptions pattern;    // which these are
  PlaneEdgeOptions ground;   // what edges move with the ground, where its motion is known
  double max_gap_px = 6.0;   // ends of chains this near are linked
  int threads = 1;
};

// Errors: INVALID_ARGUMENT, names the field.
absl::Status Validate(const AspectImageOptions& options);

inline constexpr double kBinReachRad = 0.40;  // an edge counts in bins this near its direction

struct ImageEdgePoint {
  Eigen::Vector2f point = Eigen::Vector2f::Zero();    // working pixels, sub-pixel
  Eigen::Vector2f normal = Eigen::Vector2f::UnitX();  // unit, of the gradient; sign is arbitrary
  float strength = 0.0f;                              // grey levels per px, of the best channel
};

// Working pixels: the image, or the part of it that is searched, scaled as max_width_px or
// WorkingCut says. Distances are held in
// 1/8 px, saturated: per bin the distance to the nearest edge point whose direction is within
// kBinReachRad of the bin's; the half maps have one cell per 2 x 2 pixels.
struct AspectImage {
  static constexpr float kDistanceScale = 8.0f;  // steps a px: a byte holds 32 px
  static constexpr float kMaxStrength = 25.0f;   // stronger edges count no more
  static constexpr int kChanceBlockPx = 16;      // px a side over which chance is one; chosen
  static constexpr float kChanceTausPx[] = {3.0f, 7.0f, 16.0f};  // working px; chosen
  static constexpr int kChanceWindows[] = {3, 7, 15};            // blocks
  static constexpr int kChanceLevels = 3;                        // one per tau

  int image_width = 0, image_height = 0;  // of the original
  int width = 0, height = 0;              // working pixels
  // u_working = (u + 0.5 - origin) * working_from_image - 0.5, see WorkingPixel.
  double working_from_image = 1.0;
  Eigen::Vector2d origin = Eigen::Vector2d::Zero();  // px of the image, from its border
  // Boxes of the image in which parts are looked for, its edges are from there; nothing: all of it.
  std::optional<std::vector<ImageBox>> searched;
  std::vector<std::uint8_t> grey;    // [cell], smoothed a little
  std::vector<std::uint8_t> detail;  // [cell], 128 + its difference from what is around it
  std::vector<ImageEdgePoint> edges;
  std::vector<std::int32_t> edge_at;  // [cell], index into edges, -1: none
  ContourGraph contours;
  std::vector<std::uint8_t> distance;  // [bin][cell]
  int half_width = 0, half_height = 0;
  std::vector<std::uint8_t> half_distance;  // [bin][half cell]

  // [half cell], 1: among edges that move with the ground, which have been dropped; empty where
  // that is not known.
  std::vector<std::uint8_t> ground;

  // Chance level: mean support max(0, 1 - d / tau) around each block of kChanceBlockPx, over a
  // window of some 16 tau; what an edge of that direction would find there anyway. 0 .. 255.
  int chance_width = 0, chance_height = 0;
  std::vector<std::uint8_t> chance;   // [level][bin][block], tau = kChanceTausPx[level]
  std::vector<std::uint8_t> texture;  // [block], mean over the bins of the first level

  std::size_t Cell(int x, int y) const { return static_cast<std::size_t>(y) * width + x; }
  // Distance in 1/8 working px; 255 outside.
  std::uint8_t DistanceAt(float x, float y, int bin) const {
    if (!(x >= -0.5f && y >= -0.5f && x < width - 0.5f && y < height - 0.5f)) return 255;
    const int cx = static_cast<int>(x + 0.5f), cy = static_cast<int>(y + 0.5f);
    return distance[(static_cast<std::size_t>(bin) * height + cy) * width + cx];
  }
  // Level of the chance maps that fits a tolerance best.
  static int ChanceLevel(float tau_px) { return (tau_px > 4.6f) + (tau_px > 10.6f); }
  std::size_t Block(float x, float y) const {
    const int bx = std::clamp(static_cast<int>(x) / kChanceBlockPx, 0, chance_width - 1);
    const int by = std::clamp(static_cast<int>(y) / kChanceBlockPx, 0, chance_height - 1);
    return static_cast<std::size_t>(by) * chance_width + bx;
  }
  // Chance of support at a place inside the image, 0 .. 255.
  std::uint8_t ChanceAt(float x, float y, int bin, int level) const {
    return chance[static_cast<std::size_t>(level * kAspectBins + bin) * chance_width *
                      chance_height +
                  Block(x, y)];
  }
};

// A point of the original image in its working pixels, and back; and the map as a collineation.
Eigen::Vector2d WorkingPixel(const AspectImage& image, const Eigen::Vector2d& pixel);
Eigen::Vector2d OriginalPixel(const AspectImage& image, const Eigen::Vector2d& working);
Eigen::Matrix3d WorkingFromImage(const AspectImage& image);

// Whether parts are looked for at a place, working pixels.
inline bool IsSearched(const AspectImage& image, double x, double y) {
  return !image.searched || InBoxes(OriginalPixel(image, {x, y}), *image.searched);
}

// A camera of the original image as a camera of its working pixels, and back.
PinholeCamera WorkingCamera(const AspectImage& image, const PinholeCamera& camera);
PinholeCamera OriginalCamera(const AspectImage& image, const PinholeCamera& working);

// Bin of a direction (any length, sign does not matter). No trigonometry: asked for every projected
// point.
inline int AspectBin(float dx, float dy) {
  const float ax = std::abs(dx), ay = std::abs(dy);
  // Tangents of the borders at 7.5, 22.5, ... degrees.
  const int q = (ay > 0.13165250f * ax) + (ay > 0.41421356f * ax) + (ay > 0.76732699f * ax) +
                (ay > 1.30322537f * ax) + (ay > 2.41421356f * ax) + (ay > 7.59575411f * ax);
  return (dx < 0) == (dy < 0) ? q : (kAspectBins - q) % kAspectBins;
}

// image: 8 bit, 1, 3 (BGR) or 4 channels. An empty image or one of another kind gives an empty
// result (width 0). The five channels are B, G, R, R - G and (R + G) / 2 - B: parts and tables of
// one grey differ in colour.
AspectImage MakeAspectImage(const cv::Mat& image, const AspectImageOptions& options = {});

// The same of the images of one scene, whose ground is textured: edges that move with it are
// dropped before any other (plane_edges.h). image_from_plane: homographies (px) from one frame of
// the supporting plane, one per image; nullopt: not linked, its edges all stay.
// Empty: of none is the motion known. parts: one per image, where in it parts are looked for, or
// none: everywhere.
std::vector<AspectImage> MakeAspectImagesOnGround(
    std::span<const cv::Mat> images,
    std::span<const std::optional<Eigen::Matrix3d>> image_from_plane,
    const AspectImageOptions& options,
    int threads,
    std::span<const std::optional<SearchedPart>> parts = {});

}  // namespace horopter
