#include "server/vision/recognition/aspects/texture_edges.h"

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <opencv2/core/mat.hpp>
#include <utility>

#include "server/vision/recognition/aspects/ground_colour.h"
#include "server/vision/recognition/aspects/quantile.h"
#include "server/vision/recognition/aspects/smooth_figure.h"
#include "server/vision/recognition/aspects/texture_border.h"

namespace horopter {
namespace {

// Sums of edge pixels over boxes.
class EdgeCounts {
 public:
  explicit EdgeCounts(const AspectImage& image) : width_(image.width), height_(image.height) {
    sums_.assign(static_cast<std::size_t>(width_ + 1) * (height_ + 1), 0);
    for (int y = 0; y < height_; ++y) {
      int row = 0;
      for (int x = 0; x < width_; ++x) {
        row += image.edge_at[image.Cell(x, y)] >= 0;
        sums_[At(x + 1, y + 1)] = sums_[At(x + 1, y)] + row;
      }
    }
  }

  // Share of edge pixels in a box; 1 where little of the box is inside the image.
  double Share(const Eigen::Vector2f& center, int half) const {
    const int cx = static_cast<int>(std::lround(center.x()));
    const int cy = static_cast<int>(std::lround(center.y()));
    const int x0 = std::clamp(cx - half, 0, width_), x1 = std::clamp(cx + half + 1, 0, width_);
    const int y0 = std::clamp(cy - half, 0, height_), y1 = std::clamp(cy + half + 1, 0, height_);
    if (2 * (x1 - x0) * (y1 - y0) < (2 * half + 1) * (2 * half + 1)) return 1.0;
    const int sum = sums_[At(x1, y1)] - sums_[At(x0, y1)] - sums_[At(x1, y0)] + sums_[At(x0, y0)];
    return static_cast<double>(sum) / ((x1 - x0) * (y1 - y0));
  }

 private:
  std::size_t At(int x, int y) const { return static_cast<std::size_t>(y) * (width_ + 1) + x; }

  int width_, height_;
  std::vector<int> sums_;
};

// Of edge pixels beside an edge on texture: with fewer it stays.
constexpr double kSmoothSide = 0.06;
constexpr int kNear = 3;  // px that grains stand out of a border

// Edges in whose place a border is.
void MarkNear(const AspectImage& image,
              const std::vector<ImageEdgePoint>& border,
              std::vector<std::uint8_t>* drop) {
  for (const ImageEdgePoint& b : border) {
    const int cx = static_cast<int>(std::lround(b.point.x()));
    const int cy = static_cast<int>(std::lround(b.point.y()));
    for (int y = std::max(0, cy - kNear); y <= std::min(image.height - 1, cy + kNear); ++y) {
      for (int x = std::max(0, cx - kNear); x <= std::min(image.width - 1, cx + kNear); ++x) {
        const std::int32_t at = image.edge_at[image.Cell(x, y)];
        if (at >= 0) (*drop)[at] = 1;
      }
    }
  }
}

// The better one takes the place of the other where both are.
void AddBorder(const std::vector<ImageEdgePoint>& better,
               const AspectImage& image,
               std::vector<ImageEdgePoint>* border) {
  std::vector<Eigen::Vector2f> points;
  for (const ImageEdgePoint& e : better) points.push_back(e.point);
  const PointRaster raster = MakePointRaster(image.width, image.height, points);
  std::erase_if(*border, [&](const ImageEdgePoint& e) {
    const int cx = static_cast<int>(std::lround(e.point.x()));
    const int cy = static_cast<int>(std::lround(e.point.y()));
    for (int y = std::max(0, cy - kNear); y <= std::min(image.height - 1, cy + kNear); ++y) {
      for (int x = std::max(0, cx - kNear); x <= std::min(image.width - 1, cx + kNear); ++x) {
        if (raster.at[image.Cell(x, y)] >= 0) return true;
      }
    }
    return false;
  });
  border->insert(border->end(), better.begin(), better.end());
}

// Index of the image's edge that a point of a border stands for, -1: none.
int EdgeOfBorder(const AspectImage& image, const ImageEdgePoint& border) {
  constexpr float kBorderCosine = 0.9f;  // of the normals
  constexpr float kAlongPx = 1.0f;       // along the border; across it kNear
  const int cx = static_cast<int>(std::lround(border.point.x()));
  const int cy = static_cast<int>(std::lround(border.point.y()));
  int found = -1;
  float best = kNear + 0.5f;
  for (int y = std::max(0, cy - kNear); y <= std::min(image.height - 1, cy + kNear); ++y) {
    for (int x = std::max(0, cx - kNear); x <= std::min(image.width - 1, cx + kNear); ++x) {
      const std::int32_t at = image.edge_at[image.Cell(x, y)];
      if (at < 0) continue;
      const ImageEdgePoint& e = image.edges[at];
      if (std::abs(e.normal.dot(border.normal)) < kBorderCosine) continue;
      const Eigen::Vector2f off = e.point - border.point;
      const float across = std::abs(off.dot(border.normal));
      const float along = std::abs(off.x() * border.normal.y() - off.y() * border.normal.x());
      if (along > kAlongPx || across >= best) continue;
      best = across;
      found = at;
    }
  }
  return found;
}

// Onto the image's edges where there are such; one point a cell stays.
void SnapToEdges(const AspectImage& image, std::vector<ImageEdgePoint>* border) {
  std::vector<std::uint8_t> taken(image.edge_at.size(), 0);
  std::erase_if(*border, [&](ImageEdgePoint& e) {
    const int at = EdgeOfBorder(image, e);
    if (at >= 0) e = image.edges[at];
    const std::size_t cell = image.Cell(static_cast<int>(std::lround(e.point.x())),
                                        static_cast<int>(std::lround(e.point.y())));
    return std::exchange(taken[cell], 1) != 0;
  });
}

// From where on places are texture, and what a smooth side beside them has of edges.
struct TextureLimits {
  int level = 0;
  double smooth_side = 0.0;
};

// A ground of coarser grain has fewer edges than one of fine grain, but has them everywhere.
TextureLimits LimitsOf(const AspectImageOptions& options, const AspectImage& image) {
  // Of the usual limit: coarse or half covered granite has .72 - .95 in the middle place, fine
  // granite 1.2 - 1.46, all else 0 - .52, and so had one view of granite. Looked at in 58 images.
  constexpr double kCoarseShare = 0.62, kFineShare = 1.4;
  TextureLimits out{TextureLimit(options), kSmoothSide};
  std::vector<std::uint8_t> levels = image.texture;
  const int middle = Median(&levels);
  if (middle < kCoarseShare * out.level || middle >= out.level) return out;
  out.smooth_side *= middle / (kFineShare * out.level);
  out.level = middle / 2;
  return out;
}

// What of the edges on textured ground goes, and what comes in its place.
class Dropper {
 public:
  Dropper(const AspectImage& image, int limit)
      : image_(image), limit_(limit), drop_(image.edges.size(), 0) {}

  // Marks edges that have no smooth side.
  void MarkTexture(double smooth_side) {
    constexpr float kAside = 11.0f;  // px between an edge and the middle of what lies beside it
    constexpr int kHalf = 7;         // of the box beside it: far enough not to see the edge itself
    const EdgeCounts counts(image_);
    for (std::size_t i = 0; i < drop_.size(); ++i) {
      const ImageEdgePoint& e = image_.edges[i];
      drop_[i] = IsTextured(e) && counts.Share(e.point + kAside * e.normal, kHalf) > smooth_side &&
                 counts.Share(e.point - kAside * e.normal, kHalf) > smooth_side;
    }
  }

  std::vector<Eigen::Vector2f> Places() const {
    std::vector<Eigen::Vector2f> out;
    for (std::size_t i = 0; i < drop_.size(); ++i) {
      if (drop_[i]) out.push_back(image_.edges[i].point);
    }
    return out;
  }

  // The border of smooth places takes the place of the edges beside it, where it is one of
  // `figure`.
  void AddSmoothPlaces(const GroundFigure& figure, const AspectImageOptions& options) {
    constexpr float kBesideFigurePx = 5.0f;  // of the figure's border: discs roll on the grains
    border_ = TextureBorder(image_, drop_, options);
    if (figure.width > 0) {
      std::erase_if(border_, [&](const ImageEdgePoint& e) {
        return !figure.Inside(e.point) && !figure.Inside(e.point + kBesideFigurePx * e.normal) &&
               !figure.Inside(e.point - kBesideFigurePx * e.normal);
      });
    }
    MarkNear(image_, border_, &drop_);
  }

  // Edges inside the figure stay, and its outline is added where no border is.
  void AddSmoothFigure(const GroundFigure& figure) {
    std::vector<ImageEdgePoint> outline = OnTexture(figure.outline);
    KeepWithin(figure);
    MarkNear(image_, outline, &drop_);
    SnapToEdges(image_, &outline);
    AddBorder(border_, image_, &outline);
    border_ = std::move(outline);
  }

  // Edges inside the figure stay, and its outline takes the place of a border.
  void AddColourFigure(const GroundFigure& figure) {
    const std::vector<ImageEdgePoint> outline = OnTexture(figure.outline);
    KeepWithin(figure);
    MarkNear(image_, outline, &drop_);
    AddBorder(outline, image_, &border_);
  }

  std::vector<ImageEdgePoint> Edges() const {
    std::vector<ImageEdgePoint> out;
    for (std::size_t i = 0; i < drop_.size(); ++i) {
      if (!drop_[i]) out.push_back(image_.edges[i]);
    }
    out.insert(out.end(), border_.begin(), border_.end());
    return out;
  }

 private:
  bool IsTextured(const ImageEdgePoint& e) const {
    return image_.texture[image_.Block(e.point.x(), e.point.y())] > limit_;
  }

  std::vector<ImageEdgePoint> OnTexture(std::vector<ImageEdgePoint> outline) const {
    std::erase_if(outline, [&](const ImageEdgePoint& e) { return !IsTextured(e); });
    return outline;
  }

  void KeepWithin(const GroundFigure& figure) {
    constexpr float kOfEdgePx = 3.0f;  // from an edge to what it is the edge of
    for (std::size_t i = 0; i < drop_.size(); ++i) {
      const ImageEdgePoint& e = image_.edges[i];
      if (drop_[i] && figure.Inside(e.point + kOfEdgePx * e.normal) &&
          figure.Inside(e.point - kOfEdgePx * e.normal))
        drop_[i] = 0;
    }
  }

  const AspectImage& image_;
  const int limit_;  // chance level
  std::vector<std::uint8_t> drop_;
  std::vector<ImageEdgePoint> border_;
};

}  // namespace

std::vector<Eigen::Vector2f> DropTexture(const cv::Mat& bgr,
                                         const AspectImageOptions& options,
                                         AspectImage* image) {
  constexpr double kTexturedShare = 0.2;  // of the blocks; chosen, commit f40c0a3
  auto [limit, smooth_side] = LimitsOf(options, *image);
  const auto textured = std::count_if(image->texture.begin(),
                                      image->texture.end(),
                                      [most = limit](int level) { return level > most; });
  if (textured == 0) return {};
  // Beside a part half of the window is smooth.
  if (static_cast<double>(textured) > kTexturedShare * image->texture.size()) limit /= 2;
  Dropper dropper(*image, limit);
  dropper.MarkTexture(smooth_side);
  std::vector<Eigen::Vector2f> places = dropper.Places();
  if (places.empty()) return places;
  const GroundFigure smooth =
      options.smooth_figures ? FindSmoothFigure(bgr, places, options) : GroundFigure();
  const GroundFigure coloured =
      options.coloured_figures ? FindColourFigure(bgr, places, options) : GroundFigure();
  dropper.AddSmoothPlaces(smooth, options);
  if (smooth.width > 0) dropper.AddSmoothFigure(smooth);
  if (coloured.width > 0) dropper.AddColourFigure(coloured);
  image->edges = dropper.Edges();
  return places;
}

}  // namespace horopter
