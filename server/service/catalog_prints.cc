// What is printed on objects, learnt from scenes that were answered.
#include <deque>
#include <map>
#include <memory>
#include <opencv2/core/mat.hpp>
#include <utility>

#include "absl/strings/str_cat.h"
#include "server/base/status_macros.h"
#include "server/pipeline/learn_print.h"
#include "server/service/catalog_convert.h"
#include "server/service/catalog_service.h"
#include "server/service/catalog_signing.h"
#include "server/service/convert.h"
#include "server/service/rpc_status.h"

namespace horopter {
namespace {

constexpr int kMaxScenes = 16;

using Models = std::map<std::string, std::shared_ptr<const ObjectModel>>;

// The camera of an image that was recovered; nothing of others, and of images that were rectified
// first, which are not at hand.
absl::StatusOr<std::optional<CalibratedCamera>> ViewFromProto(const v1::Camera& proto,
                                                              const cv::Mat& image,
                                                              const std::string& field) {
  if (!proto.recovered() || proto.rectified()) return std::nullopt;
  if (!(proto.focal_px() > 0.0)) return InvalidField(field + ".focal_px", "not > 0");
  if (proto.image_width_px() != image.cols || proto.image_height_px() != image.rows)
    return InvalidField(field, "of an image of another size than the request's");
  CalibratedCamera view;
  view.camera = {image.cols,
                 image.rows,
                 proto.focal_px(),
                 proto.principal_point_x_px(),
                 proto.principal_point_y_px(),
                 proto.k1()};
  HOROPTER_ASSIGN_OR_RETURN(
      view.camera_from_scene,
      RigidFromProto(proto.camera_from_scene(), field + ".camera_from_scene"));
  return view;
}

// The answered objects that are in the catalog: others hide what they hide unseen.
absl::Status PlaceObjects(const v1::RecognizeSceneResponse& proto,
                          const std::string& field,
                          Catalog& catalog,
                          Models* models,
                          AnsweredImages* scene) {
  for (int i = 0; i < proto.objects_size(); ++i) {
    const std::string of = absl::StrCat(field, ".objects[", i, "]");
    HOROPTER_ASSIGN_OR_RETURN(const std::string id,
                              ObjectIdFromName(proto.objects(i).object(), of + ".object"));
    HOROPTER_ASSIGN_OR_RETURN(
        const Rigid3 pose,
        RigidFromProto(proto.objects(i).scene_from_object(), of + ".scene_from_object"));
    auto [at, is_new] = models->try_emplace(id);
    if (is_new) {
      absl::StatusOr<CatalogRecord> record = catalog.GetObject(id);
      if (!record.ok() && !absl::IsNotFound(record.status())) return record.status();
      if (record.ok()) at->second = std::make_shared<const ObjectModel>(std::move(record->model));
    }
    if (at->second != nullptr) scene->objects.push_back({at->second, pose});
  }
  return absl::OkStatus();
}

absl::StatusOr<AnsweredImages> SceneFromProto(const v1::AnsweredScene& proto,
                                              const std::string& field,
                                              const RecognitionLimits& limits,
                                              const StopRequested& stop,
                                              Catalog& catalog,
                                              Models* models,
                                              std::vector<cv::Mat>* images) {
  AnsweredImages scene;
  absl::StatusOr<std::vector<cv::Mat>> decoded =
      DecodeImages(proto.request(), limits.images, limits.decode_threads, stop);
  if (!decoded.ok()) return PrefixField(field + ".request.", decoded.status());
  *images = *std::move(decoded);
  scene.images = *images;
  const v1::RecognizeSceneResponse& response = proto.response();
  if (response.cameras_size() != std::ssize(scene.images))
    return InvalidField(field + ".response.cameras", "not one per image of the request");
  for (int v = 0; v < response.cameras_size(); ++v) {
    const std::string camera = absl::StrCat(field, ".response.cameras[", v, "]");
    HOROPTER_ASSIGN_OR_RETURN(scene.views.emplace_back(),
                              ViewFromProto(response.cameras(v), scene.images[v], camera));
  }
  HOROPTER_RETURN_IF_ERROR(PlaceObjects(response, field + ".response", catalog, models, &scene));
  return scene;
}

}  // namespace

absl::Status CatalogService::Learn(const v1::LearnPrintRequest& request,
                                   const CallInfo& info,
                                   v1::Object* response) {
  HOROPTER_ASSIGN_OR_RETURN(const std::string id, ObjectIdFromName(request.name(), "name"));
  if (request.scenes_size() < 1 || request.scenes_size() > kMaxScenes)
    return InvalidField("scenes",
                        absl::StrCat(request.scenes_size(), " is outside 1..", kMaxScenes));
  HOROPTER_ASSIGN_OR_RETURN(CatalogRecord learnt_of, store_.catalog().GetObject(id));
  const std::string etag = EtagOf(learnt_of);
  const auto model = std::make_shared<const ObjectModel>(std::move(learnt_of.model));
  Models models{{id, model}};
  std::deque<std::vector<cv::Mat>> images;  // scenes point to them
  std::vector<AnsweredImages> scenes;
  bool shown = false;
  for (int i = 0; i < request.scenes_size(); ++i) {
    HOROPTER_ASSIGN_OR_RETURN(scenes.emplace_back(),
                              SceneFromProto(request.scenes(i),
                                             absl::StrCat("scenes[", i, "]"),
                                             images_,
                                             info.limits.stop,
                                             store_.catalog(),
                                             &models,
                                             &images.emplace_back()));
    for (const auto& o : scenes.back().objects) shown = shown || o.model == model;
  }
  if (!shown) return InvalidField("scenes", absl::StrCat("none has the object '", id, "'"));
  HOROPTER_ASSIGN_OR_RETURN(const SurfacePrint print,
                            LearnPrintOf(*model, scenes, images_.decode_threads, info.limits.stop));
  // Of the surface that was looked at: a change in between is not overwritten.
  const std::string& if_match = request.if_match().empty() ? etag : request.if_match();
  const auto merge = [&](CatalogRecord current) -> absl::StatusOr<CatalogRecord> {
    HOROPTER_RETURN_IF_ERROR(CheckEtag(if_match, current));
    current.model.print = print;
    Sign(info, &current);
    return current;
  };
  return store_.Update(id, {.print = true}, merge, [&](const CatalogRecord& written) {
    response->Clear();
    ReadyToProto(written, response);
    return absl::OkStatus();
  });
}

grpc::ServerUnaryReactor* CatalogService::LearnPrint(grpc::CallbackServerContext* context,
                                                     const grpc::ByteBuffer* bytes,
                                                     grpc::ByteBuffer* answer) {
  return RunUnaryCall<v1::LearnPrintRequest, v1::Object>(
      gate_,
      context,
      bytes,
      answer,
      {{"LearnPrint", images_.max_request_bytes},
       [this](const auto& request, const CallInfo& info, v1::Object* response) {
         return Learn(request, info, response);
       },
       [this](const v1::LearnPrintRequest& request) -> absl::StatusOr<CallDemand> {
         CallDemand demand;
         for (int i = 0; i < request.scenes_size(); ++i) {
           const absl::StatusOr<std::vector<ImageShape>> shapes =
               ShapesOf(request.scenes(i).request(), images_.images);
           if (!shapes.ok())
             return PrefixField(absl::StrCat("scenes[", i, "].request."), shapes.status());
           demand.bytes += DecodedBytes(*shapes);
         }
         return demand;
       }});
}

}  // namespace horopter
