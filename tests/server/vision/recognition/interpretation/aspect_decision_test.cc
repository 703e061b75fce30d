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

// By the thresholds.
double Probability(const LinkedScene& scene, int object) {
  AspectAcceptance options;
  options.decision = AspectAcceptance::Decision::kThresholds;
  return AspectProbability(scene.objects[object], scene, options);
}

TEST(AspectDecision, OnePartAloneIsEvenAtItsOwnScore) {
  const AspectAcceptance options;
  EXPECT_NEAR(Probability(Scene(4, 4, {options.even_alone}), 0), 0.5, 1e-9);
  EXPECT_NEAR(Probability(Scene(1, 1, {options.even_in_one_view}), 0), 0.5, 1e-9);
  EXPECT_NEAR(Probability(Scene(2, 4, {options.even_alone + 0.5 * options.missing_views_more}), 0),
              0.5,
              1e-9);
  EXPECT_LT(Probability(Scene(3, 4, {0.575}), 0), 0.6);  // was a wrong one
  EXPECT_LT(Probability(Scene(1, 4, {0.667}), 0), 0.6);  // and so was this
  EXPECT_GT(Probability(Scene(4, 4, {0.56}), 0), 0.6);
  EXPECT_GT(Probability(Scene(4, 4, {0.62}), 0), 0.9);
}

TEST(AspectDecision, ThreeViewsThatAgreeOnTheGroundMakeLessEnough) {
  const AspectAcceptance options;
  LinkedScene scene = Scene(3, 5, {options.even_on_ground});
  EXPECT_LT(Probability(scene, 0), 0.1);
  scene.agreement.ground = options.ground_agrees;
  EXPECT_NEAR(Probability(scene, 0), 0.5, 1e-9);
  LinkedScene pair = Scene(2, 2, {0.50});
  pair.agreement.ground = 0.9;
  EXPECT_LT(Probability(pair, 0), 0.5);  // two views adapt to a wrong part
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
  const double even = options.even_on_ground;
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
  EXPECT_NEAR(Probability(most, 0),
              Probability(Scene(6, 6, {options.even_alone - 0.5 * options.missing_views_more}), 0),
              1e-9);
  // Views that do not show it have no say.
  LinkedScene hidden = printed({0.9, 0.9, 0.9, 0.0, 0.0, 0.0}, even);
  for (int v = 3; v < 6; ++v) hidden.objects[0].shown[v] = false;
  EXPECT_NEAR(Probability(hidden, 0), 0.5, 1e-9);
}

TEST(AspectDecision, ViewsThatShowAnotherSurfaceAreNotBelieved) {
  LinkedScene scene = Scene(4, 4, {0.70});
  EXPECT_GT(Probability(scene, 0), 0.9);
  scene.agreement.surface.pairs = 12;
  scene.agreement.surface.mean = -0.05;
  EXPECT_LT(Probability(scene, 0), 0.2);
  scene.agreement.ground = 0.9;
  EXPECT_LT(Probability(scene, 0), 0.2);
  scene.agreement.surface.pairs = 0;  // a plain surface
  EXPECT_GT(Probability(scene, 0), 0.9);
}

TEST(AspectDecision, ATexturedGroundThatIsNotWhereTheCamerasSayContradicts) {
  const AspectAcceptance options;
  LinkedScene scene = Scene(5, 5, {0.61, 0.57, 0.55});  // was a wrong one: two parts, one twice
  scene.objects[2].object = 1;
  EXPECT_GT(Probability(scene, 0), 0.8);
  EXPECT_GT(Probability(scene, 1), 0.8);
  scene.agreement.texture = options.telling_texture;
  scene.agreement.ground = 0.05;
  EXPECT_LT(Probability(scene, 0), 0.1);
  EXPECT_LT(Probability(scene, 1), 0.1);
  LinkedScene sure = scene;
  sure.objects[0].score = 0.85;  // too much to be denied
  EXPECT_GT(Probability(sure, 0), 0.6);
  LinkedScene blank = scene, agreeing = scene, lying = scene;
  blank.agreement.texture = 3.0;
  EXPECT_GT(Probability(blank, 0), 0.8);
  agreeing.agreement.ground = options.ground_disagrees;
  EXPECT_GT(Probability(agreeing, 0), 0.8);
  LinkedScene three = scene;
  three.objects[2].object = 2;
  EXPECT_GT(Probability(three, 0), 0.8);
  EXPECT_GT(Probability(three, 1), 0.8);
  // The first of them stands on something.
  lying.objects[1].lies = lying.objects[2].lies = true;
  EXPECT_GT(Probability(lying, 0), 0.8);
  EXPECT_GT(Probability(lying, 1), 0.8);
}

TEST(AspectDecision, BesideASurePartLessIsEnough) {
  EXPECT_NEAR(Probability(Scene(4, 4, {0.60, AspectAcceptance().even_score}), 1), 0.5, 1e-9);
  EXPECT_LT(Probability(Scene(4, 4, {0.50, 0.46}), 1), 0.2);  // the first one is not sure
  EXPECT_LT(Probability(Scene(1, 4, {0.60, 0.50}), 1), 0.2);  // one view agrees with itself
}

// Poses were settled freely: few wrong ones lie on a plane.
TEST(AspectDecision, WhatLiesOnAPlaneWithASurePartNeedsLess) {
  const AspectAcceptance options;
  LinkedScene scene = Scene(4, 4, {0.60, options.even_lying});
  EXPECT_LT(Probability(scene, 1), 0.1);
  scene.objects[1].lies = true;
  EXPECT_NEAR(Probability(scene, 1), 0.5, 1e-9);
  LinkedScene unsure = Scene(4, 4, {0.50, 0.45});
  unsure.objects[1].lies = true;
  EXPECT_LT(Probability(unsure, 1), 0.2);
}

// What is level with the others stands on something that is no part.
TEST(AspectDecision, WhatIsLevelWithASurePartNeedsLessThanWhatLeans) {
  const AspectAcceptance options;
  LinkedScene scene = Scene(4, 4, {0.60, options.even_level});
  scene.objects[1].surface = options.surface_level;
  scene.objects[1].surface_pairs = options.surface_pairs;
  EXPECT_LT(Probability(scene, 1), 0.3);
  scene.objects[1].level = true;
  EXPECT_NEAR(Probability(scene, 1), 0.5, 1e-9);
  scene.objects[1].surface = 0.1;  // it is not where the views see it
  EXPECT_LT(Probability(scene, 1), 0.3);
}

// ... and less where the views agree on its surface, too; it is then no copy of the first that a
// wrong camera makes.
TEST(AspectDecision, ASurfaceThatViewsAgreeOnMakesLessEnoughOfWhatLies) {
  const AspectAcceptance options;
  LinkedScene scene = Scene(4, 4, {0.60, options.even_lying_surface});
  scene.objects[1].surface = options.surface_tells;
  scene.objects[1].surface_pairs = options.surface_pairs;
  EXPECT_LT(Probability(scene, 1), 0.1);  // it lies on nothing: wrong ones had .84
  scene.objects[1].lies = true;
  EXPECT_NEAR(Probability(scene, 1), 0.5, 1e-9);
  scene.objects[1].object = 0;
  EXPECT_NEAR(Probability(scene, 1), 0.5, 1e-9);
  scene.objects[1].surface_pairs = 2;  // two views agree on a wrong one, too
  EXPECT_LT(Probability(scene, 1), 0.1);
  scene.objects[1].surface_pairs = 12;
  scene.objects[0].score = 0.50;  // nothing is sure of the cameras
  EXPECT_LT(Probability(scene, 1), 0.1);
}

// The ground says that the cameras are right: what lies on it needs no surer part beside it.
TEST(AspectDecision, AGroundThatViewsAgreeOnIsAsGoodAsASurePart) {
  const AspectAcceptance options;
  LinkedScene scene = Scene(5, 5, {0.50, options.even_lying, options.even_score});
  scene.objects[1].lies = true;
  EXPECT_LT(Probability(scene, 1), 0.1);
  EXPECT_LT(Probability(scene, 2), 0.3);
  scene.agreement.ground = options.ground_agrees;
  EXPECT_NEAR(Probability(scene, 1), 0.5, 1e-9);
  EXPECT_NEAR(Probability(scene, 2), 0.5, 1e-9);
  LinkedScene two_views = Scene(2, 5, {0.50, 0.45});
  two_views.objects[1].lies = true;
  two_views.agreement.ground = 0.9;
  EXPECT_LT(Probability(two_views, 1), 0.2);
}

TEST(AspectDecision, ASecondOfAPartOnThePlaneOfSeveralIsOneOfThem) {
  LinkedScene scene = Scene(4, 4, {0.60, 0.57, 0.55, 0.51});
  scene.objects[3].object = 0;
  EXPECT_LT(Probability(scene, 3), 0.5);  // what a wrong camera makes of the first
  for (LinkedObject& o : scene.objects) o.lies = true;
  EXPECT_GT(Probability(scene, 3), 0.9);
  scene.objects[2].object = 1;  // two kinds of parts may both be wrong
  EXPECT_LT(Probability(scene, 3), 0.5);
}

TEST(AspectDecision, TwoPartsOnAPlaneBearEachOtherOutSooner) {
  LinkedScene two = Scene(4, 4, {0.53, 0.44});
  EXPECT_LT(Probability(two, 0), 0.6);
  two.objects[1].lies = true;
  EXPECT_GT(Probability(two, 0), 0.7);
  EXPECT_GT(Probability(two, 1), 0.9);
}

TEST(AspectDecision, WhatLeansWhereOthersLieMustSayMore) {
  const AspectAcceptance options;
  LinkedScene scene = Scene(5, 5, {0.72, 0.60, 0.55, 0.52});  // the last one was wrong
  EXPECT_GT(Probability(scene, 3), 0.7);
  for (int i = 0; i < 3; ++i) scene.objects[i].lies = true;
  EXPECT_GT(Probability(scene, 3), 0.7);  // it is level: on something that is not known
  scene.objects[3].leans = true;
  EXPECT_LT(Probability(scene, 3), 0.5);
  EXPECT_GT(Probability(scene, 1), 0.9);
  scene.objects[3].score = options.even_leaning + 0.05;
  EXPECT_GT(Probability(scene, 3), 0.6);
  scene.objects[3].score = 0.52;
  scene.objects[1].lies = scene.objects[2].lies = false;  // one alone gives no plane
  EXPECT_GT(Probability(scene, 3), 0.7);
}

// Cameras that adapted to a wrong part leave nothing for a second one.
TEST(AspectDecision, TwoPartsOnAPlaneOnWhoseSurfaceViewsAgreeAreCompany) {
  const AspectAcceptance options;
  LinkedScene scene = Scene(4, 5, {0.50, 0.48});  // two right ones on granite
  for (LinkedObject& o : scene.objects) o.lies = true;
  EXPECT_LT(Probability(scene, 0), 0.5);
  scene.agreement.surface.pairs = 12;
  scene.agreement.surface.mean = 0.96;
  EXPECT_NEAR(Probability(scene, 0), options.company_probability, 1e-9);
  EXPECT_NEAR(Probability(scene, 1), options.company_probability, 1e-9);
  LinkedScene other = scene;
  other.objects[1].lies = false;
  EXPECT_LT(Probability(other, 1), 0.5);
  other = scene;
  other.objects[1].object = other.objects[0].object;  // what a wrong camera makes of the first
  EXPECT_LT(Probability(other, 0), 0.5);
  other = scene;
  other.objects[1].score = options.pair_lying - 0.01;
  EXPECT_LT(Probability(other, 0), 0.5);
  other = scene;
  other.views[2].reset(), other.views[3].reset();  // two views adapt to wrong parts
  EXPECT_LT(Probability(other, 0), 0.5);
}

TEST(AspectDecision, TwoPartsThatAgreeOnThreeViewsBearEachOtherOut) {
  const LinkedScene two = Scene(4, 5, {0.53, 0.50});
  EXPECT_LT(Probability(Scene(4, 5, {0.53}), 0), 0.6);
  EXPECT_GT(Probability(two, 0), 0.75);
  EXPECT_GT(Probability(two, 1), 0.6);
  EXPECT_LT(Probability(Scene(2, 4, {0.53, 0.50}), 0), 0.3);  // of two views anything can be made
  EXPECT_LT(Probability(Scene(4, 4, {0.49, 0.49}), 0), 0.3);  // neither says enough
  EXPECT_LT(Probability(Scene(4, 4, {0.53, 0.44}), 0), 0.6);  // the second one does not
  // Photographs of tools: focal lengths by which a turned part fits.
  EXPECT_LT(Probability(Scene(4, 4, {0.53, 0.50}, {800.0, 1050.0}), 0), 0.6);
  LinkedScene same = two;
  same.objects[1].object = same.objects[0].object;  // what a wrong camera makes of the first
  EXPECT_LT(Probability(same, 0), 0.6);
  EXPECT_LT(Probability(same, 1), 0.5);
}

TEST(AspectDecision, ThreePartsThatAgreeOnThreeViewsMayEachSayLess) {
  const LinkedScene three = Scene(6, 6, {0.49, 0.48, 0.45});
  for (int i = 0; i < 3; ++i) EXPECT_GT(Probability(three, i), 0.6) << i;
  EXPECT_LT(Probability(Scene(2, 4, {0.49, 0.48, 0.45}), 0), 0.4);
  EXPECT_LT(Probability(Scene(6, 6, {0.49, 0.48, 0.43}), 0), 0.4);
  EXPECT_LT(Probability(Scene(6, 6, {0.46, 0.45, 0.45}), 0), 0.4);
  EXPECT_LT(Probability(Scene(6, 6, {0.49, 0.48, 0.45}, {800.0, 1050.0}), 0), 0.4);
  LinkedScene same = three;
  same.objects[2].object = same.objects[1].object;
  EXPECT_LT(Probability(same, 0), 0.4);
}

// On granite no part says much: scores of two scenes whose parts were all right.
TEST(AspectDecision, ThreePartsOnAPlaneBearEachOtherOut) {
  LinkedScene lying = Scene(4, 4, {0.45, 0.43, 0.41, 0.40});
  for (int i = 0; i < 4; ++i) EXPECT_LT(Probability(lying, i), 0.3) << i;
  for (LinkedObject& o : lying.objects) o.lies = true;
  for (int i = 0; i < 4; ++i) {
    EXPECT_GT(Probability(lying, i), 0.8) << i;
    EXPECT_LE(Probability(lying, i), AspectAcceptance().company_probability) << i;
  }
  LinkedScene two_views = Scene(2, 4, {0.45, 0.43, 0.41, 0.40});
  for (LinkedObject& o : two_views.objects) o.lies = true;
  EXPECT_LT(Probability(two_views, 0), 0.3);
  lying.objects[3].lies = false;  // three do
  EXPECT_GT(Probability(lying, 0), 0.8);
  EXPECT_LT(Probability(lying, 3), 0.3);
  lying.objects[2].lies = false;  // two do
  EXPECT_LT(Probability(lying, 0), 0.3);
  lying.objects[2].lies = true;
  lying.objects[2].object = lying.objects[1].object;  // a wrong part thrice lies on itself
  EXPECT_LT(Probability(lying, 0), 0.3);
}

TEST(AspectDecision, FocalLengthsThatDifferMuchAskForMore) {
  EXPECT_LT(Probability(Scene(4, 4, {0.56}, {500.0, 1400.0}), 0),
            Probability(Scene(4, 4, {0.56}), 0) - 0.2);
}

TEST(AspectDecision, MoreScoreIsNeverLessSure) {
  for (const int registered : {1, 2, 3, 4}) {
    double before = 0.0;
    for (double score = 0.0; score <= 1.0; score += 0.01) {
      const double now = Probability(Scene(registered, 4, {score}), 0);
      EXPECT_GE(now, before) << registered << " views, score " << score;
      before = now;
    }
  }
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
