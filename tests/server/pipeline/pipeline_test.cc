#include "server/pipeline/pipeline.h"

#include <gtest/gtest.h>

#include "tests/support/synthetic_part.h"

namespace horopter {
namespace {

CatalogSnapshot OnePart() {
  CatalogSnapshot catalog;
  catalog.objects.push_back(PrepareCatalogObject(LBracket()).value());
  return catalog;
}

SceneRequest Images(const std::vector<cv::Mat>& images) {
  SceneRequest request;
  request.images = images;
  return request;
}

TEST(RecognizeScene, BadRequestsNameTheField) {
  const CatalogSnapshot catalog = OnePart();
  const cv::Mat image(120, 160, CV_8UC3, cv::Scalar(90, 90, 90));
  EXPECT_EQ(RecognizeScene({}, catalog, {}).status().code(), absl::StatusCode::kInvalidArgument);
  const auto deep =
      RecognizeScene(Images({image, cv::Mat(120, 160, CV_16UC1, cv::Scalar(0))}), catalog, {});
  EXPECT_EQ(deep.status().code(), absl::StatusCode::kInvalidArgument);
  EXPECT_NE(std::string(deep.status().message()).find("images[1]"), std::string::npos);
  SceneRequest hints = Images({image});
  hints.hints.resize(2);
  EXPECT_EQ(RecognizeScene(hints, catalog, {}).status().code(), absl::StatusCode::kInvalidArgument);
  SceneRequest poses = Images({image});
  poses.camera_poses.resize(2);
  EXPECT_EQ(RecognizeScene(poses, catalog, {}).status().code(), absl::StatusCode::kInvalidArgument);
  poses.camera_poses.resize(1);
  poses.camera_poses[0].emplace();
  poses.camera_poses[0]->camera_from_base.R.setZero();
  const auto flat = RecognizeScene(poses, catalog, {});
  EXPECT_EQ(flat.status().code(), absl::StatusCode::kInvalidArgument);
  EXPECT_NE(std::string(flat.status().message()).find("not a rotation"), std::string::npos);
  SceneRequest unknown = Images({image});
  unknown.candidates = {"nobody"};
  const auto missing = RecognizeScene(unknown, catalog, {});
  EXPECT_EQ(missing.status().code(), absl::StatusCode::kNotFound);
  EXPECT_NE(std::string(missing.status().message()).find("nobody"), std::string::npos);
  SceneRequest reference = Images({image});
  reference.reference = ReferenceObject{"nobody", {}};
  EXPECT_EQ(RecognizeScene(reference, catalog, {}).status().code(), absl::StatusCode::kNotFound);
}

TEST(RecognizeScene, BlankImagesAndEmptyCatalogsAreReasonsNotErrors) {
  const cv::Mat image(120, 160, CV_8UC3, cv::Scalar(90, 90, 90));
  const auto blank = RecognizeScene(Images({image, image}), OnePart(), {});
  ASSERT_TRUE(blank.ok()) << blank.status();
  EXPECT_TRUE(HasReason(blank->answer, ReasonKind::kTooFewFeatures));
  EXPECT_TRUE(blank->answer.objects.empty());
  EXPECT_EQ(blank->answer.cameras.size(), 2u);
  const auto empty = RecognizeScene(Images({image}), {}, {});
  ASSERT_TRUE(empty.ok());
  EXPECT_TRUE(HasReason(empty->answer, ReasonKind::kEmptyCatalog));
}

TEST(RecognizeScene, StagesReportTheirTimesInOrder) {
  const cv::Mat grey(120, 160, CV_8UC1, cv::Scalar(90));
  const auto result = RecognizeScene(Images({grey}), OnePart(), {});
  ASSERT_TRUE(result.ok()) << result.status();
  ASSERT_GE(result->answer.stages.size(), 4u);
  EXPECT_EQ(result->answer.stages[0].stage, "features");
  EXPECT_EQ(result->answer.stages[1].stage, "matching");
  EXPECT_EQ(result->answer.stages[2].stage, "reconstruction");
  EXPECT_EQ(result->answer.stages[3].stage, "recognition");
  for (const StageReport& s : result->answer.stages) EXPECT_GE(s.seconds, 0.0);
}

TEST(RecognizeScene, AStopIsHonoured) {
  const cv::Mat image(120, 160, CV_8UC3, cv::Scalar(90, 90, 90));
  EXPECT_EQ(RecognizeScene(Images({image}), OnePart(), {}, [] { return true; }).status().code(),
            absl::StatusCode::kCancelled);
}

}  // namespace
}  // namespace horopter
