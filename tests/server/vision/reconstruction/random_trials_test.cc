// Random scenes by the thousand: nothing diverges, nothing is answered wrongly.
#include <gtest/gtest.h>

#include <Eigen/Dense>
#include <cmath>
#include <cstdio>

#include "server/vision/reconstruction/self_calibration.h"
#include "tests/server/vision/reconstruction/metric_checks.h"
#include "tests/support/synthetic_tracks.h"

namespace horopter {
namespace {

// 1,000 trials of every kind, in four blocks: a refusal counts, a wrong answer does not.
class RandomTrials : public testing::TestWithParam<unsigned> {};

TEST_P(RandomTrials, GiveNoWrongAnswer) {
  int reconstructed = 0, metric = 0;
  for (unsigned seed = 250 * GetParam() + 1; seed <= 250 * (GetParam() + 1); ++seed) {
    SCOPED_TRACE(testing::Message() << "seed " << seed);
    SyntheticTracksOptions options{.seed = seed};
    options.views = 2 + static_cast<int>(seed % 6);
    options.parts = 1 + static_cast<int>(seed % 3);
    options.arc_rad = 0.3 + 0.2 * (seed % 7);
    if (seed % 5 == 0) options.points = 12 + static_cast<int>(seed % 50);
    if (seed % 25 == 0) options.lines = 15;
    options.planar = seed % 50 == 7;
    options.pure_rotation = seed % 50 == 8;
    SyntheticTrackNoise noise{seed, 0.1 * (1 + seed % 10), 0.05 * (seed % 6)};
    noise.outlier_share = 0.02 * (seed % 4);
    const SyntheticTracks truth = MakeSyntheticTracks(options, noise);
    const auto r = ReconstructTracks(truth.tracks, {}, {}, {});
    ASSERT_TRUE(r.ok()) << r.status();
    ExpectSane(r->metric);
    if (r->projective.outcome != ProjectiveOutcome::kReconstructed) continue;
    ++reconstructed;
    EXPECT_FALSE(options.planar || options.pure_rotation);
    // Far above what noise does to the worst geometry here, far below a wrong minimum.
    EXPECT_LT(CameraCollineationRms(truth, r->projective.scene), 0.02);
    if (r->metric.outcome != MetricOutcome::kMetric) continue;
    ++metric;
    for (const double e : FocalErrors(truth, r->metric)) EXPECT_LT(std::abs(e), 0.5);
  }
  std::printf("%d of 250 reconstructed, %d metric\n", reconstructed, metric);
  EXPECT_GT(reconstructed, 180);
  EXPECT_GT(metric, 100);
}
INSTANTIATE_TEST_SUITE_P(Blocks, RandomTrials, testing::Range(0u, 4u));

}  // namespace
}  // namespace horopter
