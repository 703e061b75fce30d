#include "server/service/convert.h"

#include <gmock/gmock.h>
#include <google/protobuf/field_mask.pb.h>
#include <gtest/gtest.h>

#include <Eigen/Geometry>
#include <cmath>
#include <limits>
#include <opencv2/core.hpp>
#include <random>
#include <set>

#include "horopter/v1/catalog.pb.h"
#include "horopter/v1/recognition.pb.h"
#include "server/service/catalog_convert.h"
#include "server/service/rpc_status.h"
#include "tests/support/sample_record.h"

namespace horopter {
namespace {

constexpr double kNan = std::numeric_limits<double>::quiet_NaN();
constexpr double kRounding = 1e-14;

Rigid3 RandomRigid(std::mt19937& rng) {
  std::normal_distribution<double> normal;
  const Eigen::Quaterniond q(normal(rng), normal(rng), normal(rng), normal(rng));
  return {q.normalized().toRotationMatrix(), {normal(rng), normal(rng), normal(rng)}};
}

Eigen::Matrix3d RotationAboutZ(double angle) {
  return Eigen::AngleAxisd(angle, Eigen::Vector3d::UnitZ()).toRotationMatrix();
}

TEST(ConvertRigid, SurvivesTheRoundTrip) {
  constexpr unsigned kSeed = 11;
  std::mt19937 rng(kSeed);
  for (int i = 0; i < 1000; ++i) {
    const Rigid3 before = RandomRigid(rng);
    v1::RigidTransform proto;
    RigidToProto(before, &proto);
    EXPECT_GE(proto.rotation().w(), 0.0);
    const auto after = RigidFromProto(proto, "pose");
    ASSERT_TRUE(after.ok()) << after.status();
    EXPECT_TRUE(NearlyEqual(*after, before, kRounding)) << "seed " << kSeed << " draw " << i;
  }
}

// Half turns: w = 0, where a careless conversion divides by it.
TEST(ConvertRigid, SurvivesHalfTurns) {
  for (const Eigen::Vector3d axis :
       {Eigen::Vector3d::UnitX(), Eigen::Vector3d::UnitY(), Eigen::Vector3d::UnitZ()}) {
    Rigid3 before;
    before.R = Eigen::AngleAxisd(M_PI, axis).toRotationMatrix();
    v1::RigidTransform proto;
    RigidToProto(before, &proto);
    EXPECT_TRUE(NearlyEqual(*RigidFromProto(proto, "pose"), before, kRounding));
  }
}

TEST(ConvertRigid, QuaternionIsWFirstAndRightHanded) {
  v1::RigidTransform proto;
  proto.mutable_rotation()->set_w(std::sqrt(0.5));
  proto.mutable_rotation()->set_z(std::sqrt(0.5));
  proto.mutable_translation_m()->set_y(2.0);
  const auto transform = RigidFromProto(proto, "pose");
  ASSERT_TRUE(transform.ok());
  EXPECT_LT((*transform * Eigen::Vector3d(1, 0, 0) - Eigen::Vector3d(0, 3, 0)).norm(), kRounding);
}

TEST(ConvertRigid, RefusesWhatIsNoRotation) {
  v1::RigidTransform proto;
  EXPECT_EQ(ErrorField(RigidFromProto(proto, "pose").status()), "pose.rotation");
  proto.mutable_rotation()->set_w(0.9);
  EXPECT_EQ(ErrorField(RigidFromProto(proto, "pose").status()), "pose.rotation");
  proto.mutable_rotation()->set_w(kNan);
  EXPECT_EQ(ErrorField(RigidFromProto(proto, "pose").status()), "pose.rotation");
  proto.mutable_rotation()->set_w(1.0);
  EXPECT_TRUE(RigidFromProto(proto, "pose").ok());
  proto.mutable_translation_m()->set_x(std::numeric_limits<double>::infinity());
  EXPECT_EQ(ErrorField(RigidFromProto(proto, "pose").status()), "pose.translation_m");
}

TEST(ConvertName, TakesResourceNamesOnly) {
  EXPECT_EQ(*ObjectIdFromName("objects/obj_000001", "name"), "obj_000001");
  EXPECT_EQ(*ObjectIdFromName(ObjectName("a-b"), "name"), "a-b");
  for (const char* bad :
       {"", "objects/", "obj_000001", "objects/A", "objects/a/b", "parts/a", "objects/a "}) {
    EXPECT_EQ(ErrorField(ObjectIdFromName(bad, "name").status()), "name") << bad;
  }
}

TEST(ConvertObject, SurvivesTheRoundTrip) {
  for (unsigned seed = 1; seed <= 20; ++seed) {
    const CatalogRecord before = SampleRecord("box", seed);
    v1::Object proto;
    RecordToProto(before, &proto);
    proto.mutable_source()->set_content(before.source.content);
    const auto after = RecordFromProto("box", proto);
    ASSERT_TRUE(after.ok()) << after.status();
    // Rotations pass through quaternions and lose the last bits; the rest is exact.
    CatalogRecord settled = *after;
    settled.create_time = before.create_time;
    settled.update_time = before.update_time;
    for (size_t i = 0; i < before.model.grasps.size(); ++i) {
      Rigid3& pose = settled.model.grasps[i].object_from_gripper;
      EXPECT_TRUE(NearlyEqual(pose, before.model.grasps[i].object_from_gripper, kRounding));
      pose = before.model.grasps[i].object_from_gripper;
      auto& waiting = settled.model.grasps[i].object_from_pregrasp;
      const auto& waited = before.model.grasps[i].object_from_pregrasp;
      ASSERT_EQ(waiting.has_value(), waited.has_value());
      if (!waited) continue;
      EXPECT_TRUE(NearlyEqual(*waiting, *waited, kRounding));
      waiting = waited;
    }
    EXPECT_TRUE(NearlyEqual(settled.model.symmetries[0], before.model.symmetries[0], kRounding));
    settled.model.symmetries = before.model.symmetries;
    EXPECT_EQ(FirstDifference(settled, before), "") << "seed " << seed;
    EXPECT_EQ(settled.source.content, before.source.content);
  }
}

TEST(ConvertObject, ComputesAMissingDiameterAndRefusesAWrongOne) {
  const CatalogRecord record = SampleRecord("box");
  v1::Object proto;
  RecordToProto(record, &proto);
  proto.clear_diameter_m();
  EXPECT_NEAR(RecordFromProto("box", proto)->model.diameter_m, record.model.diameter_m, 1e-12);
  proto.set_diameter_m(1000 * record.model.diameter_m);  // millimetres
  EXPECT_EQ(ErrorField(RecordFromProto("box", proto).status()), "diameter_m");
}

TEST(ConvertObject, DiameterAgreesWithAllPairs) {
  std::mt19937 rng(3);
  std::normal_distribution<double> normal;
  for (int trial = 0; trial < 5; ++trial) {
    std::vector<Eigen::Vector3d> points(400);
    for (auto& p : points) p = Eigen::Vector3d(normal(rng), normal(rng), normal(rng)).normalized();
    double exact = 0.0;
    for (const auto& p : points) {
      for (const auto& q : points) exact = std::max(exact, (p - q).norm());
    }
    const double measured = PointSetDiameter(points);
    EXPECT_LE(measured, exact + 1e-12);
    EXPECT_GE(measured, 0.998 * exact);
  }
}

TEST(ConvertObject, NamesTheOffendingField) {
  const auto field_after = [](const std::function<void(v1::Object&)>& damage) {
    v1::Object proto;
    RecordToProto(SampleRecord("box"), &proto);
    damage(proto);
    return ErrorField(RecordFromProto("box", proto).status());
  };
  EXPECT_EQ(field_after([](v1::Object& o) { o.add_vertices_m(1.0); }), "vertices_m");
  EXPECT_EQ(field_after([](v1::Object& o) { o.set_vertices_m(0, kNan); }), "vertices_m");
  EXPECT_EQ(field_after([](v1::Object& o) { o.mutable_edges(1)->clear_kind(); }), "edges[1].kind");
  EXPECT_EQ(field_after([](v1::Object& o) { o.mutable_edges(1)->clear_end_vertex(); }),
            "edges[1].start_vertex");
  EXPECT_EQ(field_after([](v1::Object& o) { o.mutable_edges(1)->set_end_vertex(-1); }),
            "edges[1].start_vertex");
  EXPECT_EQ(field_after([](v1::Object& o) { o.clear_mesh(); }), "mesh.vertices_m");
  EXPECT_EQ(field_after([](v1::Object& o) { o.mutable_mesh()->add_triangles(0); }),
            "mesh.triangles");
  EXPECT_EQ(field_after([](v1::Object& o) { o.mutable_grasps(0)->clear_object_from_gripper(); }),
            "grasps[0].object_from_gripper.rotation");
}

TEST(ConvertMask, KnowsEveryWritableFieldAndNoOther) {
  google::protobuf::FieldMask mask;
  v1::Object populated;
  EXPECT_FALSE(MaskFromProto(mask, populated)->mesh);
  populated.mutable_mesh();
  EXPECT_TRUE(MaskFromProto(mask, populated)->mesh);
  EXPECT_FALSE(MaskFromProto(mask, populated)->grasps);
  mask.add_paths("grasps");
  EXPECT_TRUE(MaskFromProto(mask, populated)->grasps);
  EXPECT_FALSE(MaskFromProto(mask, populated)->mesh);
  for (const char* bad : {"name", "create_time", "grasps.name", "", "vertex_count"}) {
    google::protobuf::FieldMask wrong;
    wrong.add_paths(bad);
    EXPECT_EQ(ErrorField(MaskFromProto(wrong, populated).status()), "update_mask") << bad;
  }
}

TEST(ConvertAnswer, EveryKindOfFindingHasItsOwnTypedValue) {
  SceneAnswer answer;
  for (int kind = 0; kind <= static_cast<int>(FindingKind::kExifContradicted); ++kind) {
    AnswerFinding finding;
    finding.kind = static_cast<FindingKind>(kind);
    finding.value = 0.25;
    answer.findings.push_back(finding);
  }
  answer.contradicted_hints = {{3, 0.25, {1.0, 2.0}, "why"}};
  v1::RecognizeSceneResponse proto;
  SceneAnswerToProto(answer, {}, {}, &proto);
  std::set<int> cases;
  for (const v1::SceneFinding& f : proto.findings()) cases.insert(f.finding_case());
  EXPECT_EQ(cases.size(), answer.findings.size() + 1);
  EXPECT_EQ(cases.count(v1::SceneFinding::FINDING_NOT_SET), 0u);
  EXPECT_EQ(proto.findings(3).shift_undetermined().sigma_m(), 0.25);
  EXPECT_EQ(proto.findings(4).focal_and_depth().focal_log_sigma(), 0.25);
  EXPECT_DOUBLE_EQ(proto.findings(5).scale_conflict().size_ratio(), std::exp(0.25));
  EXPECT_EQ(proto.findings(7).reference_conflict().distance_m(), 0.25);
  EXPECT_EQ(proto.findings(8).exif_contradicted().focal_px(), 0.25);
  EXPECT_EQ(proto.findings(9).image(), 3);
  EXPECT_EQ(proto.findings(9).detail(), "why");
  EXPECT_EQ(proto.findings(9).hint_contradicted().focal_px(), 0.25);
  EXPECT_EQ(proto.findings(9).hint_contradicted().principal_point_x_px(), 1.0);
  EXPECT_EQ(proto.findings(9).hint_contradicted().principal_point_y_px(), 2.0);
}

TEST(ConvertAnswer, TheBasicViewHasNoCovariancesAndObjectsBelowTheScoreAreCounted) {
  SceneRequest request;
  request.images = {cv::Mat(20, 30, CV_8UC1)};
  SceneAnswer answer;
  answer.cameras.resize(1);
  for (const double score : {0.9, 0.4}) {
    AnswerObject object;
    object.object_id = "box";
    object.instance = static_cast<int>(answer.objects.size());
    object.score = score;
    answer.objects.push_back(object);
  }
  answer.joint_covariance = Eigen::MatrixXd::Identity(12, 12);
  answer.stages = {{"features", 1.0, {}}};
  answer.plane = SupportingPlane{Eigen::Vector3d::UnitX(), 0.25};
  answer.base_from_scene = Rigid3{RotationAboutZ(M_PI / 2), {1, 2, 3}};
  v1::RecognizeSceneResponse full, basic, none;
  SceneAnswerToProto(answer, request, {true, 0.5}, &full);
  ASSERT_EQ(full.objects_size(), 1);
  EXPECT_EQ(full.objects(0).score(), 0.9);
  EXPECT_EQ(full.objects_below_min_score(), 1);
  EXPECT_EQ(full.reasons_size(), 0);
  EXPECT_EQ(full.joint_pose_covariance_size(), 36);
  EXPECT_EQ(full.supporting_plane_in_scene().normal().x(), 1.0);
  EXPECT_EQ(full.supporting_plane_in_scene().offset_m(), 0.25);
  // A point of the plane, carried into the base, is in the plane there.
  const Eigen::Vector3d in_base = *answer.base_from_scene * Eigen::Vector3d(0.25, 7, -5);
  const v1::Plane& base = full.supporting_plane_in_base();
  EXPECT_NEAR(base.normal().x() * in_base.x() + base.normal().y() * in_base.y() +
                  base.normal().z() * in_base.z(),
              base.offset_m(),
              1e-12);

  SceneAnswerToProto(answer, request, {false, 0.0}, &basic);
  EXPECT_EQ(basic.objects_size(), 2);
  EXPECT_EQ(basic.objects_below_min_score(), 0);
  EXPECT_EQ(basic.joint_pose_covariance_size() + basic.stages_size() +
                basic.objects(0).pose_covariance_size() + basic.objects(0).images_size(),
            0);
  EXPECT_TRUE(basic.has_base_from_scene() && basic.objects(0).has_base_from_object());

  SceneAnswerToProto(answer, request, {true, 0.95}, &none);
  ASSERT_EQ(none.reasons_size(), 1);
  EXPECT_EQ(none.reasons(0).kind(), v1::SceneReason::KIND_BELOW_MIN_SCORE);
  EXPECT_EQ(none.objects_below_min_score(), 2);
}

TEST(ConvertAnswer, CarriesEveryValueAndComposesTheFrames) {
  std::mt19937 rng(8);
  SceneRequest request;
  request.images = {cv::Mat(20, 30, CV_8UC1), cv::Mat(40, 50, CV_8UC3)};
  SceneAnswer answer;
  AddReason(ReasonKind::kReferenceNotFound, "", &answer);
  AddReason(ReasonKind::kAmbiguous, "two", &answer);
  answer.time_limited = true;
  answer.unsearched = {{UnsearchedCause::kTime, "projective"},
                       {UnsearchedCause::kCatalogSize, "aspects"},
                       {UnsearchedCause::kUnavailable, "ranker 2 of 4"}};
  answer.base_from_scene = RandomRigid(rng);
  answer.cameras.resize(2);
  answer.cameras[1] = PosedCamera{
      {{50, 40, 77.5, 24.0, 19.5, -0.03}, RandomRigid(rng)}, 0.02, {0.1, 0.002, -0.003}};
  answer.camera_bases = {{}, {{BasisSource::kTexture, 120, 0.8}, {BasisSource::kGiven, 0, 0.0}}};
  answer.unrelated_images = {true, false};
  AnswerObject object;
  object.object_id = "box";
  object.instance = 1;
  object.score = 0.75;
  object.scene_from_object = RandomRigid(rng);
  for (int i = 0; i < 36; ++i) object.covariance(i / 6, i % 6) = i;
  object.view_scores = {-1.0, 0.5};
  object.alternatives = {"bar"};
  AnswerAlternative bar{AlternativeKind::kObject, "bar", 0.25, Rigid3()};
  bar.scene_from_camera = RandomRigid(rng);
  bar.differing_px = 12.0;
  AnswerAlternative drilled{AlternativeKind::kFeature, "box", 0.05};
  drilled.feature_place = {0.01, 0.02, 0.03};
  drilled.feature_size_m = 0.004;
  object.left_open = {bar, drilled};
  object.grasps = {{"top", 2, RandomRigid(rng), 0.05, 0.04, 0.9, RandomRigid(rng), 0.75},
                   {"cup", 0, {}, 0.0, 0.0, 1.0, {}, 1.0, 1.0, true, 0.01}};
  object.camera_covariances = {std::nullopt, Matrix6d::Constant(3.0)};
  object.base_from_object = UncertainPose{{}, Matrix6d::Constant(4.0)};
  AnswerObject first = object;
  first.instance = 0;
  answer.objects = {object, first};
  answer.joint_covariance = Eigen::MatrixXd::Zero(12, 12);
  answer.joint_covariance(0, 0) = 11.0;  // of instance 1, which comes second on the wire
  AnswerFinding finding;
  finding.kind = FindingKind::kTurnUndetermined;
  finding.object_id = "box";
  finding.instance = 1;
  finding.direction = Eigen::Vector3d::UnitZ();
  finding.value = 3.0;
  answer.findings = {finding};
  AnswerScale scale;
  scale.kind = ScaleSourceKind::kReferenceCameras;
  scale.image = 1;
  scale.log_ratio = 0.02;
  answer.scales = {scale};
  answer.stages = {{"features", 1.25, {{"edges", 412.0}}}};

  v1::RecognizeSceneResponse proto;
  SceneAnswerToProto(answer, request, {}, &proto);
  ASSERT_EQ(proto.reasons_size(), 2);
  EXPECT_EQ(proto.reasons(0).kind(), v1::SceneReason::KIND_AMBIGUOUS);
  EXPECT_EQ(proto.reasons(0).detail(), "two");
  EXPECT_EQ(proto.reasons(1).kind(), v1::SceneReason::KIND_REFERENCE_NOT_FOUND);
  EXPECT_EQ(proto.completeness(), v1::COMPLETENESS_TIME_LIMITED);
  ASSERT_EQ(proto.unsearched_size(), 3);
  EXPECT_EQ(proto.unsearched(0).cause(), v1::UnsearchedStep::CAUSE_TIME);
  EXPECT_EQ(proto.unsearched(0).step(), "projective");
  EXPECT_EQ(proto.unsearched(1).cause(), v1::UnsearchedStep::CAUSE_CATALOG_SIZE);
  EXPECT_EQ(proto.unsearched(2).cause(), v1::UnsearchedStep::CAUSE_UNAVAILABLE);
  ASSERT_EQ(proto.objects(0).alternatives_size(), 2);
  const v1::ObjectAlternative& other = proto.objects(0).alternatives(0);
  EXPECT_EQ(other.kind(), v1::ObjectAlternative::KIND_OBJECT);
  EXPECT_EQ(other.object(), "objects/bar");
  EXPECT_DOUBLE_EQ(other.probability(), 0.25);
  EXPECT_TRUE(other.has_scene_from_object());
  EXPECT_FALSE(other.has_feature_place());
  ASSERT_TRUE(other.has_scene_from_camera());
  const Eigen::Vector3d camera_in_base =
      *answer.base_from_scene * answer.objects[0].left_open[0].scene_from_camera->t;
  EXPECT_NEAR(other.base_from_camera().translation_m().x(), camera_in_base.x(), 1e-12);
  EXPECT_DOUBLE_EQ(other.differing_px(), 12.0);
  const v1::ObjectAlternative& feature = proto.objects(0).alternatives(1);
  EXPECT_EQ(feature.kind(), v1::ObjectAlternative::KIND_FEATURE);
  EXPECT_DOUBLE_EQ(feature.feature_place().z(), 0.03);
  EXPECT_DOUBLE_EQ(feature.feature_size_m(), 0.004);
  EXPECT_FALSE(feature.has_scene_from_camera());
  EXPECT_FALSE(feature.has_scene_from_object());
  EXPECT_TRUE(proto.cameras(0).unrelated());
  EXPECT_EQ(proto.cameras(0).bases_size(), 0);
  ASSERT_EQ(proto.cameras(1).bases_size(), 2);
  EXPECT_EQ(proto.cameras(1).bases(0).source(), v1::CameraBasis::SOURCE_TEXTURE);
  EXPECT_EQ(proto.cameras(1).bases(0).matches(), 120);
  EXPECT_DOUBLE_EQ(proto.cameras(1).bases(0).rms_px(), 0.8);
  EXPECT_EQ(proto.cameras(1).bases(1).source(), v1::CameraBasis::SOURCE_GIVEN);
  ASSERT_EQ(proto.cameras_size(), 2);
  EXPECT_FALSE(proto.cameras(0).recovered());
  EXPECT_EQ(proto.cameras(0).image_width_px(), 30);
  EXPECT_FALSE(proto.cameras(0).has_camera_from_scene());
  EXPECT_TRUE(proto.cameras(1).recovered());
  EXPECT_EQ(proto.cameras(1).focal_px(), 77.5);
  EXPECT_EQ(proto.cameras(1).principal_point_y_px(), 19.5);
  EXPECT_EQ(proto.cameras(1).k1(), -0.03);
  EXPECT_EQ(proto.cameras(1).k2(), 0.1);
  EXPECT_EQ(proto.cameras(1).p1(), 0.002);
  EXPECT_EQ(proto.cameras(1).p2(), -0.003);
  ASSERT_EQ(proto.objects_size(), 2);
  EXPECT_EQ(proto.objects(0).instance(), 0);
  const v1::RecognizedObject& out = proto.objects(1);
  EXPECT_EQ(out.object(), "objects/box");
  ASSERT_EQ(out.pose_covariance_size(), 36);
  EXPECT_EQ(out.pose_covariance(7), 7.0);
  EXPECT_FALSE(out.images(0).has_score());
  EXPECT_FALSE(out.images(0).has_camera_from_object());
  EXPECT_EQ(out.images(1).score(), 0.5);
  EXPECT_TRUE(NearlyEqual(*RigidFromProto(out.images(1).camera_from_object(), "x"),
                          answer.cameras[1]->camera_from_scene * object.scene_from_object,
                          kRounding));
  EXPECT_TRUE(NearlyEqual(*RigidFromProto(out.base_from_object(), "x"),
                          *answer.base_from_scene * object.scene_from_object,
                          kRounding));
  EXPECT_TRUE(NearlyEqual(*RigidFromProto(out.grasps(0).base_from_gripper(), "x"),
                          *answer.base_from_scene * object.grasps[0].scene_from_gripper,
                          kRounding));
  EXPECT_EQ(out.grasps(0).symmetry_index(), 2);
  EXPECT_EQ(out.grasps(0).success(), 0.75);
  EXPECT_EQ(out.grasps(0).parallel_jaw().jaw_opening_m(), 0.05);
  EXPECT_EQ(out.grasps(0).parallel_jaw().grip_width_m(), 0.04);
  EXPECT_EQ(out.grasps(1).suction().cup_radius_m(), 0.01);
  EXPECT_TRUE(NearlyEqual(*RigidFromProto(out.grasps(0).base_from_pregrasp(), "x"),
                          *answer.base_from_scene * object.grasps[0].scene_from_pregrasp,
                          kRounding));
  EXPECT_EQ(out.images(0).pose_covariance_size(), 0);
  EXPECT_EQ(out.images(1).pose_covariance(35), 3.0);
  EXPECT_EQ(out.base_pose_covariance(0), 4.0);
  ASSERT_EQ(proto.joint_pose_covariance_size(), 144);
  EXPECT_EQ(proto.joint_pose_covariance(0), 0.0);
  EXPECT_EQ(proto.joint_pose_covariance(6 * 12 + 6), 11.0);
  ASSERT_EQ(proto.findings_size(), 1);
  ASSERT_TRUE(proto.findings(0).has_turn_undetermined());
  EXPECT_EQ(proto.findings(0).object(), "objects/box");
  EXPECT_EQ(proto.findings(0).turn_undetermined().axis_in_object().z(), 1.0);
  EXPECT_EQ(proto.findings(0).turn_undetermined().sigma_rad(), 3.0);
  EXPECT_FALSE(proto.findings(0).has_image());
  ASSERT_EQ(proto.scale_sources_size(), 1);
  EXPECT_EQ(proto.scale_sources(0).kind(), v1::ScaleSource::KIND_REFERENCE_CAMERAS);
  EXPECT_EQ(proto.scale_sources(0).image(), 1);
  EXPECT_FALSE(proto.scale_sources(0).object().size());
  EXPECT_EQ(out.alternative_objects(0), "objects/bar");
  EXPECT_EQ(proto.stages(0).elapsed().seconds(), 1);
  EXPECT_EQ(proto.stages(0).elapsed().nanos(), 250000000);
  EXPECT_EQ(proto.stages(0).counts().at("edges"), 412.0);
}

}  // namespace
}  // namespace horopter
