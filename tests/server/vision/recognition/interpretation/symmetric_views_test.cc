#include "server/vision/recognition/interpretation/symmetric_views.h"

#include <gtest/gtest.h>

#include <Eigen/Geometry>

#include "tests/support/printed_box_scene.h"

namespace horopter {
namespace {

// The printed box whose half turns are symmetries of its edges, and views that nothing else links.
struct TurnedViews {
  PrintedBoxScene box;
  MatchingResult matching;

  explicit TurnedViews(const Looks& looks) : box(looks) {
    ObjectModel model = box.objects[0]->model;
    const Eigen::Vector3d center(0.5 * kPrintedSide, 0.4 * kPrintedSide, 0.5 * kPrintedHeight);
    model.symmetries.clear();
    for (int axis = 0; axis < 3; ++axis) {
      const Eigen::Matrix3d R =
          Eigen::AngleAxisd(M_PI, Eigen::Vector3d::Unit(axis)).toRotationMatrix();
      model.symmetries.push_back({R, center - R * center});
    }
    box.objects[0] = PrepareObject(std::move(model)).value();
    box.context.objects = box.objects;
    box.context.matching = &matching;
    box.context.views.resize(4);
    box.scene.objects[0].support.resize(4);
    box.scene.objects[0].support[0] = {100, 100, 100, 100, 100, 100, 100, 0};  // the surest view
  }

  void Align() {
    AlignSymmetricViews(box.context,
                        HypothesisTable(4, std::vector<ViewHypotheses>(1)),
                        box.surface_images.get(),
                        &box.scene);
  }

  // The camera of view v as it is when the box is taken for its equivalent pose.
  CalibratedCamera Turned(int v, int symmetry) const {
    CalibratedCamera view = *box.scene.views[v];
    view.camera_from_scene = view.camera_from_scene * box.objects[0]->model.symmetries[symmetry];
    return view;
  }
};

TEST(AlignSymmetricViews, TurnsEveryViewToWhereTheFacesLookAlike) {
  for (const unsigned seed : {1u, 2u, 3u}) {
    SCOPED_TRACE(seed);
    Looks looks;
    looks.seed = seed;
    TurnedViews turned(looks);
    const auto truth = turned.box.scene.views;
    for (int v = 1; v < 4; ++v) turned.box.scene.views[v] = turned.Turned(v, v - 1);
    turned.Align();
    for (int v = 0; v < 4; ++v) {
      ASSERT_TRUE(turned.box.scene.views[v].has_value());
      EXPECT_LT(
          (turned.box.scene.views[v]->camera_from_scene.R - truth[v]->camera_from_scene.R).norm(),
          1e-9)
          << "view " << v;
    }
  }
}

TEST(AlignSymmetricViews, LeavesAPlainPartAsItIs) {
  Looks looks;
  looks.printed_box = false;
  TurnedViews turned(looks);
  turned.box.scene.views[2] = turned.Turned(2, 1);
  const auto before = turned.box.scene.views;
  turned.Align();
  for (int v = 0; v < 4; ++v)
    EXPECT_EQ(turned.box.scene.views[v]->camera_from_scene.R, before[v]->camera_from_scene.R);
}

TEST(AlignSymmetricViews, LeavesViewsAsTheyAreThatThePlaneTies) {
  TurnedViews turned({});
  turned.matching.component.assign(4, 0);
  turned.matching.view_from_plane.assign(4, Eigen::Matrix3d::Identity());
  turned.box.scene.views[3] = turned.Turned(3, 0);
  const auto before = turned.box.scene.views;
  turned.Align();
  EXPECT_EQ(turned.box.scene.views[3]->camera_from_scene.R, before[3]->camera_from_scene.R);
}

}  // namespace
}  // namespace horopter
