// Parts that are small in wide images are found in their own pixels, on rendered images.
#include <gtest/gtest.h>

#include <algorithm>
#include <opencv2/imgproc.hpp>

#include "server/pipeline/pipeline.h"
#include "tests/support/staged_catalog.h"

namespace horopter {
namespace {

constexpr char kDataset[] = HOROPTER_TEST_DATA "/parts";
constexpr int kParts[] = {1, 12, 14};
constexpr unsigned kSeed = 7;
constexpr double kAcross = 16.0;  // diameters of the middle part that the images show

class SmallParts : public testing::Test {
 protected:
  static void SetUpTestSuite() {
    absl::StatusOr<StagedCatalog> staged = StageCatalog(kDataset, kParts);
    ASSERT_TRUE(staged.ok()) << staged.status();
    parts_ = std::move(staged->parts);
    catalog_ = std::move(staged->catalog);
    Random random(kSeed);
    RigOptions rig;
    rig.cameras = 3;
    rig.width = 1280;
    rig.height = 960;
    rig.scene_m = kAcross * MedianDiameter(parts_);
    rig_ = MakeRig(rig, &random);
    standing_ = StandParts(parts_, std::ssize(parts_), &random);
    ASSERT_EQ(standing_.size(), parts_.size());
    const SceneRenderer renderer(PaintScene(parts_,
                                            standing_,
                                            MakeTable(TableKind::kBlank, 0.01, &random),
                                            MakeLights(&random),
                                            &random));
    for (std::size_t c = 0; c < rig_.cameras.size(); ++c) {
      const CameraLook look = MakeLook(&random);
      request_.images.push_back(
          renderer.Take(rig_.cameras[c], rig_.camera_from_world[c], look).image);
    }
  }
  static void TearDownTestSuite() {
    parts_.clear();
    catalog_ = {};
    request_ = {};
  }

  // How many of the answer's objects are where they stand, as all cameras see them.
  static int Right(const SceneAnswer& answer, double scale) {
    return static_cast<int>(
        std::count_if(answer.objects.begin(), answer.objects.end(), [&](const AnswerObject& o) {
          const auto truth =
              std::find_if(standing_.begin(), standing_.end(), [&](const StagedPart& s) {
                return BopObjectName(parts_[s.part].id) == o.object_id;
              });
          bool right = truth != standing_.end();
          for (std::size_t c = 0; right && c < rig_.cameras.size(); ++c) {
            const Rigid3 is = rig_.camera_from_world[c] * truth->world_from_object;
            const auto& camera = answer.cameras[c];
            right = camera &&
                    (Project(camera->camera, (camera->camera_from_scene * o.scene_from_object).t) /
                         scale -
                     Project(rig_.cameras[c], is.t))
                            .norm() < 4.0;
          }
          return right;
        }));
  }

  static inline std::vector<StageablePart> parts_;
  static inline CatalogSnapshot catalog_;
  static inline StagedRig rig_;
  static inline std::vector<StagedPart> standing_;
  static inline SceneRequest request_;
  static inline PipelineOptions options_;
};

TEST_F(SmallParts, AreFoundInTheirOwnPixels) {
  const auto result = RecognizeScene(request_, catalog_, options_);
  ASSERT_TRUE(result.ok()) << result.status();
  EXPECT_EQ(Right(result->answer, 1.0), std::ssize(parts_)) << ReasonsText(result->answer);
  EXPECT_EQ(result->answer.objects.size(), parts_.size());
}

// So it is the pixels that tell.
TEST_F(SmallParts, AreNotAllFoundInHalfThePixels) {
  SceneRequest half = request_;
  for (cv::Mat& image : half.images) cv::resize(image, image, {}, 0.5, 0.5, cv::INTER_AREA);
  const auto result = RecognizeScene(half, catalog_, options_);
  ASSERT_TRUE(result.ok()) << result.status();
  EXPECT_LT(Right(result->answer, 0.5), std::ssize(parts_));
}

}  // namespace
}  // namespace horopter
