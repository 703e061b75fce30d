#include "horopter/v1/recognition.pb.h"
#include "server/service/convert.h"

namespace horopter {
namespace {

v1::Explanation::Test TestToProto(AcceptanceTest test) {
  switch (test) {
    case AcceptanceTest::kNone:
      return v1::Explanation::TEST_UNSPECIFIED;
    case AcceptanceTest::kFeatures:
      return v1::Explanation::TEST_FEATURES;
    case AcceptanceTest::kHypothesis:
      return v1::Explanation::TEST_HYPOTHESIS;
    case AcceptanceTest::kLink:
      return v1::Explanation::TEST_LINK;
    case AcceptanceTest::kSearch:
      return v1::Explanation::TEST_SEARCH;
    case AcceptanceTest::kSupport:
      return v1::Explanation::TEST_SUPPORT;
    case AcceptanceTest::kPlace:
      return v1::Explanation::TEST_PLACE;
    case AcceptanceTest::kChance:
      return v1::Explanation::TEST_CHANCE;
    case AcceptanceTest::kFocal:
      return v1::Explanation::TEST_FOCAL;
    case AcceptanceTest::kParallax:
      return v1::Explanation::TEST_PARALLAX;
    case AcceptanceTest::kContradiction:
      return v1::Explanation::TEST_CONTRADICTION;
    case AcceptanceTest::kCommonCameras:
      return v1::Explanation::TEST_COMMON_CAMERAS;
  }
  return v1::Explanation::TEST_UNSPECIFIED;
}

v1::ExplainedEdge::State EdgeStateToProto(EdgeState state) {
  switch (state) {
    case EdgeState::kSupported:
      return v1::ExplainedEdge::STATE_SUPPORTED;
    case EdgeState::kUnsupported:
      return v1::ExplainedEdge::STATE_UNSUPPORTED;
    case EdgeState::kHidden:
      return v1::ExplainedEdge::STATE_HIDDEN;
  }
  return v1::ExplainedEdge::STATE_UNSPECIFIED;
}

void ViewToProto(const ExplainedView& view, v1::ExplainedImage* proto) {
  RigidToProto(view.camera_from_object, proto->mutable_camera_from_object());
  v1::Camera* camera = proto->mutable_camera();
  camera->set_recovered(true);
  camera->set_image_width_px(view.camera.width);
  camera->set_image_height_px(view.camera.height);
  camera->set_focal_px(view.camera.focal_px);
  camera->set_principal_point_x_px(view.camera.cx);
  camera->set_principal_point_y_px(view.camera.cy);
  camera->set_k1(view.camera.k1);
  proto->set_score(view.score);
  proto->set_visible_px(view.edges.visible_px);
  proto->set_supported_px(view.edges.supported_px);
  proto->set_hidden_px(view.edges.hidden_px);
  for (const EdgeRun& run : view.edges.runs) {
    v1::ExplainedEdge* edge = proto->add_edges();
    if (run.edge >= 0) edge->set_edge(run.edge);
    edge->set_state(EdgeStateToProto(run.state));
    for (const Eigen::Vector2d& p : run.points) {
      edge->add_points_px(static_cast<float>(p.x()));
      edge->add_points_px(static_cast<float>(p.y()));
    }
  }
}

}  // namespace

void ExplanationToProto(const AnswerExplanation& explanation, v1::Explanation* proto) {
  proto->set_object(ObjectName(explanation.object_id));
  proto->set_failed_test(TestToProto(explanation.found.failed));
  proto->set_value(explanation.found.value);
  proto->set_needed(explanation.found.needed);
  if (!explanation.other_id.empty()) proto->set_other_object(ObjectName(explanation.other_id));
  proto->set_detail(explanation.found.detail);
  for (const auto& view : explanation.found.views) {
    v1::ExplainedImage* image = proto->add_images();
    if (view) ViewToProto(*view, image);
  }
}

}  // namespace horopter
