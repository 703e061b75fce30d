// Reconstruction without a supporting plane, and views added to one: features and matches made of
// synthetic tracks.
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <Eigen/Dense>
#include <cmath>
#include <map>
#include <random>

#include "server/vision/reconstruction/matched_tracks.h"
#include "server/vision/reconstruction/reconstruction.h"
#include "server/vision/reconstruction/view_registration.h"
#include "tests/support/synthetic_tracks.h"

namespace horopter {
namespace {

struct Matched {
  std::vector<ImageFeatures> features;
  MatchingResult matching;
};

// One junction or segment per observation; matches of all pairs. `with_geometry`: the pairs have an
// F, else similarity alone is said to have matched them.
Matched MatchTracks(const SyntheticTracks& truth, bool with_geometry) {
  Matched out;
  const int views = static_cast<int>(truth.cameras.size());
  out.features.resize(views);
  out.matching.component.assign(views, -1);
  out.matching.view_from_plane.assign(views, Eigen::Matrix3d::Identity());
  std::vector<std::map<int, int>> junction_of(views), segment_of(views);
  for (const PointObservation& o : truth.tracks.point_observations) {
    junction_of[o.view][o.point] = static_cast<int>(out.features[o.view].junctions.size());
    Junction junction;
    junction.point = o.pixel;
    out.features[o.view].junctions.push_back(junction);
  }
  for (const LineObservation& o : truth.tracks.line_observations) {
    segment_of[o.view][o.line] = static_cast<int>(out.features[o.view].segments.size());
    Segment segment;
    segment.start = o.start;
    segment.end = o.end;
    out.features[o.view].segments.push_back(segment);
  }
  for (int a = 0; a < views; ++a) {
    for (int b = a + 1; b < views; ++b) {
      PairGeometry pair;
      pair.view_a = a;
      pair.view_b = b;
      if (with_geometry) pair.F = Eigen::Matrix3d::Identity();
      for (const auto& [j, in_a] : junction_of[a]) {
        const auto it = junction_of[b].find(j);
        if (it != junction_of[b].end()) pair.matches.push_back({in_a, it->second, 5.0});
      }
      for (const auto& [j, in_a] : segment_of[a]) {
        const auto it = segment_of[b].find(j);
        if (it != segment_of[b].end()) pair.segments.push_back({in_a, it->second, 5.0});
      }
      out.matching.pairs.push_back(std::move(pair));
    }
  }
  return out;
}

Reconstruction Reconstruct(const SyntheticTracks& truth,
                           const Matched& matched,
                           const std::vector<ViewPrior>& priors = {}) {
  const auto r = ReconstructViews(
      matched.matching, matched.features, truth.tracks.sizes, priors, ReconstructionOptions());
  EXPECT_TRUE(r.ok()) << r.status();
  return r.ok() ? *r : Reconstruction();
}

int Registered(const Reconstruction& r) {
  int n = 0;
  for (const auto& v : r.views) n += v.has_value();
  return n;
}

double FocalError(const SyntheticTracks& truth, const Reconstruction& r, size_t v) {
  return std::log(r.views[v]->camera.focal_px / truth.cameras[v].focal_px);
}

// Of the relative pose of two views, degrees.
double RotationError(const SyntheticTracks& truth, const Reconstruction& r, size_t a, size_t b) {
  const Eigen::Matrix3d found =
      r.views[b]->camera_from_scene.R * r.views[a]->camera_from_scene.R.transpose();
  const Eigen::Matrix3d right =
      truth.camera_from_world[b].R * truth.camera_from_world[a].R.transpose();
  return Eigen::AngleAxisd(found * right.transpose()).angle() * 180.0 / M_PI;
}

SyntheticTracks Scene(unsigned seed, int views = 6, double outliers = 0.0) {
  SyntheticTracksOptions options;
  options.seed = seed;
  options.views = views;
  SyntheticTrackNoise noise;
  noise.seed = seed;
  noise.outlier_share = outliers;
  return MakeSyntheticTracks(options, noise);
}

TEST(MatchedTracks, AreTheObservationsOfTheFeatures) {
  const SyntheticTracks truth = Scene(1);
  for (const bool with_geometry : {true, false}) {
    const Matched matched = MatchTracks(truth, with_geometry);
    const MatchedTracks all =
        TracksOfMatches(matched.matching, MatchedPairs::kAll, matched.features, truth.tracks.sizes);
    const MatchedTracks sure = TracksOfMatches(matched.matching,
                                               MatchedPairs::kWithEpipolarGeometry,
                                               matched.features,
                                               truth.tracks.sizes);
    EXPECT_TRUE(Validate(all.tracks).ok());
    EXPECT_EQ(all.tracks.points, static_cast<int>(all.points.size()));
    EXPECT_EQ(all.tracks.lines, static_cast<int>(all.segments.size()));
    EXPECT_GT(all.tracks.points, 30);
    EXPECT_GT(all.tracks.lines, 30);
    EXPECT_EQ(sure.tracks.points, with_geometry ? all.tracks.points : 0);
  }
}

TEST(TrackRoute, FindsCamerasWithoutAPlaneAndStatesItsDeviations) {
  double squared = 0.0;
  int n = 0;
  for (unsigned seed = 1; seed <= 6; ++seed) {
    SCOPED_TRACE("seed " + std::to_string(seed));
    const SyntheticTracks truth = Scene(seed);
    const Reconstruction r = Reconstruct(truth, MatchTracks(truth, seed % 2 == 0));
    ASSERT_TRUE(r.trusted) << r.refusal;
    EXPECT_FALSE(r.has_plane);
    EXPECT_GE(Registered(r), 5);
    EXPECT_GT(r.points.size(), 30u);
    double mean_distance = 0.0;
    Eigen::Vector3d towards = Eigen::Vector3d::Zero();
    for (size_t v = 0; v < r.views.size(); ++v) {
      if (!r.views[v]) continue;
      const double e = FocalError(truth, r, v);
      squared += std::pow(e / r.views[v]->focal_log_sigma, 2);
      ++n;
      EXPECT_LT(std::abs(e), 0.15);
      EXPECT_TRUE(r.view_refusals[v].empty());
      const Eigen::Vector3d centre = r.views[v]->camera_from_scene.Inverse().t;
      towards += centre.normalized();
      mean_distance += centre.norm() / Registered(r);
    }
    EXPECT_LT(RotationError(truth, r, 0, 5), 3.0);
    // The frame faces the cameras, at a distance of 1.
    EXPECT_NEAR(mean_distance, 1.0, 1e-6);
    EXPECT_GT(towards.normalized().z(), 1.0 - 1e-9);
    for (const ReconstructedPoint& p : r.points) {
      EXPECT_GE(p.observations.size(), 2u);
      EXPECT_TRUE(p.point_in_world.allFinite());
      for (const auto& [view, junction] : p.observations) {
        const CalibratedView& in = *r.views[view];
        const Eigen::Vector3d x = in.camera_from_scene * p.point_in_world;
        EXPECT_GT(x.z(), 0.0);
      }
    }
  }
  const double ratio = std::sqrt(squared / n);
  EXPECT_LT(ratio, 1.6);
  EXPECT_GT(ratio, 0.3);
}

TEST(TrackRoute, RefusalsAreTypedAndNeverTrusted) {
  struct Case {
    const char* name;
    SyntheticTracksOptions options;
  };
  std::vector<Case> cases(5);
  cases[0] = {"two views", {}};
  cases[0].options.views = 2;
  cases[1] = {"planar", {}};
  cases[1].options.planar = true;
  cases[1].options.points = cases[1].options.lines = 60;
  cases[2] = {"rotation", {}};
  cases[2].options.pure_rotation = true;
  cases[3] = {"duplicates", {}};
  cases[3].options.arc_rad = 0.0;
  cases[4] = {"parallel lines", {}};
  cases[4].options.points = 1;
  cases[4].options.lines = 60;
  cases[4].options.parallel_lines = true;
  for (Case& c : cases) {
    for (unsigned seed = 1; seed <= 3; ++seed) {
      SCOPED_TRACE(std::string(c.name) + ", seed " + std::to_string(seed));
      c.options.seed = seed;
      SyntheticTrackNoise noise;
      noise.seed = seed;
      SyntheticTracks truth = MakeSyntheticTracks(c.options, noise);
      if (std::string(c.name) == "duplicates") {
        // All views are the first one.
        for (PointObservation& o : truth.tracks.point_observations) {
          for (const PointObservation& first : truth.tracks.point_observations) {
            if (first.view == 0 && first.point == o.point) o.pixel = first.pixel;
          }
        }
        std::erase_if(truth.tracks.line_observations, [](const auto& o) { return o.view >= 0; });
      }
      const Reconstruction r = Reconstruct(truth, MatchTracks(truth, true));
      EXPECT_FALSE(r.trusted);
      EXPECT_FALSE(r.refusal.empty());
      for (const auto& v : r.views) {
        if (v) {
          EXPECT_TRUE(v->camera_from_scene.R.allFinite() && v->camera_from_scene.t.allFinite());
        }
      }
      for (size_t v = 0; v < r.views.size(); ++v) {
        EXPECT_EQ(r.views[v].has_value(), r.view_refusals[v].empty());
      }
    }
  }
}

TEST(TrackRoute, WrongMatchesNeverGiveTrustedWrongCameras) {
  for (unsigned seed = 1; seed <= 4; ++seed) {
    SCOPED_TRACE("seed " + std::to_string(seed));
    const SyntheticTracks truth = Scene(seed, 6, 0.4);
    const Reconstruction r = Reconstruct(truth, MatchTracks(truth, false));
    if (!r.trusted) continue;
    for (size_t v = 0; v < r.views.size(); ++v) {
      if (r.views[v]) {
        EXPECT_LT(std::abs(FocalError(truth, r, v)), 0.3);
      }
    }
  }
}

TEST(TrackRoute, HintsOfFocalLengthAndPoseEnter) {
  const SyntheticTracks truth = Scene(3);
  const Matched matched = MatchTracks(truth, true);
  std::vector<ViewPrior> priors(6);
  priors[1].focal_px = truth.cameras[1].focal_px;
  priors[1].focal_log_sigma = 0.001;
  const Reconstruction blind = Reconstruct(truth, matched);
  const Reconstruction told = Reconstruct(truth, matched, priors);
  ASSERT_TRUE(told.trusted) << told.refusal;
  EXPECT_NEAR(FocalError(truth, told, 1), 0.0, 0.005);
  EXPECT_LT(told.views[1]->focal_log_sigma, blind.views[1]->focal_log_sigma);
  std::vector<ViewPrior> posed(6);
  for (size_t v = 0; v < 6; ++v) {
    posed[v].camera_from_world = truth.camera_from_world[v];
    posed[v].rotation_sigma_rad = 0.001;
    posed[v].position_sigma_m = 0.0005;
  }
  const Reconstruction with_poses = Reconstruct(truth, matched, posed);
  ASSERT_TRUE(with_poses.trusted) << with_poses.refusal;
  EXPECT_LT(RotationError(truth, with_poses, 0, 5), 0.15);
}

TEST(TrackRoute, SameInputGivesTheSameBytes) {
  const SyntheticTracks truth = Scene(2);
  const Matched matched = MatchTracks(truth, false);
  const Reconstruction a = Reconstruct(truth, matched), b = Reconstruct(truth, matched);
  ASSERT_EQ(Registered(a), Registered(b));
  for (size_t v = 0; v < a.views.size(); ++v) {
    if (a.views[v]) {
      EXPECT_EQ(a.views[v]->camera.focal_px, b.views[v]->camera.focal_px);
    }
  }
}

// The true cameras of all views but the last.
Reconstruction AllButLast(const SyntheticTracks& truth) {
  Reconstruction r;
  r.trusted = true;
  r.views.resize(truth.cameras.size());
  for (size_t v = 0; v + 1 < truth.cameras.size(); ++v) {
    r.views[v] = CalibratedView{{truth.cameras[v], truth.camera_from_world[v]}, 0.01};
  }
  return r;
}

TEST(ViewRegistration, AddsALeftOutViewAndLeavesTheOthers) {
  for (unsigned seed = 1; seed <= 6; ++seed) {
    SCOPED_TRACE("seed " + std::to_string(seed));
    const SyntheticTracks truth = Scene(seed);
    const Matched matched = MatchTracks(truth, false);
    Reconstruction r = AllButLast(truth);
    ASSERT_EQ(RegisterRemainingViews(
                  matched.matching, matched.features, truth.tracks.sizes, {}, {}, {}, &r),
              1)
        << r.view_refusals.back();
    EXPECT_LT(RotationError(truth, r, 0, 5), 1.5);
    EXPECT_LT(std::abs(FocalError(truth, r, 5)), 3.0 * r.views[5]->focal_log_sigma);
    EXPECT_EQ(r.views[0]->camera.focal_px, truth.cameras[0].focal_px);
  }
}

TEST(ViewRegistration, AnImageOfSomethingElseStaysOutWithItsReason) {
  for (unsigned seed = 1; seed <= 6; ++seed) {
    SCOPED_TRACE("seed " + std::to_string(seed));
    SyntheticTracks truth = Scene(seed);
    std::mt19937 rng(seed);
    const auto anywhere = [&] {
      return Eigen::Vector2d(640.0 * (rng() / 4294967296.0), 480.0 * (rng() / 4294967296.0));
    };
    for (PointObservation& o : truth.tracks.point_observations) {
      if (o.view == 5) o.pixel = anywhere();
    }
    for (LineObservation& o : truth.tracks.line_observations) {
      if (o.view == 5) o.start = anywhere(), o.end = anywhere();
    }
    const Matched matched = MatchTracks(truth, false);
    Reconstruction r = AllButLast(truth);
    EXPECT_EQ(RegisterRemainingViews(
                  matched.matching, matched.features, truth.tracks.sizes, {}, {}, {}, &r),
              0);
    EXPECT_FALSE(r.views[5]);
    EXPECT_THAT(r.view_refusals[5], testing::HasSubstr("agree"));
    EXPECT_TRUE(r.view_refusals[0].empty());
  }
}

}  // namespace
}  // namespace horopter
