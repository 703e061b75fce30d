// Blocks whose shape has half turns and whose print has none.
#include "server/vision/recognition/interpretation/surface_print.h"

#include <gtest/gtest.h>

#include <Eigen/Geometry>
#include <cmath>
#include <memory>
#include <numbers>

#include "server/vision/recognition/interpretation/pose_alternatives.h"
#include "server/vision/recognition/object/prepared_object.h"
#include "tests/support/printed_photo.h"
#include "tests/support/solid_meshes.h"
#include "tests/support/synthetic_part.h"

namespace horopter {
namespace {

constexpr double kMost = 12.0;  // log odds of a view
const Eigen::Vector3d kHalf(0.04, 0.025, 0.014);

Rigid3 HalfTurn(const Eigen::Vector3d& axis) {
  return {Eigen::AngleAxisd(std::numbers::pi, axis).toRotationMatrix(), Eigen::Vector3d::Zero()};
}

double DiameterOf(const TriangleMesh& mesh) {
  double out = 0.0;
  for (const auto& a : mesh.vertices) {
    for (const auto& b : mesh.vertices) out = std::max(out, (a - b).norm());
  }
  return out;
}

ObjectModel Block(const char* id) {
  ObjectModel model;
  model.id = id;
  model.mesh = BoxMesh(kHalf);
  model.diameter_m = DiameterOf(model.mesh);
  for (const Eigen::Vector3d& axis :
       {Eigen::Vector3d::UnitX(), Eigen::Vector3d::UnitY(), Eigen::Vector3d::UnitZ()}) {
    model.symmetries.push_back(HalfTurn({axis.x(), axis.y(), axis.z()}));
  }
  return model;
}

double Label(const Eigen::Vector3d& p) {
  const bool disc = (p - Eigen::Vector3d(0.02, 0.008, p.z())).norm() < 0.01;
  const bool bars = p.x() < -0.012 && std::fmod(p.y() + 0.1, 0.01) < 0.005;
  return disc ? 0.35 : bars ? 0.5 : 1.0;
}
double OtherLabel(const Eigen::Vector3d& p) {
  return std::abs(p.x() + 0.5 * p.y()) < 0.008 || p.y() > 0.015 ? 0.4 : 1.0;
}
double Plain(const Eigen::Vector3d&) {
  return 1.0;
}

AspectImage Photo(const TriangleMesh& mesh,
                  const PrintPattern& print,
                  const PinholeCamera& camera,
                  const Rigid3& camera_from_object) {
  return MakeAspectImage(PrintedPhoto(mesh, print, camera, camera_from_object));
}

// Three views of a printed mesh in the origin, from above or from below.
struct Scene {
  std::vector<AspectImage> images;
  std::vector<std::optional<CalibratedCamera>> views;

  Scene(const TriangleMesh& mesh,
        const PrintPattern& print,
        double first_rad = 0.4,
        double height = 0.2) {
    const PinholeCamera camera = CenteredCamera(640, 480, 800);
    for (int v = 0; v < 3; ++v) {
      const double a = first_rad + 0.6 * v;
      const Rigid3 from_scene =
          LookAt({0.2 * std::sin(a), -0.2 * std::cos(a), height}, {0.0, 0.0, 0.0});
      images.push_back(Photo(mesh, print, camera, from_scene));
      views.push_back(CalibratedCamera{camera, from_scene});
    }
  }
  PrintSights Of(const Rigid3& pose = {}) const { return SightsOf(images, views, pose, {}); }
};

ObjectModel Learnt(ObjectModel model, const PrintPattern& print) {
  const Scene scene(model.mesh, print);
  const std::vector<PrintSights> instances{scene.Of()};
  const absl::StatusOr<SurfacePrint> learnt = LearnPrint(model, instances);
  EXPECT_TRUE(learnt.ok()) << learnt.status();
  if (learnt.ok()) model.print = *learnt;
  return model;
}

TEST(SurfacePrint, PlacesAreSpreadByArea) {
  const std::vector<PrintPlace> places = PlacesOn(BoxMesh(kHalf), 3000);
  ASSERT_EQ(places.size(), 3000u);
  int up = 0;
  for (const PrintPlace& p : places) {
    EXPECT_NEAR(p.normal.norm(), 1.0, 1e-5);
    up += p.normal.z() > 0.9f;
  }
  const double x = kHalf.x(), y = kHalf.y(), z = kHalf.z();
  EXPECT_NEAR(up / 3000.0, 0.5 * x * y / (x * y + y * z + z * x), 0.01);
}

TEST(SurfacePrint, TellsAHalfTurnThatTheShapeDoesNot) {
  const ObjectModel block = Learnt(Block("block"), Label);
  EXPECT_LE(block.print.places.size(), kMaxPrintPlaces);
  EXPECT_EQ(block.print.views, 3);
  // From other sides than it was learnt from.
  const Scene scene(block.mesh, Label, 2.9);
  EXPECT_FALSE(TurnOfPrint(block, scene.Of(), 3.0, kMost));
  const std::optional<Rigid3> back =
      TurnOfPrint(block, scene.Of(HalfTurn(Eigen::Vector3d::UnitZ())), 3.0, kMost);
  ASSERT_TRUE(back);
  EXPECT_LT((back->R - HalfTurn(Eigen::Vector3d::UnitZ()).R).norm(), 1e-9);
  EXPECT_FALSE(
      TurnOfPrint(Block("block"), scene.Of(HalfTurn(Eigen::Vector3d::UnitZ())), 3.0, kMost))
      << "without a print nothing tells";
}

TEST(SurfacePrint, TellsPartsOfOneShape) {
  const ObjectModel block = Learnt(Block("block"), Label),
                    other = Learnt(Block("other"), OtherLabel);
  const Scene scene(block.mesh, Label, 1.0);
  EXPECT_GT(PrintLogOdds(block, scene.Of(), other, scene.Of(), kMost), 3.0);
  EXPECT_LT(PrintLogOdds(other, scene.Of(), block, scene.Of(), kMost), -3.0);
  EXPECT_EQ(PrintLogOdds(block, scene.Of(), Block("unknown"), scene.Of(), kMost), 0.0);
}

TEST(SurfacePrint, InstancesThatWereAnsweredTurnedAreTurnedBack) {
  const ObjectModel model = Block("block");
  const Scene first(model.mesh, Label), second(model.mesh, Label, 1.5);
  const std::vector<PrintSights> instances{first.Of(),
                                           second.Of(HalfTurn(Eigen::Vector3d::UnitZ()))};
  const absl::StatusOr<SurfacePrint> print = LearnPrint(model, instances);
  ASSERT_TRUE(print.ok()) << print.status();
  EXPECT_EQ(print->views, 6);
}

TEST(SurfacePrint, IsNotLearntFromOneView) {
  const ObjectModel model = Block("block");
  const Scene scene(model.mesh, Label);
  const std::vector<PrintSights> one{{scene.Of().front()}};
  EXPECT_TRUE(absl::IsFailedPrecondition(LearnPrint(model, one).status()));
  EXPECT_TRUE(absl::IsFailedPrecondition(LearnPrint(model, {}).status()));
}

TEST(SurfacePrint, OfAPlainSurfaceThereIsNone) {
  const ObjectModel model = Block("block");
  const Scene scene(model.mesh, Plain);
  const std::vector<PrintSights> instances{scene.Of()};
  EXPECT_TRUE(absl::IsFailedPrecondition(LearnPrint(model, instances).status()));
}

TEST(SurfacePrint, ViewsOfAnotherPrintAreLeftOut) {
  const ObjectModel model = Block("block");
  const Scene scene(model.mesh, Label), wrong(model.mesh, OtherLabel);
  const std::vector<PrintSights> instances{scene.Of(), {wrong.Of().front()}};
  const absl::StatusOr<SurfacePrint> print = LearnPrint(model, instances);
  ASSERT_TRUE(print.ok()) << print.status();
  EXPECT_EQ(print->views, 3);
}

// An answer of a block in the origin.
struct Answered {
  std::vector<std::shared_ptr<const PreparedObject>> objects;
  JointContext context;
  RecognitionResult result;

  Answered(const ObjectModel& model, const Scene& scene, const Rigid3& pose) {
    objects.push_back(PrepareObject(model, {.aspects = true}).value());
    context.objects = objects;
    result.state = RecognitionState::kRecognized;
    result.views = scene.views;
    SceneObject& answer = result.objects.emplace_back();
    answer.object = 0;
    answer.scene_from_object = pose;
  }
};

TEST(SurfacePrint, AnAnswerIsTurnedByASymmetryToItsPrint) {
  const ObjectModel block = Learnt(Block("block"), Label);
  const Scene scene(block.mesh, Label, 1.0);
  const Rigid3 turned = HalfTurn(Eigen::Vector3d::UnitZ());
  Answered with(block, scene, turned), without(Block("block"), scene, turned);
  TurnByPrint(with.context, scene.images, &with.result);
  EXPECT_LT((with.result.objects[0].scene_from_object.R - Eigen::Matrix3d::Identity()).norm(),
            1e-9);
  EXPECT_EQ(with.result.counts["turned_by_print"], 1.0);
  TurnByPrint(without.context, scene.images, &without.result);
  EXPECT_EQ(without.result.objects[0].scene_from_object.R, turned.R);
}

// A block whose peg alone tells its half turn, seen from where the peg is hidden.
TEST(SurfacePrint, ATurnThatEdgesLeaveOpenIsDecidedByThePrint) {
  ObjectModel pegged = Block("pegged");
  pegged.symmetries.clear();
  Append(BoxMesh({0.004, 0.004, 0.004}), {0.028, 0.0, 0.018}, &pegged.mesh);
  pegged.diameter_m = DiameterOf(pegged.mesh);
  const Scene learnt_from(pegged.mesh, Label, 0.4, -0.2), scene(pegged.mesh, Label, 1.0, -0.2);
  ObjectModel printed = pegged;
  const std::vector<PrintSights> instances{learnt_from.Of()};
  printed.print = LearnPrint(pegged, instances).value();
  const auto open_of = [&](const ObjectModel& model) {
    Answered answered(model, scene, {});
    EXPECT_FALSE(answered.objects[0]->near_symmetries.empty());
    double open = 0.0;
    for (const PoseChoice& c :
         FindPoseAlternatives(answered.context,
                              scene.images,
                              answered.result,
                              0,
                              RatePoses(answered.context, scene.images, answered.result, 0)))
      open += c.probability;
    return open;
  };
  EXPECT_GT(open_of(pegged), 0.3);
  EXPECT_LT(open_of(printed), 0.05);
}

}  // namespace
}  // namespace horopter
