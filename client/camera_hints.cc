#include "client/camera_hints.h"

#include <Eigen/Geometry>
#include <algorithm>
#include <array>
#include <cmath>
#include <utility>

#include "absl/strings/str_cat.h"
#include "client/camera_file.h"
#include "client/convert.h"
#include "client/image_size.h"
#include "server/base/status_macros.h"

namespace horopter {
namespace {

constexpr size_t kPoseNumbers = 7;

absl::Status CheckCount(const char* option, size_t given, size_t images) {
  if (given <= 1 || given == images) return absl::OkStatus();
  return absl::InvalidArgumentError(absl::StrCat(
      option, ": give one for all images or one for each; there are ", given, " for ", images));
}

template <typename T>
const T& EntryOf(const std::vector<T>& list, size_t image) {
  return list.size() == 1 ? list[0] : list[image];
}

absl::StatusOr<Rigid3> PoseOf(const std::vector<double>& numbers, size_t first) {
  const double* n = numbers.data() + first;
  const Eigen::Quaterniond q(n[3], n[4], n[5], n[6]);
  if (!(std::abs(q.norm() - 1.0) < 0.01)) {
    return absl::InvalidArgumentError("--camera-pose: the quaternion's norm is not 1");
  }
  return Rigid3{q.normalized().toRotationMatrix(), {n[0], n[1], n[2]}};
}

// Once, whatever the number of images.
void Warn(const std::string& path, const std::string& what, std::vector<std::string>* warnings) {
  std::string warning = absl::StrCat(path, ": ", what);
  if (std::find(warnings->begin(), warnings->end(), warning) == warnings->end())
    warnings->push_back(std::move(warning));
}

void SetCamera(const CameraFile& camera, v1::CameraHint* hint) {
  hint->set_principal_point_x_px(camera.cx);
  hint->set_principal_point_y_px(camera.cy);
  if (!camera.lens) {
    hint->set_focal_px(camera.focal_px);
    hint->set_k1(camera.k1);
    return;
  }
  hint->set_focal_px(camera.lens->fx);
  hint->set_focal_y_px(camera.lens->fy);
  const auto& d = camera.lens->coefficients;
  if (camera.lens->fisheye) {
    hint->mutable_fisheye()->set_k1(d[0]);
    hint->mutable_fisheye()->set_k2(d[1]);
    hint->mutable_fisheye()->set_k3(d[2]);
    hint->mutable_fisheye()->set_k4(d[3]);
    return;
  }
  hint->set_k1(d[0]);
  hint->set_k2(d[1]);
  hint->set_p1(d[2]);
  hint->set_p2(d[3]);
  hint->set_k3(d[4]);
  const auto& q = camera.lens->denominator;
  if (q == std::array<double, 3>{}) return;
  hint->set_k4(q[0]);
  hint->set_k5(q[1]);
  hint->set_k6(q[2]);
}

}  // namespace

absl::Status AddCameraHints(const CameraArguments& arguments,
                            v1::RecognizeSceneRequest* request,
                            std::vector<std::string>* warnings) {
  const auto images = static_cast<size_t>(request->images_size());
  const size_t poses = arguments.camera_pose.size() / kPoseNumbers;
  if (!arguments.focal_px.empty() && !arguments.camera.empty()) {
    return absl::InvalidArgumentError("--focal and --camera: give one of them");
  }
  if (arguments.camera_pose.size() % kPoseNumbers != 0 || (poses != 0 && poses != images)) {
    return absl::InvalidArgumentError(
        absl::StrCat("--camera-pose: takes x y z qw qx qy qz for each of the ", images, " images"));
  }
  if (!arguments.camera_pose_sigma.empty() && poses == 0)
    return absl::InvalidArgumentError("--camera-pose-sigma: only with --camera-pose");
  HOROPTER_RETURN_IF_ERROR(CheckCount("--focal", arguments.focal_px.size(), images));
  HOROPTER_RETURN_IF_ERROR(CheckCount("--camera", arguments.camera.size(), images));
  std::vector<CameraFile> cameras;
  for (const std::string& path : arguments.camera) {
    HOROPTER_ASSIGN_OR_RETURN(CameraFile camera, ReadCameraFile(path));
    for (const std::string& w : camera.warnings) Warn(path, w, warnings);
    cameras.push_back(std::move(camera));
  }
  for (size_t i = 0; i < images; ++i) {
    v1::SceneImage& image = *request->mutable_images(static_cast<int>(i));
    if (!arguments.focal_px.empty()) {
      image.mutable_camera_hint()->set_focal_px(EntryOf(arguments.focal_px, i));
    }
    if (!cameras.empty()) {
      const absl::StatusOr<cv::Size> size = EncodedImageSize(image.content());
      if (!size.ok())
        return absl::InvalidArgumentError(absl::StrCat("image ", i + 1, " cannot be decoded"));
      const std::string& path = EntryOf(arguments.camera, i);
      const CameraFile& file = EntryOf(cameras, i);
      const absl::StatusOr<CameraFile> camera =
          ForImages(file, size->width, size->height, image.cropped());
      if (!camera.ok()) {
        return absl::Status(
            camera.status().code(),
            absl::StrCat(path, ": image ", i + 1, ": ", std::string(camera.status().message())));
      }
      for (size_t w = file.warnings.size(); w < camera->warnings.size(); ++w)
        Warn(path, camera->warnings[w], warnings);
      SetCamera(*camera, image.mutable_camera_hint());
    }
    if (arguments.focal_sigma > 0.0 && image.camera_hint().has_focal_px()) {
      image.mutable_camera_hint()->set_focal_log_sigma(arguments.focal_sigma);
    }
    if (poses > 0) {
      HOROPTER_ASSIGN_OR_RETURN(const Rigid3 base_from_camera,
                                PoseOf(arguments.camera_pose, i * kPoseNumbers));
      *image.mutable_camera_hint()->mutable_camera_from_base() =
          ToProto(base_from_camera.Inverse());
      if (!arguments.camera_pose_sigma.empty()) {
        image.mutable_camera_hint()->set_rotation_sigma_rad(arguments.camera_pose_sigma[0]);
        image.mutable_camera_hint()->set_position_sigma_m(arguments.camera_pose_sigma[1]);
      }
    }
  }
  return absl::OkStatus();
}

void AddDatasetHints(DatasetHints hints, const BopImage& image, v1::SceneImage* out) {
  if (hints == DatasetHints::kNone || !(image.K(0, 0) > 1.0 && image.K(1, 1) > 1.0)) return;
  v1::CameraHint& hint = *out->mutable_camera_hint();
  hint.set_focal_px(std::sqrt(image.K(0, 0) * image.K(1, 1)));
  if (hints == DatasetHints::kFocal) return;
  hint.set_principal_point_x_px(image.K(0, 2));
  hint.set_principal_point_y_px(image.K(1, 2));
  hint.set_k1(image.distortion.empty() ? 0.0 : image.distortion[0]);
}

}  // namespace horopter
