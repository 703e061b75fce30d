#include "server/service/ranking_convert.h"

#include <algorithm>
#include <cmath>
#include <string>

#include "absl/strings/str_cat.h"
#include "server/base/status_macros.h"
#include "server/service/convert.h"
#include "server/service/rpc_status.h"

namespace horopter {
namespace {

constexpr int kMostImages = 8, kLeastSide = 16, kMostSide = 4096;
constexpr int kEdgeNumbers = 4;                        // of an edge point
constexpr int kFragmentNumbers = kFragmentAngles + 6;  // of a fragment
constexpr float kMostAngle = 100.0f;                   // radians: contours do not turn so often

absl::Status CheckNumbers(const google::protobuf::RepeatedField<float>& numbers,
                          int group,
                          const std::string& field) {
  if (numbers.size() % group != 0)
    return InvalidField(field, absl::StrCat("its numbers do not come in groups of ", group));
  if (!std::all_of(numbers.begin(), numbers.end(), [](float v) { return std::isfinite(v); }))
    return InvalidField(field, "a number that is none");
  return absl::OkStatus();
}

absl::Status EdgePointsFromProto(const v1::RankingImage& proto,
                                 const std::string& field,
                                 RankingImage* image) {
  HOROPTER_RETURN_IF_ERROR(CheckNumbers(proto.edges(), kEdgeNumbers, field));
  for (int i = 0; i < proto.edges_size(); i += kEdgeNumbers) {
    ImageEdgePoint edge;
    edge.point = {proto.edges(i), proto.edges(i + 1)};
    edge.normal = {proto.edges(i + 2), proto.edges(i + 3)};
    // As it is rounded to a pixel.
    const bool inside = edge.point.x() > -0.5f && edge.point.y() > -0.5f &&
                        edge.point.x() < static_cast<float>(image->width) - 0.5f &&
                        edge.point.y() < static_cast<float>(image->height) - 0.5f;
    if (!inside) return InvalidField(field, "an edge outside of the image");
    image->edges.push_back(edge);
  }
  return absl::OkStatus();
}

absl::Status FragmentsFromProto(const v1::RankingImage& proto,
                                const std::string& field,
                                RankingImage* image) {
  HOROPTER_RETURN_IF_ERROR(CheckNumbers(proto.fragments(), kFragmentNumbers, field));
  for (int i = 0; i < proto.fragments_size(); i += kFragmentNumbers) {
    const float* const v = proto.fragments().data() + i;
    ContourFragment f;
    std::copy(v, v + kFragmentAngles, f.key.begin());
    const float* const rest = v + kFragmentAngles;
    f.center = {rest[0], rest[1]};
    f.pivot = {rest[2], rest[3]};
    f.spread = rest[4];
    f.chord_rad = rest[5];
    const auto angle_ok = [](float a) { return std::abs(a) <= kMostAngle; };
    if (!std::all_of(f.key.begin(), f.key.end(), angle_ok) || !angle_ok(f.chord_rad) ||
        !(f.spread > 0))
      return InvalidField(field, "a fragment of no size, or angles of many turns");
    image->fragments.push_back(f);
  }
  return absl::OkStatus();
}

}  // namespace

v1::RankPartsRequest RankingQuestionToProto(std::span<const RankingImage> images) {
  v1::RankPartsRequest request;
  for (const RankingImage& image : images) {
    v1::RankingImage* const proto = request.add_images();
    proto->set_width_px(image.width);
    proto->set_height_px(image.height);
    for (const ImageEdgePoint& e : image.edges) {
      for (const float v : {e.point.x(), e.point.y(), e.normal.x(), e.normal.y()})
        proto->add_edges(v);
    }
    for (const ContourFragment& f : image.fragments) {
      for (const float angle : f.key) proto->add_fragments(angle);
      for (const float v :
           {f.center.x(), f.center.y(), f.pivot.x(), f.pivot.y(), f.spread, f.chord_rad}) {
        proto->add_fragments(v);
      }
    }
  }
  return request;
}

absl::StatusOr<std::vector<RankingImage>> RankingQuestionFromProto(
    const v1::RankPartsRequest& request) {
  if (request.images().empty() || request.images_size() > kMostImages)
    return InvalidField("images", absl::StrCat("1 to ", kMostImages, " are ranked by"));
  std::vector<RankingImage> out;
  for (int i = 0; i < request.images_size(); ++i) {
    const v1::RankingImage& proto = request.images(i);
    const std::string field = absl::StrCat("images[", i, "]");
    for (const int side : {proto.width_px(), proto.height_px()}) {
      if (side < kLeastSide || side > kMostSide)
        return InvalidField(field, absl::StrCat("a side of ", side, " pixels"));
    }
    RankingImage& image = out.emplace_back();
    image.width = proto.width_px();
    image.height = proto.height_px();
    HOROPTER_RETURN_IF_ERROR(EdgePointsFromProto(proto, field + ".edges", &image));
    HOROPTER_RETURN_IF_ERROR(FragmentsFromProto(proto, field + ".fragments", &image));
  }
  return out;
}

void RankedPartsToProto(std::span<const RankedPart> parts, v1::RankPartsResponse* response) {
  for (const RankedPart& part : parts) {
    v1::RankedPart* const proto = response->add_parts();
    proto->set_object(ObjectName(part.id));
    for (const float value : part.values) proto->add_values(value);
  }
}

absl::StatusOr<std::vector<RankedPart>> RankedPartsFromProto(const v1::RankPartsResponse& response,
                                                             int images) {
  std::vector<RankedPart> out;
  for (const v1::RankedPart& proto : response.parts()) {
    RankedPart& part = out.emplace_back();
    HOROPTER_ASSIGN_OR_RETURN(part.id, ObjectIdFromName(proto.object(), "parts.object"));
    if (proto.values_size() != images)
      return InvalidField("parts.values", "not one for each image");
    part.values.assign(proto.values().begin(), proto.values().end());
  }
  return out;
}

}  // namespace horopter
