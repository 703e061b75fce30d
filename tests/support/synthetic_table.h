// Parts on a table as known cameras see them.
#pragma once

#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <memory>
#include <random>
#include <vector>

#include "server/vision/recognition/scene/scene_model.h"
#include "server/vision/recognition/scoring/pose_score.h"
#include "tests/support/synthetic_part.h"

namespace horopter {

// An L-bracket (object 0) and a wedge (1) may stand in it; the table is z = 0.
struct Table {
  std::vector<std::shared_ptr<const PreparedObject>> objects{PrepareObject(LBracket()).value(),
                                                             PrepareObject(Wedge()).value()};
  std::vector<PinholeCamera> cameras;
  std::vector<Rigid3> camera_from_table;
  std::vector<ImageFeatures> features;
  MatchingResult matching;

  JointContext Context() {
    JointContext context;
    context.objects = objects;
    context.matching = &matching;
    for (std::size_t v = 0; v < features.size(); ++v) {
      context.views.push_back(BuildViewEvidence(features[v]));
      context.start_cameras.push_back(cameras[v]);
      context.focal_log_sigma.push_back(0.1);
    }
    return context;
  }

  HypothesisTable NoHypotheses() const {
    return HypothesisTable(features.size(), std::vector<ViewHypotheses>(objects.size()));
  }
};

struct Shown {
  int object;
  Rigid3 plane_from_object;
};

inline Rigid3 Standing(double yaw, double x, double y, double z) {
  return {Eigen::AngleAxisd(yaw, Eigen::Vector3d::UnitZ()).toRotationMatrix(), {x, y, z}};
}

// Views on an arc of radius 0.65 m, end points with Gaussian noise.
inline Table MakeTable(const std::vector<Shown>& shown, int views, double noise_px, unsigned seed) {
  Table table;
  std::mt19937 rng(seed);
  for (int v = 0; v < views; ++v) {
    const double a = -0.9 + 0.45 * v;
    table.cameras.push_back(CenteredCamera(640, 480, 880.0 + 40 * v));
    table.camera_from_table.push_back(
        LookAt({0.5 * std::sin(a), -0.5 * std::cos(a), 0.42}, {0.02, 0.01, 0.02}));
    ImageFeatures f;
    f.width = 640;
    f.height = 480;
    for (const Shown& s : shown) {
      AddSyntheticFeatures(*table.objects[s.object],
                           table.cameras[v],
                           table.camera_from_table[v] * s.plane_from_object,
                           noise_px,
                           &rng,
                           &f);
    }
    table.features.push_back(std::move(f));
  }
  table.matching.component.assign(views, 0);
  table.matching.view_from_plane.assign(views, Eigen::Matrix3d::Identity());
  return table;
}

// Largest distance of the two poses in any view, pixels.
inline double LargestError(const Table& table, int object, const Rigid3& a, const Rigid3& b) {
  double largest = 0.0;
  for (std::size_t v = 0; v < table.cameras.size(); ++v) {
    largest = std::max(largest,
                       ProjectionDistance(*table.objects[object],
                                          table.cameras[v],
                                          table.camera_from_table[v] * a,
                                          table.cameras[v],
                                          table.camera_from_table[v] * b,
                                          1.0));
  }
  return largest;
}

}  // namespace horopter
