#include "server/service/recognition_service.h"

#include <gmock/gmock.h>
#include <grpcpp/grpcpp.h>
#include <gtest/gtest.h>

#include <cmath>
#include <opencv2/core.hpp>

#include "server/service/rpc_status.h"
#include "tests/server/service/recording_recognizer.h"
#include "tests/support/fake_objects.h"
#include "tests/support/png_size.h"
#include "tests/support/service_fixture.h"

namespace horopter {
namespace {

class RecognitionServiceTest : public testing::Test {
 protected:
  RecognitionServiceTest() : server_(Recording(seen_)) {}

  grpc::Status Call(const v1::RecognizeSceneRequest& request) {
    grpc::ClientContext context;
    answer_.Clear();
    const grpc::Status status = server_.recognition().RecognizeScene(&context, request, &answer_);
    field_ = Trailing(context, kErrorFieldKey);
    return status;
  }

  // INVALID_ARGUMENT that names the field; the recognizer is not bothered.
  void ExpectRefused(const v1::RecognizeSceneRequest& request,
                     const std::string& field,
                     const std::string& says) {
    const int calls = seen_.calls;
    const grpc::Status status = Call(request);
    EXPECT_EQ(status.error_code(), grpc::StatusCode::INVALID_ARGUMENT) << status.error_message();
    EXPECT_EQ(field_, field);
    EXPECT_THAT(status.error_message(),
                testing::AllOf(testing::HasSubstr(field), testing::HasSubstr(says)));
    EXPECT_EQ(seen_.calls, calls);
  }

  static v1::RecognizeSceneRequest WithImages(const std::vector<std::string>& images) {
    v1::RecognizeSceneRequest request;
    for (const std::string& image : images) request.add_images()->set_content(image);
    return request;
  }

  Seen seen_;
  TestServer server_;
  v1::RecognizeSceneResponse answer_;
  std::string field_;
};

TEST_F(RecognitionServiceTest, OneImageIsEnoughAndTheEmptyCatalogIsAReason) {
  ASSERT_TRUE(Call(WithImages({Png(48, 64)})).ok());
  ASSERT_EQ(answer_.reasons_size(), 1);
  EXPECT_EQ(answer_.reasons(0).kind(), v1::SceneReason::KIND_EMPTY_CATALOG);
  EXPECT_EQ(answer_.completeness(), v1::COMPLETENESS_COMPLETE);
  ASSERT_EQ(answer_.cameras_size(), 1);
  EXPECT_EQ(answer_.cameras(0).image_width_px(), 64);
  EXPECT_FALSE(answer_.request_id().empty());
  ASSERT_EQ(answer_.stages_size(), 2);
  EXPECT_EQ(answer_.stages(0).stage(), "decode");
  EXPECT_EQ(answer_.stages(1).stage(), "features");
  EXPECT_TRUE(seen_.hints.empty());
}

TEST_F(RecognitionServiceTest, IdenticalImagesAreThePipelinesBusiness) {
  const std::string image = Png(48, 64);
  ASSERT_TRUE(Call(WithImages({image, image, image})).ok());
  EXPECT_EQ(seen_.images.size(), 3u);
}

TEST_F(RecognitionServiceTest, GreyAndSixteenBitImagesArriveAsEightBit) {
  ASSERT_TRUE(
      Call(WithImages({Png(20, 20, CV_8UC1), Png(20, 20, CV_16UC1), Png(20, 20, CV_16UC3)})).ok());
  EXPECT_EQ(seen_.images[0].type(), CV_8UC1);
  EXPECT_EQ(seen_.images[1].type(), CV_8UC1);
  EXPECT_EQ(seen_.images[2].type(), CV_8UC3);
}

TEST_F(RecognitionServiceTest, RefusesBadImagesByTheirIndexAndStaysUp) {
  const std::string good = Png(32, 32);
  ExpectRefused({}, "images", "at least one");
  ExpectRefused(WithImages(std::vector<std::string>(33, good)), "images", "at most 32");
  ExpectRefused(WithImages({good, ""}), "images[1].content", "empty");
  ExpectRefused(WithImages({good, good, "junk"}), "images[2].content", "not an image");
  ExpectRefused(WithImages({Png(1, 1), good}), "images[0].content", "too small");
  ExpectRefused(WithImages({good, good.substr(0, good.size() / 2)}), "images[1].content", "");
  const std::string huge = WithPngSize(good, 65535, 65535);
  ExpectRefused(WithImages({good, huge}), "images[1].content", "65535x65535 pixels is too large");
  EXPECT_TRUE(Call(WithImages({good})).ok());
}

TEST_F(RecognitionServiceTest, HintsArriveAsGivenAndBadOnesAreRefused) {
  v1::RecognizeSceneRequest request = WithImages({Png(32, 32), Png(32, 32)});
  v1::CameraHint* hint = request.mutable_images(1)->mutable_camera_hint();
  hint->set_focal_px(800.0);
  hint->set_k1(-0.05);
  ASSERT_TRUE(Call(request).ok());
  ASSERT_EQ(seen_.hints.size(), 2u);
  EXPECT_FALSE(seen_.hints[0].focal_px.has_value());
  EXPECT_EQ(seen_.hints[1].focal_px, 800.0);
  EXPECT_EQ(seen_.hints[1].k1, -0.05);
  EXPECT_FALSE(seen_.hints[1].principal_point.has_value());

  hint->set_principal_point_x_px(16.0);
  ExpectRefused(request, "images[1].camera_hint.principal_point_x_px", "together");
  hint->set_principal_point_y_px(16.0);
  EXPECT_TRUE(Call(request).ok());
  for (const double bad : {0.0, -1.0, std::nan(""), 1e300}) {
    hint->set_focal_px(bad);
    ExpectRefused(request, "images[1].camera_hint.focal_px", "");
  }
  hint->clear_focal_px();
  hint->set_focal_log_sigma(0.1);
  ExpectRefused(request, "images[1].camera_hint.focal_log_sigma", "without focal_px");
}

TEST_F(RecognitionServiceTest, WhatIsNoCameraOfTheImageIsRefused) {
  v1::RecognizeSceneRequest request = WithImages({Png(32, 64)});
  v1::SceneImage* image = request.mutable_images(0);
  v1::CameraHint* hint = image->mutable_camera_hint();
  const std::string field = "images[0].camera_hint";
  hint->set_principal_point_x_px(30.0);
  hint->set_principal_point_y_px(15.0);
  for (const double focal : {1.0, 12.0, 64.0 * 41.0}) {
    hint->set_focal_px(focal);
    ExpectRefused(request, field + ".focal_px", "64 x 32");
  }
  for (const double focal : {13.0, 64.0 * 40.0}) {
    hint->set_focal_px(focal);
    EXPECT_TRUE(Call(request).ok()) << focal;
  }
  hint->set_focal_px(80.0);
  for (const auto& [x, y] : {std::pair{-1.0, 15.0}, {64.0, 15.0}, {30.0, 32.0}, {30.0, -5.0}}) {
    hint->set_principal_point_x_px(x);
    hint->set_principal_point_y_px(y);
    image->set_cropped(false);
    ExpectRefused(request, field + ".principal_point_x_px", "cropped");
    image->set_cropped(true);
    EXPECT_TRUE(Call(request).ok()) << x << " " << y;
  }
  image->set_cropped(false);
  hint->set_principal_point_x_px(30.0);
  hint->set_principal_point_y_px(15.0);
  for (const double fy : {39.0, 161.0}) {
    hint->set_focal_y_px(fy);
    ExpectRefused(request, field + ".focal_y_px", "does not go with");
  }
  hint->clear_focal_y_px();
  hint->set_k1(-3.0);
  ExpectRefused(request, field + ".k1", "fold");
  hint->set_k2(9.0);  // which takes the fold back
  EXPECT_TRUE(Call(request).ok());
  hint->set_k2(-1.0);
  ExpectRefused(request, field + ".k1", "fold");
  hint->clear_k1();
  hint->clear_k2();
  hint->mutable_fisheye()->set_k1(-3.0);
  ExpectRefused(request, field + ".fisheye", "fold");
}

TEST_F(RecognitionServiceTest, ARationalLensIsRectified) {
  v1::RecognizeSceneRequest request = WithImages({Png(32, 32), Png(32, 32)});
  v1::CameraHint* hint = request.mutable_images(1)->mutable_camera_hint();
  hint->set_k4(0.8);
  ExpectRefused(request, "images[1].camera_hint.focal_px", "the lens needs it");
  hint->set_focal_px(20.0);
  hint->set_principal_point_x_px(15.0);
  hint->set_principal_point_y_px(16.0);
  hint->set_k1(0.1);
  ASSERT_TRUE(Call(request).ok());
  EXPECT_TRUE(answer_.cameras(1).rectified());
  EXPECT_EQ(seen_.hints[1].k1, 0.0);
  cv::Mat difference;
  cv::absdiff(seen_.images[0], seen_.images[1], difference);
  EXPECT_GT(cv::norm(difference), 0.0);
  // Large ones that take each other back.
  hint->set_k1(50.0);
  hint->set_k4(50.2);
  EXPECT_TRUE(Call(request).ok());
  hint->set_k6(101.0);
  ExpectRefused(request, "images[1].camera_hint.k6", "out of range");
  hint->set_k6(0.0);
  hint->set_p1(11.0);
  ExpectRefused(request, "images[1].camera_hint.p1", "out of range");
  hint->clear_p1();
  hint->mutable_fisheye();
  ExpectRefused(request, "images[1].camera_hint.fisheye", "together");
}

TEST_F(RecognitionServiceTest, ALensIsRectifiedAndWhatIsKnownOfTheImageComesBack) {
  v1::RecognizeSceneRequest request = WithImages({Png(32, 32), Png(32, 32)});
  v1::SceneImage* image = request.mutable_images(1);
  image->set_camera_id("left");
  image->set_frame_id("left_optical_frame");
  image->mutable_capture_time()->set_seconds(1234);
  v1::CameraHint* hint = image->mutable_camera_hint();
  hint->set_focal_px(40.0);
  hint->set_k2(0.5);
  ExpectRefused(request, "images[1].camera_hint.principal_point_x_px", "the lens needs it");
  hint->set_principal_point_x_px(15.0);
  hint->set_principal_point_y_px(16.0);
  ASSERT_TRUE(Call(request).ok());
  EXPECT_EQ(answer_.cameras(1).camera_id(), "left");
  EXPECT_EQ(answer_.cameras(1).frame_id(), "left_optical_frame");
  EXPECT_EQ(answer_.cameras(1).capture_time().seconds(), 1234);
  EXPECT_TRUE(answer_.cameras(1).rectified());
  EXPECT_FALSE(answer_.cameras(0).rectified());
  EXPECT_FALSE(answer_.cameras(0).has_capture_time());
  EXPECT_EQ(seen_.hints[1].k1, 0.0);
  // The same bytes were sent twice, and one of them is another image now.
  cv::Mat difference;
  cv::absdiff(seen_.images[0], seen_.images[1], difference);
  EXPECT_GT(cv::norm(difference), 0.0);

  hint->set_focal_y_px(400.0);
  ExpectRefused(request, "images[1].camera_hint.focal_y_px", "does not go with");
  hint->clear_focal_y_px();
  hint->mutable_fisheye()->set_k1(0.1);
  ExpectRefused(request, "images[1].camera_hint.fisheye", "together");
  hint->clear_k2();
  hint->mutable_fisheye()->set_k3(std::nan(""));
  ExpectRefused(request, "images[1].camera_hint.fisheye.k3", "out of range");
  hint->clear_fisheye();
  EXPECT_TRUE(Call(request).ok());
  image->set_frame_id(std::string(256, 'f'));
  ExpectRefused(request, "images[1].frame_id", "255");
}

TEST_F(RecognitionServiceTest, TheGripperArrivesAndViewAndScoreAreChecked) {
  v1::RecognizeSceneRequest request = WithImages({Png(32, 32)});
  ASSERT_TRUE(Call(request).ok());
  EXPECT_FALSE(seen_.gripper);
  request.mutable_gripper();
  ExpectRefused(request, "gripper", "neither");
  request.mutable_gripper()->mutable_parallel_jaw()->set_finger_length_m(0.05);
  ExpectRefused(request, "gripper.parallel_jaw.finger_width_m", "");
  request.mutable_gripper()->mutable_parallel_jaw()->set_finger_width_m(0.02);
  request.mutable_gripper()->mutable_parallel_jaw()->set_finger_thickness_m(0.01);
  request.mutable_gripper()->set_approach_m(0.1);
  ASSERT_TRUE(Call(request).ok());
  ASSERT_TRUE(seen_.gripper && seen_.gripper->parallel_jaw);
  EXPECT_FALSE(seen_.gripper->suction);
  EXPECT_EQ(seen_.gripper->parallel_jaw->finger_width_m, 0.02);
  EXPECT_EQ(seen_.gripper->approach_m, 0.1);
  request.mutable_gripper()->mutable_suction()->set_length_m(-1.0);
  ExpectRefused(request, "gripper.suction.length_m", "");
  request.clear_gripper();
  request.set_min_score(1.5);
  ExpectRefused(request, "min_score", "");
  request.set_min_score(0.5);
  for (const double share : {0.0, 1.0, -0.1, std::nan("")}) {
    request.set_unknown_share(share);
    ExpectRefused(request, "unknown_share", "");
  }
  request.set_unknown_share(0.3);
  ASSERT_TRUE(Call(request).ok());
  EXPECT_EQ(seen_.unknown_share, 0.3);
  request.clear_unknown_share();
  ASSERT_TRUE(Call(request).ok());
  EXPECT_EQ(seen_.unknown_share, kNominalUnknownShare);
  request.set_view(static_cast<v1::AnswerView>(9));
  ExpectRefused(request, "view", "");
  request.set_view(v1::ANSWER_VIEW_BASIC);
  ASSERT_TRUE(Call(request).ok());
  EXPECT_EQ(answer_.stages_size(), 0);
}

TEST_F(RecognitionServiceTest, PoseHintsArriveAsGivenAndBadOnesAreRefused) {
  v1::RecognizeSceneRequest request = WithImages({Png(32, 32), Png(32, 32)});
  v1::CameraHint* hint = request.mutable_images(1)->mutable_camera_hint();
  hint->mutable_camera_from_base()->mutable_rotation()->set_w(1.0);
  hint->mutable_camera_from_base()->mutable_translation_m()->set_z(0.8);
  hint->set_rotation_sigma_rad(0.02);
  ASSERT_TRUE(Call(request).ok());
  ASSERT_EQ(seen_.camera_poses.size(), 2u);
  EXPECT_FALSE(seen_.camera_poses[0]);
  ASSERT_TRUE(seen_.camera_poses[1]);
  EXPECT_EQ(seen_.camera_poses[1]->camera_from_base.t.z(), 0.8);
  EXPECT_EQ(seen_.camera_poses[1]->rotation_sigma_rad, 0.02);
  EXPECT_EQ(seen_.camera_poses[1]->position_sigma_m, CameraPoseHint().position_sigma_m);

  for (const double bad : {0.0, -1.0, std::nan(""), 1e300}) {
    hint->set_rotation_sigma_rad(bad);
    ExpectRefused(request, "images[1].camera_hint.rotation_sigma_rad", "");
  }
  hint->set_rotation_sigma_rad(0.02);
  hint->mutable_camera_from_base()->mutable_rotation()->set_w(0.0);
  ExpectRefused(request, "images[1].camera_hint.camera_from_base.rotation", "");
  hint->clear_camera_from_base();
  ExpectRefused(request, "images[1].camera_hint.rotation_sigma_rad", "without camera_from_base");
}

TEST_F(RecognitionServiceTest, CandidatesAndReferenceMustBeInTheCatalog) {
  ASSERT_TRUE(server_.Enrol("box"));
  v1::RecognizeSceneRequest request = WithImages({Png(32, 32)});
  request.add_candidate_objects("objects/box");
  request.mutable_reference()->set_object("objects/box");
  request.mutable_reference()->mutable_base_from_object()->mutable_rotation()->set_w(1.0);
  ASSERT_TRUE(Call(request).ok());
  EXPECT_THAT(seen_.candidates, testing::ElementsAre("box"));
  EXPECT_EQ(seen_.reference->object_id, "box");
  EXPECT_EQ(answer_.catalog_generation(), 1);  // one write

  request.add_candidate_objects("objects/nut");
  grpc::Status status = Call(request);
  EXPECT_EQ(status.error_code(), grpc::StatusCode::NOT_FOUND);
  EXPECT_EQ(field_, "candidate_objects[1]");
  EXPECT_THAT(status.error_message(), testing::HasSubstr("objects/nut"));

  request.mutable_candidate_objects()->RemoveLast();
  request.mutable_reference()->set_object("objects/nut");
  EXPECT_EQ(Call(request).error_code(), grpc::StatusCode::NOT_FOUND);
  EXPECT_EQ(field_, "reference.object");

  request.mutable_reference()->set_object("box");
  ExpectRefused(request, "reference.object", "objects/{object}");
  request.mutable_reference()->set_object("objects/box");
  request.mutable_reference()->mutable_base_from_object()->clear_rotation();
  ExpectRefused(request, "reference.base_from_object.rotation", "missing");
}

TEST_F(RecognitionServiceTest, AnEnrolledObjectIsSeenByTheNextRequestAndADeletedOneIsNot) {
  for (const char* id : {"nut", "box", "rod"}) ASSERT_TRUE(server_.Enrol(id));
  ASSERT_TRUE(Call(WithImages({Png(32, 32)})).ok());
  EXPECT_THAT(seen_.catalog_ids, testing::ElementsAre("box", "nut", "rod"));
  grpc::ClientContext context;
  v1::DeleteObjectRequest request;
  request.set_name("objects/nut");
  google::protobuf::Empty empty;
  ASSERT_TRUE(server_.catalog().DeleteObject(&context, request, &empty).ok());
  ASSERT_TRUE(Call(WithImages({Png(32, 32)})).ok());
  EXPECT_THAT(seen_.catalog_ids, testing::ElementsAre("box", "rod"));
}

}  // namespace
}  // namespace horopter
