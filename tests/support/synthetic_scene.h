// Synthetic multi-view scenes of a textured plane (z = 0) and points above it, with exact ground
// truth.
#pragma once

#include <Eigen/Core>
#include <vector>

#include "server/vision/features/features.h"
#include "server/vision/geometry/pinhole_camera.h"
#include "server/vision/geometry/rigid3.h"
#include "server/vision/matching/matching.h"
#include "server/vision/reconstruction/reconstruction.h"

namespace horopter {

struct SyntheticSceneOptions {
  unsigned seed = 1;
  int views = 5;
  int plane_points = 150;
  int off_plane_points = 30;
  double arc_rad = 1.0;        // azimuth covered by the views
  bool pure_rotation = false;  // all centres equal
  double min_focal_widths = 1.2;
  double max_focal_widths = 1.8;
  int width = 640;
  int height = 480;
};

struct SyntheticScene {
  std::vector<PinholeCamera> cameras;
  std::vector<Rigid3> camera_from_world;  // world: plane z = 0, metres
  std::vector<Eigen::Vector3d> plane_points;
  std::vector<Eigen::Vector3d> off_plane_points;

  std::vector<ImageSize> Sizes() const;
  // Pixels of view b from pixels of view a, for points of the plane.
  Eigen::Matrix3d PlaneHomographyOf(int a, int b) const;
  Eigen::Matrix3d FundamentalOf(int a, int b) const;
};

SyntheticScene MakeSyntheticScene(const SyntheticSceneOptions& options);

struct SyntheticNoise {
  unsigned seed = 1;
  double sigma_px = 0.3;
  double outlier_share = 0.0;  // of the junction matches, replaced by arbitrary partners
};

// What perfect features and matching would say about the scene, plus noise: one junction per
// off-plane point and view, planes and F of all pairs.
struct SyntheticMatches {
  std::vector<ImageFeatures> features;
  MatchingResult matching;
};
SyntheticMatches MatchSyntheticScene(const SyntheticScene& scene, const SyntheticNoise& noise);

}  // namespace horopter
