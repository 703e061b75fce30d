#include "server/vision/recognition/initialization/scene_decomposition.h"

#include <gtest/gtest.h>

#include <Eigen/Geometry>
#include <algorithm>

#include "tests/support/collineated_scene.h"

namespace horopter {
namespace {

// A collineated scene as the projective route sees it.
struct Structured {
  std::vector<std::shared_ptr<const PreparedObject>> objects;
  std::vector<PinholeCamera> cameras;
  SceneStructure structure;
  std::vector<StructureHypothesis> hypotheses;

  explicit Structured(const CollineatedScene& scene) {
    structure.cameras = scene.cameras;
    for (const Eigen::Vector2i& size : scene.sizes)
      cameras.push_back(CenteredCamera(size.x(), size.y(), 1.5 * size.x()));
    for (std::size_t k = 0; k < scene.objects.size(); ++k) {
      const CollineatedObject& o = scene.objects[k];
      const auto object = std::make_shared<PreparedObject>();
      object->model.vertices = o.points_in_object;
      objects.push_back(object);
      StructureHypothesis& h = hypotheses.emplace_back();
      h.object = static_cast<int>(k);
      h.structure_from_object = o.scene_from_object;
      for (std::size_t i = 0; i < o.points_in_object.size(); ++i) {
        const Eigen::Vector4d at = o.points_in_scene.empty()
                                       ? o.scene_from_object * o.points_in_object[i].homogeneous()
                                       : o.points_in_scene[i];
        h.vertices.push_back({static_cast<int>(i), static_cast<int>(structure.points.size())});
        for (const ObjectPointObservation& seen : scene.observations) {
          if (seen.object != h.object || seen.point_in_object != o.points_in_object[i]) continue;
          PointObservation observation;
          observation.view = seen.view;
          observation.point = static_cast<int>(structure.points.size());
          observation.pixel = seen.pixel;
          structure.point_observations.push_back(observation);
        }
        structure.points.push_back(at.hnormalized());
      }
    }
  }
  std::optional<AspectScene> Decomposed(DecompositionMethod method) const {
    BottomUpOptions options;
    options.decomposition = method;
    return SceneByDecomposition(objects, cameras, structure, hypotheses, options);
  }
};

TEST(SceneByDecomposition, EveryMethodPutsTheObjectsWhereTheyAre) {
  int scenes = 0;
  for (unsigned seed = 1; seed <= 3; ++seed) {
    const auto truth = MakeCollineatedScene(seed, 3, 5, 0.1);
    if (!truth) continue;
    ++scenes;
    const Structured scene(*truth);
    for (const DecompositionMethod method : {DecompositionMethod::kPerObject,
                                             DecompositionMethod::kCommon,
                                             DecompositionMethod::kMetric,
                                             DecompositionMethod::kImages}) {
      SCOPED_TRACE(testing::Message() << "seed " << seed << " method " << static_cast<int>(method));
      const auto found = scene.Decomposed(method);
      ASSERT_TRUE(found.has_value());
      ASSERT_EQ(found->objects.size(), 3u);
      std::vector<Rigid3> poses;
      for (const AspectSceneObject& o : found->objects) poses.push_back(o.scene_from_object);
      for (const int k : {1, 2}) EXPECT_LT(ErrorBetween(*truth, poses, k).shift_m, 0.01) << k;
    }
  }
  EXPECT_GT(scenes, 0);
}

TEST(SceneByDecomposition, NeedsTwoObjectsThatShareNoPoint) {
  const auto truth = MakeCollineatedScene(1, 3, 5, 0.1);
  ASSERT_TRUE(truth.has_value());
  Structured scene(*truth);
  EXPECT_FALSE(scene.Decomposed(DecompositionMethod::kNone).has_value());
  scene.hypotheses.resize(2);
  EXPECT_TRUE(scene.Decomposed(DecompositionMethod::kCommon).has_value());
  // The same points of the scene for vertices of both.
  auto& shared = scene.hypotheses[1].vertices;
  shared.resize(std::min(shared.size(), scene.hypotheses[0].vertices.size()));
  for (std::size_t i = 0; i < shared.size(); ++i)
    shared[i].point = scene.hypotheses[0].vertices[i].point;
  EXPECT_FALSE(scene.Decomposed(DecompositionMethod::kCommon).has_value());
  scene.hypotheses.resize(1);
  EXPECT_FALSE(scene.Decomposed(DecompositionMethod::kCommon).has_value());
}

}  // namespace
}  // namespace horopter
