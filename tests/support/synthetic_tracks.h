// Points and lines of simple parts or of random sets, seen by cameras on an arc: the experiments of
// the reconstruction, with exact ground truth.
#pragma once

#include <Eigen/Core>
#include <vector>

#include "server/vision/geometry/pinhole_camera.h"
#include "server/vision/geometry/rigid3.h"
#include "server/vision/reconstruction/multiview_tracks.h"

namespace horopter {

struct SyntheticTracksOptions {
  unsigned seed = 1;
  int views = 6;
  // 0: vertices and edges of `parts` extruded profiles (50 - 110 mm) on a circle of 120 mm.
  int points = 0;
  int lines = 0;
  int parts = 3;
  // Instead of all these: exactly these points and lines.
  std::vector<Eigen::Vector3d> given_points = {};
  std::vector<std::pair<Eigen::Vector3d, Eigen::Vector3d>> given_lines = {};
  bool planar = false;         // everything in the plane z = 0
  bool pure_rotation = false;  // all centres equal
  bool parallel_lines = false;
  double arc_rad = 1.396;   // azimuth of the cameras, 80 degrees
  double distance_m = 0.8;  // +- 10 %
  double min_focal_px = 850.0;
  double max_focal_px = 1150.0;
  bool equal_focal = false;
  double principal_point_sd_px = 10.0;
  double k1 = 0.0;
};

struct SyntheticTrackNoise {
  unsigned seed = 1;
  double sigma_px = 0.5;       // of points, and of line ends in both directions
  double missing_share = 0.2;  // of the observations
  double outlier_share = 0.0;  // of the observations, displaced
  double min_outlier_px = 6.0;
  double max_outlier_px = 40.0;
};

struct SyntheticTracks {
  std::vector<PinholeCamera> cameras;
  std::vector<Rigid3> camera_from_world;
  std::vector<Eigen::Vector3d> points;                             // metres
  std::vector<int> part_of_point;                                  // empty without parts
  std::vector<std::pair<Eigen::Vector3d, Eigen::Vector3d>> lines;  // two points on each
  MultiviewTracks tracks;
  std::vector<bool> point_outlier, line_outlier;  // per observation

  CameraMatrix TrueCamera(int view) const;
};

// The stated sigma of every observation is that of the noise (0.01 px where there is none).
SyntheticTracks MakeSyntheticTracks(const SyntheticTracksOptions& options,
                                    const SyntheticTrackNoise& noise);

// Collineation (metres from reconstruction) that maps the known points best onto the true ones, and
// the rms distance it leaves over points seen in two or more inlier observations. Infinite when
// there are fewer than 6 of them.
struct CollineationFit {
  Eigen::Matrix4d metric_from_scene = Eigen::Matrix4d::Identity();
  double rms_m = 0.0;
  int points = 0;
};
CollineationFit CompareWithTruth(const SyntheticTracks& truth, const ProjectiveScene& scene);

// How well the cameras alone carry the scene: the true points and line ends are intersected from
// their exact images; rms after the best collineation, metres. Infinite with fewer than 2 cameras.
double CameraCollineationRms(const SyntheticTracks& truth, const ProjectiveScene& scene);

}  // namespace horopter
