// A scene on few of its features, and the others found again in its cameras.
#include "server/vision/reconstruction/few_features.h"

#include <gtest/gtest.h>

#include <Eigen/Dense>
#include <algorithm>

#include "tests/support/synthetic_tracks.h"

namespace horopter {
namespace {

CalibratedScene TrueScene(const SyntheticTracks& truth) {
  CalibratedScene scene;
  for (size_t v = 0; v < truth.cameras.size(); ++v) {
    scene.views.push_back(CalibratedView{{truth.cameras[v], truth.camera_from_world[v]}, 0.0});
  }
  for (const Eigen::Vector3d& x : truth.points) scene.points.push_back(x);
  for (const auto& [a, b] : truth.lines) {
    scene.lines.push_back(
        JoinPoints(Eigen::Vector4d(a.homogeneous()), Eigen::Vector4d(b.homogeneous()))
            .normalized());
  }
  return scene;
}

// A scene that knows all features, for its marks.
ProjectiveScene AllKnown(const SyntheticTracks& truth, const CalibratedScene& scene) {
  ProjectiveScene known = EmptyScene(truth.tracks);
  for (size_t j = 0; j < scene.points.size(); ++j) {
    known.points[j] = scene.points[j]->homogeneous();
  }
  known.lines = scene.lines;
  return known;
}

std::vector<int> ObservationsOfViews(const MultiviewTracks& tracks, const CalibratedScene& scene) {
  std::vector<int> count(tracks.sizes.size(), 0);
  for (const PointObservation& o : tracks.point_observations) {
    if (scene.points[o.point]) ++count[o.view];
  }
  for (const LineObservation& o : tracks.line_observations) {
    if (scene.lines[o.line]) ++count[o.view];
  }
  return count;
}

TEST(FewFeatures, EveryViewKeepsEnoughOfThem) {
  for (unsigned seed = 1; seed <= 20; ++seed) {
    SCOPED_TRACE(seed);
    for (const auto& [points, lines] : {std::pair{150, 150}, {120, 4}, {4, 120}, {9, 9}}) {
      const SyntheticTracks truth =
          MakeSyntheticTracks({.seed = seed, .points = points, .lines = lines}, {seed, 0.5, 0.3});
      const CalibratedScene scene = TrueScene(truth);
      const CalibratedScene few = OnFewFeatures(truth.tracks, AllKnown(truth, scene), 30, scene);
      const auto all = ObservationsOfViews(truth.tracks, scene);
      const auto kept = ObservationsOfViews(truth.tracks, few);
      int features = 0;
      for (const auto& x : few.points) features += x.has_value();
      for (const auto& l : few.lines) features += l.has_value();
      for (size_t v = 0; v < kept.size(); ++v) {
        // Points of one view, lines of two say nothing and are not kept: a few of what there is.
        EXPECT_GE(kept[v], std::min(30, all[v] - 8)) << v;
      }
      if (points + lines > 200) {
        EXPECT_LT(3 * features, points + lines);
      }
    }
  }
}

TEST(FewFeatures, TheOthersAreTriangulated) {
  for (unsigned seed = 1; seed <= 20; ++seed) {
    SCOPED_TRACE(seed);
    const SyntheticTracks truth =
        MakeSyntheticTracks({.seed = seed, .points = 60, .lines = 60}, {seed, 0.0, 0.2});
    const CalibratedScene scene = TrueScene(truth);
    const ProjectiveScene known = AllKnown(truth, scene);
    CalibratedScene few = OnFewFeatures(truth.tracks, known, 10, scene);
    TriangulateOthers(truth.tracks, known, &few);
    std::vector<int> seen(60, 0), lines_seen(60, 0);
    for (const PointObservation& o : truth.tracks.point_observations) ++seen[o.point];
    for (const LineObservation& o : truth.tracks.line_observations) ++lines_seen[o.line];
    for (int j = 0; j < 60; ++j) {
      if (seen[j] >= 2) {
        ASSERT_TRUE(few.points[j]) << j;
        EXPECT_LT((*few.points[j] - truth.points[j]).norm(), 1e-6) << j;
      }
      if (lines_seen[j] >= 3) {
        ASSERT_TRUE(few.lines[j]) << j;
        EXPECT_LT(LineLineDistance(*few.lines[j], *scene.lines[j]), 1e-6) << j;
        EXPECT_GT(std::abs(few.lines[j]->normalized().dot(*scene.lines[j])), 1.0 - 1e-9) << j;
      }
    }
  }
}

TEST(FewFeatures, WithoutInliersNothingIsTriangulated) {
  const SyntheticTracks truth =
      MakeSyntheticTracks({.seed = 3, .points = 20, .lines = 20}, {3, 0.5, 0.0});
  CalibratedScene scene = TrueScene(truth);
  ProjectiveScene known = AllKnown(truth, scene);
  std::fill(known.point_inlier.begin(), known.point_inlier.end(), false);
  std::fill(known.line_inlier.begin(), known.line_inlier.end(), false);
  const CalibratedScene few = OnFewFeatures(truth.tracks, known, 30, scene);
  for (const auto& x : few.points) EXPECT_FALSE(x);
  CalibratedScene none = few;
  TriangulateOthers(truth.tracks, known, &none);
  for (const auto& x : none.points) EXPECT_FALSE(x);
  for (const auto& l : none.lines) EXPECT_FALSE(l);
}

}  // namespace
}  // namespace horopter
