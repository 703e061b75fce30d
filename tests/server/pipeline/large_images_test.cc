// Images as telephones take them are answered as smaller ones, in their own pixels.
#include "server/pipeline/large_images.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <opencv2/core.hpp>
#include <opencv2/imgcodecs.hpp>
#include <opencv2/imgproc.hpp>

#include "client/bop_dataset.h"
#include "client/cad_import.h"
#include "server/pipeline/pipeline.h"

namespace horopter {
namespace {

constexpr char kDataset[] = HOROPTER_TEST_DATA "/parts";
constexpr int kScene = 5;

TEST(LargeImages, AreReducedByWholeNumbersWhileEnoughStays) {
  EXPECT_EQ(ReductionOf({640, 480}, 1280), 1);
  EXPECT_EQ(ReductionOf({1920, 1080}, 1280), 1);
  EXPECT_EQ(ReductionOf({2560, 1920}, 1280), 2);
  EXPECT_EQ(ReductionOf({4000, 3000}, 1280), 3);
  EXPECT_EQ(ReductionOf({3024, 4032}, 1280), 3);
  EXPECT_EQ(ReductionOf({4000, 3000}, 0), 1);
  EXPECT_EQ(ReductionOf({448, 336}, 1280, 448), 1);
  EXPECT_EQ(ReductionOf({336, 447}, 1280, 448), 0.5);
  EXPECT_EQ(ReductionOf({250, 210}, 1280, 448), 1);
  EXPECT_EQ(ReductionOf({320, 240}, 1280, 0), 1);
}

TEST(LargeImages, HintsGoDownAsCamerasComeBack) {
  SceneRequest request;
  request.images.assign(2, cv::Mat(301, 402, CV_8UC3, cv::Scalar(9, 9, 9)));
  CameraHint hint;
  hint.focal_px = 450.0;
  hint.principal_point = Eigen::Vector2d(210.25, 149.5);
  hint.principal_point_sigma_px = 6.0;
  request.hints.assign(2, hint);
  const std::vector<double> factors = {3, 1};
  const SceneRequest reduced = ReducedRequest(request, factors);
  EXPECT_EQ(reduced.images[0].size(), cv::Size(134, 100));
  EXPECT_EQ(reduced.images[1].size(), cv::Size(402, 301));
  EXPECT_DOUBLE_EQ(*reduced.hints[0].focal_px, 150.0);
  EXPECT_DOUBLE_EQ(*reduced.hints[0].principal_point_sigma_px, 2.0);
  SceneAnswer answer;
  answer.cameras.resize(2);
  answer.unexplained_edges.resize(2);
  for (int v = 0; v < 2; ++v) {
    const CameraHint& known = reduced.hints[v];
    answer.cameras[v].emplace();
    answer.cameras[v]->camera =
        WithHint(CenteredCamera(reduced.images[v].cols, reduced.images[v].rows, 1.0), known);
    answer.unexplained_edges[v] = {{*known.principal_point}};
  }
  AnswerFinding lie;
  lie.kind = FindingKind::kExifContradicted;
  lie.image = 0;
  lie.value = *reduced.hints[0].focal_px;
  answer.findings.push_back(lie);
  TellInOriginalPixels(request, factors, &answer);
  for (int v = 0; v < 2; ++v) {
    const PinholeCamera& camera = answer.cameras[v]->camera;
    EXPECT_EQ(camera.width, 402);
    EXPECT_EQ(camera.height, 301);
    EXPECT_NEAR(camera.focal_px, 450.0, 1e-9);
    EXPECT_NEAR(camera.cx, 210.25, 1e-9);
    EXPECT_NEAR(camera.cy, 149.5, 1e-9);
    EXPECT_LT((answer.unexplained_edges[v][0][0] - *hint.principal_point).norm(), 1e-9);
  }
  EXPECT_NEAR(answer.findings[0].value, 450.0, 1e-9);
}

TEST(LargeImages, SmallOnesAreAskedTwiceAsLarge) {
  SceneRequest request;
  request.images.assign(1, cv::Mat(241, 320, CV_8UC3, cv::Scalar(9, 9, 9)));
  CameraHint hint;
  hint.focal_px = 210.0;
  hint.principal_point = Eigen::Vector2d(101.25, 72.5);
  request.hints.assign(1, hint);
  const SceneRequest asked = ReducedRequest(request, {0.5});
  EXPECT_EQ(asked.images[0].size(), cv::Size(640, 482));
  EXPECT_DOUBLE_EQ(*asked.hints[0].focal_px, 420.0);
  SceneAnswer answer;
  answer.cameras.resize(1);
  answer.cameras[0].emplace();
  answer.cameras[0]->camera = WithHint(CenteredCamera(640, 482, 1.0), asked.hints[0]);
  TellInOriginalPixels(request, {0.5}, &answer);
  const PinholeCamera& camera = answer.cameras[0]->camera;
  EXPECT_EQ(camera.width, 320);
  EXPECT_NEAR(camera.focal_px, 210.0, 1e-9);
  EXPECT_NEAR(camera.cx, 101.25, 1e-9);
  EXPECT_NEAR(camera.cy, 72.5, 1e-9);
}

TEST(LargeImages, ArePartlySearchedInTheImagesAsTheyCame) {
  SceneRequest request;
  request.images.assign(2, cv::Mat(3000, 4000, CV_8UC1, cv::Scalar(9)));
  SearchedPart part;
  part.boxes = {ImageBox(Eigen::Vector2d(-0.5, -0.5), Eigen::Vector2d(2.5, 5.5)),
                ImageBox(Eigen::Vector2d(1000, 2000), Eigen::Vector2d(1300, 2600))};
  request.searched = {std::nullopt, part};
  const SceneRequest reduced = ReducedRequest(request, {3, 3});
  EXPECT_FALSE(reduced.searched[0]);
  const SearchedPart& found = *reduced.searched[1];
  EXPECT_EQ(found.pixels.data, request.images[1].data);
  EXPECT_EQ(found.pixels_from_image, 3);
  // The first three by six pixels are the first one by two.
  EXPECT_TRUE(
      found.boxes[0].isApprox(ImageBox(Eigen::Vector2d(-0.5, -0.5), Eigen::Vector2d(0.5, 1.5))));
  for (std::size_t k = 0; k < part.boxes.size(); ++k) {
    const Eigen::Vector2d back = (found.boxes[k].max().array() + 0.5) * 3.0 - 0.5;
    EXPECT_LT((back - part.boxes[k].max()).norm(), 1e-9);
  }
}

TEST(LargeImages, AreAnsweredAsSmallOnes) {
  const absl::StatusOr<BopDataset> dataset = ReadBopDataset(kDataset);
  ASSERT_TRUE(dataset.ok()) << dataset.status();
  const absl::StatusOr<BopScene> scene = ReadBopScene(kDataset, "val", kScene);
  ASSERT_TRUE(scene.ok()) << scene.status();
  CatalogSnapshot catalog;
  for (const BopObject& object : dataset->objects) {
    if (object.obj_id != scene->images[0].instances[0].obj_id) continue;
    absl::StatusOr<CadImport> cad = ImportCad(object.cad_path);
    ASSERT_TRUE(cad.ok()) << cad.status();
    cad->model.id = "part";
    catalog.objects.push_back(PrepareCatalogObject(std::move(cad->model)).value());
  }
  SceneRequest small, large;
  constexpr int kLarger = 4;
  for (const BopImage& image : scene->images) {
    small.images.push_back(cv::imread(image.path, cv::IMREAD_COLOR));
    cv::Mat more;
    cv::resize(small.images.back(), more, {}, kLarger, kLarger, cv::INTER_CUBIC);
    ASSERT_GT(ReductionOf(more.size(), PipelineOptions{}.least_side_px), 1);
    large.images.push_back(more);
  }
  const auto expected = RecognizeScene(small, catalog, {});
  const auto found = RecognizeScene(large, catalog, {});
  ASSERT_TRUE(expected.ok() && found.ok()) << expected.status() << found.status();
  ASSERT_FALSE(expected->answer.objects.empty()) << ReasonsText(expected->answer);
  ASSERT_EQ(found->answer.objects.size(), expected->answer.objects.size());
  for (std::size_t v = 0; v < small.images.size(); ++v) {
    const auto &a = expected->answer.cameras[v], &b = found->answer.cameras[v];
    ASSERT_EQ(a.has_value(), b.has_value());
    if (!a) continue;
    EXPECT_EQ(b->camera.width, kLarger * a->camera.width);
    EXPECT_NEAR(std::log(b->camera.focal_px / (kLarger * a->camera.focal_px)), 0.0, 0.05);
    // The part's origin in the image.
    const auto origin = [](const PosedCamera& camera, const SceneAnswer& answer) {
      return Project(camera.camera,
                     camera.camera_from_scene * answer.objects[0].scene_from_object.t);
    };
    EXPECT_LT((origin(*b, found->answer) / kLarger - origin(*a, expected->answer)).norm(), 2.0);
  }
}

}  // namespace
}  // namespace horopter
