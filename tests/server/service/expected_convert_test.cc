// References and expected parts from the wire, and what an answer says of them.
#include "server/service/expected_convert.h"

#include <gtest/gtest.h>

#include <cmath>
#include <functional>
#include <string>
#include <utility>

#include "horopter/v1/recognition.pb.h"
#include "server/service/convert.h"
#include "server/service/reference_convert.h"
#include "server/service/rpc_status.h"

namespace horopter {
namespace {

void SetPose(double x, v1::RigidTransform* pose) {
  pose->mutable_rotation()->set_w(1.0);
  pose->mutable_translation_m()->set_x(x);
}

v1::RecognizeSceneRequest References() {
  v1::RecognizeSceneRequest request;
  request.mutable_reference()->set_object("objects/fixture");
  SetPose(0.5, request.mutable_reference()->mutable_base_from_object());
  v1::ReferenceObject* further = request.add_further_references();
  further->set_object("objects/post");
  SetPose(0.7, further->mutable_base_from_object());
  further->set_rotation_sigma_rad(0.01);
  further->set_position_sigma_m(0.002);
  return request;
}

TEST(AddReferences, TakesAllWithTheirDeviations) {
  SceneRequest request;
  ASSERT_TRUE(AddReferences(References(), &request).ok());
  const auto all = ReferencesOf(request);
  ASSERT_EQ(all.size(), 2u);
  EXPECT_EQ(all[0].object_id, "fixture");
  EXPECT_EQ(all[0].position_sigma_m, 0.0);  // exact
  EXPECT_EQ(all[1].object_id, "post");
  EXPECT_EQ(all[1].base_from_object.t.x(), 0.7);
  EXPECT_EQ(all[1].rotation_sigma_rad, 0.01);
  EXPECT_EQ(all[1].position_sigma_m, 0.002);
}

// The field that the status names.
std::string FieldOf(const absl::Status& status) {
  EXPECT_EQ(status.code(), absl::StatusCode::kInvalidArgument) << status;
  const std::string text(status.message());
  return text.substr(0, text.find(": "));
}

TEST(AddReferences, NamesTheOffendingField) {
  using Request = v1::RecognizeSceneRequest;
  const std::vector<std::pair<std::string, std::function<void(Request&)>>> cases = {
      {"further_references", [](Request& r) { r.clear_reference(); }},
      {"further_references[0].object",
       [](Request& r) { r.mutable_further_references(0)->set_object("post"); }},
      {"further_references[0].base_from_object.rotation",
       [](Request& r) { r.mutable_further_references(0)->clear_base_from_object(); }},
      {"further_references[0].position_sigma_m",
       [](Request& r) { r.mutable_further_references(0)->set_position_sigma_m(-1.0); }},
      {"reference.rotation_sigma_rad",
       [](Request& r) { r.mutable_reference()->set_rotation_sigma_rad(std::nan("")); }},
      {"further_references", [](Request& r) {
         for (int i = 0; i < 15; ++i) *r.add_further_references() = r.reference();
       }}};
  for (const auto& [field, damage] : cases) {
    v1::RecognizeSceneRequest proto = References();
    damage(proto);
    SceneRequest request;
    EXPECT_EQ(FieldOf(AddReferences(proto, &request)), field);
  }
}

v1::RecognizeSceneRequest Expecting() {
  v1::RecognizeSceneRequest request;
  v1::ExpectedPart* bolts = request.add_expected_parts();
  bolts->set_object("objects/bolt");
  bolts->set_count(3);
  v1::ExpectedPart* nut = request.add_expected_parts();
  nut->set_object("objects/nut");
  nut->set_frame_object("objects/tray");
  SetPose(0.1, nut->mutable_frame_from_object());
  nut->set_position_tolerance_m(0.02);
  nut->set_label("pocket 4");
  return request;
}

TEST(ExpectedParts, AreTakenWithTheirDefaults) {
  const auto parts = ExpectedPartsFromProto(Expecting());
  ASSERT_TRUE(parts.ok()) << parts.status();
  ASSERT_EQ(parts->size(), 2u);
  EXPECT_EQ((*parts)[0].count, 3);
  EXPECT_FALSE((*parts)[0].frame_from_object.has_value());
  EXPECT_EQ((*parts)[1].count, 1);
  EXPECT_EQ((*parts)[1].frame_object, "tray");
  EXPECT_EQ((*parts)[1].frame_from_object->t.x(), 0.1);
  EXPECT_EQ((*parts)[1].position_tolerance_m, 0.02);
  EXPECT_EQ((*parts)[1].rotation_tolerance_rad, 0.1);
  EXPECT_EQ((*parts)[1].label, "pocket 4");
}

TEST(ExpectedParts, NameTheOffendingField) {
  using Request = v1::RecognizeSceneRequest;
  const std::vector<std::pair<std::string, std::function<void(Request&)>>> cases = {
      {"expected_parts[0].object", [](Request& r) { r.mutable_expected_parts(0)->set_object(""); }},
      {"expected_parts[0].count", [](Request& r) { r.mutable_expected_parts(0)->set_count(-1); }},
      {"expected_parts[0].count", [](Request& r) { r.mutable_expected_parts(0)->set_count(201); }},
      {"expected_parts[1].count", [](Request& r) { r.mutable_expected_parts(1)->set_count(2); }},
      {"expected_parts", [](Request& r) { r.mutable_expected_parts(0)->set_count(200); }},
      {"expected_parts[0].frame_object",
       [](Request& r) { r.mutable_expected_parts(0)->set_frame_object("objects/tray"); }},
      {"expected_parts[1].frame_object",
       [](Request& r) { r.mutable_expected_parts(1)->set_frame_object("objects/nut"); }},
      {"expected_parts[0].position_tolerance_m",
       [](Request& r) { r.mutable_expected_parts(0)->set_position_tolerance_m(0.01); }},
      {"expected_parts[1].position_tolerance_m",
       [](Request& r) { r.mutable_expected_parts(1)->set_position_tolerance_m(0.0); }},
      {"expected_parts[1].rotation_tolerance_rad",
       [](Request& r) { r.mutable_expected_parts(1)->set_rotation_tolerance_rad(3.2); }},
      {"expected_parts[1].frame_from_object.rotation",
       [](Request& r) {
         r.mutable_expected_parts(1)->mutable_frame_from_object()->clear_rotation();
       }},
      {"expected_parts[1].label",
       [](Request& r) { r.mutable_expected_parts(1)->set_label(std::string(256, 'x')); }}};
  for (const auto& [field, damage] : cases) {
    v1::RecognizeSceneRequest proto = Expecting();
    damage(proto);
    EXPECT_EQ(FieldOf(ExpectedPartsFromProto(proto).status()), field);
  }
}

TEST(ExpectedParts, OutcomesReachTheWire) {
  SceneRequest request;
  request.expected_parts = *ExpectedPartsFromProto(Expecting());
  SceneAnswer answer;
  answer.objects.resize(2);
  answer.objects[0].object_id = "bolt";
  answer.objects[0].score = 0.9;
  answer.objects[1].object_id = "nut";
  answer.objects[1].instance = 1;
  answer.objects[1].score = 0.8;
  ExpectedReport report;
  ExpectedOutcome displaced;
  displaced.expected = 1;
  displaced.state = ExpectedState::kDisplaced;
  displaced.displaced = 0.7;
  displaced.present = 0.1;
  displaced.cannot_tell = 0.2;
  displaced.found = 1;
  displaced.distance_m = 0.03;
  displaced.rotation_rad = 0.2;
  ExpectedOutcome missing;
  missing.state = ExpectedState::kMissing;
  missing.missing = 1.0;
  report.outcomes = {missing, displaced};
  report.all_present = 0.0;
  report.unexpected = {0};
  answer.expected = report;
  answer.base_alternatives = {{Rigid3{}, "nut", 1, 3}};
  AnswerFinding symmetric;
  symmetric.kind = FindingKind::kReferenceSymmetric;
  symmetric.value = 4.0;
  AnswerFinding uncertain;
  uncertain.kind = FindingKind::kBaseUncertain;
  uncertain.value = 0.006;
  uncertain.turn_rad = 0.011;
  answer.findings = {symmetric, uncertain};
  answer.reasons = {{ReasonKind::kReferenceAmbiguous, "four"}};

  v1::RecognizeSceneResponse proto;
  SceneAnswerToProto(answer, request, {true, 0.0}, &proto);
  ASSERT_EQ(proto.expected().outcomes_size(), 2);
  EXPECT_EQ(proto.expected().outcomes(0).state(), v1::ExpectedOutcome::STATE_MISSING);
  EXPECT_TRUE(proto.expected().outcomes(0).object().empty());
  EXPECT_FALSE(proto.expected().outcomes(0).has_distance_m());
  const v1::ExpectedOutcome& out = proto.expected().outcomes(1);
  EXPECT_EQ(out.state(), v1::ExpectedOutcome::STATE_DISPLACED);
  EXPECT_EQ(out.label(), "pocket 4");
  EXPECT_EQ(out.object(), "objects/nut");
  EXPECT_EQ(out.instance(), 1);
  EXPECT_EQ(out.distance_m(), 0.03);
  EXPECT_EQ(out.rotation_rad(), 0.2);
  EXPECT_EQ(out.displaced_probability(), 0.7);
  ASSERT_EQ(proto.expected().unexpected_size(), 1);
  EXPECT_EQ(proto.expected().unexpected(0).object(), "objects/bolt");
  EXPECT_EQ(proto.reasons(0).kind(), v1::SceneReason::KIND_REFERENCE_AMBIGUOUS);
  ASSERT_EQ(proto.base_alternatives_size(), 1);
  EXPECT_EQ(proto.base_alternatives(0).object(), "objects/nut");
  EXPECT_EQ(proto.base_alternatives(0).symmetry_index(), 3);
  EXPECT_EQ(proto.findings(0).reference_symmetric().equivalent_poses(), 4);
  EXPECT_EQ(proto.findings(1).base_uncertain().position_sigma_m(), 0.006);
  EXPECT_EQ(proto.findings(1).base_uncertain().rotation_sigma_rad(), 0.011);
}

}  // namespace
}  // namespace horopter
