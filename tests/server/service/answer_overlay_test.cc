// The drawings that an answer brings.
#include "server/service/answer_overlay.h"

#include <gmock/gmock.h>
#include <grpcpp/grpcpp.h>
#include <gtest/gtest.h>

#include <algorithm>
#include <opencv2/core.hpp>
#include <opencv2/imgcodecs.hpp>

#include "server/service/rpc_status.h"
#include "tests/support/fake_objects.h"
#include "tests/support/service_fixture.h"

namespace horopter {
namespace {

constexpr int kWidth = 160, kHeight = 120;

std::string GreyPng() {
  std::vector<unsigned char> bytes;
  cv::imencode(".png", cv::Mat(kHeight, kWidth, CV_8UC1, cv::Scalar(90)), bytes);
  return {bytes.begin(), bytes.end()};
}

// The first object of the catalog half a metre away in the first image; the second has no camera.
// What is to be explained has one supported and one missing edge in the first image.
absl::StatusOr<PipelineResult> Answer(const SceneRequest& request,
                                      const CatalogSnapshot& catalog,
                                      const CallLimits&) {
  PipelineResult result;
  SceneAnswer& answer = result.answer;
  answer.cameras.resize(request.images.size());
  PosedCamera posed;
  posed.camera = CenteredCamera(kWidth, kHeight, 300);
  answer.cameras[0] = posed;
  AnswerObject object;
  object.object_id = ModelOfFake(*catalog.objects[0]).id;
  object.scene_from_object.t = {0, 0, 0.5};
  object.score = 0.75;
  SceneGrasp cup;
  cup.scene_from_gripper = object.scene_from_object;
  cup.suction = true;
  cup.cup_radius_m = 0.01;
  object.grasps.push_back(cup);
  answer.objects.push_back(object);
  answer.joint_covariance = Eigen::MatrixXd::Zero(6, 6);
  answer.plane = SupportingPlane{-Eigen::Vector3d::UnitY(), -0.02};
  if (request.unexplained_edges) {
    answer.unexplained_edges.resize(request.images.size());
    answer.unexplained_edges[0] = {{{100, 100}, {140, 100}}};
  }
  if (!request.explained.empty()) {
    Explanation found;
    found.failed = AcceptanceTest::kSupport;
    found.value = 0.25;
    found.needed = 0.5;
    found.detail = "told";
    found.views.resize(request.images.size());
    ExplainedView& view = found.views[0].emplace();
    view.camera = posed.camera;
    view.camera_from_object = object.scene_from_object;
    view.edges.runs = {{0, EdgeState::kSupported, {{10, 40}, {60, 40}}},
                       {-1, EdgeState::kUnsupported, {{10, 60}, {60, 60}}},
                       {2, EdgeState::kHidden, {{10, 80}, {60, 80}}}};
    view.edges.visible_px = 100;
    view.edges.supported_px = 50;
    view.edges.hidden_px = 50;
    answer.explanation = AnswerExplanation{request.explained, "other", std::move(found)};
  }
  return absl::StatusOr<PipelineResult>(std::move(result));
}

class AnswerOverlay : public testing::Test {
 protected:
  AnswerOverlay() : server_(Answer) {
    EXPECT_TRUE(server_.Enrol("part"));
    for (int i = 0; i < 2; ++i) request_.add_images()->set_content(GreyPng());
  }

  grpc::Status Call() {
    grpc::ClientContext context;
    answer_.Clear();
    const grpc::Status status = server_.recognition().RecognizeScene(&context, request_, &answer_);
    field_ = Trailing(context, kErrorFieldKey);
    return status;
  }

  cv::Mat Decoded(int i) const {
    const std::string& bytes = answer_.overlays(i).content();
    return cv::imdecode(std::vector<uchar>(bytes.begin(), bytes.end()), cv::IMREAD_UNCHANGED);
  }

  TestServer server_;
  v1::RecognizeSceneRequest request_;
  v1::RecognizeSceneResponse answer_;
  std::string field_;
};

TEST_F(AnswerOverlay, NothingIsDrawnOrExplainedUnasked) {
  ASSERT_TRUE(Call().ok());
  EXPECT_EQ(answer_.overlays_size(), 0);
  EXPECT_FALSE(answer_.has_explanation());
}

TEST_F(AnswerOverlay, EachImageComesBackAsAPngOfItsSizeWithTheAnswerOnIt) {
  request_.mutable_overlay();
  ASSERT_TRUE(Call().ok());
  ASSERT_EQ(answer_.overlays_size(), 2);
  for (int i = 0; i < 2; ++i) {
    EXPECT_EQ(answer_.overlays(i).format(), v1::OverlayOptions::FORMAT_PNG);
    const cv::Mat image = Decoded(i);
    ASSERT_EQ(image.size(), cv::Size(kWidth, kHeight));
    ASSERT_EQ(image.type(), CV_8UC3);
  }
  // Wireframes are green, and only where there is a camera.
  const auto green = [](const cv::Mat& image) {
    cv::Mat mask;
    cv::inRange(image, cv::Scalar(0, 180, 0), cv::Scalar(120, 255, 120), mask);
    return cv::countNonZero(mask);
  };
  EXPECT_GT(green(Decoded(0)), 50);
  EXPECT_EQ(green(Decoded(1)), 0);
  EXPECT_EQ(answer_.stages(answer_.stages_size() - 1).stage(), "overlay");
}

TEST_F(AnswerOverlay, AnSvgHasNamesAndScores) {
  request_.mutable_overlay()->set_format(v1::OverlayOptions::FORMAT_SVG);
  ASSERT_TRUE(Call().ok());
  ASSERT_EQ(answer_.overlays_size(), 2);
  const std::string& svg = answer_.overlays(0).content();
  EXPECT_THAT(svg, testing::HasSubstr("viewBox=\"0 0 160 120\""));
  EXPECT_THAT(svg, testing::HasSubstr(" 0.75</text>"));
  EXPECT_THAT(svg, testing::HasSubstr("#9696aa"));  // the plane's grid
  EXPECT_THAT(answer_.overlays(1).content(), testing::HasSubstr("camera not recovered"));
}

TEST_F(AnswerOverlay, ASuctionGraspIsDrawnAsACup) {
  request_.mutable_overlay()->set_format(v1::OverlayOptions::FORMAT_SVG);
  ASSERT_TRUE(Call().ok());
  const std::string& svg = answer_.overlays(0).content();
  const size_t from = svg.find("stroke=\"#ffa500\"");
  ASSERT_NE(from, std::string::npos);
  const std::string rim = svg.substr(from, svg.find('\n', from) - from);
  EXPECT_GT(std::count(rim.begin(), rim.end(), ','), 12);  // fingers have four points
}

TEST_F(AnswerOverlay, ObjectsBelowTheLeastScoreAreNotDrawn) {
  request_.mutable_overlay()->set_format(v1::OverlayOptions::FORMAT_SVG);
  request_.set_min_score(0.8);
  ASSERT_TRUE(Call().ok());
  EXPECT_EQ(answer_.objects_below_min_score(), 1);
  EXPECT_THAT(answer_.overlays(0).content(), testing::Not(testing::HasSubstr(" 0.75</text>")));
}

TEST_F(AnswerOverlay, ABasicAnswerHasWhatWasAskedFor) {
  request_.mutable_overlay();
  request_.set_explain_object("objects/part");
  request_.set_view(v1::ANSWER_VIEW_BASIC);
  ASSERT_TRUE(Call().ok());
  EXPECT_EQ(answer_.overlays_size(), 2);
  EXPECT_TRUE(answer_.has_explanation());
  EXPECT_EQ(answer_.stages_size(), 0);
}

TEST_F(AnswerOverlay, UnexplainedEdgesAreDrawnOnRequest) {
  request_.mutable_overlay()->set_format(v1::OverlayOptions::FORMAT_SVG);
  ASSERT_TRUE(Call().ok());
  EXPECT_THAT(answer_.overlays(0).content(), testing::Not(testing::HasSubstr("100.5,100.5")));
  request_.mutable_overlay()->set_unexplained_edges(true);
  ASSERT_TRUE(Call().ok());
  EXPECT_THAT(answer_.overlays(0).content(),
              testing::HasSubstr("points=\"100.5,100.5 140.5,100.5\""));
}

TEST_F(AnswerOverlay, RegionsAreToldAndDrawnInTheirImage) {
  request_.mutable_overlay()->set_format(v1::OverlayOptions::FORMAT_SVG);
  v1::ImageRegion* region = request_.mutable_images(1)->add_regions();
  region->set_x_px(20);
  region->set_y_px(30);
  region->set_width_px(40);
  region->set_height_px(50);
  ASSERT_TRUE(Call().ok());
  const auto box =
      testing::HasSubstr("points=\"20.0,30.0 60.0,30.0 60.0,80.0 20.0,80.0 20.0,30.0\"");
  EXPECT_THAT(answer_.overlays(0).content(), testing::Not(box));
  EXPECT_THAT(answer_.overlays(1).content(), box);
  EXPECT_EQ(answer_.cameras(0).regions_size(), 0);
  ASSERT_EQ(answer_.cameras(1).regions_size(), 1);
  EXPECT_EQ(answer_.cameras(1).regions(0).width_px(), 40);
  region->set_x_px(kWidth);
  EXPECT_EQ(Call().error_code(), grpc::StatusCode::INVALID_ARGUMENT);
  EXPECT_EQ(field_, "images[1].regions[0]");
}

// The second camera looks the other way.
TEST_F(AnswerOverlay, BoxesInTheBaseAreDrawnWhereTheImagesShowThem) {
  request_.mutable_overlay()->set_format(v1::OverlayOptions::FORMAT_SVG);
  v1::SpaceRegion* box = request_.add_regions();
  box->mutable_base_from_region()->mutable_rotation()->set_w(1.0);
  box->mutable_base_from_region()->mutable_translation_m()->set_z(0.5);
  box->mutable_size_m()->set_x(0.1);
  box->mutable_size_m()->set_y(0.1);
  box->mutable_size_m()->set_z(0.1);
  EXPECT_EQ(Call().error_code(), grpc::StatusCode::INVALID_ARGUMENT);  // no camera is known
  EXPECT_EQ(field_, "regions");
  for (int i = 0; i < 2; ++i) {
    v1::CameraHint* hint = request_.mutable_images(i)->mutable_camera_hint();
    hint->set_focal_px(300);
    (i == 0 ? hint->mutable_camera_from_base()->mutable_rotation()->set_w(1.0)
            : hint->mutable_camera_from_base()->mutable_rotation()->set_y(1.0));
  }
  ASSERT_TRUE(Call().ok());
  ASSERT_EQ(answer_.cameras(0).regions_size(), 1);
  const v1::ImageRegion& seen = answer_.cameras(0).regions(0);
  EXPECT_NEAR(seen.x_px() + 0.5 * seen.width_px(), 80.0, 1e-6);
  EXPECT_GT(seen.width_px(), 300 * 0.1 / 0.45);
  EXPECT_LT(seen.width_px(), 300 * 0.1 / 0.45 + 40.0);
  EXPECT_THAT(answer_.overlays(0).content(), testing::HasSubstr("#00c8ff"));
  EXPECT_TRUE(answer_.cameras(1).region_empty());
  EXPECT_THAT(answer_.overlays(1).content(), testing::HasSubstr("not searched"));
}

TEST_F(AnswerOverlay, AnExplanationIsToldAndDrawnEdgeByEdge) {
  request_.set_explain_object("objects/part");
  request_.mutable_overlay();
  ASSERT_TRUE(Call().ok());
  const v1::Explanation& told = answer_.explanation();
  EXPECT_EQ(told.object(), "objects/part");
  EXPECT_EQ(told.other_object(), "objects/other");
  EXPECT_EQ(told.failed_test(), v1::Explanation::TEST_SUPPORT);
  EXPECT_EQ(told.value(), 0.25);
  EXPECT_EQ(told.needed(), 0.5);
  ASSERT_EQ(told.images_size(), 2);
  EXPECT_FALSE(told.images(1).has_camera_from_object());
  ASSERT_EQ(told.images(0).edges_size(), 3);
  EXPECT_EQ(told.images(0).edges(0).edge(), 0);
  EXPECT_FALSE(told.images(0).edges(1).has_edge());
  EXPECT_EQ(told.images(0).edges(2).state(), v1::ExplainedEdge::STATE_HIDDEN);
  EXPECT_THAT(told.images(0).edges(0).points_px(), testing::ElementsAre(10, 40, 60, 40));
  // Green, red and blue at their places.
  const cv::Mat image = Decoded(0);
  EXPECT_GT(image.at<cv::Vec3b>(40, 30)[1], 180);
  EXPECT_GT(image.at<cv::Vec3b>(60, 30)[2], 180);
  EXPECT_GT(image.at<cv::Vec3b>(80, 30)[0], 180);
}

TEST_F(AnswerOverlay, WhatCannotBeAskedForIsRefused) {
  request_.set_explain_object("part");
  EXPECT_EQ(Call().error_code(), grpc::StatusCode::INVALID_ARGUMENT);
  EXPECT_EQ(field_, "explain_object");
  request_.set_explain_object("objects/nobody");
  EXPECT_EQ(Call().error_code(), grpc::StatusCode::NOT_FOUND);
  EXPECT_EQ(field_, "explain_object");
  request_.clear_explain_object();
  request_.mutable_overlay()->set_format(static_cast<v1::OverlayOptions::Format>(9));
  EXPECT_EQ(Call().error_code(), grpc::StatusCode::INVALID_ARGUMENT);
  EXPECT_EQ(field_, "overlay.format");
}

}  // namespace
}  // namespace horopter
