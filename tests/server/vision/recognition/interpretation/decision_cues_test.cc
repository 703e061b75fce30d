// The cues of the decision, and what their weights make of them.
#include "server/vision/recognition/interpretation/decision_cues.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <random>
#include <string>

#include "server/vision/recognition/interpretation/aspect_decision.h"
#include "server/vision/recognition/interpretation/log_odds.h"

namespace horopter {
namespace {

constexpr int kViews = 4;

// A part whose edges are found to this share, in all views.
LinkedObject Part(int object, double share) {
  LinkedObject o;
  o.object = object;
  o.precision = o.score = share;
  AspectScore s;
  s.precision = s.recall = s.score = share;
  s.support_px = 1000.0 * share;
  s.visible_px = 1000.0;
  o.views.assign(kViews, s);
  o.shown.assign(kViews, true);
  return o;
}

// `registered` of four views, parts best first.
LinkedScene Scene(int registered, std::vector<LinkedObject> objects) {
  LinkedScene scene;
  scene.views.resize(kViews);
  for (int v = 0; v < registered; ++v) {
    scene.views[v].emplace();
    scene.views[v]->camera.focal_px = 800.0;
  }
  scene.objects = std::move(objects);
  return scene;
}

double Cue(const DecisionCues& cues, std::string_view name) {
  const auto& names = CueNames();
  const auto at = std::find(names.begin(), names.end(), name);
  EXPECT_NE(at, names.end()) << name;
  return cues[at - names.begin()];
}

double Probability(const LinkedScene& scene, std::size_t object) {
  return AspectProbability(scene.objects[object], scene, {});
}

TEST(DecisionCues, AreThoseOfTheSceneTheyStandIn) {
  LinkedScene scene = Scene(3, {Part(0, 0.8), Part(1, 0.6), Part(0, 0.5)});
  scene.objects[1].lies = scene.objects[1].level = true;
  scene.objects[1].views[2].support_px = 300.0;
  scene.objects[1].views[3].support_px = 5.0;
  scene.objects[1].shown[3] = false;
  scene.objects[1].surface_pairs = 6;
  scene.agreement.ground = 0.7;
  const DecisionCues first = CuesOf(scene.objects[0], scene);
  const DecisionCues second = CuesOf(scene.objects[1], scene);
  const DecisionCues again = CuesOf(scene.objects[2], scene);
  EXPECT_EQ(Cue(first, "first"), 1.0);
  EXPECT_EQ(Cue(second, "first"), 0.0);
  EXPECT_EQ(Cue(again, "first"), 0.0);
  EXPECT_DOUBLE_EQ(Cue(first, "first_other"), 0.6);  // not the same part's second
  EXPECT_EQ(Cue(second, "first_other"), 0.0);
  EXPECT_DOUBLE_EQ(Cue(first, "ground"), 0.7);
  EXPECT_DOUBLE_EQ(Cue(first, "first_ground"), 0.4);
  EXPECT_EQ(Cue(second, "first_ground"), 0.0);
  EXPECT_DOUBLE_EQ(Cue(first, "missing"), 0.25);
  EXPECT_EQ(Cue(first, "one"), 0.0);
  EXPECT_EQ(Cue(second, "lies"), 1.0);
  EXPECT_EQ(Cue(second, "level"), 0.0);                                  // it does more
  EXPECT_DOUBLE_EQ(Cue(second, "log_support"), std::log(500.0 + 50.0));  // of those that show it
  EXPECT_EQ(Cue(first, "surface_seen"), 0.0);
  EXPECT_EQ(Cue(second, "surface_seen"), 1.0);
  scene.views[1].reset();
  EXPECT_EQ(Cue(CuesOf(scene.objects[0], scene), "first_ground"), 0.0);  // two views agree on all
  scene.views[2].reset();
  EXPECT_EQ(Cue(CuesOf(scene.objects[0], scene), "one"), 1.0);
}

TEST(DecisionCues, OfAnObjectThatNoViewShowsAreFinite) {
  LinkedScene scene = Scene(0, {LinkedObject{}});
  for (const double cue : CuesOf(scene.objects[0], scene)) EXPECT_TRUE(std::isfinite(cue));
  scene.views.clear();
  for (const double cue : CuesOf(scene.objects[0], scene)) EXPECT_TRUE(std::isfinite(cue));
  EXPECT_LT(Probability(scene, 0), 0.01);
}

TEST(FittedDecision, MoreOfItsEdgesMakeAPartLikelier) {
  double last = 0.0;
  for (const double share : {0.2, 0.4, 0.6, 0.8, 0.95}) {
    const double p = Probability(Scene(4, {Part(0, share)}), 0);
    EXPECT_GT(p, last) << share;
    last = p;
  }
  EXPECT_LT(Probability(Scene(4, {Part(0, 0.35)}), 0), 0.1);
  EXPECT_GT(Probability(Scene(4, {Part(0, 0.9)}), 0), 0.9);
}

TEST(FittedDecision, ImagesThatAreNotLinkedSpeakAgainst) {
  EXPECT_GT(Probability(Scene(4, {Part(0, 0.7)}), 0), Probability(Scene(2, {Part(0, 0.7)}), 0));
  EXPECT_GT(Probability(Scene(2, {Part(0, 0.7)}), 0), Probability(Scene(1, {Part(0, 0.7)}), 0));
}

TEST(FittedDecision, PartsThatLieTogetherBearEachOtherOut) {
  const LinkedScene alone = Scene(4, {Part(0, 0.6), Part(1, 0.42)});
  LinkedScene lying = alone;
  lying.objects[1].lies = true;
  EXPECT_GT(Probability(lying, 1), Probability(alone, 1));
  EXPECT_GT(Probability(alone, 0), Probability(Scene(4, {Part(0, 0.6)}), 0));
}

// Numbers of parts are places in the catalog: another order of it changes nothing.
TEST(FittedDecision, DoesNotAskForTheOrderOfTheCatalog) {
  const unsigned seed = 5;
  std::mt19937 rng(seed);
  std::uniform_real_distribution<double> share(0.25, 0.9);
  std::vector<LinkedObject> parts;
  for (int k = 0; k < 6; ++k) parts.push_back(Part(k, share(rng)));
  std::sort(
      parts.begin(), parts.end(), [](const auto& a, const auto& b) { return a.score > b.score; });
  const LinkedScene scene = Scene(4, parts);
  std::vector<int> renamed = {3, 5, 0, 1, 4, 2};
  LinkedScene other = scene;
  for (LinkedObject& o : other.objects) o.object = renamed[o.object];
  for (std::size_t i = 0; i < parts.size(); ++i)
    EXPECT_EQ(Probability(scene, i), Probability(other, i)) << "seed " << seed;
}

TEST(FittedDecision, PrintThatStaysInItsPlaceMakesLessEnough) {
  const AspectAcceptance options;
  LinkedScene scene = Scene(4, {Part(0, options.even_printed + 0.1)});
  const double plain = Probability(scene, 0);
  for (AspectScore& s : scene.objects[0].views) s.print = 0.9;
  EXPECT_GE(Probability(scene, 0), plain);
  EXPECT_GT(Probability(scene, 0), options.min_probability);
}

}  // namespace
}  // namespace horopter
