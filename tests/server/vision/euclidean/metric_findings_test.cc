// What a metric scene must say of itself: typed, never a silently bent scene.
#include <gtest/gtest.h>

#include <Eigen/Geometry>
#include <iostream>

#include "server/vision/euclidean/euclidean.h"
#include "server/vision/euclidean/representative.h"
#include "tests/support/synthetic_metric_scene.h"
#include "tests/support/synthetic_part.h"

namespace horopter {
namespace {

using Part = std::shared_ptr<const PreparedObject>;

Part Bracket() {
  static const Part part = PrepareObject(LBracket()).value();
  return part;
}
Part WedgePart() {
  static const Part part = PrepareObject(Wedge()).value();
  return part;
}
Part StepPart() {
  static const Part part =
      PrepareObject(Prism("step", {{0, 0}, {0.05, 0}, {0.05, 0.04}, {0.02, 0.055}}, 0.06)).value();
  return part;
}

const Finding* Find(const MetricScene& metric, FindingKind kind) {
  for (const Finding& f : metric.findings) {
    if (f.kind == kind) return &f;
  }
  return nullptr;
}

MetricSceneOptions Options(std::vector<Part> parts, unsigned seed) {
  MetricSceneOptions options;
  options.parts = std::move(parts);
  options.seed = seed;
  return options;
}

TEST(Findings, AGoodSceneHasNone) {
  for (unsigned seed = 1; seed <= 4; ++seed) {
    const auto truth = MakeMetricScene(Options({Bracket(), WedgePart(), StepPart()}, seed));
    const auto metric = RefineMetricScene(truth.Input(), truth.recognition, {});
    ASSERT_TRUE(metric.ok()) << metric.status();
    for (const Finding& f : metric->findings) {
      // Small parts may leave a focal length open; that is for the covariance to say.
      EXPECT_EQ(f.kind, FindingKind::kFocalAndDepth) << "seed " << seed << ": " << f.detail;
    }
    EXPECT_EQ(metric->scales.size(), 3u);
    for (const ScaleSource& s : metric->scales) EXPECT_TRUE(s.agrees);
  }
}

TEST(Findings, OneObjectAloneIsNamed) {
  const auto truth = MakeMetricScene(Options({Bracket()}, 5));
  const auto metric = RefineMetricScene(truth.Input(), truth.recognition, {});
  ASSERT_TRUE(metric.ok());
  EXPECT_NE(Find(*metric, FindingKind::kSingleObject), nullptr);
}

TEST(Findings, OnlySymmetricObjectsLeaveTheFrameOpen) {
  ObjectModel square = Prism("square", {{0, 0}, {0.05, 0}, {0.05, 0.05}, {0, 0.05}}, 0.03);
  const Eigen::Vector3d c(0.025, 0.025, 0.0);
  for (int i = 1; i < 4; ++i) {
    const Eigen::Matrix3d R = RotationFromVector({0, 0, 0.5 * M_PI * i});
    square.symmetries.push_back({R, c - R * c});
  }
  const Part part = PrepareObject(square).value();
  const auto truth = MakeMetricScene(Options({part, part}, 6));
  const auto metric = RefineMetricScene(truth.Input(), truth.recognition, {});
  ASSERT_TRUE(metric.ok());
  const Finding* f = Find(*metric, FindingKind::kFrameBySymmetry);
  ASSERT_NE(f, nullptr);
  EXPECT_EQ(f->value, 4.0);
}

// A part a quarter as far off as it is wide, among two right ones. Where enough of its edges lie
// near their places the adjustment pulls it right; it must not stay wrong.
TEST(Findings, AFalseHypothesisAmongThreeIsThrownOutOrPutRight) {
  int thrown_out = 0, put_right = 0;
  for (unsigned seed = 1; seed <= 5; ++seed) {
    for (int wrong = 0; wrong < 3; ++wrong) {
      auto truth = MakeMetricScene(Options({Bracket(), WedgePart(), StepPart()}, 40 + seed));
      Rigid3& pose = truth.recognition.objects[wrong].scene_from_object;
      pose.R = pose.R * RotationFromVector({0, 0, 0.35});
      pose.t += Eigen::Vector3d(0.006, -0.005, 0.0);
      const auto metric = RefineMetricScene(truth.Input(), truth.recognition, {});
      ASSERT_TRUE(metric.ok()) << metric.status();
      const Finding* f = Find(*metric, FindingKind::kObjectRejected);
      thrown_out += f != nullptr;
      put_right += f == nullptr;
      EXPECT_TRUE(f == nullptr || f->object == wrong) << "seed " << seed << " object " << wrong;
      // What is answered is as if it had never been wrong.
      ASSERT_EQ(metric->objects.size(), f != nullptr ? 2u : 3u);
      const int a = metric->objects[0].object;
      for (std::size_t k = 1; k < metric->objects.size(); ++k) {
        const int b = metric->objects[k].object;
        const Rigid3 expected = truth.world_from_object[a].Inverse() * truth.world_from_object[b];
        const Vector6d off = PerturbationBetween(expected, metric->objects[k].scene_from_object);
        EXPECT_LT(off.tail<3>().norm(), 0.003) << "seed " << seed << " object " << wrong;
        EXPECT_LT(off.head<3>().norm(), 0.02) << "seed " << seed << " object " << wrong;
      }
    }
  }
  std::cout << thrown_out << " of 15 thrown out, " << put_right << " put right\n";
  EXPECT_GE(thrown_out, 10);
}

// Enrolled 6 % too large: placed so that it looks right in the middle view.
MetricSceneTruth WithScaledPart(int wrong, double factor, unsigned seed, std::vector<Part> parts) {
  auto truth = MakeMetricScene(Options(std::move(parts), seed));
  const Part enrolled = PrepareObject(Scaled(truth.objects[wrong]->model, factor)).value();
  truth.objects[wrong] = enrolled;
  // Recognition puts it where it fits best on the same plane: about its own middle.
  Rigid3& pose = truth.recognition.objects[wrong].scene_from_object;
  const Eigen::Vector3d middle = enrolled->center / factor;
  pose.t += pose.R * (middle - enrolled->center);
  return truth;
}

TEST(Findings, AScaledCopyOfAPartIsNamedByTheOthers) {
  for (unsigned seed = 1; seed <= 4; ++seed) {
    const auto truth = WithScaledPart(1, 1.03, 60 + seed, {Bracket(), WedgePart(), StepPart()});
    const auto metric = RefineMetricScene(truth.Input(), truth.recognition, {});
    ASSERT_TRUE(metric.ok());
    const Finding* f = Find(*metric, FindingKind::kScaleConflict);
    if (f == nullptr) {
      for (const ScaleSource& x : metric->scales)
        std::cout << "seed " << seed << " object " << x.index << " log ratio " << x.log_ratio
                  << " +- " << x.log_sigma << "\n";
      for (const Finding& x : metric->findings) std::cout << x.detail << "\n";
    }
    ASSERT_NE(f, nullptr) << "seed " << seed;
    EXPECT_EQ(f->object, 1);
    EXPECT_NEAR(f->value, -std::log(1.03), 0.015);
  }
}

TEST(Findings, TwoObjectsThatDisagreeAreBothNamed) {
  const auto truth = WithScaledPart(1, 1.03, 70, {Bracket(), WedgePart()});
  const auto metric = RefineMetricScene(truth.Input(), truth.recognition, {});
  ASSERT_TRUE(metric.ok());
  int named = 0;
  for (const Finding& f : metric->findings) named += f.kind == FindingKind::kScaleConflict;
  EXPECT_EQ(named, 2);
}

TEST(Findings, TheTurnOfASurfaceOfRevolutionIsNamedWithItsAxis) {
  const auto truth =
      MakeMetricScene(Options({Bracket(), PrepareObject(Cylinder(0.02, 0.05)).value()}, 8));
  const auto metric = RefineMetricScene(truth.Input(), truth.recognition, {});
  ASSERT_TRUE(metric.ok());
  const Finding* f = Find(*metric, FindingKind::kTurnUndetermined);
  ASSERT_NE(f, nullptr);
  EXPECT_EQ(f->object, 1);
  EXPECT_GT(std::abs(f->direction.z()), 0.98);
  EXPECT_GT(f->value, 1.0);
}

Part Bar(double half_m) {
  return PrepareObject(
             Prism("bar",
                   {{-half_m, -0.015}, {half_m, -0.015}, {half_m, 0.015}, {-half_m, 0.015}},
                   0.02))
      .value();
}

// Straight edges tell nothing along themselves, also through a lens that seems to bend them, and
// also where a sample of an end that no image shows finds something by chance (1011, 1056, 1095).
TEST(Findings, ABarThatNoImageEndsSlidesAlongItself) {
  const Part bar = Bar(1.0);
  for (const unsigned seed : {1000u, 1001u, 1002u, 1003u, 1011u, 1056u, 1095u}) {
    MetricSceneOptions options = Options({bar}, seed);
    options.start_turn_rad = 0.0005;
    const auto truth = MakeMetricScene(options);
    const auto metric = RefineMetricScene(truth.Input(), truth.recognition, {});
    ASSERT_TRUE(metric.ok()) << metric.status();
    const Finding* f = Find(*metric, FindingKind::kShiftUndetermined);
    ASSERT_NE(f, nullptr) << "seed " << seed;
    EXPECT_GT(std::abs(f->direction.x()), 0.99) << "seed " << seed;
    EXPECT_GT(f->value, 1.0) << "seed " << seed;
  }
}

TEST(Findings, ABarWhoseEndsAreSeenDoesNotSlide) {
  const Part bar = Bar(0.1);
  for (unsigned seed = 1000; seed < 1006; ++seed) {
    const auto truth = MakeMetricScene(Options({bar}, seed));
    const auto metric = RefineMetricScene(truth.Input(), truth.recognition, {});
    ASSERT_TRUE(metric.ok()) << metric.status();
    EXPECT_EQ(Find(*metric, FindingKind::kShiftUndetermined), nullptr) << "seed " << seed;
  }
}

TEST(Findings, ASmallPartInANarrowViewLeavesTheFocalLengthOpen) {
  MetricSceneOptions options = Options({PrepareObject(Scaled(LBracket(), 0.5)).value()}, 9);
  options.min_focal_widths = 4.0;
  options.max_focal_widths = 5.0;
  options.distance_m = 2.0;
  options.table = false;
  const auto truth = MakeMetricScene(options);
  const auto metric = RefineMetricScene(truth.Input(), truth.recognition, {});
  ASSERT_TRUE(metric.ok());
  EXPECT_NE(Find(*metric, FindingKind::kFocalAndDepth), nullptr);
}

TEST(RepresentativePose, IsTheSameForAllEquivalentPoses) {
  ObjectModel square = Prism("square", {{0, 0}, {0.05, 0}, {0.05, 0.05}, {0, 0.05}}, 0.03);
  const Eigen::Vector3d c(0.025, 0.025, 0.0);
  for (int i = 1; i < 4; ++i) {
    const Eigen::Matrix3d R = RotationFromVector({0, 0, 0.5 * M_PI * i});
    square.symmetries.push_back({R, c - R * c});
  }
  const ObjectModel round = Cylinder(0.02, 0.05);
  std::mt19937 rng(10);
  std::normal_distribution<double> n;
  for (int i = 0; i < 200; ++i) {
    const Rigid3 pose{
        Eigen::Quaterniond(n(rng), n(rng), n(rng), n(rng)).normalized().toRotationMatrix(),
        {0.1, 0.2, 0.7}};
    const Rigid3 expected = RepresentativePose(square, pose);
    for (const Rigid3& S : square.symmetries) {
      EXPECT_LT(PerturbationBetween(RepresentativePose(square, pose * S), expected).norm(), 1e-9);
    }
    const Rigid3 any{RotationFromVector({0, 0, n(rng)}), {0, 0, 0}};
    EXPECT_LT(
        PerturbationBetween(RepresentativePose(round, pose * any), RepresentativePose(round, pose))
            .norm(),
        1e-9);
  }
}

TEST(SupportingPlane, IsTheTableWithAndWithoutTexture) {
  for (const bool table : {true, false}) {
    MetricSceneOptions options = Options({Bracket(), WedgePart(), StepPart()}, 12);
    options.table = table;
    const auto truth = MakeMetricScene(options);
    const auto metric = RefineMetricScene(truth.Input(), truth.recognition, {});
    ASSERT_TRUE(metric.ok());
    ASSERT_TRUE(metric->plane.has_value()) << table;
    // The scene frame is the first part's, which stands upright.
    EXPECT_GT(metric->plane->normal.z(), 0.999);
    EXPECT_NEAR(metric->plane->offset_m, 0.0, 0.0015);
  }
}

}  // namespace
}  // namespace horopter
