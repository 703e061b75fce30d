#include "server/pipeline/variants.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <set>

#include "absl/strings/str_join.h"
#include "absl/strings/str_split.h"

namespace horopter {
namespace {

using testing::HasSubstr;

TEST(ApplyVariants, SetsWhatItNames) {
  PipelineOptions options;
  ASSERT_TRUE(ApplyVariants("detector=edge_drawing,splitting=curvature_templates,conic_fit="
                            "orthogonal,line_sets=verify,"
                            "association=axes,decomposition=common,routes=projective",
                            &options)
                  .ok());
  const BottomUpOptions& bottom_up = options.bottom_up;
  EXPECT_EQ(options.features.splitting.method, ChainSplittingMethod::kCurvatureTemplates);
  EXPECT_EQ(options.features.detector, EdgeDetector::kEdgeDrawingChannels);
  EXPECT_TRUE(options.refit_arcs);
  EXPECT_TRUE(bottom_up.projective.route.support.check_line_sets);
  EXPECT_TRUE(bottom_up.metric.route.support.check_line_sets);
  EXPECT_EQ(bottom_up.projective.association, AssociationForm::kAxes);
  EXPECT_EQ(bottom_up.decomposition, DecompositionMethod::kCommon);
  EXPECT_TRUE(options.recognition.routes.projective);
  EXPECT_FALSE(options.recognition.routes.matched_cameras || options.recognition.routes.metric ||
               options.recognition.routes.aspects);
}

TEST(ApplyVariants, EveryVariantIsTakenAndItsOptionsAreValid) {
  for (const std::string& variant : AllVariants()) {
    PipelineOptions options;
    EXPECT_TRUE(ApplyVariants(variant, &options).ok()) << variant;
    EXPECT_TRUE(Validate(options).ok()) << variant << Validate(options);
  }
}

TEST(PipelineOptions, AreValidatedAsOneTreeThatNamesTheField) {
  ASSERT_TRUE(Validate(PipelineOptions()).ok()) << Validate(PipelineOptions());
  const auto refused = [](const auto& spoil) {
    PipelineOptions options;
    spoil(&options);
    const absl::Status status = Validate(options);
    EXPECT_EQ(status.code(), absl::StatusCode::kInvalidArgument);
    return std::string(status.message());
  };
  using Options = PipelineOptions*;
  EXPECT_THAT(refused([](Options o) { o->features.linking.high = -1.0; }),
              HasSubstr("features.linking.high"));
  EXPECT_THAT(refused([](Options o) { o->matching.features.per_feature = 0; }),
              HasSubstr("matching.features."));
  EXPECT_THAT(refused([](Options o) { o->reconstruction.tracks.max_starts = 0; }),
              HasSubstr("reconstruction.tracks."));
  EXPECT_THAT(refused([](Options o) { o->recognition.acceptance.aspects.min_probability = 2.0; }),
              HasSubstr("recognition.acceptance.aspects.min_probability"));
  EXPECT_THAT(refused([](Options o) { o->aspects.images.sigma_px = 0.0; }),
              HasSubstr("aspects.images."));
  EXPECT_THAT(refused([](Options o) { o->threads = 0; }), HasSubstr("threads"));
}

// The first value of every name is what the options are without it.
TEST(ApplyVariants, DefaultsChangeNothing) {
  std::set<std::string> seen;
  std::vector<std::string> defaults;
  for (const std::string& variant : AllVariants()) {
    const std::string name = std::vector<std::string>(absl::StrSplit(variant, '='))[0];
    if (seen.insert(name).second) defaults.push_back(variant);
  }
  PipelineOptions options;
  ASSERT_TRUE(ApplyVariants(absl::StrJoin(defaults, ","), &options).ok());
  EXPECT_EQ(options.features.splitting.method, FeatureOptions().splitting.method);
  EXPECT_EQ(options.refit_arcs, PipelineOptions().refit_arcs);
  EXPECT_EQ(options.follow_ground, PipelineOptions().follow_ground);
  EXPECT_EQ(options.bottom_up.projective.association, BottomUpOptions().projective.association);
  EXPECT_EQ(options.bottom_up.decomposition, BottomUpOptions().decomposition);
  EXPECT_TRUE(options.recognition.routes.matched_cameras && options.recognition.routes.aspects);
}

TEST(ApplyVariants, TheGroundMayBeLeftUnused) {
  PipelineOptions options;
  ASSERT_TRUE(ApplyVariants("ground=unused", &options).ok());
  EXPECT_FALSE(options.follow_ground);
}

// What is not in every image cannot be told from what is off: the options say which it is.
TEST(ApplyVariants, MechanismsAreLeftOutOneAtATime) {
  PipelineOptions options;
  ASSERT_TRUE(ApplyVariants("pairs=off,patterns=off,standing=on,half_turns=off", &options).ok());
  EXPECT_EQ(options.aspects.find.votes.max_pair_matches, 0);
  EXPECT_FALSE(options.aspects.images.drop_pattern);
  EXPECT_FALSE(options.recognition.aspects.half_turns);
  EXPECT_EQ(options.aspects.link.standing, AspectLinkOptions().standing);
  EXPECT_TRUE(options.aspects.link.faint_parts && options.aspects.link.printed_surfaces);
  EXPECT_FALSE(ApplyVariants("standing=on,standing=off", &options).ok());
  EXPECT_FALSE(ApplyVariants("standing=0", &options).ok());
}

TEST(ApplyVariants, RefusesWhatIsUnknownOrTwiceAndLeavesTheOptions) {
  for (const char* wrong : {"splitting",
                            "splitting=",
                            "splitting=none",
                            "",
                            ",",
                            "edges=all",
                            "splitting=chords,splitting=chords",
                            "conic_fit=rim, line_sets=off"}) {
    PipelineOptions options;
    options.refit_arcs = true;
    const absl::Status status = ApplyVariants(wrong, &options);
    EXPECT_EQ(status.code(), absl::StatusCode::kInvalidArgument) << wrong;
    EXPECT_TRUE(options.refit_arcs) << wrong;
  }
  PipelineOptions options;
  EXPECT_THAT(
      std::string(ApplyVariants("splitting=none", &options).message()),
      testing::AllOf(HasSubstr("splitting=none"), HasSubstr("splitting=curvature_templates")));
}

}  // namespace
}  // namespace horopter
