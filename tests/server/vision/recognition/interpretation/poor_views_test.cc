#include "server/vision/recognition/interpretation/poor_views.h"

#include <gtest/gtest.h>

namespace horopter {
namespace {

// An answer of one object that its views show with these scores; negative: it is outside.
std::pair<AspectJudgement, RecognitionResult> Answer(const std::vector<double>& scores) {
  AspectJudgement judgement;
  LinkedObject& o = judgement.objects.emplace_back();
  RecognitionResult answer;
  SceneObject& object = answer.objects.emplace_back();
  for (const double score : scores) {
    CalibratedCamera view;
    view.camera = CenteredCamera(640, 480, 800.0);
    answer.views.push_back(view);
    object.view_scores.push_back(score);
    o.views.emplace_back().score = std::max(0.0, score);
    o.shown.push_back(score >= 0.0);
  }
  return {judgement, answer};
}

TEST(LeaveOutPoorViews, TakesTheViewThatShowsLittleAndNoOther) {
  auto [judgement, answer] = Answer({0.7, 0.65, 0.1, 0.72});
  EXPECT_EQ(LeaveOutPoorViews(judgement, &answer), 1);
  EXPECT_TRUE(answer.views[0] && answer.views[1] && answer.views[3]);
  EXPECT_FALSE(answer.views[2]);
  EXPECT_EQ(answer.objects[0].view_scores[2], -1.0);
  EXPECT_EQ(answer.objects[0].view_scores[1], 0.65);
}

TEST(LeaveOutPoorViews, LeavesViewsThatShowAboutAsMuch) {
  auto [judgement, answer] = Answer({0.7, 0.5, 0.6});
  EXPECT_EQ(LeaveOutPoorViews(judgement, &answer), 0);
  EXPECT_TRUE(answer.views[0] && answer.views[1] && answer.views[2]);
}

TEST(LeaveOutPoorViews, OfTwoViewsNeitherIsPoorer) {
  auto [judgement, answer] = Answer({0.7, 0.1});
  EXPECT_EQ(LeaveOutPoorViews(judgement, &answer), 0);
  RecognitionResult nothing;
  EXPECT_EQ(LeaveOutPoorViews({}, &nothing), 0);
}

}  // namespace
}  // namespace horopter
