// A station whose cameras are known, through the whole pipeline, on rendered images.
#include <gtest/gtest.h>

#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <numbers>

#include "server/pipeline/pipeline.h"
#include "tests/support/staged_catalog.h"

namespace horopter {
namespace {

constexpr char kDataset[] = HOROPTER_TEST_DATA "/parts";
constexpr int kParts[] = {1, 12, 14};
constexpr unsigned kSeed = 5;
constexpr double kDegree = std::numbers::pi / 180.0;

// Four cameras over a blank table with two parts on it, and a station that knows them.
class StationImages : public testing::Test {
 protected:
  static void SetUpTestSuite() {
    absl::StatusOr<StagedCatalog> staged = StageCatalog(kDataset, kParts);
    ASSERT_TRUE(staged.ok()) << staged.status();
    parts_ = std::move(staged->parts);
    catalog_ = std::move(staged->catalog);
    Random random(kSeed);
    RigOptions options;
    options.scene_m = 2.2 * MedianDiameter(parts_);
    rig_ = MakeRig(options, &random);
    standing_ = StandParts(parts_, 2, &random);
    ASSERT_EQ(standing_.size(), 2u);
    renderer_ = new SceneRenderer(PaintScene(parts_,
                                             standing_,
                                             MakeTable(TableKind::kBlank, 0.01, &random),
                                             MakeLights(&random),
                                             &random));
    for (std::size_t c = 0; c < rig_.cameras.size(); ++c) {
      looks_.push_back(MakeLook(&random));
      request_.images.push_back(Take(c, rig_.camera_from_world[c]));
    }
    request_.station = Known();
  }
  static void TearDownTestSuite() {
    delete renderer_;
    parts_.clear();
    catalog_ = {};
  }

  static cv::Mat Take(std::size_t c, const Rigid3& camera_from_world) {
    return renderer_->Take(rig_.cameras[c], camera_from_world, looks_[c]).image;
  }

  static StationRequest Known() {
    StationRequest out;
    const StationOptions options;
    // Turn, place and principal point move an image alike: learnt states know their sum to a
    // fraction of a pixel, and so does this one.
    const Eigen::Matrix<double, kStationCameraParameters, 1> sigmas{
        2e-4, 2e-4, 2e-4, 1e-4, 1e-4, 2e-4, 5e-4, 0.2, 0.2, 1e-3};
    for (std::size_t c = 0; c < rig_.cameras.size(); ++c) {
      const PinholeCamera& camera = rig_.cameras[c];
      AddStationCamera(
          "camera" + std::to_string(c), camera.width, camera.height, options, &out.state);
      StationCamera& known = out.state.cameras.back();
      known.camera = camera;
      known.posed = true;
      known.camera_from_rig = rig_.camera_from_world[c] * rig_.camera_from_world[0].Inverse();
      known.requests = 10;
      const auto at = static_cast<Eigen::Index>(kStationCameraParameters * c);
      out.state.covariance.diagonal().segment<kStationCameraParameters>(at) = sigmas.cwiseAbs2();
      // The first holds the rig's frame.
      if (c == 0) out.state.covariance.diagonal().head<kStationIntrinsics>().setZero();
      out.views.push_back(static_cast<int>(c));
    }
    out.state.requests = 10;
    out.bases.resize(rig_.cameras.size());
    return out;
  }

  // The answer's objects are where they stand, as the cameras but `but` see them.
  static void ExpectRight(const PipelineResult& result, int but) {
    ASSERT_EQ(result.answer.objects.size(), standing_.size()) << ReasonsText(result.answer);
    for (const AnswerObject& o : result.answer.objects) {
      const auto truth = std::find_if(standing_.begin(), standing_.end(), [&](const StagedPart& s) {
        return BopObjectName(parts_[s.part].id) == o.object_id;
      });
      ASSERT_NE(truth, standing_.end()) << o.object_id;
      for (int c = 0; c < static_cast<int>(rig_.cameras.size()); ++c) {
        if (c == but) continue;
        ASSERT_TRUE(result.answer.cameras[c]);
        const Rigid3 found = result.answer.cameras[c]->camera_from_scene * o.scene_from_object;
        const Rigid3 is = rig_.camera_from_world[c] * truth->world_from_object;
        EXPECT_LT((Project(rig_.cameras[c], found.t) - Project(rig_.cameras[c], is.t)).norm(), 4.0);
      }
    }
  }

  static bool RanStage(const PipelineResult& result, const std::string& stage) {
    return std::any_of(result.answer.stages.begin(),
                       result.answer.stages.end(),
                       [&](const StageReport& s) { return s.stage == stage; });
  }

  static inline std::vector<StageablePart> parts_;
  static inline CatalogSnapshot catalog_;
  static inline StagedRig rig_;
  static inline std::vector<StagedPart> standing_;
  static inline std::vector<CameraLook> looks_;
  static inline SceneRenderer* renderer_ = nullptr;
  static inline SceneRequest request_;
};

TEST_F(StationImages, KnownCamerasNeedNoMatchesBetweenViews) {
  const auto result = RecognizeScene(request_, catalog_, {});
  ASSERT_TRUE(result.ok()) << result.status();
  ExpectRight(*result, -1);
  ASSERT_TRUE(result->station);
  EXPECT_TRUE(result->station->prior_used);
  EXPECT_TRUE(result->station->test.changes.empty());
  EXPECT_FALSE(RanStage(*result, "matching"));
}

TEST_F(StationImages, ACameraThatWasTurnedIsNamedAndBendsNothing) {
  constexpr int kTurned = 2;
  SceneRequest request = request_;
  const Rigid3 bump{
      Eigen::AngleAxisd(0.5 * kDegree, Eigen::Vector3d(0.6, 0.7, 0.2).normalized()).matrix(),
      Eigen::Vector3d::Zero()};
  request.images[kTurned] = Take(kTurned, bump * rig_.camera_from_world[kTurned]);
  const auto result = RecognizeScene(request, catalog_, {});
  ASSERT_TRUE(result.ok()) << result.status();
  ExpectRight(*result, kTurned);
  ASSERT_TRUE(result->station);
  EXPECT_FALSE(result->station->test.agrees);
  EXPECT_FALSE(result->station->prior_used);
  ASSERT_EQ(result->station->test.changes.size(), 1u);
  EXPECT_EQ(result->station->test.changes[0].kind, StationChangeKind::kMoved);
  EXPECT_EQ(result->station->test.changes[0].cameras[0], kTurned);
  EXPECT_NEAR(result->station->test.changes[0].turn_rad, 0.5 * kDegree, 0.3 * kDegree);
}

// A robot that says where its cameras were, and through what lenses: no station.
SceneRequest WithPlaces(SceneRequest request, const StagedRig& rig) {
  request.station.reset();
  for (std::size_t c = 0; c < rig.cameras.size(); ++c) {
    CameraHint hint;
    hint.focal_px = rig.cameras[c].focal_px;
    hint.principal_point = Eigen::Vector2d(rig.cameras[c].cx, rig.cameras[c].cy);
    hint.k1 = rig.cameras[c].k1;
    request.hints.push_back(hint);
    request.camera_poses.push_back(CameraPoseHint{rig.camera_from_world[c]});
  }
  return request;
}

TEST_F(StationImages, PlacesThatARequestGivesAreLookedUnder) {
  const auto result = RecognizeScene(WithPlaces(request_, rig_), catalog_, {});
  ASSERT_TRUE(result.ok()) << result.status();
  ExpectRight(*result, -1);
  EXPECT_TRUE(result->trace.recognition.under_known_cameras);
  EXPECT_FALSE(RanStage(*result, "matching"));
  for (const AnswerObject& o : result->answer.objects) EXPECT_TRUE(o.base_from_object);
}

TEST_F(StationImages, PlacesThatAreWrongMisleadNobody) {
  SceneRequest request = WithPlaces(request_, rig_);
  Rigid3& wrong = request.camera_poses[1]->camera_from_base;
  wrong = Rigid3{Eigen::AngleAxisd(25 * kDegree, Eigen::Vector3d::UnitY()).matrix(),
                 Eigen::Vector3d(0.05, 0.0, 0.0)} *
          wrong;
  const auto result = RecognizeScene(request, catalog_, {});
  ASSERT_TRUE(result.ok()) << result.status();
  if (!result->answer.objects.empty()) ExpectRight(*result, -1);
  for (const AnswerObject& o : result->answer.objects) EXPECT_FALSE(o.base_from_object);
}

}  // namespace
}  // namespace horopter
