// Regions of the command line and of a dataset's truth.
#include "client/regions.h"

#include <gtest/gtest.h>

#include <filesystem>
#include <fstream>

#include "tests/client/temp_folder.h"

namespace horopter {
namespace {

v1::RecognizeSceneRequest OfImages(int n) {
  v1::RecognizeSceneRequest request;
  for (int i = 0; i < n; ++i) request.add_images();
  return request;
}

TEST(AddRegions, CountsImagesFromOneAndTakesSeveral) {
  v1::RecognizeSceneRequest request = OfImages(2);
  ASSERT_TRUE(AddRegions({{"2:10,20.5,30,40", "1:0,0,1,1", "2:-5,0,9,9"},
                          {0.1, 0.2, 0.3, 0.0, 0.0, 2.0 / 2.0, 0.0, 0.6, 0.4, 0.2}},
                         &request)
                  .ok());
  EXPECT_EQ(request.images(0).regions_size(), 1);
  ASSERT_EQ(request.images(1).regions_size(), 2);
  EXPECT_EQ(request.images(1).regions(0).y_px(), 20.5);
  EXPECT_EQ(request.images(1).regions(0).height_px(), 40.0);
  EXPECT_EQ(request.images(1).regions(1).x_px(), -5.0);
  ASSERT_EQ(request.regions_size(), 1);
  EXPECT_EQ(request.regions(0).size_m().y(), 0.4);
  EXPECT_EQ(request.regions(0).base_from_region().translation_m().z(), 0.3);
  EXPECT_EQ(request.regions(0).base_from_region().rotation().y(), 1.0);
}

TEST(AddRegions, SaysWhatIsNotUnderstood) {
  for (const char* word : {"",
                           "1",
                           "1:",
                           "1:1,2,3",
                           "1:1,2,3,4,5",
                           "1:a,2,3,4",
                           "1:1,2,3,4:5",
                           "x:1,2,3,4",
                           "0:1,2,3,4",
                           "3:1,2,3,4",
                           "-1:1,2,3,4",
                           "1:1,,3,4"}) {
    v1::RecognizeSceneRequest request = OfImages(2);
    const absl::Status status = AddRegions({{word}, {}}, &request);
    EXPECT_TRUE(absl::IsInvalidArgument(status)) << word;
  }
  v1::RecognizeSceneRequest request = OfImages(1);
  EXPECT_TRUE(absl::IsInvalidArgument(AddRegions({{}, {1, 2, 3}}, &request)));
  EXPECT_TRUE(absl::IsInvalidArgument(AddRegions({{}, {0, 0, 0, 2, 0, 0, 0, 1, 1, 1}}, &request)));
}

TEST(AddTrueRegions, AreTheVisibleBoxesGrown) {
  BopImage image;
  image.instances.resize(3);
  image.instances[0].visible_box = {Eigen::Vector2d(100, 200), Eigen::Vector2d(150, 220)};
  image.instances[2].visible_box = {Eigen::Vector2d(300, 100), Eigen::Vector2d(310, 140)};
  v1::SceneImage parts, all, none;
  AddTrueRegions(TrueRegions::kParts, 0.2, image, &parts);
  ASSERT_EQ(parts.regions_size(), 2);
  EXPECT_EQ(parts.regions(0).x_px(), 90.0);
  EXPECT_EQ(parts.regions(0).y_px(), 190.0);
  EXPECT_EQ(parts.regions(0).width_px(), 70.0);
  EXPECT_EQ(parts.regions(0).height_px(), 40.0);
  AddTrueRegions(TrueRegions::kAll, 0.0, image, &all);
  ASSERT_EQ(all.regions_size(), 1);
  EXPECT_EQ(all.regions(0).x_px(), 100.0);
  EXPECT_EQ(all.regions(0).width_px(), 210.0);
  EXPECT_EQ(all.regions(0).height_px(), 120.0);
  AddTrueRegions(TrueRegions::kNone, 0.2, image, &none);
  AddTrueRegions(TrueRegions::kAll, 0.2, BopImage(), &none);
  EXPECT_EQ(none.regions_size(), 0);
}

}  // namespace
}  // namespace horopter
