#include <gtest/gtest.h>

#include <Eigen/Geometry>
#include <limits>

#include "server/vision/recognition/initialization/bottom_up_route.h"
#include "tests/support/matched_scene.h"

namespace horopter {
namespace {

using Objects = std::vector<std::shared_ptr<const PreparedObject>>;

Objects Prepared(const std::vector<ObjectModel>& models) {
  Objects out;
  for (const ObjectModel& m : models) out.push_back(PrepareObject(m).value());
  return out;
}

JointContext ContextOf(const MatchedScene& scene, const StopRequested& stop = {}) {
  return MakeContext({scene.features, {}, scene.objects}, {}, stop, {});
}

RouteCatalog CatalogOf(const MatchedScene& scene) {
  return MakeRouteCatalog(scene.objects, nullptr, {}).value();
}

// Least error (pixels) of the scenes whose part is the one that is there.
double BestError(const MatchedScene& truth, const std::vector<AspectScene>& scenes) {
  double best = 1e9;
  for (const AspectScene& s : scenes) {
    if (s.objects.front().object == 0) best = std::min(best, truth.LargestError(s));
  }
  return best;
}

std::vector<FeatureView> FeatureViews(const MatchedScene& scene) {
  std::vector<FeatureView> views;
  for (std::size_t v = 0; v < scene.cameras.size(); ++v) {
    views.push_back({{scene.cameras[v], scene.camera_from_world[v]}, &scene.features[v], 1.0});
  }
  return views;
}

TEST(StructureOfCorners, IsThePartUpToASimilarity) {
  for (const double noise : {0.0, 0.3}) {
    const MatchedScene scene = MakeMatchedScene(Prepared({LBracket()}), 5, noise, 11);
    const std::vector<FeatureView> views = FeatureViews(scene);
    const auto found = StructureOfCorners(views, FindSpaceCorners(views));
    ASSERT_TRUE(found.ok()) << found.status();
    const SceneStructure& s = found->structure;
    EXPECT_TRUE(s.metric);
    ASSERT_GE(s.points.size(), 6u);
    EXPECT_GE(s.edges.size(), 5u);
    const ObjectModel& model = scene.objects[0]->model;
    const Eigen::Matrix4d back = found->structure_from_scene.inverse();
    std::vector<int> vertex;
    for (const Eigen::Vector3d& x : s.points) {
      const Eigen::Vector3d world = (back * x.homogeneous()).hnormalized();
      vertex.push_back(-1);
      for (int i = 0; i < static_cast<int>(model.vertices.size()); ++i) {
        if ((scene.world_from_object * model.vertices[i] - world).norm() < 0.0005 + 0.003 * noise)
          vertex.back() = i;
      }
      EXPECT_GE(vertex.back(), 0);
    }
    for (const auto& [a, b] : s.edges) {
      EXPECT_TRUE(std::any_of(model.edges.begin(),
                              model.edges.end(),
                              [&](const ModelEdge& e) {
                                return (e.start_vertex == vertex[a] && e.end_vertex == vertex[b]) ||
                                       (e.start_vertex == vertex[b] && e.end_vertex == vertex[a]);
                              }))
          << vertex[a] << " - " << vertex[b];
    }
    for (const PointObservation& o : s.point_observations) {
      const Eigen::Vector2d seen =
          ProjectPoint(*s.cameras[o.view], s.points[o.point].homogeneous());
      EXPECT_LT((seen - o.pixel).norm(), 0.1 + 5.0 * noise);
    }
    // A few segments are those of another edge that looks alike there.
    std::vector<double> misses;
    for (const LineObservation& o : s.line_observations) {
      const Eigen::Vector3d line = ProjectLine(*s.cameras[o.view], s.lines[o.line]);
      misses.push_back(std::max(std::abs(line.dot(o.start.homogeneous())),
                                std::abs(line.dot(o.end.homogeneous()))));
    }
    ASSERT_GE(misses.size(), 15u);
    std::sort(misses.begin(), misses.end());
    EXPECT_LT(misses[misses.size() / 2], 0.1 + 2.0 * noise);
    EXPECT_LT(misses.back(), CornerStructureOptions().max_line_px);
  }
}

TEST(StructureOfCorners, RefusesTooFewAndTooMany) {
  const MatchedScene scene = MakeMatchedScene(Prepared({LBracket()}), 4, 0.0, 12);
  const std::vector<FeatureView> views = FeatureViews(scene);
  std::vector<SpaceCorner> corners = FindSpaceCorners(views);
  EXPECT_EQ(StructureOfCorners(views, {}).status().code(), absl::StatusCode::kFailedPrecondition);
  EXPECT_EQ(StructureOfCorners(views, std::span(corners).first(4)).status().code(),
            absl::StatusCode::kFailedPrecondition);
  corners.resize(kMaxStructurePoints + 1, corners[0]);
  EXPECT_EQ(StructureOfCorners(views, corners).status().code(), absl::StatusCode::kInvalidArgument);
}

TEST(MetricScenes, AreOfThePartInItsScale) {
  for (unsigned seed = 1; seed <= 3; ++seed) {
    SCOPED_TRACE(testing::Message() << "seed " << seed);
    const MatchedScene scene =
        MakeMatchedScene(Prepared({LBracket(), Wedge(), TwistedPrism(1)}), 5, 0.3, seed);
    const std::vector<AspectScene> scenes =
        MetricScenes(ContextOf(scene), scene.features, scene.reconstruction, CatalogOf(scene), {});
    ASSERT_FALSE(scenes.empty());
    EXPECT_EQ(scenes.front().objects.front().object, 0);
    // The images refine what comes near.
    EXPECT_LT(BestError(scene, scenes), 8.0);
  }
}

TEST(MetricScenes, AreTheSameWithTheCatalogsIndexAndItsSlots) {
  const MatchedScene scene = MakeMatchedScene(Prepared({LBracket(), Wedge()}), 5, 0.3, 5);
  const Objects others = Prepared({TwistedPrism(1), TwistedPrism(2)});
  auto index = KeyIndex::Build({&others[0]->keys,
                                &scene.objects[1]->keys,
                                nullptr,
                                &scene.objects[0]->keys,
                                &others[1]->keys},
                               7);
  ASSERT_TRUE(index.ok());
  const KeyIndexSnapshot snapshot = index->Snapshot();
  const std::vector<int> slots = {3, 1};
  const auto catalog = MakeRouteCatalog(scene.objects, &snapshot, slots);
  ASSERT_TRUE(catalog.ok()) << catalog.status();
  const JointContext context = ContextOf(scene);
  const auto own =
      MetricScenes(context, scene.features, scene.reconstruction, CatalogOf(scene), {});
  const auto with_catalog =
      MetricScenes(context, scene.features, scene.reconstruction, *catalog, {});
  ASSERT_FALSE(own.empty());
  EXPECT_LT(BestError(scene, own), 8.0);
  EXPECT_LT(BestError(scene, with_catalog), 8.0);
  EXPECT_EQ(MakeRouteCatalog(scene.objects, &snapshot, std::span(slots).first(1)).status().code(),
            absl::StatusCode::kInvalidArgument);
}

TEST(ProjectiveScenes, AreOfThePartAndItsCamerasFromMatchesAlone) {
  int right = 0;
  for (unsigned seed = 1; seed <= 4; ++seed) {
    SCOPED_TRACE(testing::Message() << "seed " << seed);
    const MatchedScene scene = MakeMatchedScene(
        Prepared({TwistedPrism(seed), TwistedPrism(seed + 10), LBracket()}), 6, 0.2, seed);
    const std::vector<AspectScene> scenes =
        ProjectiveScenes(ContextOf(scene), scene.features, scene.matching, CatalogOf(scene), {});
    const double error = BestError(scene, scenes);
    RecordProperty("error_px_" + std::to_string(seed), std::to_string(error));
    right += error < 12.0;
  }
  EXPECT_GE(right, 3);
}

TEST(StructureScenes, AreNoneOnAStopAndOfFiveFeatures) {
  MatchedScene scene = MakeMatchedScene(Prepared({LBracket()}), 4, 0.0, 7);
  const RouteCatalog catalog = CatalogOf(scene);
  const JointContext stopped = ContextOf(scene, [] { return true; });
  EXPECT_TRUE(MetricScenes(stopped, scene.features, scene.reconstruction, catalog, {}).empty());
  EXPECT_TRUE(ProjectiveScenes(stopped, scene.features, scene.matching, catalog, {}).empty());
  for (ImageFeatures& f : scene.features) {
    f.segments.resize(5);
    f.junctions.clear();
  }
  for (PairGeometry& pair : scene.matching.pairs) {
    pair.matches.clear();
    pair.segments.clear();
  }
  const JointContext context = ContextOf(scene);
  EXPECT_TRUE(MetricScenes(context, scene.features, scene.reconstruction, catalog, {}).empty());
  EXPECT_TRUE(ProjectiveScenes(context, scene.features, scene.matching, catalog, {}).empty());
}

TEST(TrackEdges, AreTheSegmentsThatTwoViewsShowBetweenTwoTracks) {
  ImageFeatures f;
  f.segments.resize(2);
  f.junctions.resize(3);
  f.junctions[0].ends = {{0, true, false}};
  f.junctions[1].ends = {{0, false, false}, {1, true, false}};
  f.junctions[2].ends = {{1, false, true}};  // on a passing segment
  const std::vector<FeatureTrack> points = {
      {{{0, 0}, {1, 0}}}, {{{0, 1}, {1, 1}}}, {{{0, 2}, {1, 2}}}};
  const std::vector<ImageFeatures> two = {f, f};
  EXPECT_EQ(TrackEdges(points, two), (std::vector<std::array<int, 2>>{{0, 1}}));
  EXPECT_TRUE(TrackEdges(points, std::span(two).first(1)).empty());
}

TEST(RecognitionOptions, AreCheckedFieldByField) {
  EXPECT_TRUE(Validate(RecognitionOptions()).ok());
  const auto message = [](const RecognitionOptions& o) {
    EXPECT_EQ(Validate(o).code(), absl::StatusCode::kInvalidArgument);
    return std::string(Validate(o).message());
  };
  RecognitionOptions options;
  options.routes = {false, false, false, false};
  EXPECT_EQ(message(options), "routes: none is on");
  options = {};
  options.acceptance.aspects.min_probability = std::numeric_limits<double>::quiet_NaN();
  EXPECT_NE(message(options).find("acceptance.aspects.min_probability"), std::string::npos);
  options = {};
  options.threads = 0;
  EXPECT_NE(message(options).find("threads"), std::string::npos);
  options = {};
  options.acceptance.scene.min_parallax_rad = -1.0;
  EXPECT_NE(message(options).find("acceptance.scene.min_parallax_rad"), std::string::npos);
}

}  // namespace
}  // namespace horopter
