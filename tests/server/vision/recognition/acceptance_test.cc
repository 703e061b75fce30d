#include "server/vision/recognition/acceptance.h"

#include <gtest/gtest.h>

#include <limits>
#include <string>

#include "server/vision/recognition/options.h"

namespace horopter {
namespace {

constexpr double kNaN = std::numeric_limits<double>::quiet_NaN();

void ExpectRefused(const AcceptanceOptions& options, const std::string& field) {
  const absl::Status status = Validate(options);
  EXPECT_EQ(status.code(), absl::StatusCode::kInvalidArgument) << field;
  EXPECT_NE(std::string(status.message()).find("acceptance." + field + ":"), std::string::npos)
      << status.message();
}

template <typename Part>
void ExpectRefused(Part AcceptanceOptions::*part,
                   double Part::*field,
                   double value,
                   const std::string& name) {
  AcceptanceOptions options;
  options.*part.*field = value;
  ExpectRefused(options, name);
}

TEST(AcceptanceOptions, DefaultsAreInTheirRanges) {
  EXPECT_TRUE(Validate(AcceptanceOptions()).ok());
}

TEST(AcceptanceOptions, NamesTheFieldThatIsOutOfItsRange) {
  using A = AcceptanceOptions;
  for (const double value : {-0.1, 1.1, kNaN}) {
    ExpectRefused(&A::scene, &SceneAcceptance::ambiguity_gap, value, "scene.ambiguity_gap");
    ExpectRefused(&A::aspects, &AspectAcceptance::print_tells, value, "aspects.print_tells");
    ExpectRefused(&A::pose_choices,
                  &PoseChoiceAcceptance::ambiguous_share,
                  value,
                  "pose_choices.ambiguous_share");
  }
  for (const double value : {-1.0, 0.0, kNaN, std::numeric_limits<double>::infinity()}) {
    ExpectRefused(&A::aspects, &AspectAcceptance::score_weight, value, "aspects.score_weight");
    ExpectRefused(&A::pose_choices,
                  &PoseChoiceAcceptance::independent_px,
                  value,
                  "pose_choices.independent_px");
    ExpectRefused(&A::misfits, &MisfitAcceptance::factor, value, "misfits.factor");
  }
  AcceptanceOptions none;
  none.scene.min_segments = 0;
  ExpectRefused(none, "scene.min_segments");
  none = {};
  none.aspects.print_views = 0;
  ExpectRefused(none, "aspects.print_views");
  none = {};
  none.misfits.min_samples = 0;
  ExpectRefused(none, "misfits.min_samples");
}

// A server is configured by RecognitionOptions alone: what is wrong about acceptance is refused
// there.
TEST(AcceptanceOptions, AreCheckedWithThoseOfRecognition) {
  RecognitionOptions options;
  EXPECT_TRUE(Validate(options).ok());
  options.acceptance.aspects.min_probability = 2.0;
  EXPECT_EQ(Validate(options).message(), Validate(options.acceptance).message());
  EXPECT_FALSE(Validate(options).ok());
}

}  // namespace
}  // namespace horopter
