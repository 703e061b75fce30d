#include "client/bop_request.h"

#include <algorithm>

#include "client/commands.h"
#include "client/convert.h"
#include "server/base/status_macros.h"

namespace horopter {

// 12 for "objects/obj_000012"; nothing for an object that is not of a dataset.
std::optional<int> BopIdOf(const std::string& resource) {
  const std::string id = IdOfResource(resource);
  constexpr char kPrefix[] = "obj_";
  const std::string digits = id.rfind(kPrefix, 0) == 0 ? id.substr(sizeof(kPrefix) - 1) : "";
  if (digits.empty() || digits.size() > 9 ||
      digits.find_first_not_of("0123456789") != std::string::npos) {
    return std::nullopt;
  }
  return std::stoi(digits);
}

// The images of a scene that are sent; `most` > 0 takes that many, spread evenly.
std::vector<const BopImage*> ImagesToSend(const BopScene& scene, int most) {
  std::vector<const BopImage*> images;
  for (const BopImage& image : scene.images) {
    if (!image.path.empty()) images.push_back(&image);
  }
  const size_t n = images.size(), keep = static_cast<size_t>(std::max(0, most));
  if (keep == 0 || keep >= n) return images;
  std::vector<const BopImage*> kept;
  for (size_t i = 0; i < keep; ++i) {
    kept.push_back(images[keep == 1 ? 0 : i * (n - 1) / (keep - 1)]);
  }
  return kept;
}

void AddAnswer(int scene_id,
               const std::vector<int>& im_ids,
               const v1::RecognizeSceneResponse& response,
               double seconds,
               BopResults& results) {
  for (size_t i = 0; i < im_ids.size(); ++i) {
    const int index = static_cast<int>(i);
    if (index < response.cameras_size() && response.cameras(index).recovered()) {
      const v1::Camera& camera = response.cameras(index);
      Eigen::Matrix3d K;
      K << camera.focal_px(), 0, camera.principal_point_x_px(), 0, camera.focal_px(),
          camera.principal_point_y_px(), 0, 0, 1;
      results.cameras[scene_id][im_ids[i]] = K;
      results.distortions[scene_id][im_ids[i]] =
          std::vector<double>{camera.k1(), camera.k2(), camera.p1(), camera.p2()};
    }
    for (const v1::RecognizedObject& object : response.objects()) {
      const std::optional<int> obj_id = BopIdOf(object.object());
      if (!obj_id || index >= object.images_size() ||
          !object.images(index).has_camera_from_object()) {
        continue;
      }
      results.estimates.push_back({scene_id,
                                   im_ids[i],
                                   *obj_id,
                                   object.score(),
                                   FromProto(object.images(index).camera_from_object()),
                                   seconds});
    }
  }
}

absl::StatusOr<v1::RecognizeSceneRequest> SceneRequestOf(const std::vector<const BopImage*>& images,
                                                         DatasetHints hints) {
  v1::RecognizeSceneRequest request;
  for (const BopImage* image : images) {
    v1::SceneImage& out = *request.add_images();
    HOROPTER_ASSIGN_OR_RETURN(*out.mutable_content(), ReadFileBytes(image->path));
    AddDatasetHints(hints, *image, &out);
  }
  return request;
}

}  // namespace horopter
