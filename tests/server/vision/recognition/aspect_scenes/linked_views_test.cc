// Hypotheses of single images, linked to scenes.
#include <gtest/gtest.h>

#include <Eigen/Geometry>
#include <algorithm>
#include <initializer_list>
#include <opencv2/core.hpp>
#include <string>
#include <vector>

#include "server/vision/recognition/aspect_scenes/scene_generator.h"
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

// Of what effort is there, two images are searched whatever it is; the rest is answered as in a
// hurry, on any machine and with any number of threads the same.
TEST_F(LinkedViews, LimitedEffortEndsTheSearchAndIsTheSameWithAnyThreads) {
  auto [images, priors, poses] = Turned({-0.4, -0.2, 0.0, 0.2, 0.4});
  images.push_back(MakeAspectImage(cv::Mat(480, 640, CV_8UC3, cv::Scalar::all(128))));
  priors.push_back({NominalCamera(images.back())});
  const auto found = [&](double most, int threads, std::size_t* searched) {
    const std::vector<std::vector<AspectHypothesis>> none(images.size());
    SearchEffort effort(most);
    *searched = 0;
    AspectLinkInput input{images, priors, none, list_, [&](int v) {
                            ++*searched;
                            effort.Spend(kImageEffort);
                            return FindAspectHypotheses(images[v], *index_).hypotheses;
                          }};
    input.effort = &effort;
    AspectLinkOptions options;
    options.threads = threads;
    const LinkedScene scene = SearchScene(input, options);
    EXPECT_EQ(effort.IsSpent(), effort.spent() >= most);
    return scene;
  };
  std::size_t searched = 0;
  const LinkedScene any = found(1e6, 2, &searched);
  EXPECT_EQ(searched, images.size());
  EXPECT_EQ(any.registered(), 5);
  const LinkedScene one = found(2.2, 1, &searched);
  EXPECT_EQ(searched, 2u);
  ASSERT_EQ(one.objects.size(), 1u);
  EXPECT_LT(one.registered(), any.registered());
  const LinkedScene two = found(2.2, 2, &searched);
  ASSERT_EQ(two.objects.size(), 1u);
  EXPECT_EQ(one.score, two.score);
  EXPECT_EQ(one.objects[0].scene_from_object.t, two.objects[0].scene_from_object.t);
}

// A generator is asked in the order of what it takes, and not where the scene is credible without.
TEST_F(LinkedViews, GeneratorsAreAskedWhileNothingIsCredible) {
  auto [images, priors, poses] = Turned({-0.2, 0.2});
  std::vector<std::vector<AspectHypothesis>> hypotheses;
  for (const AspectImage& image : images)
    hypotheses.push_back(FindAspectHypotheses(image, *index_).hypotheses);
  std::vector<std::string> asked;
  const auto lister = [&](const char* name) {
    return [&asked, name] {
      asked.emplace_back(name);
      return std::vector<AspectScene>();
    };
  };
  ListedScenes dear(50.0, lister("dear")), dearer(60.0, lister("dearer")),
      cheap(0.01, lister("cheap"));
  std::vector<SceneGenerator*> generators = {&dearer, &cheap, &dear};
  AspectLinkInput input{images, priors, hypotheses, list_};
  input.generators = generators;
  EXPECT_EQ(SearchScene(input).objects.size(), 1u);
  EXPECT_EQ(asked, std::vector<std::string>{"cheap"});
  EXPECT_FALSE(cheap.Applies({}));
  // Nothing links two images of nothing: all are asked, and each once.
  asked.clear();
  hypotheses.assign(2, {});
  EXPECT_TRUE(SearchScene(input).objects.empty());
  EXPECT_EQ(asked, (std::vector<std::string>{"dear", "dearer"}));
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
