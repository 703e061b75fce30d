#include "server/vision/explanation/edge_report.h"

#include <gtest/gtest.h>

#include <set>

#include "tests/support/shaded_parts.h"
#include "tests/support/synthetic_part.h"

namespace horopter {
namespace {

const PinholeCamera kCamera = CenteredCamera(640, 480, 800.0);

std::shared_ptr<const PreparedObject> Prepared(const ObjectModel& model) {
  return PrepareObject(model).value();
}

Rigid3 PoseAt(double x_m) {
  Rigid3 pose = LookAt({0.3, -0.35, 0.3}, {0.03, 0.02, 0.02});
  pose.t.x() += x_m;
  return pose;
}

AspectImage ImageOf(std::span<const ShadedPart> parts) {
  AspectImageOptions options;
  options.drop_pattern = false;
  return MakeAspectImage(PhotographParts(kCamera, parts), options);
}

double Share(const EdgeReport& report) {
  return report.supported_px / report.visible_px;
}

TEST(EdgeReport, TheTruePoseIsSupportedAndAShiftedOneIsNot) {
  const auto object = Prepared(LBracket());
  const ShadedPart shown{&object->model, PoseAt(0)};
  const AspectImage image = ImageOf({&shown, 1});
  const EdgeReport right = ReportEdges(image, kCamera, {object.get(), PoseAt(0)}, {});
  EXPECT_GT(right.visible_px, 500.0);
  EXPECT_GT(Share(right), 0.9);
  EXPECT_EQ(right.hidden_px, 0.0);
  // 12 pixels to the side: only edges along the way stay on edges.
  const EdgeReport wrong = ReportEdges(image, kCamera, {object.get(), PoseAt(0.008)}, {});
  EXPECT_NEAR(wrong.visible_px, right.visible_px, 0.1 * right.visible_px);
  EXPECT_LT(Share(wrong), 0.4);
}

TEST(EdgeReport, LengthsAreThoseOfTheRunsAndRunsNameTheirEdges) {
  const auto object = Prepared(LBracket());
  const ShadedPart shown{&object->model, PoseAt(0)};
  const EdgeReport report =
      ReportEdges(ImageOf({&shown, 1}), kCamera, {object.get(), PoseAt(0)}, {});
  double supported = 0.0, unsupported = 0.0, named = 0.0;
  std::set<int> edges;
  for (const EdgeRun& run : report.runs) {
    double length = 0.0;
    for (std::size_t i = 1; i < run.points.size(); ++i) {
      length += (run.points[i] - run.points[i - 1]).norm();
    }
    (run.state == EdgeState::kSupported ? supported : unsupported) += length;
    if (run.edge >= 0) named += length, edges.insert(run.edge);
    if (run.edge < 0) continue;
    // Its points are points of the edge's projection.
    const auto& line = object->model.edges[run.edge].polyline;
    const Eigen::Vector2d a = Project(kCamera, PoseAt(0) * line.front());
    const Eigen::Vector2d b = Project(kCamera, PoseAt(0) * line.back());
    const Eigen::Vector2d normal(a.y() - b.y(), b.x() - a.x());
    for (const Eigen::Vector2d& p : run.points) {
      EXPECT_LT(std::abs((p - a).dot(normal.normalized())), 3.0);
    }
  }
  EXPECT_NEAR(supported, report.supported_px, 1e-6);
  EXPECT_NEAR(supported + unsupported, report.visible_px, 1e-6);
  // All edges of a prism are enrolled.
  EXPECT_GT(named, 0.95 * report.visible_px);
  EXPECT_GE(edges.size(), 9u);
}

TEST(EdgeReport, WhatStandsBeforeAnObjectHidesItsEdges) {
  const auto bracket = Prepared(LBracket()), wedge = Prepared(Wedge());
  Rigid3 nearer = PoseAt(0.01);
  nearer.t.z() -= 0.12;
  const ShadedPart shown[] = {{&bracket->model, PoseAt(0)}, {&wedge->model, nearer}};
  const AspectImage image = ImageOf(shown);
  const ExplainedObject other{wedge.get(), nearer};
  const EdgeReport report = ReportEdges(image, kCamera, {bracket.get(), PoseAt(0)}, {&other, 1});
  EXPECT_GT(report.hidden_px, 50.0);
  EXPECT_GT(Share(report), 0.85);
  const EdgeReport alone = ReportEdges(image, kCamera, {bracket.get(), PoseAt(0)}, {});
  EXPECT_NEAR(alone.visible_px, report.visible_px + report.hidden_px, 1e-6);
  EXPECT_LT(Share(alone), Share(report));
  // It does not hide what is nearer.
  const ExplainedObject behind{bracket.get(), PoseAt(0)};
  EXPECT_LT(ReportEdges(image, kCamera, {wedge.get(), nearer}, {&behind, 1}).hidden_px, 5.0);
}

TEST(EdgeReport, APoseBehindTheCameraOrOutsideOfTheImageIsEmpty) {
  const auto object = Prepared(LBracket());
  const AspectImage image = ImageOf({});
  for (const double z : {-1.0, 0.0}) {
    Rigid3 pose;
    pose.t = {5.0, 0.0, z};
    EXPECT_TRUE(ReportEdges(image, kCamera, {object.get(), pose}, {}).runs.empty());
  }
}

double Length(const std::vector<std::vector<Eigen::Vector2d>>& lines) {
  double sum = 0.0;
  for (const auto& line : lines) {
    for (std::size_t i = 1; i < line.size(); ++i) sum += (line[i] - line[i - 1]).norm();
  }
  return sum;
}

TEST(UnexplainedEdges, AreThoseOfWhatIsNotThere) {
  const auto bracket = Prepared(LBracket()), wedge = Prepared(Wedge());
  const ShadedPart shown[] = {{&bracket->model, PoseAt(-0.06)}, {&wedge->model, PoseAt(0.06)}};
  const cv::Mat photo = PhotographParts(kCamera, shown);
  const ImageFeatures features = DetectFeatures(photo, {}).value();
  const ExplainedObject parts[] = {{bracket.get(), PoseAt(-0.06)}, {wedge.get(), PoseAt(0.06)}};
  const double all = Length(UnexplainedEdges(features, kCamera, {}));
  const auto rest = UnexplainedEdges(features, kCamera, std::span(parts, 1));
  const double none = Length(UnexplainedEdges(features, kCamera, parts));
  EXPECT_GT(all, 1000.0);
  EXPECT_LT(none, 0.05 * all);
  EXPECT_GT(Length(rest), 0.2 * all);
  EXPECT_LT(Length(rest), 0.7 * all);
  // What is left lies on the wedge's side of the image.
  for (const auto& line : rest) {
    for (const Eigen::Vector2d& p : line) EXPECT_GT(p.x(), 280.0);
  }
}

}  // namespace
}  // namespace horopter
