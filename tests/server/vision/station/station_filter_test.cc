#include "server/vision/station/station_filter.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <Eigen/Geometry>
#include <cmath>

#include "tests/support/synthetic_rig.h"

namespace horopter {
namespace {

// Evidence as sure as it says, nothing forgotten: then the filter must be exact.
StationOptions Exact() {
  StationOptions options;
  options.remembered = 1.0;
  options.widening = 1.0;
  options.linear_log_focal = 1e3;  // this evidence is linear everywhere
  return options;
}

StationState Learn(const SyntheticRig& rig,
                   const StationViews& views,
                   int requests,
                   double noise,
                   const StationOptions& options,
                   unsigned seed,
                   StationState state) {
  std::mt19937 rng(seed);
  for (int r = 0; r < requests; ++r) {
    const CameraEvidence evidence = SayOf(rig, views, noise, &rng);
    state = UpdateStation(
        std::move(state), views, evidence, TestStation(state, views, evidence, options), options);
  }
  return state;
}

const StationChange* FindChange(const StationTest& test, StationChangeKind kind, int camera) {
  for (const StationChange& c : test.changes) {
    if (c.kind == kind && std::find(c.cameras.begin(), c.cameras.end(), camera) != c.cameras.end())
      return &c;
  }
  return nullptr;
}

TEST(CameraGroup, DerivativesAreThoseOfDifferences) {
  const SyntheticRig rig = MakeSyntheticRig(3, 1);
  std::mt19937 rng(5);
  const CameraGroup group = SayOf(rig, {0, 1, 2}, 1.0, &rng).group;
  std::vector<AdjustedView> views;
  for (int c = 0; c < 3; ++c) views.push_back({true, rig.cameras[c], rig.poses[c]});
  const Eigen::MatrixXd J = GroupJacobian(group, views);
  constexpr double kStep = 1e-6;
  for (int v = 0; v < 3; ++v) {
    for (int i = 0; i < 6; ++i) {
      const auto moved = [&](double step) {
        std::vector<AdjustedView> m = views;
        m[v].camera_from_scene = Perturbed(m[v].camera_from_scene, step * Vector6d::Unit(i));
        return GroupOffset(group, m);
      };
      const Eigen::VectorXd by = (moved(kStep) - moved(-kStep)) / (2.0 * kStep);
      // The offset from a group that is 1e-3 away turns its axes by as much.
      EXPECT_LT((by - J.col(kGroupParameters * v + i)).norm(), 0.01) << v << " " << i;
    }
  }
}

TEST(StationFilter, EllipsoidsHoldTheTruthAtEveryNoise) {
  for (const double noise : {0.3, 1.0, 2.0}) {
    int lens_in = 0, place_in = 0, lenses = 0, places = 0;
    for (unsigned seed = 1; seed <= 60; ++seed) {
      const SyntheticRig rig = MakeSyntheticRig(3, seed);
      const StationState state =
          Learn(rig, {0, 1, 2}, 8, noise, Exact(), 100 + seed, FreshStation(rig, Exact()));
      for (int c = 0; c < 3; ++c) {
        const PinholeCamera &has = state.cameras[c].camera, &is = rig.cameras[c];
        const Eigen::Vector4d d(
            std::log(has.focal_px / is.focal_px), has.cx - is.cx, has.cy - is.cy, has.k1 - is.k1);
        const Eigen::Matrix4d P = state.covariance.block<4, 4>(10 * c + 6, 10 * c + 6);
        lens_in += d.dot(P.ldlt().solve(d)) <= 9.488;
        ++lenses;
        ASSERT_TRUE(state.cameras[c].posed);
        if (c == 0) continue;  // holds the frame
        const Vector6d off = PerturbationBetween(rig.poses[c] * rig.poses[0].Inverse(),
                                                 state.cameras[c].camera_from_rig);
        const Matrix6d Q = state.covariance.block<6, 6>(10 * c, 10 * c);
        place_in += off.dot(Q.ldlt().solve(off)) <= 12.592;
        ++places;
      }
    }
    const double lens = 100.0 * lens_in / lenses, place = 100.0 * place_in / places;
    EXPECT_GE(lens, 90.0) << "noise " << noise;
    EXPECT_GE(place, 90.0) << "noise " << noise;
    RecordProperty("lens_" + std::to_string(noise), std::to_string(lens));
  }
}

TEST(StationFilter, NothingIsCountedTwice) {
  const SyntheticRig rig = MakeSyntheticRig(2, 3);
  const StationOptions options = Exact();
  std::mt19937 rng(7);
  const CameraEvidence once = SayOf(rig, {0, 1}, 0.5, &rng);
  StationTest agreed;
  const StationState first =
      UpdateStation(FreshStation(rig, options), {0, 1}, once, agreed, options);
  const StationState second = UpdateStation(first, {0, 1}, once, agreed, options);
  // Twice the information of the data, and once that of any camera: less than half the variance is
  // gone where the data say little, just half where they say all.
  for (int i = 6; i < 10; ++i) {
    EXPECT_GE(second.covariance(i, i), 0.499 * first.covariance(i, i)) << i;
    EXPECT_LT(second.covariance(i, i), first.covariance(i, i)) << i;
  }
  EXPECT_EQ(second.requests, 2);
  EXPECT_EQ(second.cameras[1].requests, 2);
}

TEST(StationFilter, TheOrderOfRequestsDoesNotMatter) {
  const SyntheticRig rig = MakeSyntheticRig(3, 4);
  StationOptions options = Exact();
  std::mt19937 rng(8);
  const StationViews views = {0, 1, 2};
  StationState state = Learn(rig, views, 4, 1.0, options, 2, FreshStation(rig, options));
  const CameraEvidence a = SayOf(rig, views, 1.0, &rng), b = SayOf(rig, views, 1.0, &rng);
  const StationTest agreed;
  const StationState ab =
      UpdateStation(UpdateStation(state, views, a, agreed, options), views, b, agreed, options);
  const StationState ba =
      UpdateStation(UpdateStation(state, views, b, agreed, options), views, a, agreed, options);
  for (int c = 0; c < 3; ++c) {
    EXPECT_NEAR(ab.cameras[c].camera.focal_px, ba.cameras[c].camera.focal_px, 0.02);
    EXPECT_NEAR(ab.cameras[c].camera.cx, ba.cameras[c].camera.cx, 0.05);
    EXPECT_LT(
        PerturbationBetween(ab.cameras[c].camera_from_rig, ba.cameras[c].camera_from_rig).norm(),
        1e-4);
  }
}

TEST(StationTestOf, FalseAlarmsAreRare) {
  const StationOptions options;
  int alarms = 0, requests = 0;
  for (unsigned seed = 1; seed <= 12; ++seed) {
    const SyntheticRig rig = MakeSyntheticRig(4, seed);
    std::mt19937 rng(1000 + seed);
    StationState state = FreshStation(rig, options);
    for (int r = 0; r < 42; ++r, ++requests) {
      const CameraEvidence evidence = SayOf(rig, {0, 1, 2, 3}, 0.3 + 0.1 * (r % 10), &rng);
      const StationTest test = TestStation(state, {0, 1, 2, 3}, evidence, options);
      alarms += !test.agrees;
      state = UpdateStation(state, {0, 1, 2, 3}, evidence, test, options);
    }
  }
  EXPECT_EQ(requests, 504);
  EXPECT_LE(alarms, 1);
}

TEST(StationTestOf, SaysWhichCameraMovedAndByHowMuch) {
  const StationOptions options;
  int alarmed = 0, named = 0;
  constexpr int kSeeds = 40;
  for (unsigned seed = 1; seed <= kSeeds; ++seed) {
    SyntheticRig rig = MakeSyntheticRig(4, seed);
    const StationState state =
        Learn(rig, {0, 1, 2, 3}, 10, 0.5, options, seed, FreshStation(rig, options));
    const int c = static_cast<int>(seed % 4);
    std::mt19937 rng(seed);
    const Eigen::Vector3d axis = NormalVector(3, &rng).normalized();
    rig.poses[c] = Rigid3{Eigen::AngleAxisd(0.0087, axis).toRotationMatrix(),
                          Eigen::Vector3d(0.004, 0.0, 0.0)} *
                   rig.poses[c];
    const StationTest test =
        TestStation(state, {0, 1, 2, 3}, SayOf(rig, {0, 1, 2, 3}, 0.4, &rng), options);
    alarmed += !test.agrees;
    const StationChange* found = FindChange(test, StationChangeKind::kMoved, c);
    if (found == nullptr) continue;
    ++named;
    EXPECT_NEAR(found->turn_rad, 0.0087, 0.007) << "seed " << seed;
  }
  EXPECT_GE(alarmed, 0.95 * kSeeds);
  EXPECT_GE(named, 0.8 * kSeeds);
}

TEST(StationTestOf, SaysWhichLensChangedAndByHowMuch) {
  const StationOptions options;
  int named = 0;
  constexpr int kSeeds = 40;
  for (unsigned seed = 1; seed <= kSeeds; ++seed) {
    SyntheticRig rig = MakeSyntheticRig(4, seed);
    const StationState state =
        Learn(rig, {0, 1, 2, 3}, 10, 0.5, options, seed, FreshStation(rig, options));
    const int c = static_cast<int>(seed % 4);
    std::mt19937 rng(seed);
    rig.cameras[c].focal_px *= std::exp(0.02);
    const StationTest test =
        TestStation(state, {0, 1, 2, 3}, SayOf(rig, {0, 1, 2, 3}, 0.4, &rng), options);
    const StationChange* found = FindChange(test, StationChangeKind::kLens, c);
    if (found == nullptr) continue;
    ++named;
    EXPECT_NEAR(found->log_focal, 0.02, 0.012) << "seed " << seed;
  }
  EXPECT_GE(named, 0.95 * kSeeds);
}

TEST(StationTestOf, SaysThatCamerasAreSwappedAndLearnsNothingOfIt) {
  const StationOptions options;
  const SyntheticRig rig = MakeSyntheticRig(3, 9);
  const StationState state = Learn(rig, {0, 1, 2}, 10, 0.5, options, 3, FreshStation(rig, options));
  std::mt19937 rng(4);
  const CameraEvidence evidence = SayOf(rig, {1, 0, 2}, 0.5, &rng);
  const StationTest test = TestStation(state, {0, 1, 2}, evidence, options);
  ASSERT_EQ(test.changes.size(), 1u);
  EXPECT_EQ(test.changes[0].kind, StationChangeKind::kSwapped);
  EXPECT_THAT(test.changes[0].cameras, testing::UnorderedElementsAre(0, 1));
  const StationState after = UpdateStation(state, {0, 1, 2}, evidence, test, options);
  EXPECT_EQ(after.covariance, state.covariance);
  EXPECT_EQ(after.requests, state.requests);
}

TEST(StationTestOf, OfTwoCamerasNobodyKnowsWhichOneMoved) {
  const StationOptions options;
  SyntheticRig rig = MakeSyntheticRig(2, 9);
  const StationState state = Learn(rig, {0, 1}, 10, 0.3, options, 3, FreshStation(rig, options));
  std::mt19937 rng(4);
  rig.poses[0].t.x() += 0.03;
  const StationTest test = TestStation(state, {0, 1}, SayOf(rig, {0, 1}, 0.3, &rng), options);
  ASSERT_EQ(test.changes.size(), 1u);
  EXPECT_EQ(test.changes[0].kind, StationChangeKind::kMoved);
  EXPECT_THAT(test.changes[0].cameras, testing::UnorderedElementsAre(0, 1));
}

TEST(StationFilter, LearnsAMovedCameraAnewAndKeepsTheOthers) {
  const StationOptions options;
  SyntheticRig rig = MakeSyntheticRig(4, 5);
  StationState state = Learn(rig, {0, 1, 2, 3}, 10, 0.5, options, 1, FreshStation(rig, options));
  rig.poses[2] = Rigid3{Eigen::AngleAxisd(0.3, Eigen::Vector3d::UnitY()).toRotationMatrix(),
                        Eigen::Vector3d(0.1, 0, 0)} *
                 rig.poses[2];
  state = Learn(rig, {0, 1, 2, 3}, 6, 0.5, options, 2, std::move(state));
  EXPECT_EQ(state.cameras[2].requests, 16);  // its lens was not forgotten
  for (int c = 1; c < 4; ++c) {
    const Vector6d off = PerturbationBetween(
        rig.poses[c] * rig.poses[0].Inverse(),
        state.cameras[c].camera_from_rig * state.cameras[0].camera_from_rig.Inverse());
    EXPECT_LT(off.head<3>().norm(), 0.005) << c;
  }
}

TEST(StationFilter, MovingCamerasKeepTheirLensesAlone) {
  const StationOptions options;
  const SyntheticRig rig = MakeSyntheticRig(2, 6);
  StationState state = FreshStation(rig, options);
  state.cameras[1].moving = true;
  state = Learn(rig, {0, 1}, 6, 0.5, options, 1, std::move(state));
  EXPECT_FALSE(state.cameras[1].posed);
  EXPECT_EQ(state.covariance.block(10, 0, 6, 20).norm(), 0.0);
  EXPECT_LT(DeviationsOf(state, 1).log_focal, 0.005);
  // Somewhere else in each request: no alarm.
  SyntheticRig elsewhere = rig;
  elsewhere.poses[1].t.x() += 0.2;
  std::mt19937 rng(3);
  EXPECT_TRUE(TestStation(state, {0, 1}, SayOf(elsewhere, {0, 1}, 0.5, &rng), options).agrees);
}

TEST(StationFilter, ZoomingCamerasKeepTheirPlacesAlone) {
  const StationOptions options;
  SyntheticRig rig = MakeSyntheticRig(3, 6);
  StationState state = FreshStation(rig, options);
  state.cameras[1].zooming = true;
  state = Learn(rig, {0, 1, 2}, 6, 0.5, options, 1, std::move(state));
  EXPECT_TRUE(state.cameras[1].posed);
  rig.cameras[1].focal_px *= 1.1;
  std::mt19937 rng(3);
  EXPECT_TRUE(TestStation(state, {0, 1, 2}, SayOf(rig, {0, 1, 2}, 0.5, &rng), options).agrees);
}

TEST(StationFilter, SeveralImagesOfOneCameraTeachItsLens) {
  const StationOptions options;
  const SyntheticRig rig = MakeSyntheticRig(2, 6);
  StationState state = FreshStation(rig, options);
  SyntheticRig three = rig;  // the first camera at three places
  three.cameras = {rig.cameras[0], rig.cameras[0], rig.cameras[0]};
  three.poses = MakeSyntheticRig(3, 7).poses;
  std::mt19937 rng(3);
  const StationState after =
      UpdateStation(state, {0, 0, 0}, SayOf(three, {0, 1, 2}, 1.0, &rng), StationTest(), options);
  EXPECT_FALSE(after.cameras[0].posed);
  const StationState of_one =
      UpdateStation(state, {0}, SayOf(rig, {0}, 1.0, &rng), StationTest(), options);
  EXPECT_LT(DeviationsOf(after, 0).log_focal, 0.65 * DeviationsOf(of_one, 0).log_focal);
}

TEST(StationFilter, ImagesOfOtherCamerasAndEmptyEvidenceChangeNothing) {
  const StationOptions options;
  const SyntheticRig rig = MakeSyntheticRig(3, 6);
  const StationState state = FreshStation(rig, options);
  const StationState same =
      UpdateStation(state, {0, 1, 2}, CameraEvidence(), StationTest(), options);
  EXPECT_EQ(same.covariance, state.covariance);
  EXPECT_EQ(same.requests, 0);
  std::mt19937 rng(3);
  const StationState after =
      UpdateStation(state, {0, -1, -1}, SayOf(rig, {0, 1, 2}, 0.5, &rng), StationTest(), options);
  EXPECT_EQ(after.cameras[1].requests, 0);
  EXPECT_EQ(after.cameras[1].camera.focal_px, state.cameras[1].camera.focal_px);
  EXPECT_TRUE(TestStation(state, {0, 1, 2}, CameraEvidence(), options).agrees);
}

TEST(StationFilter, ManyRequestsStayFiniteAndNeverSurerThanTheirMemory) {
  const StationOptions options;
  const SyntheticRig rig = MakeSyntheticRig(3, 6);
  StationState few = Learn(rig, {0, 1, 2}, 400, 1.0, options, 1, FreshStation(rig, options));
  const double after_400 = DeviationsOf(few, 0).log_focal;
  few = Learn(rig, {0, 1, 2}, 400, 1.0, options, 2, std::move(few));
  EXPECT_NEAR(DeviationsOf(few, 0).log_focal, after_400, 0.05 * after_400);
  EXPECT_TRUE(few.covariance.allFinite());
  EXPECT_EQ(few.requests, 800);
}

TEST(PriorOfRequest, IsTheStateSeenFromAPosedCamera) {
  const StationOptions options;
  const SyntheticRig rig = MakeSyntheticRig(3, 6);
  const StationState state = Learn(rig, {0, 1, 2}, 10, 0.5, options, 1, FreshStation(rig, options));
  const CameraGroupPrior prior = PriorOfRequest(state, {2, -1, 1}, {true, true, true}, options);
  ASSERT_EQ(prior.group.views, (std::vector<int>{0, 2}));
  const Rigid3 expected =
      state.cameras[1].camera_from_rig * state.cameras[2].camera_from_rig.Inverse();
  EXPECT_LT(PerturbationBetween(prior.group.camera_from_anchor[1], expected).norm(), 1e-9);
  EXPECT_EQ(prior.information.topRows(6).norm(), 0.0);
  EXPECT_TRUE(prior.information.allFinite());
  EXPECT_GT(prior.information(6, 6), 1.0 / (0.01 * 0.01));
  EXPECT_TRUE(PriorOfRequest(state, {-1, -1}, {true, true}, options).group.views.empty());
}

TEST(StationOptions, BadOnesAreNamed) {
  StationOptions options;
  EXPECT_TRUE(Validate(options).ok());
  options.remembered = 0.0;
  EXPECT_THAT(std::string(Validate(options).message()), testing::HasSubstr("remembered"));
  options = {};
  options.widening = -1.0;
  EXPECT_THAT(std::string(Validate(options).message()), testing::HasSubstr("widening"));
}

TEST(ChiSquareLimit, IsThatOfTables) {
  EXPECT_NEAR(ChiSquareLimit(10, 1.6449), 18.307, 0.1);  // 95 %
  EXPECT_NEAR(ChiSquareLimit(6, 3.0902), 22.458, 0.3);   // 99.9 %
  EXPECT_TRUE(std::isinf(ChiSquareLimit(0, 3.0)));
}

}  // namespace
}  // namespace horopter
