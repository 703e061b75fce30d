// Photographs as they come: out of focus, re-processed, of unequal cameras, and pictures of parts.
// Whatever is answered is there, or is told to be doubtful.
#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <iterator>
#include <memory>
#include <opencv2/calib3d.hpp>
#include <opencv2/imgproc.hpp>
#include <vector>

#include "server/pipeline/pipeline.h"
#include "tests/support/staged_catalog.h"

namespace horopter {
namespace {

constexpr char kDataset[] = HOROPTER_TEST_DATA "/parts";
constexpr int kParts[] = {1, 12, 14};
constexpr unsigned kSeed = 5;
constexpr double kAcross = 4.0;  // diameters of the middle part that the images show
constexpr double kRightPx = 6.0;
constexpr double kDoubtful = 0.5;  // what is stated with less is nobody's to grip

class AwkwardPhotographs : public testing::Test {
 protected:
  static void SetUpTestSuite() {
    absl::StatusOr<StagedCatalog> staged = StageCatalog(kDataset, kParts);
    ASSERT_TRUE(staged.ok()) << staged.status();
    parts_ = std::move(staged->parts);
    catalog_ = std::move(staged->catalog);
    Random random(kSeed);
    RigOptions options;
    options.cameras = 3;
    options.scene_m = kAcross * MedianDiameter(parts_);
    rig_ = MakeRig(options, &random);
    standing_ = StandParts(parts_, std::ssize(parts_), &random);
    ASSERT_EQ(standing_.size(), parts_.size());
    renderer_ =
        std::make_unique<SceneRenderer>(PaintScene(parts_,
                                                   standing_,
                                                   MakeTable(TableKind::kMottled, 0.1, &random),
                                                   MakeLights(&random),
                                                   &random));
    for (std::size_t c = 0; c < rig_.cameras.size(); ++c)
      images_.push_back(Take(rig_.cameras[c], c));
  }
  static void TearDownTestSuite() {
    renderer_.reset();
    parts_.clear();
    catalog_ = {};
    images_.clear();
  }

  static cv::Mat Take(const PinholeCamera& camera, std::size_t c) {
    Random random(kSeed + static_cast<unsigned>(c));
    return renderer_->Take(camera, rig_.camera_from_world[c], MakeLook(&random)).image;
  }

  static std::vector<cv::Mat> Copies() {
    std::vector<cv::Mat> out;
    for (const cv::Mat& image : images_) out.push_back(image.clone());
    return out;
  }

  struct Count {
    int right = 0;
    int wrong = 0;  // and stated as probable
  };

  // An object is right where every camera that is recovered sees it where it stands.
  static Count Ask(const std::vector<cv::Mat>& images, const std::vector<PinholeCamera>& cameras) {
    SceneRequest request;
    request.images = images;
    const auto result = RecognizeScene(request, catalog_, {});
    EXPECT_TRUE(result.ok()) << result.status();
    Count count;
    if (!result.ok()) return count;
    for (const AnswerObject& o : result->answer.objects) {
      const bool right = IsRight(result->answer, o, cameras);
      count.right += right;
      count.wrong += !right && o.score >= kDoubtful;
    }
    return count;
  }

  static bool IsRight(const SceneAnswer& answer,
                      const AnswerObject& o,
                      const std::vector<PinholeCamera>& cameras) {
    const auto truth = std::find_if(standing_.begin(), standing_.end(), [&](const StagedPart& s) {
      return BopObjectName(parts_[s.part].id) == o.object_id;
    });
    if (truth == standing_.end()) return false;
    bool seen = false;
    for (std::size_t c = 0; c < cameras.size(); ++c) {
      const auto& camera = answer.cameras[c];
      if (!camera) continue;
      const Rigid3 is = rig_.camera_from_world[c] * truth->world_from_object;
      const Eigen::Vector2d off =
          Project(camera->camera, (camera->camera_from_scene * o.scene_from_object).t) -
          Project(cameras[c], is.t);
      if (off.norm() > kRightPx * cameras[c].width / 640.0) return false;
      seen = true;
    }
    return seen;
  }

  static inline std::vector<StageablePart> parts_;
  static inline CatalogSnapshot catalog_;
  static inline StagedRig rig_;
  static inline std::vector<StagedPart> standing_;
  static inline std::unique_ptr<SceneRenderer> renderer_;
  static inline std::vector<cv::Mat> images_;
};

// What the other tests are compared with.
TEST_F(AwkwardPhotographs, PlainOnesShowAllParts) {
  const Count count = Ask(images_, rig_.cameras);
  EXPECT_EQ(count.right, std::ssize(parts_));
  EXPECT_EQ(count.wrong, 0);
}

TEST_F(AwkwardPhotographs, OneImageOutOfFocus) {
  std::vector<cv::Mat> images = Copies();
  cv::GaussianBlur(images[1], images[1], {}, 5.0);
  const Count count = Ask(images, rig_.cameras);
  EXPECT_GE(count.right, 2);
  EXPECT_EQ(count.wrong, 0);
}

TEST_F(AwkwardPhotographs, CamerasOfVeryDifferentResolution) {
  std::vector<PinholeCamera> cameras = rig_.cameras;
  PinholeCamera& fine = cameras[1];
  fine.cx = 3.0 * (fine.cx + 0.5) - 0.5;
  fine.cy = 3.0 * (fine.cy + 0.5) - 0.5;
  fine.focal_px *= 3.0;
  fine.width *= 3;
  fine.height *= 3;
  std::vector<cv::Mat> images = Copies();
  images[1] = Take(fine, 1);
  const Count count = Ask(images, cameras);
  EXPECT_GE(count.right, 2);
  EXPECT_EQ(count.wrong, 0);
}

// Five times the focal length, at what its middle shows: hardly one part.
TEST_F(AwkwardPhotographs, ATelephotoBesideWideOnes) {
  std::vector<PinholeCamera> cameras = rig_.cameras;
  cameras[2].focal_px *= 5.0;
  std::vector<cv::Mat> images = Copies();
  images[2] = Take(cameras[2], 2);
  const Count count = Ask(images, cameras);
  EXPECT_GE(count.right, 2);
  EXPECT_EQ(count.wrong, 0);
}

// Tone mapping of night modes: light evened out over the image, noise and fine detail smoothed.
TEST_F(AwkwardPhotographs, NightModeAndHdr) {
  std::vector<cv::Mat> images = Copies();
  for (cv::Mat& image : images) {
    cv::Mat lab, smooth;
    cv::bilateralFilter(image, smooth, 5, 25.0, 3.0);
    cv::cvtColor(smooth, lab, cv::COLOR_BGR2Lab);
    std::vector<cv::Mat> channels;
    cv::split(lab, channels);
    cv::createCLAHE(3.0, {8, 8})->apply(channels[0], channels[0]);
    cv::merge(channels, lab);
    cv::cvtColor(lab, image, cv::COLOR_Lab2BGR);
  }
  const Count count = Ask(images, rig_.cameras);
  EXPECT_GE(count.right, 2);
  EXPECT_EQ(count.wrong, 0);
}

// Portrait mode: blurred beyond an ellipse in the middle, whose border is no edge.
TEST_F(AwkwardPhotographs, PortraitBlur) {
  std::vector<cv::Mat> images = Copies();
  for (cv::Mat& image : images) {
    cv::Mat blurred, mask(image.size(), CV_32F, cv::Scalar(0));
    cv::GaussianBlur(image, blurred, {}, 6.0);
    cv::ellipse(mask,
                {image.cols / 2, image.rows / 2},
                {image.cols / 4, image.rows / 3},
                0,
                0,
                360,
                1.0,
                cv::FILLED);
    cv::GaussianBlur(mask, mask, {}, 8.0);
    for (int i = 0; i < image.rows * image.cols; ++i) {
      const float sharp = mask.at<float>(i);
      image.at<cv::Vec3b>(i) = sharp * cv::Vec3f(image.at<cv::Vec3b>(i)) +
                               (1 - sharp) * cv::Vec3f(blurred.at<cv::Vec3b>(i));
    }
  }
  const Count count = Ask(images, rig_.cameras);
  EXPECT_GE(count.right, 2);
  EXPECT_EQ(count.wrong, 0);
}

// Rays at equal angles lie at equal distances: no pinhole camera makes it.
TEST_F(AwkwardPhotographs, APanoramaAmongThem) {
  std::vector<cv::Mat> images = Copies();
  const PinholeCamera& camera = rig_.cameras[0];
  const double f = 0.6 * camera.focal_px;
  cv::Mat_<cv::Vec2f> from(images[0].size());
  for (int y = 0; y < from.rows; ++y) {
    for (int x = 0; x < from.cols; ++x) {
      const double angle = (x - camera.cx) / f;
      from(y, x) = {static_cast<float>(camera.cx + f * std::tan(angle)),
                    static_cast<float>(camera.cy + (y - camera.cy) / std::cos(angle))};
    }
  }
  cv::remap(images[0], images[0], from, cv::noArray(), cv::INTER_LINEAR);
  const Count count = Ask(images, rig_.cameras);
  EXPECT_GE(count.right, 2);
  EXPECT_EQ(count.wrong, 0);
}

// What cameras see of a picture in the middle of the scene, world_from_picture its axes: right, up
// and out of it.
std::vector<cv::Mat> PhotographsOf(const cv::Mat& picture,
                                   const StagedRig& rig,
                                   const Eigen::Matrix3d& world_from_picture,
                                   double side_m) {
  std::vector<cv::Mat> out;
  for (std::size_t c = 0; c < rig.cameras.size(); ++c) {
    std::vector<cv::Point2f> to;
    const double ratio = static_cast<double>(picture.rows) / picture.cols;
    for (const auto& [x, y] : {std::pair{-.5, .5}, {.5, .5}, {.5, -.5}, {-.5, -.5}}) {
      const Eigen::Vector2d p =
          Project(rig.cameras[c],
                  rig.camera_from_world[c] *
                      (world_from_picture * Eigen::Vector3d(x * side_m, ratio * y * side_m, 0)));
      to.emplace_back(static_cast<float>(p.x()), static_cast<float>(p.y()));
    }
    const auto w = static_cast<float>(picture.cols), h = static_cast<float>(picture.rows);
    const std::vector<cv::Point2f> corners = {{0, 0}, {w, 0}, {w, h}, {0, h}};
    cv::Mat image;
    cv::warpPerspective(picture,
                        image,
                        cv::getPerspectiveTransform(corners, to),
                        {rig.cameras[c].width, rig.cameras[c].height},
                        cv::INTER_AREA,
                        cv::BORDER_CONSTANT,
                        cv::Scalar(170, 175, 180));
    cv::GaussianBlur(image, image, {}, 0.7);
    out.push_back(image);
  }
  return out;
}

// Held up to the camera in the middle, where it looks as the scene would.
Eigen::Matrix3d FacingTheMiddle(const StagedRig& rig) {
  return rig.camera_from_world[1].R.transpose() * Eigen::Vector3d(1, -1, -1).asDiagonal();
}

std::vector<cv::Mat> Page(const cv::Mat& picture, const StagedRig& rig, double across_m) {
  return PhotographsOf(picture, rig, FacingTheMiddle(rig), across_m);
}

TEST_F(AwkwardPhotographs, APageOfACatalogueShowsNoPart) {
  for (const double share : {1.0, 1.2}) {
    const double side = share * kAcross * MedianDiameter(parts_);
    const Count count = Ask(Page(images_[1], rig_, side), rig_.cameras);
    EXPECT_EQ(count.right + count.wrong, 0) << share;
  }
}

// The image that faces the page shows the scene that is printed on it; the other two do not agree.
TEST_F(AwkwardPhotographs, APageThatFillsTheImagesShowsNoPart) {
  const double side = 1.8 * kAcross * MedianDiameter(parts_);
  const Count count = Ask(Page(images_[1], rig_, side), rig_.cameras);
  EXPECT_EQ(count.right + count.wrong, 0);
}

// Rows of a screen beat with those of the camera.
TEST_F(AwkwardPhotographs, AScreenShowsNoPart) {
  std::vector<cv::Mat> images = Page(images_[1], rig_, 1.8 * kAcross * MedianDiameter(parts_));
  for (std::size_t c = 0; c < images.size(); ++c) {
    for (int y = 0; y < images[c].rows; ++y) {
      for (int x = 0; x < images[c].cols; ++x) {
        const double beat = 1.0 + 0.12 * std::sin(0.35 * x + 0.1 * y + static_cast<double>(c)) *
                                      std::sin(0.4 * y - 0.002 * x * y / 10);
        for (int k = 0; k < 3; ++k) {
          auto& value = images[c].at<cv::Vec3b>(y, x)[k];
          value = cv::saturate_cast<std::uint8_t>(beat * value);
        }
      }
    }
  }
  const Count count = Ask(images, rig_.cameras);
  EXPECT_EQ(count.right + count.wrong, 0);
}

TEST_F(AwkwardPhotographs, NothingButPrintShowsNoPart) {
  cv::Mat print(960, 1280, CV_8UC3, cv::Scalar(235, 240, 240));
  Random random(kSeed);
  for (int i = 0; i < 60; ++i) {
    const auto place = [&] {
      return cv::Point(static_cast<int>(random.Uniform(0, 1280)),
                       static_cast<int>(random.Uniform(0, 960)));
    };
    const cv::Scalar ink(random.Uniform(0, 200), random.Uniform(0, 200), random.Uniform(0, 200));
    const cv::Point at = place();
    if (i % 3 == 0) {
      cv::putText(print,
                  "Horopter 42",
                  at,
                  cv::FONT_HERSHEY_DUPLEX,
                  random.Uniform(0.6, 2.5),
                  ink,
                  3,
                  cv::LINE_AA);
    } else if (i % 3 == 1) {
      cv::rectangle(print,
                    at,
                    at + cv::Point(static_cast<int>(random.Uniform(40, 250)),
                                   static_cast<int>(random.Uniform(30, 200))),
                    ink,
                    i % 2 ? 4 : cv::FILLED);
    } else {
      cv::circle(print,
                 at,
                 static_cast<int>(random.Uniform(15, 110)),
                 ink,
                 i % 2 ? 4 : cv::FILLED,
                 cv::LINE_AA);
    }
  }
  const Count count =
      Ask(PhotographsOf(print, rig_, Eigen::Matrix3d::Identity(), kAcross * MedianDiameter(parts_)),
          rig_.cameras);
  EXPECT_EQ(count.right + count.wrong, 0);
}

}  // namespace
}  // namespace horopter
