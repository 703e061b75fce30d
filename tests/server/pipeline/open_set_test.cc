// Whole answers to questions that no part of the catalog, or more than one, answers: nothing that
// is not there is stated as certain.
#include <gtest/gtest.h>

#include <algorithm>
#include <opencv2/core.hpp>
#include <opencv2/imgcodecs.hpp>

#include "client/bop_dataset.h"
#include "client/cad_import.h"
#include "server/pipeline/pipeline.h"

namespace horopter {
namespace {

constexpr char kDataset[] = HOROPTER_TEST_DATA "/parts";
constexpr int kScene = 11;  // parts 3, 4 and 18
constexpr int kShown[] = {3, 4, 18};
constexpr double kSure = 0.9;

class OpenSetTest : public testing::Test {
 protected:
  static ObjectModel ModelOf(int id) {
    const BopDataset dataset = ReadBopDataset(kDataset).value();
    CadImport cad = ImportCad(dataset.Find(id)->cad_path).value();
    cad.model.id = BopObjectName(id);
    return std::move(cad.model);
  }

  static CatalogSnapshot Enrolled(std::vector<ObjectModel> models) {
    CatalogSnapshot catalog;
    for (ObjectModel& model : models)
      catalog.objects.push_back(PrepareCatalogObject(std::move(model)).value());
    return catalog;
  }

  static SceneRequest Images() {
    SceneRequest request;
    const BopScene scene = ReadBopScene(kDataset, "val", kScene).value();
    for (const BopImage& image : scene.images)
      request.images.push_back(cv::imread(image.path, cv::IMREAD_COLOR));
    return request;
  }

  // Objects that are stated as certain, and may be nothing else.
  static int Sure(const SceneAnswer& answer) {
    return static_cast<int>(
        std::count_if(answer.objects.begin(), answer.objects.end(), [](const AnswerObject& o) {
          return o.score >= kSure && o.alternatives.empty();
        }));
  }
};

TEST_F(OpenSetTest, PartsThatAreNotShownAreNotCertain) {
  const auto result = RecognizeScene(Images(), Enrolled({ModelOf(1)}), {});
  ASSERT_TRUE(result.ok()) << result.status();
  EXPECT_EQ(Sure(result->answer), 0);
}

TEST_F(OpenSetTest, CopiesInOtherSizesAreNamed) {
  ObjectModel larger = ModelOf(18), smaller = larger;
  const auto scale = [](double by, const char* id, ObjectModel* model) {
    model->id = id;
    for (auto& v : model->vertices) v *= by;
    for (auto& v : model->mesh.vertices) v *= by;
    for (auto& e : model->edges) {
      for (auto& p : e.polyline) p *= by;
    }
    model->diameter_m *= by;
    model->symmetries.clear();
  };
  scale(1.4, "larger", &larger);
  scale(0.7, "smaller", &smaller);
  const auto result = RecognizeScene(Images(), Enrolled({larger, smaller}), {});
  ASSERT_TRUE(result.ok()) << result.status();
  EXPECT_EQ(Sure(result->answer), 0);
}

TEST_F(OpenSetTest, AMirroredImageSetIsNotTakenForTheScene) {
  SceneRequest request = Images();
  for (cv::Mat& image : request.images) cv::flip(image.clone(), image, 1);
  std::vector<ObjectModel> models;
  for (const int id : kShown) models.push_back(ModelOf(id));
  const CatalogSnapshot catalog = Enrolled(std::move(models));
  const auto result = RecognizeScene(request, catalog, {});
  ASSERT_TRUE(result.ok()) << result.status();
  // Parts that are their own mirror images are what they are.
  for (const AnswerObject& o : result->answer.objects) {
    const auto part =
        std::find_if(catalog.objects.begin(), catalog.objects.end(), [&](const auto& object) {
          return object->model.id == o.object_id;
        });
    ASSERT_NE(part, catalog.objects.end());
    const PreparedObject& own = **part;
    const bool handed =
        own.twin->Of(own.model.mesh, own.model.diameter_m, own.aspects->object.mesh).chiral;
    if (handed) EXPECT_TRUE(o.score < kSure || !o.alternatives.empty()) << o.object_id;
  }
}

TEST_F(OpenSetTest, AlternativesAndTheAnswerAreAtMostCertain) {
  std::vector<ObjectModel> models;
  for (const int id : kShown) models.push_back(ModelOf(id));
  SceneRequest request = Images();
  const CatalogSnapshot catalog = Enrolled(std::move(models));
  const auto result = RecognizeScene(request, catalog, {});
  ASSERT_TRUE(result.ok()) << result.status();
  ASSERT_FALSE(result->answer.objects.empty());
  double best = 0.0;
  for (const AnswerObject& o : result->answer.objects) {
    double sum = o.score, last = 1.0;
    for (const AnswerAlternative& a : o.left_open) {
      sum += a.probability;
      EXPECT_LE(a.probability, last);
      last = a.probability;
    }
    EXPECT_LE(sum, 1.0 + 1e-9) << o.object_id;
    best = std::max(best, o.score);
  }
  // Where strangers come by as often, the same images make the same parts less sure.
  request.unknown_share = 0.9;
  const auto doubted = RecognizeScene(request, catalog, {});
  ASSERT_TRUE(doubted.ok()) << doubted.status();
  for (const AnswerObject& o : doubted->answer.objects) EXPECT_LT(o.score, best);
}

}  // namespace
}  // namespace horopter
