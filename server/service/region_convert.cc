#include "server/service/region_convert.h"

#include <algorithm>
#include <cmath>

#include "absl/strings/str_cat.h"
#include "horopter/v1/recognition.pb.h"
#include "server/base/status_macros.h"
#include "server/pipeline/placed_boxes.h"
#include "server/service/convert.h"
#include "server/service/rpc_status.h"

namespace horopter {
namespace {

constexpr double kMaxSizeM = 100.0;
constexpr double kLeastPx = 1.0;  // of a side, within the image
constexpr int kBorderSteps = 32;  // of a side, which a lens bends

// Errors: INVALID_ARGUMENT.
absl::StatusOr<ImageBox> BoxFromProto(const v1::ImageRegion& proto,
                                      int width,
                                      int height,
                                      const std::string& field) {
  const double values[] = {proto.x_px(), proto.y_px(), proto.width_px(), proto.height_px()};
  for (const double value : values) {
    if (!std::isfinite(value)) return InvalidField(field, "not finite");
  }
  if (!(proto.width_px() > 0.0) || !(proto.height_px() > 0.0))
    return InvalidField(field, "empty: width_px and height_px must be > 0");
  const Eigen::Vector2d from(proto.x_px() - 0.5, proto.y_px() - 0.5);
  const ImageBox box(from, from + Eigen::Vector2d(proto.width_px(), proto.height_px()));
  const ImageBox within = box.intersection(WholeImage(width, height));
  if (within.isEmpty() || within.sizes().minCoeff() < kLeastPx) {
    return InvalidField(field,
                        absl::StrCat("outside of the image, which has ", width, " x ", height));
  }
  return within;
}

// The box of the rectified image that holds what a box of the sent one shows.
ImageBox RectifiedBox(const ImageBox& box, const LensModel& lens, int width, int height) {
  constexpr int kRounds = 40;        // towards the ray whose image a pixel is
  constexpr double kDamping = 0.7;   // wide lenses overshoot
  constexpr double kMostRay = 20.0;  // tangent of the angle to the axis
  const double reach = std::min(ReachOf(lens).ray, kMostRay);
  ImageBox out;
  const auto add = [&](const Eigen::Vector2d& pixel) {
    Eigen::Vector2d ray((pixel.x() - lens.cx) / lens.fx, (pixel.y() - lens.cy) / lens.fy);
    for (int i = 0; i < kRounds; ++i) {
      const Eigen::Vector2d back = DistortedPixel(lens, ray);
      const Eigen::Vector2d miss((pixel.x() - back.x()) / lens.fx,
                                 (pixel.y() - back.y()) / lens.fy);
      ray += kDamping * miss;
      if (ray.norm() > reach) ray *= reach / ray.norm();
    }
    out.extend(Eigen::Vector2d(lens.fx * ray.x() + lens.cx, lens.fx * ray.y() + lens.cy));
  };
  for (int i = 0; i <= kBorderSteps; ++i) {
    const double t = 1.0 * i / kBorderSteps;
    const Eigen::Vector2d along = box.min() + t * box.sizes();
    for (const double side : {box.min().y(), box.max().y()}) add({along.x(), side});
    for (const double side : {box.min().x(), box.max().x()}) add({side, along.y()});
  }
  const ImageBox whole = WholeImage(width, height);
  const ImageBox within = out.intersection(whole);
  // Rectification keeps the middle of wide lenses only: a pixel of its border shows no part.
  if (!within.isEmpty() && within.sizes().minCoeff() >= kLeastPx) return within;
  const Eigen::Vector2d nearest =
      out.center().cwiseMax(whole.min()).cwiseMin((whole.max().array() - kLeastPx).matrix());
  return {nearest, nearest + Eigen::Vector2d::Constant(kLeastPx)};
}

}  // namespace

absl::StatusOr<std::optional<SearchedPart>> RegionsFromProto(const v1::SceneImage& proto,
                                                             int width,
                                                             int height,
                                                             const std::optional<LensModel>& lens,
                                                             const std::string& field) {
  if (proto.regions().empty()) return std::nullopt;
  if (proto.regions_size() > kMaxImageRegions)
    return InvalidField(field + ".regions", absl::StrCat("more than ", kMaxImageRegions));
  SearchedPart part;
  for (int i = 0; i < proto.regions_size(); ++i) {
    HOROPTER_ASSIGN_OR_RETURN(
        const ImageBox box,
        BoxFromProto(proto.regions(i), width, height, absl::StrCat(field, ".regions[", i, "]")));
    part.boxes.push_back(lens ? RectifiedBox(box, *lens, width, height) : box);
  }
  return part;
}

absl::StatusOr<std::vector<SpaceBox>> SpaceRegionsFromProto(
    const v1::RecognizeSceneRequest& proto) {
  if (proto.regions_size() > kMaxSpaceRegions)
    return InvalidField("regions", absl::StrCat("more than ", kMaxSpaceRegions));
  std::vector<SpaceBox> boxes;
  for (int i = 0; i < proto.regions_size(); ++i) {
    const v1::SpaceRegion& region = proto.regions(i);
    const std::string field = absl::StrCat("regions[", i, "]");
    SpaceBox& box = boxes.emplace_back();
    HOROPTER_ASSIGN_OR_RETURN(
        box.base_from_box, RigidFromProto(region.base_from_region(), field + ".base_from_region"));
    box.size_m = {region.size_m().x(), region.size_m().y(), region.size_m().z()};
    if (!box.size_m.allFinite() || !(box.size_m.minCoeff() > 0.0) ||
        !(box.size_m.maxCoeff() <= kMaxSizeM))
      return InvalidField(field + ".size_m", absl::StrCat("must be > 0 and <= ", kMaxSizeM));
  }
  return boxes;
}

absl::Status PlaceRegions(SceneRequest* request) {
  const absl::Status placed = PlaceBoxes(request);
  return placed.ok() ? placed : InvalidField("regions", std::string(placed.message()));
}

void RegionsToProto(const SceneRequest& request, int i, v1::Camera* camera) {
  if (request.searched.empty() || !request.searched[i]) return;
  for (const ImageBox& box : request.searched[i]->boxes) {
    v1::ImageRegion* const region = camera->add_regions();
    region->set_x_px(box.min().x() + 0.5);
    region->set_y_px(box.min().y() + 0.5);
    region->set_width_px(box.sizes().x());
    region->set_height_px(box.sizes().y());
  }
  camera->set_region_empty(request.searched[i]->boxes.empty());
}

}  // namespace horopter
