#include "server/vision/matching/relative_pose.h"

#include <opencv2/calib3d.hpp>
#include <vector>

namespace horopter {
namespace {

constexpr int kLeastPoints = 8;
constexpr double kConfidence = 0.9999;

}  // namespace

std::optional<Rigid3> EstimateRelativePose(std::span<const PointPair> points, double gate) {
  if (std::ssize(points) < kLeastPoints) return std::nullopt;
  std::vector<cv::Point2d> a, b;
  for (const PointPair& p : points) {
    a.emplace_back(p.a.x(), p.a.y());
    b.emplace_back(p.b.x(), p.b.y());
  }
  const cv::Mat K = cv::Mat::eye(3, 3, CV_64F);
  try {
    cv::Mat mask, R, t;
    const cv::Mat E = cv::findEssentialMat(a, b, K, cv::RANSAC, kConfidence, gate, mask);
    if (E.rows != 3 || E.cols != 3) return std::nullopt;
    if (cv::recoverPose(E, a, b, K, R, t, mask) < kLeastPoints) return std::nullopt;
    Rigid3 b_from_a;
    for (int r = 0; r < 3; ++r) {
      for (int c = 0; c < 3; ++c) b_from_a.R(r, c) = R.at<double>(r, c);
      b_from_a.t(r) = t.at<double>(r);
    }
    return b_from_a;
  } catch (const cv::Exception&) {
    return std::nullopt;
  }
}

}  // namespace horopter
