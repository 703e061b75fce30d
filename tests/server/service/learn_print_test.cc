// What is printed on a part is learnt over the wire from scenes that were answered.
#include <grpcpp/grpcpp.h>
#include <gtest/gtest.h>

#include <Eigen/Geometry>
#include <algorithm>
#include <numbers>
#include <opencv2/imgcodecs.hpp>

#include "server/service/convert.h"
#include "server/service/rpc_status.h"
#include "tests/support/printed_photo.h"
#include "tests/support/service_fixture.h"
#include "tests/support/solid_meshes.h"
#include "tests/support/synthetic_part.h"

namespace horopter {
namespace {

using grpc::StatusCode;
using Stub = v1::CatalogService::Stub;

const Eigen::Vector3d kHalf(0.04, 0.025, 0.014);

double Label(const Eigen::Vector3d& p) {
  return (p - Eigen::Vector3d(0.02, 0.008, p.z())).norm() < 0.01 ? 0.35 : 1.0;
}
double Plain(const Eigen::Vector3d&) {
  return 1.0;
}

v1::Object BlockObject() {
  const TriangleMesh mesh = BoxMesh(kHalf);
  v1::Object object;
  for (const Eigen::Vector3d& v : mesh.vertices) {
    for (const double x : v) object.mutable_mesh()->add_vertices_m(x);
  }
  for (const Eigen::Vector3i& t : mesh.triangles) {
    for (const int i : t) object.mutable_mesh()->add_triangles(i);
  }
  const Eigen::AngleAxisd turn(std::numbers::pi, Eigen::Vector3d::UnitZ());
  RigidToProto({turn.toRotationMatrix(), Eigen::Vector3d::Zero()},
               object.add_object_from_symmetric_object());
  return object;
}

// Three images of the block in the scene's origin, and what they were answered.
v1::AnsweredScene Answered(const PrintPattern& print, double first_rad = 0.4) {
  const TriangleMesh mesh = BoxMesh(kHalf);
  const PinholeCamera camera = CenteredCamera(640, 480, 800);
  v1::AnsweredScene scene;
  for (int v = 0; v < 3; ++v) {
    const double a = first_rad + 0.6 * v;
    const Rigid3 from_scene = LookAt({0.2 * std::sin(a), -0.2 * std::cos(a), 0.2}, {0.0, 0.0, 0.0});
    std::vector<std::uint8_t> bytes;
    cv::imencode(".png", PrintedPhoto(mesh, print, camera, from_scene), bytes);
    scene.mutable_request()->add_images()->set_content(bytes.data(), bytes.size());
    v1::Camera& out = *scene.mutable_response()->add_cameras();
    out.set_recovered(true);
    out.set_image_width_px(camera.width);
    out.set_image_height_px(camera.height);
    out.set_focal_px(camera.focal_px);
    out.set_principal_point_x_px(camera.cx);
    out.set_principal_point_y_px(camera.cy);
    RigidToProto(from_scene, out.mutable_camera_from_scene());
  }
  v1::RecognizedObject& object = *scene.mutable_response()->add_objects();
  object.set_object("objects/block");
  RigidToProto({}, object.mutable_scene_from_object());
  return scene;
}

class LearnPrintCall : public testing::Test {
 protected:
  void SetUp() override {
    v1::CreateObjectRequest request;
    request.set_object_id("block");
    *request.mutable_object() = BlockObject();
    ASSERT_TRUE(Call(&Stub::CreateObject, request).ok());
    learn_.set_name("objects/block");
    *learn_.add_scenes() = Answered(Label);
  }
  template <typename Request, typename Method>
  grpc::Status Call(Method method, const Request& request) {
    grpc::ClientContext context;
    const grpc::Status status = (server_.catalog().*method)(&context, request, &object_);
    field_ = Trailing(context, kErrorFieldKey);
    return status;
  }
  v1::Object Get(v1::ObjectView view = v1::OBJECT_VIEW_GEOMETRY) {
    v1::GetObjectRequest request;
    request.set_name("objects/block");
    request.set_view(view);
    EXPECT_TRUE(Call(&Stub::GetObject, request).ok());
    return object_;
  }
  StatusCode Refused() { return Call(&Stub::LearnPrint, learn_).error_code(); }

  TestServer server_{nullptr};
  v1::Object object_;
  std::string field_;
  v1::LearnPrintRequest learn_;
};

TEST_F(LearnPrintCall, StoresWhatTheScenesShow) {
  EXPECT_FALSE(Get().has_print()) << "off by default";
  const grpc::Status learnt = Call(&Stub::LearnPrint, learn_);
  ASSERT_TRUE(learnt.ok()) << learnt.error_message();
  EXPECT_GT(object_.print().place_count(), 300);
  EXPECT_EQ(object_.print().view_count(), 3);
  EXPECT_EQ(object_.print().places_size(), 0) << "counts alone";
  const v1::Object now = Get();
  ASSERT_EQ(now.print().places_size(), 7 * now.print().place_count());
  // The dark disc is darker than the top it is on.
  double disc = 0.0, top = 0.0;
  int in_disc = 0, on_top = 0;
  for (int i = 0; i < now.print().places_size(); i += 7) {
    const float* p = now.print().places().data() + i;
    if (p[5] < 0.9f) continue;
    const bool dark = Label({p[0], p[1], p[2]}) < 1.0;
    (dark ? disc : top) += p[6];
    ++(dark ? in_disc : on_top);
  }
  ASSERT_GT(in_disc, 10);
  EXPECT_LT(disc / in_disc, top / on_top - 0.2);
  EXPECT_FALSE(Get(v1::OBJECT_VIEW_BASIC).has_print());
}

TEST_F(LearnPrintCall, IsAWriteThatIsKeptUndoneAndRemoved) {
  const v1::Object before = Get();
  ASSERT_TRUE(Call(&Stub::LearnPrint, learn_).ok());
  const v1::Object learnt = Get();
  EXPECT_GT(learnt.revision(), before.revision());
  v1::UpdateObjectRequest remove;
  remove.mutable_object()->set_name("objects/block");
  remove.mutable_update_mask()->add_paths("print");
  ASSERT_TRUE(Call(&Stub::UpdateObject, remove).ok());
  EXPECT_FALSE(Get().has_print());
  v1::RestoreObjectRequest restore;
  restore.set_name("objects/block");
  restore.set_revision(learnt.revision());
  ASSERT_TRUE(Call(&Stub::RestoreObject, restore).ok());
  const v1::Object back = Get();
  ASSERT_EQ(back.print().places_size(), learnt.print().places_size());
  EXPECT_TRUE(std::equal(
      back.print().places().begin(), back.print().places().end(), learnt.print().places().begin()));
  // Another shape has no print.
  v1::UpdateObjectRequest reshape;
  reshape.mutable_object()->set_name("objects/block");
  *reshape.mutable_object()->mutable_mesh() = BlockObject().mesh();
  reshape.mutable_update_mask()->add_paths("mesh");
  ASSERT_TRUE(Call(&Stub::UpdateObject, reshape).ok());
  EXPECT_FALSE(Get().has_print());
}

TEST_F(LearnPrintCall, AnObjectIsCopiedWithIt) {
  ASSERT_TRUE(Call(&Stub::LearnPrint, learn_).ok());
  v1::CreateObjectRequest copy;
  copy.set_object_id("copy");
  *copy.mutable_object() = Get(v1::OBJECT_VIEW_FULL);
  const grpc::Status made = Call(&Stub::CreateObject, copy);
  ASSERT_TRUE(made.ok()) << made.error_message();
  EXPECT_EQ(object_.print().place_count(), copy.object().print().place_count());
}

TEST_F(LearnPrintCall, WhatCannotBeLearntFromIsRefusedByItsField) {
  const v1::LearnPrintRequest good = learn_;
  learn_.set_name("objects/none");
  EXPECT_EQ(Refused(), StatusCode::NOT_FOUND);
  learn_ = good;
  learn_.clear_scenes();
  EXPECT_EQ(Refused(), StatusCode::INVALID_ARGUMENT);
  EXPECT_EQ(field_, "scenes");
  learn_ = good;
  learn_.mutable_scenes(0)->mutable_response()->clear_objects();
  EXPECT_EQ(Refused(), StatusCode::INVALID_ARGUMENT);
  EXPECT_EQ(field_, "scenes");
  learn_ = good;
  learn_.mutable_scenes(0)->mutable_response()->mutable_cameras()->RemoveLast();
  EXPECT_EQ(Refused(), StatusCode::INVALID_ARGUMENT);
  EXPECT_EQ(field_, "scenes[0].response.cameras");
  learn_ = good;
  learn_.mutable_scenes(0)->mutable_response()->mutable_cameras(1)->set_image_width_px(320);
  EXPECT_EQ(Refused(), StatusCode::INVALID_ARGUMENT);
  EXPECT_EQ(field_, "scenes[0].response.cameras[1]");
  learn_ = good;
  learn_.mutable_scenes(0)->mutable_request()->mutable_images(2)->set_content("no image");
  EXPECT_EQ(Refused(), StatusCode::INVALID_ARGUMENT);
  EXPECT_EQ(field_, "scenes[0].request.images[2].content");
  learn_ = good;
  learn_.set_if_match("another");
  EXPECT_EQ(Refused(), StatusCode::ABORTED);
  learn_ = good;
  learn_.mutable_scenes(0)->Clear();
  EXPECT_EQ(Refused(), StatusCode::INVALID_ARGUMENT);
  EXPECT_FALSE(Get().has_print());
}

TEST_F(LearnPrintCall, APlainPartAndOneViewTeachNothing) {
  *learn_.mutable_scenes(0) = Answered(Plain);
  EXPECT_EQ(Refused(), StatusCode::FAILED_PRECONDITION);
  *learn_.mutable_scenes(0) = Answered(Label);
  for (const int v : {1, 2})
    learn_.mutable_scenes(0)->mutable_response()->mutable_cameras(v)->set_recovered(false);
  EXPECT_EQ(Refused(), StatusCode::FAILED_PRECONDITION);
  EXPECT_FALSE(Get().has_print());
}

}  // namespace
}  // namespace horopter
