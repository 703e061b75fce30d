#include "server/vision/recognition/aspects/aspect_fragments.h"

#include <gtest/gtest.h>

#include "tests/support/solid_meshes.h"

namespace horopter {
namespace {

TEST(AspectFragments, OneRenderingGivesWhatTwoGive) {
  const absl::StatusOr<RenderMesh> mesh = MakeRenderMesh(RingMesh(0.03, 0.014, 0.008, 24));
  ASSERT_TRUE(mesh.ok()) << mesh.status();
  const AspectOptions options{.directions = 20};
  const AspectSet aspects = MakeAspects(*mesh, {}, options);
  const ModelFragments fragments = MakeModelFragments(*mesh, aspects);
  ASSERT_FALSE(fragments.fragments.empty());
  const AspectsWithFragments both = MakeAspectsWithFragments(*mesh, {}, options);
  EXPECT_EQ(both.fragments, fragments);
  EXPECT_EQ(both.aspects.points, aspects.points);
  ASSERT_EQ(both.aspects.aspects.size(), aspects.aspects.size());
  EXPECT_EQ(AspectCamera(both.aspects).focal_px, AspectCamera(aspects).focal_px);
  for (std::size_t i = 0; i < aspects.aspects.size(); ++i) {
    EXPECT_EQ(both.aspects.aspects[i].camera_from_object, aspects.aspects[i].camera_from_object);
    EXPECT_EQ(both.aspects.aspects[i].point_count, aspects.aspects[i].point_count);
  }
}

}  // namespace
}  // namespace horopter
