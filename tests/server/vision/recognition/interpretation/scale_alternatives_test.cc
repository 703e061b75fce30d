#include "server/vision/recognition/interpretation/scale_alternatives.h"

#include <gtest/gtest.h>

#include <memory>
#include <vector>

#include "server/vision/recognition/object/prepared_object.h"
#include "tests/support/synthetic_part.h"

namespace horopter {
namespace {

// An L-shaped bar, all lengths times `size`; `leg`: length of its shorter side.
std::shared_ptr<const PreparedObject> Bar(const char* id, double size, double leg = 0.05) {
  std::vector<Eigen::Vector2d> outline = {
      {0, 0}, {0.09, 0}, {0.09, 0.02}, {0.03, 0.02}, {0.03, leg}, {0, leg}};
  for (Eigen::Vector2d& p : outline) p *= size;
  return PrepareObject(Prism(id, outline, 0.04 * size)).value();
}

RecognitionResult Answer(std::vector<int> objects) {
  RecognitionResult result;
  result.state = RecognitionState::kRecognized;
  for (const int o : objects) {
    result.objects.emplace_back();
    result.objects.back().object = o;
  }
  return result;
}

TEST(ScaleAlternatives, APartAloneLooksLikeItsCopiesInOtherSizes) {
  const std::vector<std::shared_ptr<const PreparedObject>> objects = {
      Bar("bar", 1.0), Bar("other", 1.0, 0.06), Bar("small", 0.84), Bar("large", 2.5)};
  JointContext context;
  context.objects = objects;
  RecognitionResult result = Answer({0});
  SayScaleAlternatives(context, &result);
  EXPECT_EQ(result.state, RecognitionState::kAmbiguous);
  EXPECT_EQ(result.objects[0].alternatives, (std::vector<int>{2, 3}));
  EXPECT_NE(result.detail.find("bar: alone it looks like small, which is 84.0 % of its size"),
            std::string::npos)
      << result.detail;
  EXPECT_NE(result.detail.find("large, which is 250.0 %"), std::string::npos) << result.detail;
}

TEST(ScaleAlternatives, NothingIsSaidTwice) {
  const std::vector<std::shared_ptr<const PreparedObject>> objects = {Bar("bar", 1.0),
                                                                      Bar("small", 0.5)};
  JointContext context;
  context.objects = objects;
  RecognitionResult result = Answer({0});
  result.objects[0].alternatives = {1};
  SayScaleAlternatives(context, &result);
  EXPECT_EQ(result.objects[0].alternatives, std::vector<int>{1});
}

TEST(ScaleAlternatives, SeveralPartsTellTheirSizesByEachOther) {
  const std::vector<std::shared_ptr<const PreparedObject>> objects = {
      Bar("bar", 1.0), Bar("small", 0.84), Bar("other", 1.0, 0.06)};
  JointContext context;
  context.objects = objects;
  RecognitionResult result = Answer({0, 2});
  SayScaleAlternatives(context, &result);
  EXPECT_EQ(result.state, RecognitionState::kRecognized);
  RecognitionResult nothing;
  SayScaleAlternatives(context, &nothing);
  EXPECT_TRUE(nothing.objects.empty());
}

TEST(ScaleAlternatives, OtherShapesAreNone) {
  const std::vector<std::shared_ptr<const PreparedObject>> objects = {
      Bar("bar", 1.0), Bar("other", 1.0, 0.06), Bar("third", 0.8, 0.045)};
  JointContext context;
  context.objects = objects;
  RecognitionResult result = Answer({0});
  SayScaleAlternatives(context, &result);
  EXPECT_EQ(result.state, RecognitionState::kRecognized);
  EXPECT_TRUE(result.objects[0].alternatives.empty());
}

}  // namespace
}  // namespace horopter
