// An answer that time has cut short says so, and one that says it is complete was not.
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <atomic>
#include <opencv2/core.hpp>
#include <opencv2/imgcodecs.hpp>
#include <random>

#include "client/bop_dataset.h"
#include "client/cad_import.h"
#include "server/pipeline/pipeline.h"

namespace horopter {
namespace {

constexpr char kDataset[] = HOROPTER_TEST_DATA "/parts";
constexpr int kScene = 5;

class Completeness : public testing::Test {
 protected:
  // The images of a scene and the parts in it.
  static void SetUpTestSuite() {
    const BopDataset dataset = ReadBopDataset(kDataset).value();
    const BopScene scene = ReadBopScene(kDataset, "val", kScene).value();
    for (const BopObject& object : dataset.objects) {
      if (object.obj_id != scene.images[0].instances[0].obj_id) continue;
      CadImport cad = ImportCad(object.cad_path).value();
      cad.model.id = "part";
      catalog_.objects.push_back(PrepareCatalogObject(std::move(cad.model)).value());
    }
    for (const BopImage& image : scene.images) {
      request_.images.push_back(cv::imread(image.path, cv::IMREAD_COLOR));
      ASSERT_FALSE(request_.images.back().empty());
    }
  }
  static void TearDownTestSuite() {
    catalog_ = {};
    request_ = {};
  }

  // Time runs short at the n-th look at the clock; negative: never. `looks`: how often it was
  // looked at.
  static SceneAnswer Answer(int n, int* looks) {
    std::atomic<int> count{0};
    PipelineOptions options;
    options.recognition.hurry = [&] { return count++ >= n && n >= 0; };
    auto result = RecognizeScene(request_, catalog_, options);
    EXPECT_TRUE(result.ok()) << result.status();
    *looks = count;
    return std::move(result->answer);
  }

  static SceneRequest request_;
  static CatalogSnapshot catalog_;
};

SceneRequest Completeness::request_;
CatalogSnapshot Completeness::catalog_;

bool SameObjects(const SceneAnswer& a, const SceneAnswer& b) {
  if (a.objects.size() != b.objects.size()) return false;
  for (size_t i = 0; i < a.objects.size(); ++i) {
    if (a.objects[i].object_id != b.objects[i].object_id ||
        a.objects[i].score != b.objects[i].score ||
        !a.objects[i].scene_from_object.t.isApprox(b.objects[i].scene_from_object.t, 1e-12)) {
      return false;
    }
  }
  return true;
}

TEST_F(Completeness, WithTimeEnoughNothingIsLeftOut) {
  int looks = 0;
  const SceneAnswer answer = Answer(-1, &looks);
  EXPECT_FALSE(answer.objects.empty()) << ReasonsText(answer);
  EXPECT_FALSE(answer.time_limited);
  EXPECT_TRUE(answer.unsearched.empty());
  EXPECT_GT(looks, 0);
}

TEST_F(Completeness, AnAnswerThatTimeChangedSaysSoAndWhatWasNotSearched) {
  int all = 0;
  const SceneAnswer whole = Answer(-1, &all);
  constexpr unsigned kSeed = 5;
  std::mt19937 rng(kSeed);
  int changed = 0;
  for (int trial = 0; trial < 6; ++trial) {
    const int n = trial == 0 ? 0 : std::uniform_int_distribution<int>(1, all)(rng);
    int looks = 0;
    const SceneAnswer answer = Answer(n, &looks);
    EXPECT_EQ(answer.time_limited, looks > n) << "seed " << kSeed << " look " << n;
    if (answer.time_limited) {
      EXPECT_FALSE(answer.unsearched.empty());
      for (const UnsearchedStep& step : answer.unsearched) {
        EXPECT_EQ(step.cause, UnsearchedCause::kTime);
        EXPECT_FALSE(step.step.empty());
      }
    }
    if (SameObjects(answer, whole)) continue;
    ++changed;
    EXPECT_TRUE(answer.time_limited) << "seed " << kSeed << " look " << n;
    EXPECT_FALSE(answer.reasons.empty() && answer.objects.empty());
  }
  EXPECT_GT(changed, 0) << "of " << all << " looks";
}

// Whatever route the parts are found by, their aspects are looked for in single images.
TEST_F(Completeness, ABriefSearchSaysSo) {
  for (const double allowed_s : {0.0, 1e-3, AspectRouteOptions{}.full_search_s}) {
    SCOPED_TRACE(testing::Message() << allowed_s << " s");
    PipelineOptions options;
    options.recognition.allowed_s = allowed_s;
    const auto result = RecognizeScene(request_, catalog_, options);
    ASSERT_TRUE(result.ok()) << result.status();
    const bool brief = allowed_s == 1e-3;
    EXPECT_EQ(result->answer.time_limited, brief);
    EXPECT_EQ(result->answer.unsearched.size(), brief ? 1u : 0u);
    for (const UnsearchedStep& step : result->answer.unsearched) {
      EXPECT_EQ(step.cause, UnsearchedCause::kTime);
      EXPECT_EQ(step.step, "aspect_search");
    }
    EXPECT_FALSE(result->answer.objects.empty());
  }
}

}  // namespace
}  // namespace horopter
