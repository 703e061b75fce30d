// What recognition looks for of an object, as thumbnails.
#include <algorithm>

#include "absl/strings/numbers.h"
#include "absl/strings/str_cat.h"
#include "server/base/status_macros.h"
#include "server/pipeline/view_templates.h"
#include "server/service/catalog_service.h"
#include "server/service/convert.h"
#include "server/service/rpc_status.h"
#include "server/service/unary_call.h"

namespace horopter {
namespace {

constexpr int kDefaultTemplates = 24;
constexpr int kMaxTemplates = 100;
// A token is this prefix and how many templates were sent.
constexpr std::string_view kTokenPrefix = "v1.";

absl::StatusOr<int> FirstOf(const std::string& token) {
  if (token.empty()) return 0;
  int first = 0;
  if (token.substr(0, kTokenPrefix.size()) != kTokenPrefix ||
      !absl::SimpleAtoi(token.substr(kTokenPrefix.size()), &first) || first < 1) {
    return InvalidField("page_token", "not a token of this method");
  }
  return first;
}

v1::ViewTemplate::EdgeKind EdgeKindToProto(TemplateEdge kind) {
  switch (kind) {
    case TemplateEdge::kSilhouette:
      return v1::ViewTemplate::EDGE_KIND_SILHOUETTE;
    case TemplateEdge::kOcclusion:
      return v1::ViewTemplate::EDGE_KIND_OCCLUSION;
    case TemplateEdge::kCrease:
      return v1::ViewTemplate::EDGE_KIND_CREASE;
  }
  return v1::ViewTemplate::EDGE_KIND_UNSPECIFIED;
}

void TemplatesToProto(const TemplateViews& views, v1::ListViewTemplatesResponse* response) {
  for (const TemplateView& view : views.views) {
    v1::ViewTemplate* out = response->add_templates();
    RigidToProto(view.camera_from_object, out->mutable_camera_from_object());
    for (const TemplatePoint& point : view.points) {
      out->add_points_px(point.image_px.x());
      out->add_points_px(point.image_px.y());
      out->add_directions_rad(point.direction_rad);
      out->add_kinds(EdgeKindToProto(point.kind));
    }
  }
  response->set_total_size(views.count);
  response->set_width_px(views.camera.width);
  response->set_height_px(views.camera.height);
  response->set_focal_px(views.camera.focal_px);
}

}  // namespace

absl::Status CatalogService::Templates(const v1::ListViewTemplatesRequest& request,
                                       v1::ListViewTemplatesResponse* response) {
  HOROPTER_ASSIGN_OR_RETURN(const std::string id, ObjectIdFromName(request.name(), "name"));
  if (request.page_size() < 0) return InvalidField("page_size", "negative");
  const int page =
      request.page_size() == 0 ? kDefaultTemplates : std::min(request.page_size(), kMaxTemplates);
  HOROPTER_ASSIGN_OR_RETURN(const int first, FirstOf(request.page_token()));
  HOROPTER_ASSIGN_OR_RETURN(LoadedObject object,
                            store_.catalog().LoadObject(id, {.version = store_.derived_version()}));
  const DerivedData& stored = object.derived;
  const absl::StatusOr<TemplateViews> views =
      ReadTemplates(std::move(object.model), stored.data, stored.keys, first, page);
  if (absl::IsDataLoss(views.status()) || absl::IsInvalidArgument(views.status())) {
    // A row that is made anew; until then as good as none.
    return absl::FailedPreconditionError(
        absl::StrCat("object '", id, "': ", std::string(views.status().message())));
  }
  HOROPTER_RETURN_IF_ERROR(views.status());
  if (first > 0 && first >= views->count) {
    return InvalidField("page_token", "not a token of this method");
  }
  TemplatesToProto(*views, response);
  const int sent = first + static_cast<int>(views->views.size());
  if (sent < views->count) {
    response->set_next_page_token(absl::StrCat(std::string(kTokenPrefix), sent));
  }
  return absl::OkStatus();
}

grpc::ServerUnaryReactor* CatalogService::ListViewTemplates(grpc::CallbackServerContext* context,
                                                            const grpc::ByteBuffer* bytes,
                                                            grpc::ByteBuffer* answer) {
  return RunUnaryCall<v1::ListViewTemplatesRequest, v1::ListViewTemplatesResponse>(
      gate_,
      context,
      bytes,
      answer,
      {{.name = "ListViewTemplates", .needs = Role::kRobot},
       [this](const v1::ListViewTemplatesRequest& request,
              const CallInfo&,
              v1::ListViewTemplatesResponse* response) { return Templates(request, response); }});
}

}  // namespace horopter
