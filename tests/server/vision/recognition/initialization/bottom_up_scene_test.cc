#include <gtest/gtest.h>

#include <Eigen/Geometry>
#include <atomic>
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

RecognitionOptions Only(RecognitionRoute route) {
  RecognitionOptions options;
  options.routes.supporting_plane = route == RecognitionRoute::kSupportingPlane;
  options.routes.metric = route == RecognitionRoute::kMetric;
  options.routes.view_led = route == RecognitionRoute::kViewLed;
  options.routes.projective = route == RecognitionRoute::kProjective;
  return options;
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

TEST(MetricRouteAlone, FindsThePartAndTheScale) {
  int right = 0;
  for (unsigned seed = 1; seed <= 3; ++seed) {
    SCOPED_TRACE(testing::Message() << "seed " << seed);
    const MatchedScene scene =
        MakeMatchedScene(Prepared({LBracket(), Wedge(), TwistedPrism(1)}), 5, 0.3, seed);
    const auto result = RecognizeObjects(scene.Input(), Only(RecognitionRoute::kMetric));
    ASSERT_TRUE(result.ok()) << result.status();
    ASSERT_LE(result->objects.size(), 1u);
    if (result->objects.empty()) continue;
    EXPECT_EQ(result->route, RecognitionRoute::kMetric);
    EXPECT_EQ(result->objects[0].object, 0);
    EXPECT_LT(scene.LargestError(*result, result->objects[0]), 3.0);
    ++right;
  }
  EXPECT_EQ(right, 3);
}

TEST(MetricRouteAlone, GivesTheSameWithTheCatalogsIndexAndItsSlots) {
  const MatchedScene scene = MakeMatchedScene(Prepared({LBracket(), Wedge()}), 5, 0.3, 5);
  const Objects others = Prepared({TwistedPrism(1), TwistedPrism(2)});
  const auto index = KeyIndex::Build({&others[0]->keys,
                                      &scene.objects[1]->keys,
                                      nullptr,
                                      &scene.objects[0]->keys,
                                      &others[1]->keys},
                                     7);
  ASSERT_TRUE(index.ok());
  KeyIndex catalog = *index;
  const KeyIndexSnapshot snapshot = catalog.Snapshot();
  const std::vector<int> slots = {3, 1};
  RecognitionInput input = scene.Input();
  const auto own = RecognizeObjects(input, Only(RecognitionRoute::kMetric));
  input.keys = &snapshot;
  input.slots = slots;
  const auto with_catalog = RecognizeObjects(input, Only(RecognitionRoute::kMetric));
  ASSERT_TRUE(own.ok() && with_catalog.ok());
  ASSERT_EQ(own->objects.size(), 1u);
  ASSERT_EQ(with_catalog->objects.size(), 1u);
  EXPECT_EQ(with_catalog->objects[0].object, 0);
  EXPECT_LT(scene.LargestError(*with_catalog, with_catalog->objects[0]), 3.0);
  input.slots = std::span(slots).first(1);
  EXPECT_EQ(RecognizeObjects(input, Only(RecognitionRoute::kMetric)).status().code(),
            absl::StatusCode::kInvalidArgument);
}

TEST(ProjectiveRouteAlone, FindsThePartAndItsCamerasFromMatchesAlone) {
  int right = 0;
  for (unsigned seed = 1; seed <= 4; ++seed) {
    SCOPED_TRACE(testing::Message() << "seed " << seed);
    MatchedScene scene = MakeMatchedScene(
        Prepared({TwistedPrism(seed), TwistedPrism(seed + 10), LBracket()}), 6, 0.2, seed);
    scene.reconstruction = Reconstruction();  // nothing is known of the cameras
    scene.reconstruction.views.resize(scene.features.size());
    const auto result = RecognizeObjects(scene.Input(), Only(RecognitionRoute::kProjective));
    ASSERT_TRUE(result.ok()) << result.status();
    for (const SceneObject& o : result->objects) {
      EXPECT_EQ(result->route, RecognitionRoute::kProjective);
      EXPECT_EQ(o.object, 0);
      const double error = scene.LargestError(*result, o);
      EXPECT_LT(error, 3.0);
      right += error < 3.0;
    }
  }
  EXPECT_GE(right, 3);
}

TEST(BottomUpRoutes, AcceptNothingOfPartsThatAreNotEnrolled) {
  for (unsigned seed = 1; seed <= 3; ++seed) {
    SCOPED_TRACE(testing::Message() << "seed " << seed);
    MatchedScene scene = MakeMatchedScene(Prepared({TwistedPrism(seed)}), 5, 0.3, seed);
    scene.objects = Prepared({LBracket(), Wedge(), TwistedPrism(seed + 20)});
    scene.reconstruction.trusted = false;  // so that both routes are asked
    RecognitionOptions options;
    options.routes = {false, true, false, true};
    const auto result = RecognizeObjects(scene.Input(), options);
    ASSERT_TRUE(result.ok()) << result.status();
    EXPECT_TRUE(result->objects.empty());
    EXPECT_EQ(result->route, RecognitionRoute::kNone);
  }
}

TEST(BottomUpRoutes, AreLeftInAHurryAndStopWhenTold) {
  const MatchedScene scene = MakeMatchedScene(Prepared({LBracket()}), 5, 0.3, 6);
  RecognitionOptions options;
  options.routes = {false, true, false, true};
  options.hurry = [] { return true; };
  const auto hurried = RecognizeObjects(scene.Input(), options);
  ASSERT_TRUE(hurried.ok()) << hurried.status();
  EXPECT_EQ(hurried->state, RecognitionState::kNothingFound);
  // What was due is named; in trusted cameras the projective route is not.
  EXPECT_EQ(hurried->unasked, std::vector<std::string>{"metric"});
  // In a hurry from the n-th time it is asked on: what is found then, never an error or a wrong
  // one.
  for (int asked = 1; asked < 4000; asked *= 3) {
    std::atomic<int> count{0};
    options.hurry = [&] { return ++count > asked; };
    const auto result = RecognizeObjects(scene.Input(), options);
    ASSERT_TRUE(result.ok()) << result.status();
    EXPECT_LE(result->objects.size(), 1u) << "asked " << asked;
  }
  options.hurry = {};
  // Stopped wherever it is asked for the n-th time: an answer or CANCELLED, never a wrong answer.
  const auto complete = RecognizeObjects(scene.Input(), options);
  ASSERT_TRUE(complete.ok());
  ASSERT_EQ(complete->objects.size(), 1u);
  for (int asked = 1; asked < 4000; asked *= 3) {
    std::atomic<int> count{0};
    const StopRequested stop = [&] { return ++count > asked; };
    const auto result = RecognizeObjects(scene.Input(), options, stop);
    if (result.ok()) {
      EXPECT_EQ(result->objects.size(), 1u) << "asked " << asked;
    } else {
      EXPECT_EQ(result.status().code(), absl::StatusCode::kCancelled);
    }
  }
}

TEST(BottomUpRoutes, FiveFeaturesInAllAreNothing) {
  MatchedScene scene = MakeMatchedScene(Prepared({LBracket()}), 4, 0.0, 7);
  for (ImageFeatures& f : scene.features) {
    f.segments.resize(5);
    f.junctions.clear();
  }
  for (PairGeometry& pair : scene.matching.pairs) {
    pair.matches.clear();
    pair.segments.clear();
  }
  RecognitionOptions options;
  options.routes = {false, true, false, true};
  const auto result = RecognizeObjects(scene.Input(), options);
  ASSERT_TRUE(result.ok()) << result.status();
  EXPECT_EQ(result->state, RecognitionState::kNothingFound);
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
  options.routes = {false, false, false, false, false};
  EXPECT_EQ(message(options), "routes: none is on");
  options = {};
  options.acceptance.placements.min_score = std::numeric_limits<double>::quiet_NaN();
  EXPECT_NE(message(options).find("acceptance.placements.min_score"), std::string::npos);
  options = {};
  options.threads = 0;
  EXPECT_NE(message(options).find("threads"), std::string::npos);
  options = {};
  options.acceptance.scene.min_parallax_rad = -1.0;
  EXPECT_NE(message(options).find("acceptance.scene.min_parallax_rad"), std::string::npos);
  const MatchedScene scene = MakeMatchedScene(Prepared({LBracket()}), 2, 0.0, 8);
  EXPECT_EQ(RecognizeObjects(scene.Input(), options).status().code(),
            absl::StatusCode::kInvalidArgument);
}

}  // namespace
}  // namespace horopter
