// Where parts are looked for, from the wire and back.
#include "server/service/region_convert.h"

#include <gtest/gtest.h>

#include <cmath>
#include <functional>
#include <limits>
#include <string>
#include <utility>
#include <vector>

#include "horopter/v1/recognition.pb.h"

namespace horopter {
namespace {

constexpr double kNan = std::numeric_limits<double>::quiet_NaN();
constexpr double kInfinity = std::numeric_limits<double>::infinity();

v1::ImageRegion* AddRegion(double x, double y, double width, double height, v1::SceneImage* image) {
  v1::ImageRegion* region = image->add_regions();
  region->set_x_px(x);
  region->set_y_px(y);
  region->set_width_px(width);
  region->set_height_px(height);
  return region;
}

// The field that the status names.
std::string FieldOf(const absl::Status& status) {
  EXPECT_EQ(status.code(), absl::StatusCode::kInvalidArgument) << status;
  const std::string text(status.message());
  return text.substr(0, text.find(": "));
}

TEST(RegionsFromProto, CountsFromTheBorderAndCutsOffWhatReachesBeyond) {
  v1::SceneImage image;
  EXPECT_FALSE(*RegionsFromProto(image, 640, 480, std::nullopt, "images[0]"));
  AddRegion(0, 0, 640, 480, &image);
  AddRegion(10, 20, 30, 40, &image);
  AddRegion(-50, 470, 60, 100, &image);
  const auto part = RegionsFromProto(image, 640, 480, std::nullopt, "images[0]");
  ASSERT_TRUE(part.ok() && *part) << part.status();
  EXPECT_TRUE((*part)->boxes[0].isApprox(WholeImage(640, 480)));
  EXPECT_TRUE((*part)->boxes[1].isApprox(
      ImageBox(Eigen::Vector2d(9.5, 19.5), Eigen::Vector2d(39.5, 59.5))));
  EXPECT_TRUE((*part)->boxes[2].isApprox(
      ImageBox(Eigen::Vector2d(-0.5, 469.5), Eigen::Vector2d(9.5, 479.5))));
}

TEST(RegionsFromProto, TellsWhatItWasGiven) {
  v1::SceneImage image;
  AddRegion(10.25, 20, 30, 40.5, &image);
  SceneRequest request;
  request.searched = {
      *RegionsFromProto(image, 640, 480, std::nullopt, ""), std::nullopt, SearchedPart()};
  v1::Camera cameras[3];
  for (int i = 0; i < 3; ++i) RegionsToProto(request, i, &cameras[i]);
  ASSERT_EQ(cameras[0].regions_size(), 1);
  EXPECT_NEAR(cameras[0].regions(0).x_px(), 10.25, 1e-12);
  EXPECT_NEAR(cameras[0].regions(0).height_px(), 40.5, 1e-12);
  EXPECT_FALSE(cameras[0].region_empty());
  EXPECT_EQ(cameras[1].regions_size(), 0);
  EXPECT_FALSE(cameras[1].region_empty());
  EXPECT_TRUE(cameras[2].region_empty());
}

TEST(RegionsFromProto, NamesTheOffendingField) {
  const std::vector<std::vector<double>> bad = {{kNan, 0, 10, 10},
                                                {0, kInfinity, 10, 10},
                                                {0, 0, 10, kNan},
                                                {0, 0, 0, 10},
                                                {0, 0, 10, -3},
                                                {640, 0, 10, 10},
                                                {0, -30, 10, 20},
                                                {639.5, 0, 10, 10},
                                                {0, 0, 1e-9, 10},
                                                {1e300, 0, 1e300, 10}};
  for (const std::vector<double>& b : bad) {
    v1::SceneImage image;
    AddRegion(0, 0, 10, 10, &image);
    AddRegion(b[0], b[1], b[2], b[3], &image);
    EXPECT_EQ(FieldOf(RegionsFromProto(image, 640, 480, std::nullopt, "images[3]").status()),
              "images[3].regions[1]")
        << b[0] << " " << b[1] << " " << b[2] << " " << b[3];
  }
  v1::SceneImage many;
  for (int i = 0; i <= kMaxImageRegions; ++i) AddRegion(0, 0, 10, 10, &many);
  EXPECT_EQ(FieldOf(RegionsFromProto(many, 640, 480, std::nullopt, "images[3]").status()),
            "images[3].regions");
}

// What the sent image shows in a box the rectified image shows in the box's place.
TEST(RegionsFromProto, FollowTheRectification) {
  for (const LensModel::Kind kind : {LensModel::Kind::kPlumbBob, LensModel::Kind::kEquidistant}) {
    LensModel lens;
    lens.kind = kind;
    lens.fx = 500.0;
    lens.fy = 520.0;
    lens.cx = 330.0;
    lens.cy = 235.0;
    lens.coefficients = {-0.2, 0.05, 0.001, -0.002, 0.0};
    if (kind == LensModel::Kind::kEquidistant) lens.coefficients = {-0.02, 0.003, 0, 0, 0};
    v1::SceneImage image;
    AddRegion(60, 70, 200, 120, &image);
    const auto part = RegionsFromProto(image, 640, 480, lens, "images[0]");
    ASSERT_TRUE(part.ok() && *part);
    const ImageBox sent(Eigen::Vector2d(59.5, 69.5), Eigen::Vector2d(259.5, 189.5));
    const ImageBox& rectified = (*part)->boxes[0];
    ImageBox seen;
    for (int v = 0; v < 480; ++v) {
      for (int u = 0; u < 640; ++u) {
        const Eigen::Vector2d ray((u - lens.cx) / lens.fx, (v - lens.cy) / lens.fx);
        if (sent.contains(DistortedPixel(lens, ray))) seen.extend(Eigen::Vector2d(u, v));
      }
    }
    ASSERT_FALSE(seen.isEmpty());
    EXPECT_LT((rectified.min() - seen.min()).cwiseAbs().maxCoeff(), 2.0);
    EXPECT_LT((rectified.max() - seen.max()).cwiseAbs().maxCoeff(), 2.0);
  }
}

v1::SpaceRegion* AddSpace(double x, double y, double z, v1::RecognizeSceneRequest* request) {
  v1::SpaceRegion* region = request->add_regions();
  region->mutable_base_from_region()->mutable_rotation()->set_w(1.0);
  region->mutable_size_m()->set_x(x);
  region->mutable_size_m()->set_y(y);
  region->mutable_size_m()->set_z(z);
  return region;
}

TEST(SpaceRegionsFromProto, NamesTheOffendingField) {
  using Change = std::function<void(v1::SpaceRegion&)>;
  const std::vector<std::pair<std::string, Change>> cases = {
      {"regions[1].base_from_region.rotation",
       [](v1::SpaceRegion& r) { r.clear_base_from_region(); }},
      {"regions[1].base_from_region.rotation",
       [](v1::SpaceRegion& r) { r.mutable_base_from_region()->mutable_rotation()->set_w(2.0); }},
      {"regions[1].base_from_region.translation_m",
       [](v1::SpaceRegion& r) {
         r.mutable_base_from_region()->mutable_translation_m()->set_y(kNan);
       }},
      {"regions[1].size_m", [](v1::SpaceRegion& r) { r.clear_size_m(); }},
      {"regions[1].size_m", [](v1::SpaceRegion& r) { r.mutable_size_m()->set_z(0.0); }},
      {"regions[1].size_m", [](v1::SpaceRegion& r) { r.mutable_size_m()->set_z(kNan); }},
      {"regions[1].size_m", [](v1::SpaceRegion& r) { r.mutable_size_m()->set_x(-1.0); }},
      {"regions[1].size_m", [](v1::SpaceRegion& r) { r.mutable_size_m()->set_x(101.0); }}};
  for (const auto& [field, change] : cases) {
    v1::RecognizeSceneRequest request;
    AddSpace(0.6, 0.4, 0.2, &request);
    change(*AddSpace(0.6, 0.4, 0.2, &request));
    EXPECT_EQ(FieldOf(SpaceRegionsFromProto(request).status()), field);
  }
  v1::RecognizeSceneRequest many;
  for (int i = 0; i <= kMaxSpaceRegions; ++i) AddSpace(1, 1, 1, &many);
  EXPECT_EQ(FieldOf(SpaceRegionsFromProto(many).status()), "regions");
}

TEST(PlaceRegions, WithoutACameraThatIsKnownNamesThem) {
  SceneRequest request;
  request.images.resize(2);
  EXPECT_TRUE(PlaceRegions(&request).ok());
  request.space_boxes.push_back({{}, {0.1, 0.1, 0.1}});
  EXPECT_EQ(FieldOf(PlaceRegions(&request)), "regions");
}

}  // namespace
}  // namespace horopter
