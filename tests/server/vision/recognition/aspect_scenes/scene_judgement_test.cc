#include "server/vision/recognition/aspect_scenes/scene_judgement.h"

#include <gtest/gtest.h>

#include <opencv2/core.hpp>
#include <opencv2/imgproc.hpp>
#include <random>

#include "tests/support/photo_scene.h"

namespace horopter {
namespace {

// Short dark lines on the block's upper face, in the block's frame.
std::vector<std::pair<Eigen::Vector3d, Eigen::Vector3d>> Print(unsigned seed) {
  std::mt19937 random(seed);
  std::uniform_real_distribution<double> x(-0.026, 0.0), y(-0.017, 0.0), along(-0.008, 0.008);
  std::vector<std::pair<Eigen::Vector3d, Eigen::Vector3d>> out;
  for (int i = 0; i < 14; ++i) {
    const Eigen::Vector3d a(x(random), y(random), 0.012);
    out.push_back({a, a + Eigen::Vector3d(along(random), along(random), 0)});
  }
  return out;
}

struct Photos {
  std::vector<cv::Mat> pictures;
  std::vector<AspectImage> images;
};

// print_seed of a view; 0: nothing is printed.
template <typename SeedOf>
Photos Take(const std::vector<std::pair<const RenderMesh*, Rigid3>>& parts,
            const SeedOf& print_seed) {
  Photos out;
  for (int v = 0; v < kViews; ++v) {
    std::vector<std::pair<const RenderMesh*, Rigid3>> seen;
    for (const auto& [mesh, pose] : parts) seen.push_back({mesh, CameraFromScene(v) * pose});
    cv::Mat picture = PhotoOf(seen, Camera());
    if (const unsigned seed = print_seed(v); seed != 0) {
      for (const auto& [a, b] : Print(seed)) {
        const Eigen::Vector2d p = 16 * Project(Camera(), seen.front().second * a);
        const Eigen::Vector2d q = 16 * Project(Camera(), seen.front().second * b);
        cv::line(picture,
                 cv::Point(std::lround(p.x()), std::lround(p.y())),
                 cv::Point(std::lround(q.x()), std::lround(q.y())),
                 cv::Scalar(25, 25, 25),
                 2,
                 cv::LINE_AA,
                 4);
      }
    }
    out.pictures.push_back(picture);
    out.images.push_back(MakeAspectImage(picture));
  }
  return out;
}

constexpr auto kNoPrint = [](int) { return 0u; };

class SceneJudgement : public testing::Test {
 protected:
  static void SetUpTestSuite() {
    block_ = new PhotoPart(MakePart(SteppedBlock()));
    cube_ = new PhotoPart(MakePart(BoxMesh({0.012, 0.012, 0.012})));
  }
  static void TearDownTestSuite() {
    delete block_;
    delete cube_;
  }
  static const RenderMesh& block() { return block_->object.mesh; }
  static const RenderMesh& cube() { return cube_->object.mesh; }

 private:
  static inline PhotoPart *block_ = nullptr, *cube_ = nullptr;
};

TEST_F(SceneJudgement, TrueScoresHighAShiftedPoseLow) {
  const Photos photos = Take({{&block(), Rigid3{}}}, kNoPrint);
  const LinkedObject right = JudgeInViews(photos.images, block(), Views(), {0, Rigid3{}});
  Rigid3 shifted;
  shifted.t.x() = 0.008;
  const LinkedObject wrong = JudgeInViews(photos.images, block(), Views(), {0, shifted});
  EXPECT_EQ(std::count(right.shown.begin(), right.shown.end(), true), kViews);
  EXPECT_GT(right.score, 0.6);
  EXPECT_LT(wrong.score, 0.5 * right.score);
}

// The photographs without what is left of a share of the part's box, and cameras that know it.
struct CutOff {
  Photos photos;
  std::vector<std::optional<AspectSceneView>> views = Views();

  CutOff(Photos whole, const RenderMesh& mesh, double share) : photos(std::move(whole)) {
    for (int v = 0; v < kViews; ++v) {
      PinholeCamera& camera = views[v]->camera;
      double left = 1e9, right = -1e9;
      for (const Eigen::Vector3d& corner : BoxCorners(mesh)) {
        const double x = Project(camera, CameraFromScene(v) * corner).x();
        left = std::min(left, x);
        right = std::max(right, x);
      }
      const int cut = std::max(0, static_cast<int>(left + share * (right - left)));
      cv::Mat& picture = photos.pictures[v];
      picture = picture(cv::Rect(cut, 0, picture.cols - cut, picture.rows)).clone();
      camera.cx -= cut;
      camera.width -= cut;
      photos.images[v] = MakeAspectImage(picture);
    }
  }
};

TEST_F(SceneJudgement, APartThatTheBorderCutsOffCountsByWhatIsSeen) {
  const Photos whole = Take({{&block(), Rigid3{}}}, kNoPrint);
  const LinkedObject uncut = JudgeInViews(whole.images, block(), Views(), {0, Rigid3{}});
  for (const double share : {0.2, 0.4}) {
    SCOPED_TRACE(share);
    const CutOff cut(whole, block(), share);
    const LinkedObject right = JudgeInViews(cut.photos.images, block(), cut.views, {0, Rigid3{}});
    Rigid3 shifted;
    shifted.t.y() = 0.008;
    const LinkedObject wrong = JudgeInViews(cut.photos.images, block(), cut.views, {0, shifted});
    EXPECT_EQ(std::count(right.shown.begin(), right.shown.end(), true), kViews);
    for (const AspectScore& score : right.views)
      EXPECT_LT(score.visible_px, uncut.views[0].visible_px);
    EXPECT_GT(right.score, 0.75 * uncut.score);
    EXPECT_LT(wrong.score, 0.6 * right.score);
  }
  const CutOff gone(whole, block(), 0.95);
  EXPECT_EQ(JudgeInViews(gone.photos.images, block(), gone.views, {0, Rigid3{}}).score, 0.0);
}

TEST_F(SceneJudgement, ASecondPartInTheSameSurfaceScoresNothing) {
  const Photos photos = Take({{&block(), Rigid3{}}}, kNoPrint);
  AspectScene scene;
  scene.views = Views();
  Rigid3 near;
  near.t = {0.0004, 0.0, 0.0};
  scene.objects = {{0, near}, {0, Rigid3{}}};
  const RenderMesh* meshes[] = {&block()};
  const auto judged = JudgeScene(photos.images, meshes, scene);
  EXPECT_EQ(std::min(judged[0].score, judged[1].score), 0.0);
  EXPECT_GT(std::max(judged[0].score, judged[1].score), 0.6);
}

TEST_F(SceneJudgement, PartsBesideEachOtherBothStand) {
  Rigid3 beside;
  beside.t = {0.05, 0.0, 0.0};
  const Photos photos = Take({{&block(), Rigid3{}}, {&cube(), beside}}, kNoPrint);
  AspectScene scene;
  scene.views = Views();
  scene.objects = {{0, Rigid3{}}, {1, beside}};
  const RenderMesh* meshes[] = {&block(), &cube()};
  const auto judged = JudgeScene(photos.images, meshes, scene);
  EXPECT_GT(judged[0].score, 0.55);
  EXPECT_GT(judged[1].score, 0.55);
}

TEST_F(SceneJudgement, WhatFitsIntoTheEdgesOfABetterPartSaysNothing) {
  const Photos photos = Take({{&block(), Rigid3{}}}, kNoPrint);
  AspectScene scene;
  scene.views = Views();
  scene.objects = {{0, Rigid3{}}};
  const RenderMesh* meshes[] = {&block()};
  const auto judged = JudgeScene(photos.images, meshes, scene);
  const SceneLayers layers = MakeSceneLayers(photos.images, meshes, scene, judged);
  const std::vector<ObjectLayer>* better[] = {&layers[0]};
  // A plate that would be the block's lower step: nothing of it is hidden from above the edges.
  const PhotoPart plate = MakePart(BoxMesh({0.03, 0.02, 0.003}));
  Rigid3 there;
  there.t.z() = -0.009;
  const LinkedObject alone =
      JudgeInViews(photos.images, plate.object.mesh, scene.views, {0, there});
  const LinkedObject beside =
      JudgeInViews(photos.images, plate.object.mesh, scene.views, {0, there}, {}, better);
  EXPECT_GT(alone.score, 0.25);
  EXPECT_LT(beside.score, 0.4 * alone.score);
  for (int v = 0; v < kViews; ++v) {
    EXPECT_EQ(alone.views[v].claimed_px, 0.0);
    EXPECT_GT(beside.views[v].claimed_px, 0.5 * alone.views[v].support_px);
  }
}

TEST_F(SceneJudgement, PrintThatStaysInItsPlaceNeedsNoExplanation) {
  SceneJudgementOptions strict;
  strict.print_precision = 2.0;  // never
  for (const unsigned seed : {3u, 4u, 5u}) {
    SCOPED_TRACE(testing::Message() << "seed " << seed);
    const Photos printed = Take({{&block(), Rigid3{}}}, [&](int) { return seed; });
    const auto with = JudgeInViews(printed.images, block(), Views(), {0, Rigid3{}});
    const auto without = JudgeInViews(printed.images, block(), Views(), {0, Rigid3{}}, strict);
    EXPECT_LT(without.score, 0.62);
    EXPECT_GT(with.score, without.score + 0.1);
    // Edges that lie elsewhere in every image are no print.
    const Photos clutter = Take({{&block(), Rigid3{}}}, [&](int v) { return seed + 10 * (v + 1); });
    const auto moving = JudgeInViews(clutter.images, block(), Views(), {0, Rigid3{}});
    const auto moving_strict =
        JudgeInViews(clutter.images, block(), Views(), {0, Rigid3{}}, strict);
    EXPECT_LT(moving.score, moving_strict.score + 0.03);
  }
}

TEST_F(SceneJudgement, OneViewWithAPoorCameraDoesNotDecideWhatIsPrint) {
  const unsigned seed = 3;
  const Photos printed = Take({{&block(), Rigid3{}}}, [&](int) { return seed; });
  auto views = Views();
  views[kViews - 1]->camera_from_scene.t.x() += 0.0015;
  SceneJudgementOptions strict;
  strict.print_precision = 2.0;  // never
  const auto with = JudgeInViews(printed.images, block(), views, {0, Rigid3{}});
  const auto without = JudgeInViews(printed.images, block(), views, {0, Rigid3{}}, strict);
  EXPECT_LT(with.views[kViews - 1].print, with.views[0].print);
  for (int v = 0; v + 1 < kViews; ++v)
    EXPECT_GT(with.views[v].score, without.views[v].score + 0.05) << "view " << v;
}

// Short lines beside the part, other ones in every view: what lies behind it.
void DrawGround(const std::vector<std::pair<const RenderMesh*, Rigid3>>& seen,
                unsigned seed,
                cv::Mat* picture) {
  cv::Mat part, lines = picture->clone();
  cv::absdiff(PhotoOf(seen, Camera()), PhotoOf({}, Camera()), part);
  cv::cvtColor(part, part, cv::COLOR_BGR2GRAY);
  cv::threshold(part, part, 4, 255, cv::THRESH_BINARY);
  cv::dilate(part, part, cv::Mat(), {-1, -1}, 3);
  const cv::Rect around = cv::boundingRect(part);
  std::mt19937 random(seed);
  std::uniform_int_distribution<int> x(around.x - 10, around.br().x + 10),
      y(around.y - 10, around.br().y + 10), along(-9, 9);
  for (int i = 0; i < 120; ++i) {
    const cv::Point a(x(random), y(random));
    cv::line(lines, a, a + cv::Point(along(random), along(random)), {20, 20, 20}, 2, cv::LINE_AA);
  }
  picture->copyTo(lines, part);
  *picture = lines;
}

TEST_F(SceneJudgement, PrintIsToldBeforeAGroundWithEdges) {
  SceneJudgementOptions by_recall;
  by_recall.print_share = 2.0;  // never
  for (const unsigned seed : {3u, 4u, 5u}) {
    SCOPED_TRACE(testing::Message() << "seed " << seed);
    const auto before_ground = [&](const auto& print_seed) {
      Photos photos = Take({{&block(), Rigid3{}}}, print_seed);
      for (int v = 0; v < kViews; ++v) {
        DrawGround({{&block(), CameraFromScene(v)}}, 100 * seed + v, &photos.pictures[v]);
        photos.images[v] = MakeAspectImage(photos.pictures[v]);
      }
      return photos;
    };
    const Photos printed = before_ground([&](int) { return seed; });
    const auto share = JudgeInViews(printed.images, block(), Views(), {0, Rigid3{}});
    const auto recall = JudgeInViews(printed.images, block(), Views(), {0, Rigid3{}}, by_recall);
    EXPECT_GT(share.views[0].print, 0.8);
    EXPECT_LT(share.views[0].recall, 0.6);
    EXPECT_GT(share.score, recall.score + 0.05);
    // Edges that lie elsewhere in every image are no print.
    const Photos clutter = before_ground([&](int v) { return seed + 10 * (v + 1); });
    const auto moving = JudgeInViews(clutter.images, block(), Views(), {0, Rigid3{}});
    EXPECT_EQ(moving.score,
              JudgeInViews(clutter.images, block(), Views(), {0, Rigid3{}}, by_recall).score);
    EXPECT_LT(moving.score, share.score);
  }
}

TEST_F(SceneJudgement, RoughCamerasHideThatPrintStays) {
  SceneJudgementOptions growing;
  growing.presumed_recall = kPresumedRecall;
  const unsigned seed = 3;
  const Photos printed = Take({{&block(), Rigid3{}}}, [&](int) { return seed; });
  for (const double off_m : {0.0, 0.0004, 0.0008}) {  // 2.5 px a millimetre
    SCOPED_TRACE(off_m);
    Rigid3 rough;
    rough.t = {off_m, off_m, 0.0};
    const auto grown = JudgeInViews(printed.images, block(), Views(), {0, rough}, growing);
    EXPECT_GE(grown.score, JudgeInViews(printed.images, block(), Views(), {0, rough}).score);
    for (const AspectScore& score : grown.views) {
      if (score.print >= 0.5) {
        EXPECT_GE(score.recall, 0.5);
      }
    }
  }
}

TEST_F(SceneJudgement, TwoViewsPresumePrintWhileASceneGrowsAndThreeAskForIt) {
  SceneJudgementOptions growing;
  growing.presumed_recall = 0.55;
  growing.print_precision = 0.6;
  const unsigned seed = 3;
  const Photos clutter = Take({{&block(), Rigid3{}}}, [&](int v) { return seed + 10 * (v + 1); });
  auto two = Views();
  for (std::size_t v = 2; v < two.size(); ++v) two[v].reset();
  const auto strict = JudgeInViews(clutter.images, block(), two, {0, Rigid3{}});
  const auto presumed = JudgeInViews(clutter.images, block(), two, {0, Rigid3{}}, growing);
  ASSERT_LT(strict.views[0].recall, 0.55);
  EXPECT_GT(presumed.score, strict.score);
  EXPECT_GE(presumed.views[0].recall, 0.55);
  // A wrong pose finds few of its edges: nothing is presumed.
  Rigid3 shifted;
  shifted.t.x() = 0.008;
  EXPECT_EQ(JudgeInViews(clutter.images, block(), two, {0, shifted}, growing).score,
            JudgeInViews(clutter.images, block(), two, {0, shifted}).score);
  // Three and more views say what it is: edges that move are none of its print.
  const auto all = JudgeInViews(clutter.images, block(), Views(), {0, Rigid3{}}, growing);
  EXPECT_LT(all.views[0].recall, 0.55);
}

TEST_F(SceneJudgement, OneOfTwoCamerasSaysNothingOfBoth) {
  const Photos photos = Take({{&block(), Rigid3{}}}, kNoPrint);
  std::vector<std::optional<AspectSceneView>> views = Views();
  for (int v = 1; v < kViews; ++v) views[v].reset();
  EXPECT_GT(JudgeInViews(photos.images, block(), views, {0, Rigid3{}}).score, 0.6);
  // A second one that looks past the part.
  views[1] = Views()[1];
  views[1]->camera_from_scene.t.x() += 10.0;
  const LinkedObject seen_once = JudgeInViews(photos.images, block(), views, {0, Rigid3{}});
  EXPECT_EQ(std::count(seen_once.shown.begin(), seen_once.shown.end(), true), 1);
  EXPECT_EQ(seen_once.score, 0.0);
}

TEST_F(SceneJudgement, NothingRegisteredScoresNothing) {
  const Photos photos = Take({{&block(), Rigid3{}}}, kNoPrint);
  const std::vector<std::optional<AspectSceneView>> none(kViews);
  EXPECT_EQ(JudgeInViews(photos.images, block(), none, {0, Rigid3{}}).score, 0.0);
  EXPECT_TRUE(JudgeScene(photos.images, {}, {none, {}}).empty());
}

}  // namespace
}  // namespace horopter
