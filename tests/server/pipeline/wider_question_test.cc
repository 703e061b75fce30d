#include "server/pipeline/wider_question.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <opencv2/imgcodecs.hpp>

#include "client/bop_dataset.h"
#include "client/cad_import.h"

namespace horopter {
namespace {

constexpr char kDataset[] = HOROPTER_TEST_DATA "/parts";
// Three parts close together: 3, 4 and 18. Part 4 alone leaves its cameras open.
constexpr int kScene = 11;
constexpr int kAlone = 4, kAbsent = 1;
constexpr int kEnrolled[] = {1, 3, 4, 18};

class WiderQuestionTest : public testing::Test {
 protected:
  static void SetUpTestSuite() {
    const absl::StatusOr<BopDataset> dataset = ReadBopDataset(kDataset);
    ASSERT_TRUE(dataset.ok()) << dataset.status();
    for (const int id : kEnrolled) {
      absl::StatusOr<CadImport> cad = ImportCad(dataset->Find(id)->cad_path);
      ASSERT_TRUE(cad.ok()) << cad.status();
      cad->model.id = BopObjectName(id);
      catalog_.objects.push_back(PrepareCatalogObject(std::move(cad->model)).value());
    }
    const absl::StatusOr<BopScene> scene = ReadBopScene(kDataset, "val", kScene);
    ASSERT_TRUE(scene.ok()) << scene.status();
    for (const BopImage& image : scene->images)
      request_.images.push_back(cv::imread(image.path, cv::IMREAD_COLOR));
  }
  static void TearDownTestSuite() {
    catalog_ = {};
    request_ = {};
  }

  static inline CatalogSnapshot catalog_;
  static inline SceneRequest request_;
};

TEST_F(WiderQuestionTest, IsAskedForSomeOfASmallCatalog) {
  SceneRequest request = request_;
  PipelineOptions options;
  // How many objects are looked for; 0 where no wider question is asked.
  const auto wider = [&](const CatalogSnapshot& catalog) {
    const Selection asked = SelectObjects(request, catalog, options.max_searched_objects).value();
    const auto out = WiderQuestion(request, asked, catalog, options).value();
    return out ? out->objects.size() : 0;
  };
  EXPECT_EQ(wider(catalog_), 0u);
  request.candidates = {BopObjectName(kAlone)};
  EXPECT_EQ(wider(catalog_), 4u);
  // A copy under another name is ruled out by whoever names this one.
  CatalogSnapshot with_copy = catalog_;
  ObjectModel copy = catalog_.objects[2]->model;
  ASSERT_EQ(copy.id, BopObjectName(kAlone));
  copy.id = "obj_copy";
  with_copy.objects.push_back(PrepareCatalogObject(std::move(copy)).value());
  EXPECT_EQ(wider(with_copy), 4u);
  request.candidates.push_back("obj_copy");
  EXPECT_EQ(wider(with_copy), 5u);
  request.candidates.clear();
  for (const int id : kEnrolled) request.candidates.push_back(BopObjectName(id));
  EXPECT_EQ(wider(catalog_), 0u);
  request.candidates.resize(1);
  options.recognition.aspects.max_objects = 3;
  EXPECT_EQ(wider(catalog_), 0u);
}

TEST_F(WiderQuestionTest, WhatWasNotAskedForIsNotAnswered) {
  SceneAnswer answer;
  for (const char* id : {"asked", "other", "asked"}) answer.objects.emplace_back().object_id = id;
  answer.objects[1].alternatives = {"asked"};
  for (const char* id : {"other", "", "asked"}) answer.findings.emplace_back().object_id = id;
  answer.reasons.push_back({ReasonKind::kAmbiguous, ""});
  auto asked = std::make_shared<PreparedObject>();
  asked->model.id = "asked";
  const std::shared_ptr<const PreparedObject> list[] = {asked};
  LeaveAsked(list, &answer);
  EXPECT_EQ(answer.objects.size(), 2u);
  EXPECT_EQ(answer.findings.size(), 2u);
  EXPECT_TRUE(answer.reasons.empty());
}

// With the other parts in the catalog, but not asked for, the part is found as all are.
TEST_F(WiderQuestionTest, ANarrowQuestionFindsWhatTheWideOneDoes) {
  const auto wide = RecognizeScene(request_, catalog_, {});
  ASSERT_TRUE(wide.ok()) << wide.status();
  const auto is_asked = [](const AnswerObject& o) { return o.object_id == BopObjectName(kAlone); };
  ASSERT_TRUE(std::any_of(wide->answer.objects.begin(), wide->answer.objects.end(), is_asked))
      << ReasonsText(wide->answer);
  SceneRequest request = request_;
  request.candidates = {BopObjectName(kAbsent), BopObjectName(kAlone)};
  const auto narrow = RecognizeScene(request, catalog_, {});
  ASSERT_TRUE(narrow.ok()) << narrow.status();
  ASSERT_EQ(narrow->answer.objects.size(), 1u) << ReasonsText(narrow->answer);
  EXPECT_TRUE(is_asked(narrow->answer.objects[0]));
  for (const auto& camera : narrow->answer.cameras) EXPECT_TRUE(camera);
  // ... and at the same cost: the same steps, once.
  const auto steps = [](const PipelineResult& result) {
    std::vector<std::string> names;
    for (const StageReport& s : result.answer.stages) names.push_back(s.stage);
    return names;
  };
  EXPECT_EQ(steps(*narrow), steps(*wide));
}

// Parts of few edges are asked for by their aspects after matching, with no other route as well.
TEST_F(WiderQuestionTest, AspectsAloneAreAskedForPlainPartsToo) {
  SceneRequest request = request_;
  request.variants = "routes=aspects";
  const auto result = RecognizeScene(request, catalog_, {});
  ASSERT_TRUE(result.ok()) << result.status();
  const auto recognition =
      std::find_if(result->answer.stages.begin(), result->answer.stages.end(), [](const auto& s) {
        return s.stage == "recognition" && s.counts.count("aspects_searched") > 0;
      });
  EXPECT_NE(recognition, result->answer.stages.end());
}

}  // namespace
}  // namespace horopter
