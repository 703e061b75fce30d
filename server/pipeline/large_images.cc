#include "server/pipeline/large_images.h"

#include <algorithm>

#include "server/pipeline/contradicted_hint.h"
#include "server/pipeline/presumed_focal.h"
#include "server/vision/features/image_strips.h"

namespace horopter {
namespace {

// Of the centre of a pixel: those of the larger image stand half a pixel about it.
double Enlarged(double coordinate, double factor) {
  return (coordinate + 0.5) * factor - 0.5;
}
double Reduced(double coordinate, double factor) {
  return (coordinate + 0.5) / factor - 0.5;
}

Eigen::Vector2d Enlarged(const Eigen::Vector2d& point, double factor) {
  return {Enlarged(point.x(), factor), Enlarged(point.y(), factor)};
}

void Reduce(double factor, CameraHint* hint) {
  if (hint->focal_px) *hint->focal_px /= factor;
  if (hint->principal_point)
    hint->principal_point = Eigen::Vector2d(Reduced(hint->principal_point->x(), factor),
                                            Reduced(hint->principal_point->y(), factor));
  if (hint->principal_point_sigma_px) *hint->principal_point_sigma_px /= factor;
}

// What is cut out for the search is cut out of the image as it came.
void Reduce(double factor, const cv::Mat& original, SearchedPart* part) {
  for (ImageBox& box : part->boxes) {
    box = ImageBox((box.min().array() + 0.5) / factor - 0.5,
                   (box.max().array() + 0.5) / factor - 0.5);
  }
  part->pixels = original;
  part->pixels_from_image = factor;
}

void Enlarge(double factor, const cv::Mat& image, PinholeCamera* camera) {
  camera->width = image.cols;
  camera->height = image.rows;
  camera->focal_px *= factor;
  camera->cx = Enlarged(camera->cx, factor);
  camera->cy = Enlarged(camera->cy, factor);
}

void Enlarge(double factor, EdgeReport* edges) {
  for (EdgeRun& run : edges->runs) {
    for (Eigen::Vector2d& point : run.points) point = Enlarged(point, factor);
  }
  edges->visible_px *= factor;
  edges->supported_px *= factor;
  edges->hidden_px *= factor;
}

cv::Mat Shrunk(const cv::Mat& image, int factor) {
  const cv::Rect whole(0, 0, image.cols / factor * factor, image.rows / factor * factor);
  return ShrinkInStrips(image(whole), factor);
}

}  // namespace

double ReductionOf(cv::Size image, int least_side_px, int small_side_px) {
  const int side = std::max(image.width, image.height);
  if (side < small_side_px && 3 * side >= 2 * small_side_px) return 0.5;
  return least_side_px > 0 ? std::max(1, side / least_side_px) : 1;
}

SceneRequest ReducedRequest(const SceneRequest& request, const std::vector<double>& factors) {
  SceneRequest out = request;
  for (std::size_t i = 0; i < factors.size(); ++i) {
    const double factor = factors[i];
    if (factor == 1) continue;
    const cv::Mat& image = request.images[i];
    out.images[i] = factor < 1.0 ? Doubled(image) : Shrunk(image, static_cast<int>(factor));
    if (!out.hints.empty()) Reduce(factor, &out.hints[i]);
    if (!out.searched.empty() && out.searched[i]) Reduce(factor, image, &*out.searched[i]);
  }
  return out;
}

void TellInOriginalPixels(const SceneRequest& original,
                          const std::vector<double>& factors,
                          SceneAnswer* answer) {
  for (AnswerFinding& f : answer->findings) {
    if (f.kind == FindingKind::kExifContradicted)
      f = ContradictedFocal(f.image, f.value * factors[f.image]);
  }
  for (ContradictedHint& hint : answer->contradicted_hints) {
    const double factor = factors[hint.image];
    hint = TellHint(hint.image, hint.focal_px * factor, Enlarged(hint.principal_point, factor));
  }
  for (std::size_t i = 0; i < factors.size(); ++i) {
    const double factor = factors[i];
    if (factor == 1) continue;
    const cv::Mat& image = original.images[i];
    if (auto& camera = answer->cameras[i]) Enlarge(factor, image, &camera->camera);
    if (i < answer->camera_bases.size()) {
      for (CameraBasis& basis : answer->camera_bases[i]) basis.rms_px *= factor;
    }
    if (!answer->unexplained_edges.empty()) {
      for (auto& line : answer->unexplained_edges[i]) {
        for (Eigen::Vector2d& point : line) point = Enlarged(point, factor);
      }
    }
    if (!answer->explanation || answer->explanation->found.views.empty()) continue;
    if (auto& view = answer->explanation->found.views[i]) {
      Enlarge(factor, image, &view->camera);
      Enlarge(factor, &view->edges);
    }
  }
}

}  // namespace horopter
