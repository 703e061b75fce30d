// The supporting plane as the adjustment sees it: hundreds of patch matches per pair of views,
// averaged in cells. Texture all over the image tells focal lengths, principal points and lens
// distortion better than the parts in its middle do.
#pragma once

#include <Eigen/Core>
#include <optional>
#include <vector>

#include "server/vision/euclidean/learnt_constants.h"
#include "server/vision/matching/matching.h"
#include "server/vision/recognition/recognition.h"

namespace horopter {

// A point of the plane seen in two views: the mean of `matches` matches that lie together in
// view a. Image pixels; pixel_a counts as exact.
struct PlaneCell {
  int view_a = -1;
  int view_b = -1;
  Eigen::Vector2d pixel_a = Eigen::Vector2d::Zero();
  Eigen::Vector2d pixel_b = Eigen::Vector2d::Zero();
  // Makes an error of pixel_b one in standard deviations: its square is the inverse covariance.
  Eigen::Matrix2d whitening = Eigen::Matrix2d::Identity();
  int matches = 0;
};

struct ObservedPlane {
  // plane.(X - anchor) = -1 in the scene frame; the anchor is the mean camera centre.
  Eigen::Vector3d plane = Eigen::Vector3d::Zero();
  Eigen::Vector3d anchor = Eigen::Vector3d::Zero();
  std::vector<PlaneCell> cells;  // empty: the plane plays no part
};

struct PlaneCellOptions {
  // Cells of all pairs together, about; more: slower, hardly better (a cell's mean is as good as
  // its matches, and the map between two views varies slowly).
  int max_cells = 600;
  int matches_per_cell = 8;  // about; where there are few matches, cells are larger
  // What the deviation of a cell's mean does not fall below, however many matches it has: pixels of
  // an image kAdjustmentWidth wide.
  double floor_px = kCellFloorPx;
  // Noise alone gives a patch this share of its structure in every direction. Along grain and other
  // parallel edges nothing more is there: the search for the patch stays where it began, pixels off
  // and alike in all patches, and must not count. Higher: fewer directions are believed.
  double noise_share = kPatchNoiseShare;
};

// The matched points of the supporting plane between known views (matching.planes), averaged in
// square cells of the first view. Within a cell what counts is the offset from the pair's
// homography, so that a mean stands for its place although the map is not linear; what a patch did
// not measure (PlaneHomography::information) is not counted; matches three deviations off their
// cell are left out. Every pair of n views repeats what the others say: each is believed as much as
// 2 / n of an independent one. No cells when fewer than 12 matches agree on a plane
// (FindPlanePoints).
ObservedPlane AveragePlaneMatches(const MatchingResult& matching,
                                  const std::vector<std::optional<CalibratedCamera>>& views,
                                  const PlaneCellOptions& options);

}  // namespace horopter
