#include "server/vision/recognition/aspects/closed_outlines.h"

#include <algorithm>
#include <cmath>
#include <numbers>
#include <opencv2/imgproc.hpp>
#include <span>

#include "server/vision/features/ellipse_fit.h"

namespace horopter {
namespace {

constexpr int kLeastPoints = 16;         // of a chain that may be an ellipse
constexpr double kSamePx = 2.0;          // ellipses whose centres and axes differ by less are one
constexpr double kPerimeterSlack = 1.3;  // a chain longer than this many perimeters is none

}  // namespace

std::vector<std::vector<Eigen::Vector2f>> FindClosedOutlines(const AspectImage& image,
                                                             const ClosedOutlineOptions& options) {
  if (image.width < 3 || image.height < 3) return {};
  // 0: free, 1: edge and what is near; a border cell more all around, from which the ground is
  // reached.
  cv::Mat edges(image.height + 2, image.width + 2, CV_8U, cv::Scalar(0));
  for (int y = 0; y < image.height; ++y) {
    for (int x = 0; x < image.width; ++x) {
      if (image.edge_at[image.Cell(x, y)] >= 0) edges.at<std::uint8_t>(y + 1, x + 1) = 1;
    }
  }
  const int side = 2 * options.gap_px + 1;
  const cv::Mat disc = cv::getStructuringElement(cv::MORPH_ELLIPSE, cv::Size(side, side));
  cv::Mat thick;
  cv::dilate(edges, thick, disc);
  // What touches the border may be cut off: the outermost cells stay free.
  cv::rectangle(thick, cv::Rect(0, 0, thick.cols, thick.rows), cv::Scalar(0));
  cv::floodFill(thick, cv::Point(0, 0), cv::Scalar(2), nullptr, cv::Scalar(), cv::Scalar(), 4);
  cv::Mat enclosed = thick == 0;
  cv::dilate(enclosed, enclosed, disc);  // to where the edges are
  std::vector<std::vector<cv::Point>> borders;
  cv::findContours(enclosed, borders, cv::RETR_EXTERNAL, cv::CHAIN_APPROX_NONE);
  std::vector<std::pair<double, std::vector<Eigen::Vector2f>>> found;
  for (const std::vector<cv::Point>& border : borders) {
    const cv::Rect box = cv::boundingRect(border);
    if (std::min(box.width, box.height) < options.min_size_px ||
        std::max(box.width, box.height) > options.max_size_share * image.width)
      continue;
    std::vector<cv::Point> hull;
    cv::convexHull(border, hull);
    std::vector<Eigen::Vector2f> outline;
    for (const cv::Point& p : hull)
      outline.emplace_back(static_cast<float>(p.x - 1), static_cast<float>(p.y - 1));
    found.emplace_back(cv::contourArea(hull), std::move(outline));
  }
  std::stable_sort(
      found.begin(), found.end(), [](const auto& a, const auto& b) { return a.first > b.first; });
  if (static_cast<int>(found.size()) > options.most) found.resize(options.most);
  std::vector<std::vector<Eigen::Vector2f>> out;
  for (auto& [area, outline] : found) out.push_back(std::move(outline));
  return out;
}

std::vector<EllipseArc> FindContourEllipses(const ContourGraph& contours,
                                            const ContourEllipseOptions& options) {
  std::vector<EllipseArc> out;
  for (const ContourChain& chain : contours.chains) {
    if (chain.size < kLeastPoints) continue;
    const auto arc = FitEllipse(std::span(contours.points).subspan(chain.begin, chain.size));
    if (!arc || arc->rms_px > options.max_rms_px || arc->semi_minor_px < options.min_minor_px ||
        std::abs(arc->sweep_rad) < options.min_sweep_rad)
      continue;
    const double perimeter = 2 * std::numbers::pi *
                             std::sqrt(0.5 * (arc->semi_major_px * arc->semi_major_px +
                                              arc->semi_minor_px * arc->semi_minor_px));
    if (chain.size > kPerimeterSlack * perimeter) continue;
    out.push_back(*arc);
  }
  std::stable_sort(out.begin(), out.end(), [](const EllipseArc& a, const EllipseArc& b) {
    return a.semi_major_px > b.semi_major_px;
  });
  std::vector<EllipseArc> distinct;
  for (const EllipseArc& e : out) {
    if (static_cast<int>(distinct.size()) >= options.most) break;
    const bool known = std::any_of(distinct.begin(), distinct.end(), [&](const EllipseArc& o) {
      return (o.center - e.center).norm() < kSamePx &&
             std::abs(o.semi_major_px - e.semi_major_px) < kSamePx &&
             std::abs(o.semi_minor_px - e.semi_minor_px) < kSamePx;
    });
    if (!known) distinct.push_back(e);
  }
  return distinct;
}

}  // namespace horopter
