#include "server/vision/recognition/search_options.h"

#include <gtest/gtest.h>

#include <limits>
#include <string>

#include "server/vision/recognition/options.h"

namespace horopter {
namespace {

void ExpectRefused(const EdgeSearchOptions& options, const std::string& field) {
  RecognitionOptions all;
  all.search = options;
  const absl::Status status = Validate(all);
  EXPECT_EQ(status.code(), absl::StatusCode::kInvalidArgument) << field;
  EXPECT_EQ(std::string(status.message()).find("search." + field + ":"), 0u) << status.message();
}

TEST(EdgeSearchOptions, DefaultsAreInTheirRanges) {
  EXPECT_TRUE(Validate(EdgeSearchOptions()).ok()) << Validate(EdgeSearchOptions());
}

TEST(EdgeSearchOptions, NamesTheFieldThatIsOutOfItsRange) {
  for (const double value : {-1.0, 0.0, std::numeric_limits<double>::quiet_NaN()}) {
    EdgeSearchOptions options;
    options.plane.votes.cell_m = value;
    ExpectRefused(options, "plane.votes.cell_m");
    options = {};
    options.views.refine.start_reach_px = value;
    ExpectRefused(options, "views.refine.start_reach_px");
    options = {};
    options.shortlist.corners.angle_rad = value;
    ExpectRefused(options, "shortlist.corners.angle_rad");
  }
  EdgeSearchOptions options;
  options.placements.min_quick = 1.5f;
  ExpectRefused(options, "placements.min_quick");
  options = {};
  options.plane_scales = 0;
  ExpectRefused(options, "plane_scales");
}

TEST(EdgeSearchOptions, AFirstLookAndARankingAreQuickerThanASearch) {
  const EdgeSearchOptions options;
  EXPECT_LT(options.plane_first_look.peaks, options.plane.peaks);
  EXPECT_LT(options.plane_first_look.settle.settled, options.plane.settle.settled);
  EXPECT_LT(options.shortlist.corners.settle.settled, options.corners.settle.settled);
  EXPECT_EQ(options.plane_first_look.settle.refine.start_reach_px,
            options.plane.settle.refine.start_reach_px);
}

}  // namespace
}  // namespace horopter
