#include "server/vision/matching/feature_tracks.h"

#include <gtest/gtest.h>

#include <random>
#include <set>
#include <utility>

namespace horopter {
namespace {

TEST(FeatureTracks, JoinsOverViews) {
  const std::vector<FeatureTrack> tracks =
      JoinTracks({{0, 5, 1, 7, 2.0}, {1, 7, 2, 9, 1.0}, {0, 1, 2, 3, 1.0}});
  ASSERT_EQ(tracks.size(), 2u);
  EXPECT_EQ(tracks[0].features.size(), 2u);
  ASSERT_EQ(tracks[1].features.size(), 3u);
  EXPECT_EQ(tracks[1].features[0].feature, 5);
  EXPECT_EQ(tracks[1].features[1].feature, 7);
  EXPECT_EQ(tracks[1].features[2].feature, 9);
}

TEST(FeatureTracks, AConflictLosesTheUnlikelierLinkOnly) {
  // 0:1 - 1:1 - 2:1 and 0:2 - 1:2; the weak link 2:1 - 0:2 would put two features of view 0 into
  // one track.
  const std::vector<FeatureTrack> tracks =
      JoinTracks({{0, 1, 1, 1, 9.0}, {1, 1, 2, 1, 8.0}, {0, 2, 1, 2, 7.0}, {0, 2, 2, 1, 1.0}});
  ASSERT_EQ(tracks.size(), 2u);
  EXPECT_EQ(tracks[0].features.size(), 3u);
  EXPECT_EQ(tracks[1].features.size(), 2u);
}

TEST(FeatureTracks, RandomLinksGiveDisjointTracksWithOneFeaturePerView) {
  for (unsigned seed = 1; seed <= 20; ++seed) {
    std::mt19937 rng(seed);
    std::vector<TrackLink> links;
    for (int k = 0; k < 400; ++k) {
      const int a = static_cast<int>(rng() % 5), b = (a + 1 + static_cast<int>(rng() % 4)) % 5;
      links.push_back({a,
                       static_cast<int>(rng() % 30),
                       b,
                       static_cast<int>(rng() % 30),
                       static_cast<double>(rng() % 100)});
    }
    std::set<std::pair<int, int>> seen;
    for (const FeatureTrack& track : JoinTracks(links)) {
      EXPECT_GE(track.features.size(), 2u);
      int last = -1;
      for (const FeatureTrack::Feature& f : track.features) {
        EXPECT_GT(f.view, last) << "seed " << seed;
        last = f.view;
        EXPECT_TRUE(seen.insert({f.view, f.feature}).second) << "seed " << seed;
      }
    }
  }
}

TEST(FeatureTracks, NothingGivesNothing) {
  EXPECT_TRUE(JoinTracks({}).empty());
}

}  // namespace
}  // namespace horopter
