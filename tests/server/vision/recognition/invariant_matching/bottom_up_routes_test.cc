#include <gtest/gtest.h>

#include <Eigen/Dense>
#include <limits>

#include "server/vision/recognition/invariant_matching/metric_route.h"
#include "server/vision/recognition/invariant_matching/projective_route.h"
#include "server/vision/reconstruction/self_calibration.h"
#include "tests/support/profile_parts.h"

namespace horopter {
namespace {

// Parts without symmetry: every one has a clipped corner and a boss.
struct Catalog {
  std::vector<ObjectModel> models;
  std::vector<ObjectKeys> keys;
  std::vector<StructureObject> objects;
  KeyIndexSnapshot index;
};

Catalog MakeCatalog(int count) {
  Catalog out;
  for (int i = 0; i < count; ++i) {
    out.models.push_back(ProfilePart(static_cast<unsigned>(i) + 1, {1.0, 1.0}));
    out.keys.push_back(ComputeObjectKeys(out.models.back()));
  }
  std::vector<const ObjectKeys*> keys;
  for (int i = 0; i < count; ++i) {
    keys.push_back(&out.keys[i]);
    out.objects.push_back({&out.models[i], &out.keys[i], i});
  }
  auto index = KeyIndex::Build(keys, 1);
  EXPECT_TRUE(index.ok());
  out.index = index->Snapshot();
  return out;
}

struct Scene {
  ProfileScene truth;
  TracksResult reconstructed;
};

Scene MakeScene(const Catalog& catalog, unsigned seed, double sigma_px) {
  ProfileSceneOptions options;
  options.seed = seed;
  options.parts = 2;
  options.sigma_px = sigma_px;
  options.deleted_share = 0.1;
  options.clutter_share = 0.1;
  Scene out{MakeProfileScene(catalog.models, options), {}};
  auto found = ReconstructTracks(out.truth.tracks.tracks, {}, {}, {});
  EXPECT_TRUE(found.ok());
  out.reconstructed = *std::move(found);
  return out;
}

// Parts of which the best hypothesis on their points is the right object, vertex by vertex.
int RightParts(const ProfileScene& truth,
               const SceneStructure& structure,
               const std::vector<StructureHypothesis>& hypotheses) {
  int right = 0;
  for (int part = 0; part < static_cast<int>(truth.objects.size()); ++part) {
    for (const StructureHypothesis& h : hypotheses) {
      int own = 0, exact = 0;
      for (const VertexMatch& m : h.vertices) {
        const int track = structure.point_track[m.point];
        own += truth.part_of_point[track] == part;
        exact += truth.part_of_point[track] == part && truth.vertex_of_point[track] == m.vertex;
      }
      if (2 * own < static_cast<int>(h.vertices.size())) continue;
      right +=
          h.object == truth.objects[part] && 5 * exact >= 4 * static_cast<int>(h.vertices.size());
      break;  // the first is the best
    }
  }
  return right;
}

TEST(ProjectiveRoute, FindsPartsAtLowNoise) {
  const Catalog catalog = MakeCatalog(6);
  int right = 0, all = 0;
  for (unsigned seed = 1; seed <= 2; ++seed) {
    const Scene scene = MakeScene(catalog, seed, 0.1);
    ASSERT_EQ(scene.reconstructed.projective.outcome, ProjectiveOutcome::kReconstructed);
    const auto structure = ProjectiveStructure(
        scene.truth.tracks.tracks, scene.reconstructed.projective.scene, scene.truth.edges);
    ASSERT_TRUE(structure.ok()) << structure.status();
    ProjectiveRouteOptions options;
    options.tuples.max_sets = 4000;
    const auto found = ProjectiveHypotheses(*structure, catalog.index, catalog.objects, options);
    ASSERT_TRUE(found.ok()) << found.status();
    right += RightParts(scene.truth, *structure, found->hypotheses);
    all += 2;
  }
  EXPECT_GE(right, all - 1);
}

TEST(MetricRoute, FindsPartsAndTheScale) {
  const Catalog catalog = MakeCatalog(6);
  int right = 0, all = 0;
  for (unsigned seed = 1; seed <= 3; ++seed) {
    SCOPED_TRACE(testing::Message() << "seed " << seed);
    const Scene scene = MakeScene(catalog, seed, 0.3);
    if (scene.reconstructed.metric.outcome != MetricOutcome::kMetric) continue;
    const auto structure = MetricStructure(scene.truth.tracks.tracks,
                                           scene.reconstructed.projective.scene,
                                           scene.reconstructed.metric.scene,
                                           *scene.reconstructed.metric.covariance,
                                           scene.truth.edges);
    ASSERT_TRUE(structure.ok()) << structure.status();
    const auto found = MetricHypotheses(*structure, catalog.index, catalog.objects, {});
    ASSERT_TRUE(found.ok()) << found.status();
    right += RightParts(scene.truth, *structure, found->found.hypotheses);
    all += 2;
    ASSERT_TRUE(found->units_per_metre.has_value());
    // Two points of the same part, whose distance is known, tell the same scale.
    for (std::size_t i = 0; i < structure->points.size(); ++i) {
      for (std::size_t k = 0; k < i; ++k) {
        const double true_m = (scene.truth.tracks.points[structure->point_track[i]] -
                               scene.truth.tracks.points[structure->point_track[k]])
                                  .norm();
        if (true_m < 0.15) continue;
        const double units = (structure->points[i] - structure->points[k]).norm();
        EXPECT_NEAR(units / true_m / *found->units_per_metre, 1.0, 0.05);
      }
    }
  }
  ASSERT_GE(all, 4);
  EXPECT_GE(right, all - 1);
}

TEST(BottomUpRoutes, FindNothingOfPartsThatAreNotEnrolled) {
  const Catalog catalog = MakeCatalog(6);
  Catalog others = MakeCatalog(12);
  for (unsigned seed = 1; seed <= 2; ++seed) {
    const Scene scene = MakeScene(catalog, seed, 0.3);
    const auto structure = ProjectiveStructure(
        scene.truth.tracks.tracks, scene.reconstructed.projective.scene, scene.truth.edges);
    ASSERT_TRUE(structure.ok());
    ProjectiveRouteOptions options;
    options.tuples.max_sets = 1500;
    const auto found = ProjectiveHypotheses(
        *structure, others.index, std::span(others.objects).subspan(6), options);
    ASSERT_TRUE(found.ok());
    for (const StructureHypothesis& h : found->hypotheses) EXPECT_LT(h.log_odds, 45.0);
  }
}

TEST(BottomUpRoutes, RefuseWhatTheyCannotUse) {
  const Catalog catalog = MakeCatalog(2);
  SceneStructure empty;
  const auto nothing = ProjectiveHypotheses(empty, catalog.index, catalog.objects, {});
  ASSERT_TRUE(nothing.ok());
  EXPECT_TRUE(nothing->hypotheses.empty());
  EXPECT_EQ(MetricHypotheses(empty, catalog.index, catalog.objects, {}).status().code(),
            absl::StatusCode::kInvalidArgument);
  std::vector<StructureObject> twice = {catalog.objects[0], catalog.objects[0]};
  EXPECT_EQ(ProjectiveHypotheses(empty, catalog.index, twice, {}).status().code(),
            absl::StatusCode::kInvalidArgument);
  const Scene scene = MakeScene(catalog, 1, 0.3);
  const MultiviewTracks& tracks = scene.truth.tracks.tracks;
  const auto structure =
      ProjectiveStructure(tracks, scene.reconstructed.projective.scene, scene.truth.edges);
  ASSERT_TRUE(structure.ok());
  EXPECT_EQ(
      ProjectiveHypotheses(*structure, catalog.index, catalog.objects, {}, [] { return true; })
          .status()
          .code(),
      absl::StatusCode::kCancelled);
  // No points, and edges that name none.
  EXPECT_EQ(ProjectiveStructure(tracks, EmptyScene(tracks), {}).status().code(),
            absl::StatusCode::kFailedPrecondition);
  const std::vector<std::array<int, 2>> wrong = {{0, tracks.points}};
  EXPECT_EQ(
      ProjectiveStructure(tracks, scene.reconstructed.projective.scene, wrong).status().code(),
      absl::StatusCode::kInvalidArgument);
  EXPECT_EQ(ProjectiveStructure(tracks, ProjectiveScene(), {}).status().code(),
            absl::StatusCode::kInvalidArgument);
}

}  // namespace
}  // namespace horopter
