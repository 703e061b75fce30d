#include "client/bop_request.h"

#include <algorithm>

#include "absl/strings/str_cat.h"
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

BopSceneOptions ReadForRecognition(DatasetHints hints, TrueRegions regions) {
  return {.cameras = hints != DatasetHints::kNone,
          .truth = regions != TrueRegions::kNone,
          .all_sensors = true};
}

absl::Status CheckSet(const BopScene& scene, const BopImageSet& set) {
  for (const int id : set.im_ids) {
    const bool there = std::any_of(scene.images.begin(), scene.images.end(), [&](const auto& i) {
      return i.im_id == id && !i.path.empty();
    });
    if (!there) return absl::NotFoundError(absl::StrCat(scene.folder, ": no image ", id));
  }
  return absl::OkStatus();
}

std::vector<const BopImage*> ImagesToSend(const BopScene& scene, int most, const BopImageSet& set) {
  const auto chosen = [](const auto& list, const auto& value) {
    return list.empty() || std::find(list.begin(), list.end(), value) != list.end();
  };
  std::vector<const BopImage*> images;
  for (const BopImage& image : scene.images) {
    if (image.path.empty() || !chosen(set.im_ids, image.im_id)) continue;
    if (chosen(set.sensors, image.sensor)) images.push_back(&image);
  }
  const size_t n = images.size(), keep = static_cast<size_t>(std::max(0, most));
  if (keep == 0 || keep >= n) return images;
  std::vector<const BopImage*> kept;
  for (size_t i = 0; i < keep; ++i) {
    kept.push_back(images[keep == 1 ? 0 : i * (n - 1) / (keep - 1)]);
  }
  return kept;
}

std::vector<int> ReportedIds(const std::vector<const BopImage*>& images) {
  std::vector<int> ids;
  for (const BopImage* image : images) {
    ids.push_back(image->sensor == images[0]->sensor ? image->im_id : -1);
  }
  return ids;
}

void AddAnswer(int scene_id,
               const std::vector<int>& im_ids,
               const v1::RecognizeSceneResponse& response,
               double seconds,
               BopResults& results) {
  for (size_t i = 0; i < im_ids.size(); ++i) {
    const int index = static_cast<int>(i), im_id = im_ids[i];
    if (im_id < 0) continue;
    if (index < response.cameras_size() && response.cameras(index).recovered()) {
      const v1::Camera& camera = response.cameras(index);
      Eigen::Matrix3d K;
      K << camera.focal_px(), 0, camera.principal_point_x_px(), 0, camera.focal_px(),
          camera.principal_point_y_px(), 0, 0, 1;
      results.cameras[scene_id][im_id] = K;
      results.distortions[scene_id][im_id] =
          std::vector<double>{camera.k1(), camera.k2(), camera.p1(), camera.p2()};
    }
    for (const v1::RecognizedObject& object : response.objects()) {
      const std::optional<int> obj_id = BopIdOf(object.object());
      if (!obj_id || index >= object.images_size() ||
          !object.images(index).has_camera_from_object()) {
        continue;
      }
      results.estimates.push_back({scene_id,
                                   im_id,
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
