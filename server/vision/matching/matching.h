// What the matching stage gives: supporting-plane homographies, feature matches and epipolar
// geometry (thesis 2.7).
#pragma once

#include <Eigen/Core>
#include <map>
#include <optional>
#include <span>
#include <string>
#include <vector>

#include "absl/status/statusor.h"
#include "server/base/stop_token.h"
#include "server/vision/features/features.h"
#include "server/vision/matching/matching_options.h"

namespace horopter {

// Homography of the supporting plane between two views: x_b ~ H x_a in pixels.
struct PlaneHomography {
  int view_a = -1;
  int view_b = -1;
  Eigen::Matrix3d b_from_a = Eigen::Matrix3d::Identity();
  std::vector<Eigen::Vector2d> inliers_a;  // matched points, pixels
  std::vector<Eigen::Vector2d> inliers_b;
  // Per inlier: inliers_b - b_from_a(inliers_a) is this times the offset that was found. What was
  // measured of the point in b, relative: 1 across the edges of its patch, less along them, where
  // the homography speaks. Empty: everything was measured.
  std::vector<Eigen::Matrix2d> information;
};

// Junction match between two views (indices into ImageFeatures::junctions).
struct JunctionMatch {
  int junction_a = -1;
  int junction_b = -1;
  double log_ratio = 0.0;  // log-likelihood ratio of being right, neighbours included
};

// Segment match between two views (indices into ImageFeatures::segments): pieces of one edge, whose
// ends need not correspond.
struct SegmentMatch {
  int segment_a = -1;
  int segment_b = -1;
  double log_ratio = 0.0;
};

// One junction or segment of the scene as found in >= 2 views, at most once in each.
struct FeatureTrack {
  struct Feature {
    int view = -1;
    int feature = -1;  // index into ImageFeatures::junctions or ::segments
  };
  std::vector<Feature> features;  // by view
};

// Epipolar geometry of two views, x_b^T F x_a = 0, with the matches found along its lines; without
// F the matches that similarity and neighbourhood alone give.
struct PairGeometry {
  int view_a = -1;
  int view_b = -1;
  std::optional<Eigen::Matrix3d> F;
  std::vector<JunctionMatch> matches;
  std::vector<SegmentMatch> segments;
  std::string refusal;  // why F is empty
};

struct MatchingResult {
  std::vector<PlaneHomography> planes;  // accepted pairs only
  std::vector<PairGeometry> pairs;
  // Over all views, from the pairs with an F; conflicts resolved for the likelier match.
  std::vector<FeatureTrack> junction_tracks;
  std::vector<FeatureTrack> segment_tracks;
  // Chained supporting plane: component[i] is the id of view i's plane component (-1: none);
  // view_from_plane[i] maps the component's first view's pixels to view i's pixels (identity for
  // that view itself).
  std::vector<int> component;
  std::vector<Eigen::Matrix3d> view_from_plane;
  // Per view and segment: moves with the supporting plane, so it lies on it (texture, shadow,
  // contact edge). Judged only against views whose epipolar geometry proves parallax; else false.
  std::vector<std::vector<bool>> segment_on_plane;
  std::map<std::string, double> counts;
};

// Matches N views of one static scene. images: CV_8UC3 or CV_8UC1, same order as features. Views
// without any link keep component -1. Errors: INVALID_ARGUMENT for sizes that do not agree,
// CANCELLED.
absl::StatusOr<MatchingResult> MatchViews(std::span<const cv::Mat> images,
                                          std::span<const ImageFeatures> features,
                                          const MatchingOptions& options,
                                          const StopRequested& stop = {});

}  // namespace horopter
