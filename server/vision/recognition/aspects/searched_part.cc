#include "server/vision/recognition/aspects/searched_part.h"

#include <algorithm>
#include <cmath>
#include <limits>

namespace horopter {

WorkingCutOptions CuttingOf(int images) {
  constexpr double kLargest = 4.0;
  WorkingCutOptions options;
  options.most_px *= std::min(1.0, kLargest / std::max(images, 1));
  return options;
}

WorkingCut CutOf(const cv::Size& size,
                 const std::vector<ImageBox>& boxes,
                 const WorkingCutOptions& options) {
  ImageBox all;
  double smallest = std::numeric_limits<double>::infinity();
  for (const ImageBox& box : boxes) {
    all.extend(box);
    smallest = std::min(smallest, box.sizes().maxCoeff());
  }
  WorkingCut out;
  out.scale = std::max(std::min(options.box_px / smallest, options.most_enlarged),
                       std::min(options.least_scale, options.most_enlarged));
  const double margin = options.margin_px / out.scale;
  const Eigen::Vector2i from = (all.min().array() + 0.5 - margin).floor().cast<int>();
  const Eigen::Vector2i to = (all.max().array() + 0.5 + margin).ceil().cast<int>();
  out.cut = cv::Rect(cv::Point(from.x(), from.y()), cv::Point(to.x(), to.y())) &
            cv::Rect(0, 0, size.width, size.height);
  out.scale = std::min(out.scale, std::sqrt(options.most_px / out.cut.area()));
  return out;
}

}  // namespace horopter
