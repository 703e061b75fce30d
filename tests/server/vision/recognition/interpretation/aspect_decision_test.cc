#include "server/vision/recognition/interpretation/aspect_decision.h"

#include <gtest/gtest.h>

#include <initializer_list>

namespace horopter {
namespace {

// `registered` of `views` views with these focal lengths in turn, objects of parts 0, 1, ... with
// these scores.
LinkedScene Scene(int registered,
                  int views,
                  std::initializer_list<double> scores,
                  std::initializer_list<double> focals_px = {800.0}) {
  LinkedScene scene;
  scene.views.resize(views);
  for (int v = 0; v < registered; ++v) {
    scene.views[v].emplace();
    scene.views[v]->camera.focal_px = focals_px.begin()[v % focals_px.size()];
  }
  for (const double score : scores) {
    LinkedObject& o = scene.objects.emplace_back();
    o.object = static_cast<int>(scene.objects.size()) - 1;
    o.score = score;
  }
  return scene;
}

double Probability(const LinkedScene& scene, int object) {
  return AspectProbability(scene.objects[object], scene, {});
}

TEST(AspectDecision, WhatOneImageOfSeveralShowsMayBeAPicture) {
  const auto seen = [](int registered, int views) {
    LinkedScene scene = Scene(registered, views, {0.98});
    LinkedObject& o = scene.objects[0];
    o.precision = 0.95;
    o.views.resize(views);
    o.shown.assign(views, false);
    for (int v = 0; v < registered; ++v) {
      o.views[v].support_px = 500.0;
      o.shown[v] = true;
    }
    return scene;
  };
  EXPECT_GT(Probability(seen(1, 1), 0), 0.7);
  EXPECT_GT(Probability(seen(2, 3), 0), 0.7);
  EXPECT_LT(Probability(seen(1, 3), 0), 0.1);
  EXPECT_LT(Probability(seen(1, 10), 0), 0.1);
}

TEST(AspectDecision, PrintThatStaysInItsPlaceMakesLessEnough) {
  const AspectAcceptance options;
  const auto printed = [&](std::initializer_list<double> print, double score) {
    LinkedScene scene =
        Scene(static_cast<int>(print.size()), static_cast<int>(print.size()), {score});
    for (const double share : print) {
      scene.objects[0].views.emplace_back().print = share;
      scene.objects[0].shown.push_back(true);
    }
    return scene;
  };
  const double even = options.even_printed;
  EXPECT_NEAR(Probability(printed({0.8, 0.8, 0.7, 0.3}, even), 0), 0.5, 1e-9);
  EXPECT_GT(Probability(printed({0.9, 0.9, 0.9, 0.9, 0.9, 0.9}, 0.49), 0), 0.6);
  EXPECT_LT(Probability(printed({0.6, 0.6, 0.6, 0.9}, even), 0), 0.2);  // wrong ones had so much
  EXPECT_LT(Probability(printed({0.9, 0.9}, 0.49), 0), 0.5);            // two views cannot tell
  LinkedScene denied = printed({0.9, 0.9, 0.9, 0.9}, 0.49);
  denied.agreement.surface.pairs = 12;
  denied.agreement.surface.mean = 0.1;
  EXPECT_LT(Probability(denied, 0), 0.1);
  LinkedScene most = printed({0.9, 0.9, 0.9}, even);
  most.views.resize(6);  // three of six views are linked
  EXPECT_LT(Probability(most, 0), 0.2);
  // Views that do not show it have no say.
  LinkedScene hidden = printed({0.9, 0.9, 0.9, 0.0, 0.0, 0.0}, even);
  for (int v = 3; v < 6; ++v) hidden.objects[0].shown[v] = false;
  EXPECT_NEAR(Probability(hidden, 0), 0.5, 1e-9);
}

// A part under known cameras, found alike in so many of five views.
LinkedScene UnderCameras(int shown, double precision, double score, double support_px) {
  LinkedScene scene = Scene(5, 5, {score});
  LinkedObject& o = scene.objects.front();
  o.precision = precision;
  for (int v = 0; v < 5; ++v) {
    o.shown.push_back(v < shown);
    o.views.emplace_back().precision = precision;
    o.views.back().support_px = support_px;
  }
  return scene;
}

// A box among tools that are no boxes: alone it is chance, whatever the ground says; beside a part
// that is sure it may be one.
TEST(AspectDecision, UnderKnownCamerasASurePartSpeaksForOthers) {
  LinkedScene alone = UnderCameras(5, 0.85, 0.36, 230);
  alone.agreement.texture = 12.0;
  alone.agreement.ground = 0.1;
  EXPECT_LT(ProbabilityUnderCameras(alone.objects.front(), alone), 0.5);
  LinkedScene beside = UnderCameras(5, 0.95, 0.5, 480);
  beside.agreement = {{}, 0.25, 12.0};
  ASSERT_GT(ProbabilityUnderCameras(beside.objects.front(), beside), 0.9);
  beside.objects.push_back(alone.objects.front());
  EXPECT_GT(ProbabilityUnderCameras(beside.objects.back(), beside), 0.7);
}

TEST(AspectDecision, UnderKnownCamerasViewsThatAgreeMakeLessScoreEnough) {
  const auto probability = [](const LinkedScene& scene) {
    return ProbabilityUnderCameras(scene.objects.front(), scene);
  };
  LinkedScene scanned = UnderCameras(5, 0.57, 0.36, 900);  // of a photographed scanned part
  EXPECT_LT(probability(scanned), 0.7);
  scanned.agreement.texture = 12.0;  // on a ground that the cameras agree on
  scanned.agreement.ground = 0.43;
  EXPECT_GT(probability(scanned), 0.8);
  AspectAcceptance options;
  EXPECT_LT(AspectProbability(scanned.objects.front(), scanned, options), 0.1);
  EXPECT_LT(probability(UnderCameras(2, 0.57, 0.36, 900)), probability(scanned));
  EXPECT_LT(probability(UnderCameras(5, 0.45, 0.30, 390)), 0.5);  // where it is not
  EXPECT_LT(probability(UnderCameras(5, 0.25, 0.12, 300)), 0.01);
  LinkedScene doubtful = scanned;  // one view shows next to nothing of it
  doubtful.objects.front().views[2].precision = 0.1;
  EXPECT_LT(probability(doubtful), probability(scanned));
  LinkedScene lost = scanned;
  lost.views[4].reset();
  EXPECT_LT(probability(lost), probability(scanned));
}

}  // namespace
}  // namespace horopter
