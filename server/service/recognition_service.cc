#include "server/service/recognition_service.h"

#include <spdlog/spdlog.h>

#include <algorithm>
#include <chrono>
#include <map>
#include <memory>
#include <optional>
#include <string>
#include <utility>

#include "absl/strings/numbers.h"
#include "absl/strings/str_cat.h"
#include "absl/strings/str_join.h"
#include "server/base/status_macros.h"
#include "server/service/answer_overlay.h"
#include "server/service/convert.h"
#include "server/service/region_convert.h"
#include "server/service/rpc_status.h"
#include "server/service/station_convert.h"
#include "server/service/station_store.h"
#include "server/service/unary_call.h"

namespace horopter {
namespace {

// Clients ask again by themselves, a few times.
constexpr int kAskAgainMs = 2000;

absl::Status NotInCatalog(const PublishedCatalog& published,
                          const std::string& field,
                          const std::string& id) {
  if (published.pending.count(id) > 0) {
    return RetryLater(
        absl::StrCat(field, ": '", ObjectName(id), "' is still being prepared after an upgrade"),
        kAskAgainMs);
  }
  return FieldError(absl::StatusCode::kNotFound,
                    field,
                    absl::StrCat("'", ObjectName(id), "' is not in the catalog"));
}

// The position in the request is only known here: the pipeline sees ids.
absl::Status CheckIds(const v1::RecognizeSceneRequest& proto,
                      const SceneRequest& request,
                      const PublishedCatalog& published) {
  for (int i = 0; i < proto.candidate_objects_size(); ++i) {
    const std::string field = absl::StrCat("candidate_objects[", i, "]");
    HOROPTER_ASSIGN_OR_RETURN(const std::string id,
                              ObjectIdFromName(proto.candidate_objects(i), field));
    if (!published.Contains(id)) return NotInCatalog(published, field, id);
  }
  const std::vector<ReferenceObject> references = ReferencesOf(request);
  for (size_t i = 0; i < references.size(); ++i) {
    if (published.Contains(references[i].object_id)) continue;
    return NotInCatalog(
        published,
        i == 0 ? "reference.object" : absl::StrCat("further_references[", i - 1, "].object"),
        references[i].object_id);
  }
  for (size_t i = 0; i < request.expected_parts.size(); ++i) {
    const ExpectedPart& part = request.expected_parts[i];
    const std::string field = absl::StrCat("expected_parts[", i, "]");
    if (!published.Contains(part.object_id))
      return NotInCatalog(published, field + ".object", part.object_id);
    if (!part.frame_object.empty() && !published.Contains(part.frame_object))
      return NotInCatalog(published, field + ".frame_object", part.frame_object);
  }
  if (!request.explained.empty() && !published.Contains(request.explained)) {
    return NotInCatalog(published, "explain_object", request.explained);
  }
  return absl::OkStatus();
}

absl::StatusOr<std::string> AllowedVariants(const std::string& named,
                                            const RecognitionLimits& limits) {
  if (named.empty() || limits.allow_variants) return named;
  return FieldError(absl::StatusCode::kPermissionDenied,
                    kVariantsKey,
                    "this server takes no variants: start it with --allow-variants");
}

// Waits for the writes that the caller knows of. Errors: INVALID_ARGUMENT, UNAVAILABLE.
absl::Status AwaitCatalog(const CallInfo& call, const CatalogStore& store) {
  constexpr double kMostS = 2.0;  // a server that follows is behind by less
  if (call.min_generation.empty()) return absl::OkStatus();
  int64_t generation = 0;
  if (!absl::SimpleAtoi(call.min_generation, &generation) || generation < 0)
    return InvalidField(kMinGenerationKey, "not a number of a generation");
  return store.AwaitGeneration(generation, kMostS, call.limits.stop);
}

// Of a request that names a station; its state goes into the record, for a replay.
absl::StatusOr<std::optional<StationStart>> BeginStationOf(const v1::RecognizeSceneRequest& proto,
                                                           Catalog& catalog,
                                                           bool may_teach,
                                                           SceneRequest* scene,
                                                           RequestRecord* record) {
  if (proto.station().empty()) {
    if (!proto.station_state().empty()) return InvalidField("station_state", "set without station");
    if (proto.station_read_only()) return InvalidField("station_read_only", "set without station");
    return std::nullopt;
  }
  HOROPTER_ASSIGN_OR_RETURN(const std::string id, StationIdFromName(proto.station(), "station"));
  StationUse use;
  use.state = proto.station_state();
  for (const v1::SceneImage& image : proto.images()) use.camera_ids.push_back(image.camera_id());
  use.read_only = proto.station_read_only() || !may_teach;
  HOROPTER_ASSIGN_OR_RETURN(std::optional<StationStart> station,
                            BeginStation(catalog, id, use, scene->images));
  scene->station = station->request;
  if (proto.station_state().empty()) {
    v1::RecognizeSceneRequest supplement;
    supplement.set_station_state(station->state);
    record->request_supplement = supplement.SerializeAsString();
  }
  return station;
}

// What looking at parts of the images enlarged takes at most.
int64_t RegionBytes(const v1::RecognizeSceneRequest& request,
                    const std::vector<ImageShape>& shapes) {
  constexpr double kBytes = 32.0;  // per working pixel
  const WorkingCutOptions cutting = CuttingOf(request.images_size());
  double pixels = 0.0;
  for (int i = 0; i < request.images_size(); ++i) {
    if (request.regions().empty() && request.images(i).regions().empty()) continue;
    const double of_image = 1.0 * shapes[i].width * shapes[i].height;
    const double enlarged = cutting.most_enlarged * cutting.most_enlarged * of_image;
    pixels += std::min(enlarged, cutting.most_px);
  }
  return static_cast<int64_t>(kBytes * pixels);
}

StageReport DecodeReport(std::chrono::steady_clock::time_point start, const SceneRequest& request) {
  StageReport report;
  report.stage = "decode";
  report.seconds = std::chrono::duration<double>(std::chrono::steady_clock::now() - start).count();
  double pixels = 0.0;
  for (const cv::Mat& image : request.images) pixels += static_cast<double>(image.total());
  report.counts = {{"images", static_cast<double>(request.images.size())}, {"pixels", pixels}};
  return report;
}

// Draws what is told of the answer and says how long it took.
absl::Status AddDrawings(const v1::RecognizeSceneRequest& request,
                         const SceneRequest& scene,
                         const AnswerFormat& format,
                         const CatalogStore& store,
                         const CatalogSnapshot& catalog,
                         PipelineResult* result,
                         v1::RecognizeSceneResponse* response) {
  const auto start = std::chrono::steady_clock::now();
  // Of a catalog that is not in memory the objects are read, and must stay while they are drawn.
  std::map<std::string, std::shared_ptr<const PreparedObject>> objects;
  const ModelLookup models = [&](const std::string& id) -> const ObjectModel* {
    auto [at, is_new] = objects.try_emplace(id);
    for (int i = 0; is_new && i < ObjectCount(catalog); ++i) {
      if (catalog.stored.empty() ? store.ModelOf(*catalog.objects[i]).id != id
                                 : catalog.stored[i]->id() != id)
        continue;
      auto object = ObjectAt(catalog, i);
      if (object.ok()) at->second = *std::move(object);
      break;
    }
    return at->second == nullptr ? nullptr : &store.ModelOf(*at->second);
  };
  SceneAnswer told = result->answer;
  std::erase_if(told.objects, [&](const AnswerObject& o) { return o.score < format.min_score; });
  HOROPTER_RETURN_IF_ERROR(
      AddOverlays(request.overlay(), scene, DrawAnswer(told, scene, models), response));
  StageReport& report = result->answer.stages.emplace_back();
  report.stage = "overlay";
  report.seconds = std::chrono::duration<double>(std::chrono::steady_clock::now() - start).count();
  return absl::OkStatus();
}

void DescribeStation(const std::string& id,
                     const v1::StationReport& report,
                     RequestRecord* record) {
  constexpr size_t kPrefix = sizeof("KIND_") - 1;
  record->station = id;
  const auto* const kinds = v1::StationFinding::Kind_descriptor();
  for (int i = 0; i < kinds->value_count(); ++i) {
    const int kind = kinds->value(i)->number();
    if (kind == v1::StationFinding::KIND_UNSPECIFIED) continue;
    const bool found = std::any_of(report.findings().begin(),
                                   report.findings().end(),
                                   [&](const auto& finding) { return finding.kind() == kind; });
    record->station_findings.emplace_back(kinds->value(i)->name().substr(kPrefix), found);
  }
}

// Stages are not in every view of the answer.
void DescribeAnswer(const v1::RecognizeSceneResponse& response,
                    const std::vector<StageReport>& stages,
                    RequestRecord* record) {
  constexpr size_t kPrefix = sizeof("KIND_") - 1;
  for (const v1::SceneReason& reason : response.reasons()) {
    record->reasons.push_back(v1::SceneReason::Kind_Name(reason.kind()).substr(kPrefix));
  }
  record->state =
      response.objects_size() > 0 || record->reasons.empty() ? "RECOGNIZED" : record->reasons[0];
  record->time_limited = response.completeness() == v1::COMPLETENESS_TIME_LIMITED;
  record->objects = response.objects_size();
  record->catalog_generation = response.catalog_generation();
  for (const StageReport& s : stages) record->stages.emplace_back(s.stage, s.seconds);
}

}  // namespace

RecognitionService::RecognitionService(CatalogStore& store,
                                       const CallGate& gate,
                                       Recognizer recognizer,
                                       const RecognitionLimits& limits)
    : store_(store), gate_(gate), recognizer_(std::move(recognizer)), limits_(limits) {}

grpc::ServerUnaryReactor* RecognitionService::RecognizeScene(grpc::CallbackServerContext* context,
                                                             const grpc::ByteBuffer* request,
                                                             grpc::ByteBuffer* response) {
  return RunUnaryCall<v1::RecognizeSceneRequest, v1::RecognizeSceneResponse>(
      gate_,
      context,
      request,
      response,
      {{"RecognizeScene", limits_.max_request_bytes, Role::kRobot},
       [this](const auto& message, const CallInfo& call, auto* answer) {
         return Handle(message, call, answer);
       },
       [this](const auto& message) { return Demand(message); }});
}

absl::StatusOr<CallDemand> RecognitionService::Demand(
    const v1::RecognizeSceneRequest& request) const {
  HOROPTER_ASSIGN_OR_RETURN(const std::vector<ImageShape> shapes,
                            ShapesOf(request, limits_.images));
  if (!v1::Priority_IsValid(request.priority())) return InvalidField("priority", "unknown value");
  CallDemand demand;
  demand.batch = request.priority() == v1::PRIORITY_BATCH;
  demand.bytes = DecodedBytes(shapes);
  demand.bytes += RegionBytes(request, shapes);
  for (const ImageShape& shape : shapes) {
    demand.bytes += limits_.work_bytes_per_pixel * shape.width * shape.height;
    if (request.has_overlay())
      demand.bytes += OverlayBytesPerPixel(request.overlay()) * shape.width * shape.height;
  }
  return demand;
}

absl::Status RecognitionService::Handle(const v1::RecognizeSceneRequest& request,
                                        const CallInfo& call,
                                        v1::RecognizeSceneResponse* response) const {
  const auto start = std::chrono::steady_clock::now();
  call.record->images = request.images_size();
  if (gate_.sink != nullptr && gate_.sink->KeepsMessages()) {
    call.record->request = &request;
    call.record->response = response;
  }
  HOROPTER_ASSIGN_OR_RETURN(const AnswerFormat format, AnswerFormatFromProto(request));
  HOROPTER_RETURN_IF_ERROR(AwaitCatalog(call, store_));
  const std::shared_ptr<const PublishedCatalog> published = store_.Published();
  if (store_.catalog().IsShared())
    call.record->catalog_age_ms = static_cast<int64_t>(1e3 * store_.SecondsBehind());
  HOROPTER_ASSIGN_OR_RETURN(
      SceneRequest scene,
      SceneRequestFromProto(request, limits_.images, limits_.decode_threads, call.limits.stop));
  HOROPTER_RETURN_IF_ERROR(CheckIds(request, scene, *published));
  HOROPTER_ASSIGN_OR_RETURN(scene.variants, AllowedVariants(call.variants, limits_));
  HOROPTER_ASSIGN_OR_RETURN(
      const std::optional<StationStart> station,
      BeginStationOf(request, store_.catalog(), call.may_teach, &scene, call.record));
  HOROPTER_RETURN_IF_ERROR(PlaceRegions(&scene));
  StageReport decode = DecodeReport(start, scene);

  HOROPTER_ASSIGN_OR_RETURN(PipelineResult result,
                            recognizer_(scene, published->snapshot, call.limits));
  if (call.limits.stop()) return absl::CancelledError("stopped");
  result.answer.stages.insert(result.answer.stages.begin(), std::move(decode));
  if (request.has_overlay()) {
    HOROPTER_RETURN_IF_ERROR(
        AddDrawings(request, scene, format, store_, published->snapshot, &result, response));
  }
  SceneAnswerToProto(result.answer, scene, format, response);
  if (station) {
    // An answer is no worse for a station that could not be taught.
    const auto learnt = TeachStation(
        store_.catalog(), *station, result.station.value_or(StationOutcome()), call.request_id);
    if (!learnt.ok()) {
      spdlog::error("request={} station={} cannot be taught: {}",
                    call.request_id,
                    station->id,
                    std::string(learnt.status().message()));
    }
    StationReportToProto(*station,
                         result.station.value_or(StationOutcome()),
                         learnt.ok() && *learnt,
                         response->mutable_station());
    DescribeStation(station->id, response->station(), call.record);
  }
  if (scene.candidates.empty() && !published->pending.empty()) {
    v1::UnsearchedStep* const step = response->add_unsearched();
    step->set_cause(v1::UnsearchedStep::CAUSE_PREPARING);
    step->set_step("catalog");
  }
  EchoImages(request, response);
  response->set_request_id(call.request_id);
  response->set_catalog_generation(published->snapshot.generation);
  DescribeAnswer(*response, result.answer.stages, call.record);
  spdlog::info("request={} images={} state={} reasons={} time_limited={} objects={}",
               call.request_id,
               scene.images.size(),
               call.record->state,
               absl::StrJoin(call.record->reasons, ","),
               call.record->time_limited,
               response->objects_size());
  return absl::OkStatus();
}

}  // namespace horopter
