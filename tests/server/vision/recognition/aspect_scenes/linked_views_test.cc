// Hypotheses of single images, linked to scenes.
#include <gtest/gtest.h>

#include <Eigen/Geometry>
#include <algorithm>
#include <initializer_list>
#include <opencv2/core.hpp>
#include <vector>

#include "server/vision/recognition/aspect_scenes/scene_search.h"
#include "tests/server/vision/recognition/aspect_search/find_aspects_fixture.h"

namespace horopter {
namespace {

class LinkedViews : public FindAspects {
 protected:
  struct Views {
    std::vector<AspectImage> images;
    std::vector<AspectViewPrior> priors;
    std::vector<Rigid3> poses;  // camera from object
  };

  // The angle, turned by so many radians about its z from view to view.
  static Views Turned(std::initializer_list<double> turns) {
    Views out;
    for (const double turn : turns) {
      Rigid3 pose = Pose();
      pose.R = pose.R * Turn(Eigen::Vector3d::UnitZ(), turn).R;
      out.poses.push_back(pose);
      out.images.push_back(MakeAspectImage(Photo(0, pose)));
      out.priors.push_back({NominalCamera(out.images.back())});
    }
    return out;
  }
};

// The same part before three cameras whose relative pose nobody knows.
TEST_F(LinkedViews, ViewsAreLinkedThroughAPart) {
  auto [images, priors, truth] = Turned({-0.25, 0.0, 0.3});
  std::vector<std::vector<AspectHypothesis>> hypotheses;
  for (const AspectImage& image : images)
    hypotheses.push_back(FindAspectHypotheses(image, *index_).hypotheses);
  // A view of nothing gets no camera, and does no harm.
  images.push_back(MakeAspectImage(cv::Mat(480, 640, CV_8UC3, cv::Scalar::all(128))));
  priors.push_back({NominalCamera(images.back())});
  hypotheses.emplace_back();
  const LinkedScene scene = SearchScene({images, priors, hypotheses, list_});
  ASSERT_EQ(scene.objects.size(), 1u);
  EXPECT_EQ(scene.objects[0].object, 0);
  EXPECT_EQ(scene.registered(), 3);
  EXPECT_FALSE(scene.views[3].has_value());
  for (int v = 0; v < 3; ++v) {
    ASSERT_TRUE(scene.views[v].has_value()) << v;
    const AspectSceneView& view = *scene.views[v];
    EXPECT_LT(PoseDistancePx(list_[0],
                             view.camera,
                             view.camera_from_scene * scene.objects[0].scene_from_object,
                             Camera(),
                             truth[v]),
              4.0)
        << "view " << v;
    EXPECT_GT(scene.objects[0].views[v].score, 0.5) << "view " << v;
  }
}

// Two views show what there is; the others are only looked at for that.
TEST_F(LinkedViews, ViewsAreSearchedForAllPartsOnlyWhenTheyAreNeeded) {
  auto [images, priors, poses] = Turned({-0.4, -0.2, 0.0, 0.2, 0.4});
  const auto searched = [&] {
    std::vector<int> views;
    const std::vector<std::vector<AspectHypothesis>> none(images.size());
    const LinkedScene scene =
        SearchScene({images, priors, none, list_, [&](int v) {
                       views.push_back(v);
                       return FindAspectHypotheses(images[v], *index_).hypotheses;
                     }});
    EXPECT_EQ(scene.objects.size(), 1u);
    EXPECT_TRUE(!scene.objects.empty() && scene.objects[0].object == 0);
    for (std::size_t v = 0; v < images.size(); ++v) EXPECT_EQ(scene.views[v].has_value(), v < 5);
    std::sort(views.begin(), views.end());
    return views;
  };
  EXPECT_EQ(searched(), (std::vector<int>{1, 3}));
  // Where a view does not show it, all are searched, each once.
  images.push_back(MakeAspectImage(cv::Mat(480, 640, CV_8UC3, cv::Scalar::all(128))));
  priors.push_back({NominalCamera(images.back())});
  EXPECT_EQ(searched(), (std::vector<int>{0, 1, 2, 3, 4, 5}));
}

// Searches end at once in a hurry; what had been searched before is linked, unless nobody wants it.
TEST_F(LinkedViews, InAHurryViewsThatWereSearchedAreLinked) {
  auto [images, priors, poses] = Turned({-0.2, 0.2});
  std::vector<std::vector<AspectHypothesis>> hypotheses;
  for (const AspectImage& image : images)
    hypotheses.push_back(
        FindAspectHypotheses(image, *index_, Brief(FindAspectOptions{})).hypotheses);
  const auto always = [] { return true; };
  const LinkedScene scene = SearchScene({images, priors, hypotheses, list_}, {}, always);
  ASSERT_EQ(scene.objects.size(), 1u);
  EXPECT_EQ(scene.objects[0].object, 0);
  EXPECT_EQ(scene.registered(), 2);
  EXPECT_TRUE(SearchScene({images, priors, hypotheses, list_}, {}, always, always).objects.empty());
}

TEST_F(LinkedViews, NothingLinksViewsOfNothing) {
  std::vector<AspectImage> images(2,
                                  MakeAspectImage(cv::Mat(480, 640, CV_8UC3, cv::Scalar::all(90))));
  std::vector<AspectViewPrior> priors(2, {NominalCamera(images[0])});
  std::vector<std::vector<AspectHypothesis>> hypotheses(2);
  const LinkedScene scene = SearchScene({images, priors, hypotheses, list_});
  EXPECT_TRUE(scene.objects.empty());
  EXPECT_EQ(scene.views.size(), 2u);
  EXPECT_EQ(scene.registered(), 0);
}

}  // namespace
}  // namespace horopter
