#include "server/vision/recognition/aspects/aspect_image.h"

#include <algorithm>
#include <cmath>
#include <opencv2/imgproc.hpp>

#include "absl/strings/str_cat.h"
#include "server/base/parallel_for.h"
#include "server/vision/features/image_strips.h"
#include "server/vision/recognition/aspects/edge_pixels.h"
#include "server/vision/recognition/aspects/ground_colour.h"
#include "server/vision/recognition/aspects/pattern_edges.h"
#include "server/vision/recognition/aspects/quantile.h"
#include "server/vision/recognition/aspects/texture_border.h"

namespace horopter {
namespace {

constexpr float kPi = 3.14159265358979f;

cv::Mat AsBgr(const cv::Mat& image) {
  if (image.depth() != CV_8U) return {};
  switch (image.channels()) {
    case 1:
      return RecolourInStrips(image, cv::COLOR_GRAY2BGR, 3);
    case 3:
      return image;
    case 4:
      return RecolourInStrips(image, cv::COLOR_BGRA2BGR, 3);
    default:
      return {};
  }
}

// Both maps of one bin.
void FillBin(int bin, double reach_rad, const std::vector<float>& directions, AspectImage* image) {
  cv::Mat zero_at_edges(image->height, image->width, CV_8U, cv::Scalar(1));
  const float center = bin * kPi / kAspectBins;
  for (std::size_t i = 0; i < image->edges.size(); ++i) {
    float off = std::abs(directions[i] - center);
    off = std::min(off, kPi - off);
    if (off > reach_rad) continue;
    const Eigen::Vector2f& p = image->edges[i].point;
    zero_at_edges.at<std::uint8_t>(static_cast<int>(std::lround(p.y())),
                                   static_cast<int>(std::lround(p.x()))) = 0;
  }
  cv::Mat distance;
  cv::distanceTransform(zero_at_edges, distance, cv::DIST_L2, cv::DIST_MASK_3, CV_32F);
  cv::Mat full(
      image->height,
      image->width,
      CV_8U,
      image->distance.data() + static_cast<std::size_t>(bin) * image->width * image->height);
  distance.convertTo(full, CV_8U, AspectImage::kDistanceScale);
  cv::Mat half(image->half_height,
               image->half_width,
               CV_8U,
               image->half_distance.data() +
                   static_cast<std::size_t>(bin) * image->half_width * image->half_height);
  cv::resize(full, half, half.size(), 0, 0, cv::INTER_AREA);
}

// Chance levels of one bin: block means of the support, then means over the window.
void FillChance(int bin, AspectImage* image) {
  constexpr int kBlock = AspectImage::kChanceBlockPx;  // px
  const std::size_t blocks = static_cast<std::size_t>(image->chance_width) * image->chance_height;
  const std::uint8_t* half = image->half_distance.data() +
                             static_cast<std::size_t>(bin) * image->half_width * image->half_height;
  for (int level = 0; level < AspectImage::kChanceLevels; ++level) {
    const float tau = AspectImage::kChanceTausPx[level] * AspectImage::kDistanceScale;
    cv::Mat sum(image->chance_height, image->chance_width, CV_32F, cv::Scalar(0));
    cv::Mat count(image->chance_height, image->chance_width, CV_32F, cv::Scalar(1e-6));
    for (int y = 0; y < image->half_height; ++y) {
      float* sum_row = sum.ptr<float>(std::min(2 * y / kBlock, image->chance_height - 1));
      float* count_row = count.ptr<float>(std::min(2 * y / kBlock, image->chance_height - 1));
      for (int x = 0; x < image->half_width; ++x) {
        const int block = std::min(2 * x / kBlock, image->chance_width - 1);
        const float d = half[static_cast<std::size_t>(y) * image->half_width + x];
        sum_row[block] += std::max(0.0f, 1.0f - d / tau);
        count_row[block] += 1.0f;
      }
    }
    const cv::Size window(AspectImage::kChanceWindows[level], AspectImage::kChanceWindows[level]);
    cv::blur(sum, sum, window, cv::Point(-1, -1), cv::BORDER_REPLICATE);
    cv::blur(count, count, window, cv::Point(-1, -1), cv::BORDER_REPLICATE);
    cv::divide(sum, count, sum);
    cv::Mat out(
        image->chance_height,
        image->chance_width,
        CV_8U,
        image->chance.data() + static_cast<std::size_t>(level * kAspectBins + bin) * blocks);
    sum.convertTo(out, CV_8U, 255.0);
  }
}

void FillTexture(AspectImage* image) {
  const std::size_t blocks = static_cast<std::size_t>(image->chance_width) * image->chance_height;
  image->texture.resize(blocks);
  for (std::size_t b = 0; b < blocks; ++b) {
    int sum = 0;
    for (int bin = 0; bin < kAspectBins; ++bin) sum += image->chance[bin * blocks + b];
    image->texture[b] = static_cast<std::uint8_t>(sum / kAspectBins);
  }
}

void FillMaps(const AspectImageOptions& options, AspectImage* image) {
  const std::size_t cells = static_cast<std::size_t>(image->width) * image->height;
  image->half_width = (image->width + 1) / 2;
  image->half_height = (image->height + 1) / 2;
  image->distance.resize(cells * kAspectBins);
  image->half_distance.resize(static_cast<std::size_t>(image->half_width) * image->half_height *
                              kAspectBins);
  image->chance_width =
      (image->width + AspectImage::kChanceBlockPx - 1) / AspectImage::kChanceBlockPx;
  image->chance_height =
      (image->height + AspectImage::kChanceBlockPx - 1) / AspectImage::kChanceBlockPx;
  image->chance.resize(static_cast<std::size_t>(AspectImage::kChanceLevels) * kAspectBins *
                       image->chance_width * image->chance_height);
  std::vector<float> directions;
  directions.reserve(image->edges.size());
  for (const ImageEdgePoint& e : image->edges) {
    float angle = std::atan2(e.normal.x(), -e.normal.y());
    angle = angle < 0 ? angle + kPi : angle;
    directions.push_back(angle >= kPi ? angle - kPi : angle);
  }
  ParallelFor(kAspectBins, options.threads, [&](int bin) {
    FillBin(bin, options.bin_reach_rad, directions, image);
    FillChance(bin, image);
  });
  FillTexture(image);
}

std::vector<Eigen::Vector2f> EdgePlaces(const AspectImage& image) {
  std::vector<Eigen::Vector2f> points;
  points.reserve(image.edges.size());
  for (const ImageEdgePoint& e : image.edges) points.push_back(e.point);
  return points;
}

// There is one edge a cell at most, so indices of the raster are those of the edges.
void IndexEdges(AspectImage* image) {
  image->edge_at = MakePointRaster(image->width, image->height, EdgePlaces(*image)).at;
}

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

// Chance level from which on edges are texture.
int TextureLimit(const AspectImageOptions& options) {
  return static_cast<int>(255 * options.max_texture);
}

bool HasTexture(const AspectImageOptions& options, const AspectImage& image) {
  return std::any_of(image.texture.begin(), image.texture.end(), [&](int level) {
    return level > TextureLimit(options);
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
  TextureLimits out{TextureLimit(options), options.smooth_side};
  std::vector<std::uint8_t> levels = image.texture;
  const int middle = Median(&levels);
  if (middle < kCoarseShare * out.level || middle >= out.level) return out;
  out.smooth_side *= middle / (kFineShare * out.level);
  out.level = middle / 2;
  return out;
}

// Drops the edges of textured places but for those with a smooth side, outlines of smooth parts on
// granite, and those of things of another colour. Returns whether there were any; `dropped` are
// their places.
bool DropTexture(const cv::Mat& bgr,
                 const AspectImageOptions& options,
                 std::vector<Eigen::Vector2f>* dropped,
                 AspectImage* image) {
  constexpr float kOfEdgePx = 3.0f;  // from an edge to what it is the edge of
  constexpr float kAside = 11.0f;    // px between an edge and the middle of what lies beside it
  constexpr int kHalf = 7;           // of the box beside it: far enough not to see the edge itself
  constexpr double kTexturedShare = 0.2;  // of the blocks; chosen, commit f40c0a3
  auto [limit, smooth_side] = LimitsOf(options, *image);
  const auto textured = std::count_if(image->texture.begin(),
                                      image->texture.end(),
                                      [most = limit](int level) { return level > most; });
  if (textured == 0) return false;
  // Beside a part half of the window is smooth.
  if (static_cast<double>(textured) > kTexturedShare * image->texture.size()) limit /= 2;
  const EdgeCounts counts(*image);
  std::vector<std::uint8_t> drop(image->edges.size(), 0);
  for (std::size_t i = 0; i < image->edges.size(); ++i) {
    const ImageEdgePoint& e = image->edges[i];
    if (image->texture[image->Block(e.point.x(), e.point.y())] <= limit) continue;
    drop[i] = counts.Share(e.point + kAside * e.normal, kHalf) > smooth_side &&
              counts.Share(e.point - kAside * e.normal, kHalf) > smooth_side;
    if (drop[i]) dropped->push_back(e.point);
  }
  if (dropped->empty()) return false;
  std::vector<ImageEdgePoint> border = TextureBorder(*image, drop, options);
  MarkNear(*image, border, &drop);
  const ColourFigure figure = FindColourFigure(bgr, *dropped, options);
  if (figure.width > 0) {
    for (std::size_t i = 0; i < drop.size(); ++i) {
      const ImageEdgePoint& e = image->edges[i];
      if (drop[i] && figure.Differs(e.point + kOfEdgePx * e.normal) &&
          figure.Differs(e.point - kOfEdgePx * e.normal))
        drop[i] = 0;
    }
    std::vector<ImageEdgePoint> outline = figure.outline;
    std::erase_if(outline, [&](const ImageEdgePoint& e) {
      return image->texture[image->Block(e.point.x(), e.point.y())] <= limit;
    });
    MarkNear(*image, outline, &drop);
    AddBorder(outline, *image, &border);
  }
  std::size_t kept = 0;
  for (std::size_t i = 0; i < drop.size(); ++i) {
    if (!drop[i]) image->edges[kept++] = image->edges[i];
  }
  image->edges.resize(kept);
  image->edges.insert(image->edges.end(), border.begin(), border.end());
  return true;
}

ContourGraph Contours(const AspectImageOptions& options, const AspectImage& image) {
  return TraceContours({image.width, image.height, EdgePlaces(image), image.edge_at},
                       options.max_gap_px);
}

void Drop(const std::vector<std::uint8_t>& marked, AspectImage* image) {
  std::size_t kept = 0;
  for (std::size_t i = 0; i < marked.size(); ++i) {
    if (!marked[i]) image->edges[kept++] = image->edges[i];
  }
  image->edges.resize(kept);
  IndexEdges(image);
}

PointRaster RasterOf(const AspectImage& image) {
  return {image.width, image.height, EdgePlaces(image), image.edge_at};
}

// Holes of a perforated sheet are told one by one before they count as texture, which takes what
// lies beside them with it. Returns whether there were any.
bool DropHoles(const AspectImageOptions& options, AspectImage* image) {
  if (!options.drop_pattern || !HasTexture(options, *image)) return false;
  std::vector<Eigen::Vector2f> texture;
  for (const ImageEdgePoint& e : image->edges) {
    if (image->texture[image->Block(e.point.x(), e.point.y())] > TextureLimit(options))
      texture.push_back(e.point);
  }
  const std::vector<std::uint8_t> holes =
      FindHolePoints(RasterOf(*image), Contours(options, *image), texture, options.pattern);
  if (!holes.empty()) Drop(holes, image);
  return !holes.empty();
}

// Returns whether there were any.
bool DropPattern(const AspectImageOptions& options,
                 const std::vector<Eigen::Vector2f>& texture,
                 AspectImage* image) {
  if (!options.drop_pattern) return false;
  const std::vector<std::uint8_t> patterned =
      FindPatternPoints(RasterOf(*image), image->contours, texture, options.pattern);
  if (!patterned.empty()) Drop(patterned, image);
  return !patterned.empty();
}

// Scores count supported pixels, and tolerances are a few: a small image, as of a cut-out, is
// looked at as large as others are.
double WorkingScale(const cv::Size& size, const AspectImageOptions& options) {
  constexpr double kMostEnlarged = 2.6;  // beyond, an edge is wider than the tolerances
  constexpr double kSmall = 0.7;         // of max_width_px
  const double width = options.max_width_px, side = std::max(size.width, size.height);
  if (size.width > width) return width / size.width;
  return side < kSmall * width ? std::min(kMostEnlarged, width / side) : 1.0;
}

void FillGrey(const cv::Mat& bgr, AspectImage* out) {
  constexpr double kSmoothPx = 1.0, kSurroundingsPx = 8.0;  // working px: of noise; of shading
  cv::Mat grey, around, detail;
  cv::cvtColor(bgr, grey, cv::COLOR_BGR2GRAY);
  cv::GaussianBlur(grey, grey, {}, kSmoothPx);
  cv::GaussianBlur(grey, around, {}, kSurroundingsPx);
  cv::subtract(grey, around, detail, cv::noArray(), CV_16S);
  detail.convertTo(detail, CV_8U, 1.0, 128.0);
  out->grey.assign(grey.datastart, grey.dataend);
  out->detail.assign(detail.datastart, detail.dataend);
}

}  // namespace

absl::Status Validate(const AspectImageOptions& o) {
  const auto bad = [](const char* field) {
    return absl::InvalidArgumentError(absl::StrCat("AspectImageOptions.", field));
  };
  if (o.max_width_px < 64) return bad("max_width_px");
  if (!(o.sigma_px > 0)) return bad("sigma_px");
  if (!(o.low_threshold > 0)) return bad("low_threshold");
  if (!(o.high_threshold >= o.low_threshold)) return bad("high_threshold");
  if (!(o.noise_factor >= 0)) return bad("noise_factor");
  if (o.min_component_px < 1) return bad("min_component_px");
  if (!(o.max_texture > 0)) return bad("max_texture");
  if (!(o.smooth_side >= 0)) return bad("smooth_side");
  if (!(o.max_gap_px >= 0)) return bad("max_gap_px");
  if (!(o.bin_reach_rad > 0.14)) return bad("bin_reach_rad");
  if (o.threads < 1) return bad("threads");
  return absl::OkStatus();
}

PinholeCamera WorkingCamera(const AspectImage& image, const PinholeCamera& camera) {
  const double s = image.working_from_image;
  PinholeCamera out = camera;
  out.width = image.width;
  out.height = image.height;
  out.focal_px *= s;
  out.cx = (camera.cx + 0.5) * s - 0.5;
  out.cy = (camera.cy + 0.5) * s - 0.5;
  return out;
}

PinholeCamera OriginalCamera(const AspectImage& image, const PinholeCamera& working) {
  const double s = 1.0 / image.working_from_image;
  PinholeCamera out = working;
  out.width = image.image_width;
  out.height = image.image_height;
  out.focal_px *= s;
  out.cx = (working.cx + 0.5) * s - 0.5;
  out.cy = (working.cy + 0.5) * s - 0.5;
  return out;
}

AspectImage MakeAspectImage(const cv::Mat& image, const AspectImageOptions& given) {
  AspectImage out;
  AspectImageOptions options = given;
  cv::Mat bgr = image.empty() ? cv::Mat() : AsBgr(image);
  if (bgr.empty()) return out;
  out.working_from_image = WorkingScale(bgr.size(), options);
  if (out.working_from_image != 1.0) {
    const bool larger = out.working_from_image > 1.0;
    const int width = std::max(1, static_cast<int>(std::lround(bgr.cols * out.working_from_image)));
    const int height =
        std::max(1, static_cast<int>(std::lround(image.rows * out.working_from_image)));
    const int factor = larger ? 1 : StripFactor(bgr.size(), out.working_from_image);
    if (factor > 1) bgr = ShrinkInStrips(bgr, factor);
    cv::Mat scaled;
    cv::resize(
        bgr, scaled, cv::Size(width, height), 0, 0, larger ? cv::INTER_CUBIC : cv::INTER_AREA);
    bgr = scaled;
    if (larger) {
      // The same edge is so much less steep.
      options.low_threshold /= out.working_from_image;
      options.high_threshold /= out.working_from_image;
    }
  }
  out.image_width = image.cols;
  out.image_height = image.rows;
  out.width = bgr.cols;
  out.height = bgr.rows;
  FillGrey(bgr, &out);
  out.edges = DetectEdgePoints(bgr, options);
  IndexEdges(&out);
  FillMaps(options, &out);
  if (DropHoles(options, &out)) FillMaps(options, &out);
  std::vector<Eigen::Vector2f> texture;
  const bool textured = DropTexture(bgr, options, &texture, &out);
  if (textured) IndexEdges(&out);
  out.contours = Contours(options, out);
  const bool patterned = DropPattern(options, texture, &out);
  if (patterned) out.contours = Contours(options, out);
  if (textured || patterned) FillMaps(options, &out);
  return out;
}

}  // namespace horopter
