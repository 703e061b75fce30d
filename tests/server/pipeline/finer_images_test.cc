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

// So many boxes of one size in a row.
std::vector<ImageBox> Row(int boxes, double side = 40.0) {
  std::vector<ImageBox> out;
  for (int k = 0; k < boxes; ++k) {
    const Eigen::Vector2d from(20.0 + 25.0 * k, 400.0);
    out.emplace_back(from, from + Eigen::Vector2d(20.0, side));
  }
  return out;
}

TEST_F(FinerImages, AttentionIsForTheWindowsAndForNothingElse) {
  const std::vector<std::vector<ImageBox>> things{Row(5), {}};
  const Attention attention = Attend(images_, things, {});
  ASSERT_EQ(attention.parts.size(), 2u);
  EXPECT_EQ(attention.windows, 5);
  EXPECT_EQ(attention.parts[0]->boxes.size(), 5u);
  ASSERT_TRUE(attention.parts[1]) << "an image without windows is not searched";
  EXPECT_TRUE(attention.parts[1]->boxes.empty());
  EXPECT_NEAR(attention.share, 0.5 * 5 * 20 * 40 / (1.0 * kWidth * kHeight), 1e-9);
}

TEST_F(FinerImages, TheWorkOfAttentionIsBounded) {
  const std::vector<std::vector<ImageBox>> many{Row(50), Row(50, 900.0)};
  const Attention attention = Attend(images_, many, {});
  EXPECT_EQ(std::ssize(attention.parts[0]->boxes), kMostWindows);
  double area = 0.0;
  for (const ImageBox& box : attention.parts[1]->boxes) area += box.volume();
  EXPECT_LE(area, 0.36 * kWidth * kHeight);
  EXPECT_GT(area, 0.30 * kWidth * kHeight);
}

TEST_F(FinerImages, WhatStandsOffThePlaneIsAttendedToFirst) {
  OffPlaneGroup thing, wall, unseen;
  const ImageBox box(Eigen::Vector2d(700, 700), Eigen::Vector2d(760, 780));
  thing.images = {box, std::nullopt};
  wall.images = {ImageBox(Eigen::Vector2d(0, 0), Eigen::Vector2d(900, 300)), std::nullopt};
  unseen.images = {std::nullopt, std::nullopt};
  const std::vector<OffPlaneGroup> groups{wall, unseen, thing};
  const std::vector<std::vector<ImageBox>> things{{box, Row(1)[0]}, {}};
  const Attention attention = Attend(images_, things, groups);
  EXPECT_EQ(attention.standing_off, 1);
  ASSERT_EQ(attention.windows, 2) << "one window for one thing";
  EXPECT_EQ(attention.parts[0]->boxes[0].min(), box.min());
}

}  // namespace
}  // namespace horopter
