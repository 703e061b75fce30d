#include "server/service/image_preview.h"

#include <algorithm>
#include <cmath>
#include <opencv2/imgproc.hpp>
#include <utility>
#include <vector>

#include "horopter/v1/recognition.pb.h"
#include "server/base/status_macros.h"
#include "server/service/image_codecs.h"

namespace horopter {
namespace {

constexpr int kPreviewSidePx = 800;

cv::Mat Smaller(const cv::Mat& image) {
  const int longer = std::max(image.cols, image.rows);
  if (longer <= kPreviewSidePx) return image;
  const double scale = static_cast<double>(kPreviewSidePx) / longer;
  const cv::Size size(std::max(1, static_cast<int>(std::lround(scale * image.cols))),
                      std::max(1, static_cast<int>(std::lround(scale * image.rows))));
  cv::Mat small;
  cv::resize(image, small, size, 0, 0, cv::INTER_AREA);
  return small;
}

}  // namespace

absl::StatusOr<ImagePreview> MakePreview(const v1::SceneImage& image, const ImageLimits& limits) {
  v1::RecognizeSceneRequest request;
  *request.add_images() = image;
  HOROPTER_RETURN_IF_ERROR(ShapesOf(request, limits).status());
  HOROPTER_ASSIGN_OR_RETURN(const std::vector<cv::Mat> decoded,
                            DecodeImages(request, limits, 1, {}));
  ImagePreview preview;
  preview.image_width = decoded[0].cols;
  preview.image_height = decoded[0].rows;
  HOROPTER_ASSIGN_OR_RETURN(preview.jpeg, EncodeJpeg(Smaller(decoded[0])));
  return preview;
}

}  // namespace horopter
