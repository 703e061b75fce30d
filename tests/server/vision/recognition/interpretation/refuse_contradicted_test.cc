#include <gtest/gtest.h>

#include "server/vision/recognition/interpretation/aspect_route.h"

namespace horopter {
namespace {

// What is left of an answer of one object that the aspects give this score.
RecognitionResult Left(double median, bool aspects_find_something, RefusalLog* log = nullptr) {
  AspectJudgement judgement;
  judgement.median = median;
  RecognitionResult answer;
  answer.state = RecognitionState::kRecognized;
  answer.route = RecognitionRoute::kSupportingPlane;
  answer.objects.emplace_back().object = 3;
  CalibratedCamera view;
  view.camera = CenteredCamera(640, 480, 800.0);
  answer.views.assign(2, view);
  RefuseContradicted(judgement, aspects_find_something, AspectAcceptance(), log, &answer);
  return answer;
}

TEST(RefuseContradicted, LeavesAnAnswerThatIsConfirmed) {
  for (const bool found : {false, true}) {
    const RecognitionResult left = Left(AspectAcceptance().confirming_score, found);
    EXPECT_EQ(left.objects.size(), 1u);
    EXPECT_EQ(left.state, RecognitionState::kRecognized);
  }
}

TEST(RefuseContradicted, LeavesAnAnswerInDoubtOnlyWhereAspectsFindSomething) {
  const AspectAcceptance options;
  const double doubt = (options.confirming_score + options.contradicting_score) / 2;
  EXPECT_EQ(Left(doubt, true).objects.size(), 1u);
  const RecognitionResult refused = Left(doubt, false);
  EXPECT_TRUE(refused.objects.empty());
  EXPECT_EQ(refused.state, RecognitionState::kNothingFound);
  EXPECT_EQ(refused.route, RecognitionRoute::kNone);
  ASSERT_EQ(refused.views.size(), 2u);
  EXPECT_FALSE(refused.views[0] || refused.views[1]);
  EXPECT_FALSE(refused.detail.empty());
}

TEST(RefuseContradicted, RefusesWhatIsContradictedAndSaysOfTheObjectAskedFor) {
  RefusalLog log, of_another;
  log.object = 3;
  of_another.object = 2;
  for (const bool found : {false, true}) {
    EXPECT_TRUE(Left(0.1, found, &log).objects.empty());
    EXPECT_TRUE(Left(0.1, found, &of_another).objects.empty());
  }
  ASSERT_EQ(log.refusals.size(), 2u);
  const AspectAcceptance options;
  EXPECT_EQ(log.refusals[0].test, AcceptanceTest::kContradiction);
  EXPECT_EQ(log.refusals[0].needed, options.confirming_score);
  EXPECT_EQ(log.refusals[1].needed, options.contradicting_score);
  EXPECT_EQ(log.refusals[0].value, 0.1);
  EXPECT_TRUE(of_another.refusals.empty());
}

}  // namespace
}  // namespace horopter
