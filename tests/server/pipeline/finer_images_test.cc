#include "server/pipeline/finer_images.h"

#include <gtest/gtest.h>

#include <memory>
#include <opencv2/core.hpp>
#include <optional>
#include <vector>

#include "server/vision/recognition/object/prepared_object.h"

namespace horopter {
namespace {

constexpr int kWidth = 1280, kHeight = 960;

// Two parts, of which the larger one was found in both images, 400 pixels long.
class FinerImages : public testing::Test {
 protected:
  FinerImages() {
    for (const double diameter_m : {0.1, 0.06}) {
      auto aspects = std::make_shared<ModelAspects>();
      aspects->object.mesh.diameter_m = diameter_m;
      auto object = std::make_shared<PreparedObject>();
      object->aspects = aspects;
      objects_.push_back(object);
    }
    for (int v = 0; v < 2; ++v) {
      images_.emplace_back(kHeight, kWidth, CV_8UC1);
      auto& view = answer_.views.emplace_back().emplace();
      view.camera = CenteredCamera(kWidth, kHeight, 2000.0);
    }
    SceneObject found;
    found.object = 0;
    found.scene_from_object.t = {0.0, 0.0, 0.5};
    answer_.objects.push_back(found);
  }

  bool MayShowMoreIn(double box_px) const {
    const ImageBox box(Eigen::Vector2d(100, 100), Eigen::Vector2d(100 + box_px, 500));
    const std::vector<std::optional<SearchedPart>> searched(2, SearchedPart{{box}, {}, 1.0});
    return MayShowMore(images_, searched, objects_, answer_);
  }

  std::vector<cv::Mat> images_;
  std::vector<std::shared_ptr<const PreparedObject>> objects_;
  RecognitionResult answer_;
};

TEST_F(FinerImages, ShowNoMoreOfACompleteAnswerOfLargeParts) {
  EXPECT_FALSE(MayShowMore(images_, {}, objects_, answer_));
}

TEST_F(FinerImages, MayShowWhatWouldBeSmallOrIsMissing) {
  answer_.objects[0].scene_from_object.t.z() = 1.5;
  EXPECT_TRUE(MayShowMore(images_, {}, objects_, answer_));
  answer_.objects.clear();
  EXPECT_TRUE(MayShowMore(images_, {}, objects_, answer_));
}

TEST_F(FinerImages, OfAsManyPixelsAsTheFirstLookHadShowNothingElse) {
  answer_.objects.clear();
  for (cv::Mat& image : images_) image = cv::Mat(480, 640, CV_8UC1);
  EXPECT_FALSE(MayShowMore(images_, {}, objects_, answer_));
}

TEST_F(FinerImages, MayShowMoreWhereABoxHasRoomForIt) {
  EXPECT_FALSE(MayShowMoreIn(500.0));  // the part's own place
  EXPECT_TRUE(MayShowMoreIn(1000.0));  // a carrier
}

}  // namespace
}  // namespace horopter
