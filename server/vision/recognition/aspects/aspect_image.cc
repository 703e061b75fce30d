#include "server/vision/recognition/aspects/aspect_image.h"

#include <Eigen/LU>
#include <algorithm>
#include <cmath>
#include <opencv2/imgproc.hpp>

#include "absl/strings/str_cat.h"
#include "server/base/parallel_for.h"
#include "server/vision/features/image_strips.h"
#include "server/vision/recognition/aspects/aspect_maps.h"
#include "server/vision/recognition/aspects/edge_pixels.h"
#include "server/vision/recognition/aspects/jpeg_blocks.h"
#include "server/vision/recognition/aspects/pattern_edges.h"
#include "server/vision/recognition/aspects/plane_edges.h"
#include "server/vision/recognition/aspects/sharpening_halos.h"
#include "server/vision/recognition/aspects/texture_edges.h"

namespace horopter {
namespace {

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

std::vector<Eigen::Vector2f> EdgePlaces(const AspectImage& image) {
  std::vector<Eigen::Vector2f> points;
  points.reserve(image.edges.size());
  for (const ImageEdgePoint& e : image.edges) points.push_back(e.point);
  return points;
}

// Of several edges in one cell, as borders and edges of a figure may be, the first stays: edges and
// their raster share indices.
void IndexEdges(AspectImage* image) {
  image->edge_at.assign(static_cast<std::size_t>(image->width) * image->height, -1);
  std::size_t kept = 0;
  for (const ImageEdgePoint& e : image->edges) {
    std::int32_t& at = image->edge_at[image->Cell(static_cast<int>(e.point.x() + 0.5f),
                                                  static_cast<int>(e.point.y() + 0.5f))];
    if (at >= 0) continue;
    at = static_cast<std::int32_t>(kept);
    image->edges[kept++] = e;
  }
  image->edges.resize(kept);
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
  constexpr double kMostEnlarged = 1.6;  // beyond, an edge is wider than the tolerances
  constexpr double kEnlargedPx = 640.0;  // at most to this
  constexpr double kSmall = 0.7;         // of that
  const double width = options.max_width_px, side = std::max(size.width, size.height);
  if (size.width > width) return width / size.width;
  const double enlarged = std::min(width, kEnlargedPx);
  return side < kSmall * enlarged ? std::min(kMostEnlarged, enlarged / side) : 1.0;
}

void FillGrey(const cv::Mat& bgr, AspectImage* out) {
  constexpr double kNoiseSigmaPx = 1.0, kSurroundingsPx = 8.0;  // working px: of noise; of shading
  cv::Mat grey, around, detail;
  cv::cvtColor(bgr, grey, cv::COLOR_BGR2GRAY);
  cv::GaussianBlur(grey, grey, {}, kNoiseSigmaPx);
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
  if (!(o.noisy > 0)) return bad("noisy");
  if (!(o.max_texture > 0)) return bad("max_texture");
  if (!(o.max_gap_px >= 0)) return bad("max_gap_px");
  if (o.threads < 1) return bad("threads");
  if (!(o.ground.min_coverage >= 0 && o.ground.min_coverage <= 1))
    return bad("ground.min_coverage");
  if (!(o.ground.told_alone >= 0)) return bad("ground.told_alone");
  return absl::OkStatus();
}

Eigen::Vector2d WorkingPixel(const AspectImage& image, const Eigen::Vector2d& pixel) {
  return (pixel.array() + 0.5 - image.origin.array()) * image.working_from_image - 0.5;
}

Eigen::Vector2d OriginalPixel(const AspectImage& image, const Eigen::Vector2d& working) {
  return (working.array() + 0.5) / image.working_from_image - 0.5 + image.origin.array();
}

Eigen::Matrix3d WorkingFromImage(const AspectImage& image) {
  const double s = image.working_from_image;
  const Eigen::Vector2d t = WorkingPixel(image, Eigen::Vector2d::Zero());
  Eigen::Matrix3d m;
  m << s, 0, t.x(), 0, s, t.y(), 0, 0, 1;
  return m;
}

PinholeCamera WorkingCamera(const AspectImage& image, const PinholeCamera& camera) {
  const Eigen::Vector2d center = WorkingPixel(image, {camera.cx, camera.cy});
  PinholeCamera out = camera;
  out.width = image.width;
  out.height = image.height;
  out.focal_px *= image.working_from_image;
  out.cx = center.x();
  out.cy = center.y();
  return out;
}

PinholeCamera OriginalCamera(const AspectImage& image, const PinholeCamera& working) {
  const double s = 1.0 / image.working_from_image;
  PinholeCamera out = working;
  out.width = image.image_width;
  out.height = image.image_height;
  out.focal_px *= s;
  out.cx = (working.cx + 0.5) * s - 0.5 + image.origin.x();
  out.cy = (working.cy + 0.5) * s - 0.5 + image.origin.y();
  return out;
}

namespace {

// Grey levels per px an edge of an image with blocks must have, in its blockiness. Of four images
// of cad-dev at JPEG 60 and 30: edges that are there without compression are .37 - .94 of all
// without it, .83 - .97 with 1.5; of those of 8 levels per px .97 - .99 are left at 60, .89 - .99
// at 30.
constexpr double kEdgeOfBlocks = 1.25;

// An image on its way: its working pixels, and thresholds that fit them.
struct Detected {
  AspectImage image;
  cv::Mat bgr;
  AspectImageOptions options;
};

// What becomes the working pixels: an image, or the part of it that is searched.
struct Source {
  cv::Mat bgr;                                       // empty: no image, or one of another kind
  double scale = 1.0;                                // working pixels per pixel of it
  Eigen::Vector2d origin = Eigen::Vector2d::Zero();  // AspectImage::origin
  double working_from_image = 1.0;
  double blockiness = 0.0;  // of the image before its blocks were smoothed, 0: it has none
};

// Smooths the steps between JPEG's blocks and says how large they were; made much smaller, an image
// has none left.
Unblocked WithoutBlocksAt(double scale, const cv::Mat& bgr, const AspectImageOptions& options) {
  constexpr double kBlocksVanish = 0.4;
  if (!options.jpeg_blocks || scale < kBlocksVanish) return {bgr, 0.0};
  return WithoutBlocks(bgr);
}

Source WholeSource(const cv::Mat& image, const AspectImageOptions& options) {
  Source out;
  if (!image.empty()) out.bgr = AsBgr(image);
  if (out.bgr.empty()) return out;
  out.scale = out.working_from_image = WorkingScale(out.bgr.size(), options);
  const Unblocked smooth = WithoutBlocksAt(out.scale, out.bgr, options);
  out.bgr = smooth.image;
  out.blockiness = smooth.blockiness;
  return out;
}

// Nothing is cut out where nothing is searched.
Source PartSource(const cv::Mat& image,
                  const SearchedPart& part,
                  const AspectImageOptions& options,
                  WorkingCutOptions cutting) {
  Source out = WholeSource(image, options);
  if (out.bgr.empty() || part.boxes.empty()) return out;
  const cv::Mat& pixels = part.pixels.empty() ? image : part.pixels;
  const double there = part.pixels.empty() ? 1.0 : part.pixels_from_image;
  std::vector<ImageBox> boxes;
  for (const ImageBox& box : part.boxes) {
    boxes.emplace_back((box.min().array() + 0.5) * there - 0.5,
                       (box.max().array() + 0.5) * there - 0.5);
  }
  cutting.least_scale = out.scale / there;
  cutting.most_enlarged = part.most_enlarged;
  const WorkingCut cut = CutOf(pixels.size(), boxes, cutting);
  if (!part.pixels.empty() || out.scale < cut.scale) {
    const Unblocked smooth = WithoutBlocksAt(cut.scale, AsBgr(pixels), options);
    out.bgr = smooth.image;
    out.blockiness = smooth.blockiness;
  }
  out.bgr = out.bgr(cut.cut);
  out.scale = cut.scale;
  out.working_from_image = cut.scale * there;
  out.origin = Eigen::Vector2d(cut.cut.x, cut.cut.y) / there;
  return out;
}

// Scaled by `scale`.
cv::Mat Scaled(const cv::Mat& bgr, double scale) {
  if (scale == 1.0) return bgr;
  const bool larger = scale > 1.0;
  const cv::Size size(std::max(1, static_cast<int>(std::lround(bgr.cols * scale))),
                      std::max(1, static_cast<int>(std::lround(bgr.rows * scale))));
  const int factor = larger ? 1 : StripFactor(bgr.size(), scale);
  cv::Mat scaled;
  cv::resize(factor > 1 ? ShrinkInStrips(bgr, factor) : bgr,
             scaled,
             size,
             0,
             0,
             larger ? cv::INTER_CUBIC : cv::INTER_AREA);
  return scaled;
}

// What is outside of the boxes is no edge of a part that is looked for.
void DropUnsearched(AspectImage* image) {
  if (!image->searched) return;
  std::erase_if(image->edges, [&](const ImageEdgePoint& e) {
    return !InBoxes(OriginalPixel(*image, e.point.cast<double>()), *image->searched);
  });
}

// All edges and their maps.
Detected Detect(const cv::Mat& image,
                const AspectImageOptions& given,
                const std::optional<SearchedPart>& part,
                const WorkingCutOptions& cutting) {
  const Source source = part ? PartSource(image, *part, given, cutting) : WholeSource(image, given);
  Detected d{{}, source.bgr, given};
  AspectImage& out = d.image;
  if (d.bgr.empty()) return d;
  d.bgr = Scaled(source.bgr, source.scale);
  if (source.scale > 1.0) {
    // The same edge is so much less steep.
    d.options.low_threshold /= source.scale;
    d.options.high_threshold /= source.scale;
  }
  // Quantisation leaves flat blocks, by which no noise is told, and steps of its own within them.
  const double quantized =
      kEdgeOfBlocks * source.blockiness * std::min(source.scale, 1.0 / source.scale);
  if (quantized > d.options.low_threshold) {
    d.options.high_threshold *= quantized / d.options.low_threshold;
    d.options.noisy *= d.options.low_threshold / quantized;  // as much noise as before is much
    d.options.low_threshold = quantized;
  }
  out.working_from_image = source.working_from_image;
  out.origin = source.origin;
  if (part) out.searched = part->boxes;
  out.image_width = image.cols;
  out.image_height = image.rows;
  out.width = d.bgr.cols;
  out.height = d.bgr.rows;
  FillGrey(d.bgr, &out);
  out.edges = DetectEdgePoints(d.bgr, d.options);
  DropHalos(d.bgr, &out.edges);
  DropUnsearched(&out);
  IndexEdges(&out);
  FillAspectMaps(d.options.threads, &out);
  return d;
}

// Without the edges of texture and pattern.
AspectImage WithoutTexture(Detected d) {
  AspectImage& out = d.image;
  if (d.bgr.empty()) return std::move(out);
  const std::vector<Eigen::Vector2f> texture = DropTexture(d.bgr, d.options, &out);
  const bool textured = !texture.empty();
  if (textured) IndexEdges(&out);
  out.contours = Contours(d.options, out);
  const bool patterned = DropPattern(d.options, texture, &out);
  if (patterned) out.contours = Contours(d.options, out);
  if (textured || patterned) FillAspectMaps(d.options.threads, &out);
  return std::move(out);
}

// What is left of edges that were dropped in part: nothing of this length is a part's.
void DropFragments(AspectImage* image) {
  constexpr int kFragmentPx = 8;  // chosen
  cv::Mat there(image->height, image->width, CV_8U, cv::Scalar(0)), labels, stats, centroids;
  for (std::size_t i = 0; i < image->edge_at.size(); ++i) there.data[i] = image->edge_at[i] >= 0;
  cv::connectedComponentsWithStats(there, labels, stats, centroids, 8, CV_32S);
  std::vector<std::uint8_t> fragments(image->edges.size(), 0);
  for (std::size_t i = 0; i < fragments.size(); ++i) {
    const Eigen::Vector2f& p = image->edges[i].point;
    const int component =
        labels.at<int>(static_cast<int>(p.y() + 0.5f), static_cast<int>(p.x() + 0.5f));
    fragments[i] = stats.at<int>(component, cv::CC_STAT_AREA) < kFragmentPx;
  }
  Drop(fragments, image);
}

// The first image's edges in the blocks told, the second's in the others.
AspectImage Composed(const AspectImageOptions& options,
                     const std::vector<std::uint8_t>& told,
                     const AspectImage& in_told,
                     AspectImage elsewhere) {
  std::vector<ImageEdgePoint> edges;
  const auto take = [&](const AspectImage& image, bool where) {
    for (const ImageEdgePoint& e : image.edges) {
      if ((told[image.Block(e.point.x(), e.point.y())] != 0) == where) edges.push_back(e);
    }
  };
  take(in_told, true);
  take(elsewhere, false);
  AspectImage& out = elsewhere;
  out.edges = std::move(edges);
  IndexEdges(&out);
  out.contours = Contours(options, out);
  FillAspectMaps(options.threads, &out);
  return std::move(out);
}

// Where the image alone tells the ground's texture it tells it best: before dense texture outlines
// of what stands on it meet something in the other views, too, and what motion leaves of the
// texture is too thin to be told afterwards.
AspectImage WithoutGround(Detected d, const PlaneEdges& on_ground) {
  const std::vector<std::uint8_t> ground = GroundCells(d.image, on_ground);
  AspectImage out = WithoutTexture(d);
  const ToldAlone told = FindToldAlone(d.image, on_ground.marked, out, d.options.ground.told_alone);
  if (!told.as_a_whole) {
    Drop(on_ground.marked, &d.image);
    DropFragments(&d.image);
    FillAspectMaps(d.options.threads, &d.image);
    const AspectImageOptions options = d.options;
    out = Composed(options, told.blocks, out, WithoutTexture(std::move(d)));
  }
  out.ground = ground;
  return out;
}

}  // namespace

AspectImage MakeAspectImage(const cv::Mat& image, const AspectImageOptions& options) {
  return WithoutTexture(Detect(image, options, std::nullopt, {}));
}

std::vector<AspectImage> MakeAspectImagesOnGround(
    std::span<const cv::Mat> images,
    std::span<const std::optional<Eigen::Matrix3d>> image_from_plane,
    const AspectImageOptions& options,
    int threads,
    std::span<const std::optional<SearchedPart>> parts) {
  const int n = static_cast<int>(images.size());
  const WorkingCutOptions cutting = CuttingOf(n);
  const bool known = image_from_plane.size() == images.size();
  std::vector<Detected> detected(n);
  ParallelFor(n, threads, [&](int i) {
    detected[i] = Detect(images[i], options, parts.empty() ? std::nullopt : parts[i], cutting);
  });
  std::vector<PlaneEdges> on_ground(n);
  ParallelFor(n, threads, [&](int i) {
    if (!known || !image_from_plane[i]) return;
    const Eigen::Matrix3d plane_from_here =
        (WorkingFromImage(detected[i].image) * *image_from_plane[i]).inverse();
    std::vector<GroundView> others;
    for (int k = 0; k < n; ++k) {
      if (k == i || !image_from_plane[k]) continue;
      const AspectImage& there = detected[k].image;
      others.push_back({&there, WorkingFromImage(there) * *image_from_plane[k] * plane_from_here});
    }
    on_ground[i] = FindPlaneEdges(detected[i].image, others, options.ground);
  });
  std::vector<AspectImage> out(n);
  ParallelFor(n, threads, [&](int i) {
    out[i] = on_ground[i].marked.empty() ? WithoutTexture(std::move(detected[i]))
                                         : WithoutGround(std::move(detected[i]), on_ground[i]);
  });
  return out;
}

}  // namespace horopter
