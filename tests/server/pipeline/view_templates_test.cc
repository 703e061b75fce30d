#include "server/pipeline/view_templates.h"

#include <gtest/gtest.h>

#include <numbers>
#include <set>

#include "server/pipeline/pipeline.h"
#include "tests/support/sample_record.h"

namespace horopter {
namespace {

class ViewTemplates : public testing::Test {
 protected:
  const ObjectModel model_ = SampleRecord("box", 1).model;
  const PreparedBytes bytes_ = CatalogPreparer().encode(*CatalogPreparer().prepare(model_).value());
};

TEST_F(ViewTemplates, AreThosePointsOfThePartThatTheCameraSees) {
  const TemplateViews views = ReadTemplates(model_, bytes_.data, bytes_.keys, 0, 20).value();
  ASSERT_EQ(views.views.size(), 20u);
  for (const TemplateView& view : views.views) {
    ASSERT_GT(view.points.size(), 20u);
    int outline = 0;
    for (const TemplatePoint& point : view.points) {
      EXPECT_GE(point.image_px.minCoeff(), 0.0f);
      EXPECT_LT(point.image_px.maxCoeff(), static_cast<float>(views.camera.width));
      EXPECT_GE(point.direction_rad, 0.0f);
      EXPECT_LE(point.direction_rad, std::numbers::pi_v<float> + 1e-5f);
      outline += point.kind == TemplateEdge::kSilhouette;
    }
    EXPECT_GT(outline, 0);
    // The part's corners are drawn between the points that are farthest out.
    Eigen::Vector2f low = view.points[0].image_px, high = low;
    for (const TemplatePoint& point : view.points) {
      low = low.cwiseMin(point.image_px);
      high = high.cwiseMax(point.image_px);
    }
    for (const Eigen::Vector3d& corner : model_.vertices) {
      const Eigen::Vector3d at = view.camera_from_object.R * corner + view.camera_from_object.t;
      const Eigen::Vector2f image = Project(views.camera, at).cast<float>();
      constexpr float kSpacingPx = 12.0f;  // of the points along the edges
      EXPECT_GT((image - low).minCoeff(), -kSpacingPx);
      EXPECT_LT((image - high).maxCoeff(), kSpacingPx);
    }
  }
}

// Points near each other on a straight edge lie in the direction of that edge.
TEST_F(ViewTemplates, DirectionsAreThoseOfTheEdgesInTheImage) {
  const TemplateViews views = ReadTemplates(model_, bytes_.data, bytes_.keys, 0, 5).value();
  int agree = 0, compared = 0;
  for (const TemplateView& view : views.views) {
    for (const TemplatePoint& a : view.points) {
      for (const TemplatePoint& b : view.points) {
        const Eigen::Vector2f apart = b.image_px - a.image_px;
        if (&a == &b || apart.norm() > 8.0f || apart.norm() < 2.0f) continue;
        if (std::abs(a.direction_rad - b.direction_rad) > 0.02f) continue;
        const Eigen::Vector2f along(std::cos(a.direction_rad), std::sin(a.direction_rad));
        ++compared;
        agree += std::abs(along.dot(apart.normalized())) > 0.95f;
      }
    }
  }
  ASSERT_GT(compared, 100);
  EXPECT_GT(agree, compared * 4 / 5);  // the rest are of two edges that run side by side
}

TEST_F(ViewTemplates, EveryRunOfThemIsSpreadAndAllComeOnce) {
  const TemplateViews all = ReadTemplates(model_, bytes_.data, bytes_.keys, 0, 10'000).value();
  ASSERT_EQ(all.views.size(), static_cast<size_t>(all.count));
  std::set<std::vector<double>> axes;
  for (const TemplateView& view : all.views) {
    const Eigen::Vector3d axis = view.camera_from_object.R.row(2);
    axes.insert({axis.x(), axis.y(), axis.z()});
  }
  EXPECT_EQ(axes.size(), all.views.size());
  // Of what a symmetry leaves, the first dozen look from very different sides.
  double nearest = 1e9;
  for (int i = 0; i < 12; ++i) {
    for (int j = 0; j < i; ++j) {
      const double cosine =
          all.views[i].camera_from_object.R.row(2).dot(all.views[j].camera_from_object.R.row(2));
      nearest = std::min(nearest, std::acos(std::clamp(cosine, -1.0, 1.0)));
    }
  }
  EXPECT_GT(nearest, 0.15);
  const TemplateViews rest =
      ReadTemplates(model_, bytes_.data, bytes_.keys, all.count - 1, 5).value();
  ASSERT_EQ(rest.views.size(), 1u);
  EXPECT_EQ(rest.views[0].camera_from_object.R, all.views.back().camera_from_object.R);
  EXPECT_TRUE(ReadTemplates(model_, bytes_.data, bytes_.keys, all.count, 5).value().views.empty());
}

TEST_F(ViewTemplates, DataOfSomethingElseAreRefused) {
  EXPECT_FALSE(ReadTemplates(model_, "", "", 0, 5).ok());
  EXPECT_FALSE(
      ReadTemplates(model_, bytes_.data.substr(0, bytes_.data.size() / 2), bytes_.keys, 0, 5).ok());
  EXPECT_EQ(
      ReadTemplates(SampleRecord("box", 2).model, bytes_.data, bytes_.keys, 0, 5).status().code(),
      absl::StatusCode::kFailedPrecondition);
}

}  // namespace
}  // namespace horopter
