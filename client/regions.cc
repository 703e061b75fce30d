#include "client/regions.h"

#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>

#include "absl/strings/numbers.h"
#include "absl/strings/str_cat.h"
#include "absl/strings/str_split.h"
#include "client/convert.h"

namespace horopter {
namespace {

constexpr size_t kSpaceNumbers = 10;

absl::Status AddImageRegion(const std::string& word, v1::RecognizeSceneRequest* request) {
  const auto bad = [&](const char* what) {
    return absl::InvalidArgumentError(absl::StrCat(
        "--region ", word, ": ", what, "; need IMAGE:X,Y,WIDTH,HEIGHT, e.g. 1:0,0,640,480"));
  };
  const std::vector<std::string> parts = absl::StrSplit(word, ':');
  int image = 0;
  if (parts.size() != 2 || !absl::SimpleAtoi(parts[0], &image)) return bad("not understood");
  if (image < 1 || image > request->images_size()) return bad("there is no such image");
  const std::vector<std::string> numbers = absl::StrSplit(parts[1], ',');
  double n[4];
  if (numbers.size() != 4) return bad("not four numbers");
  for (size_t k = 0; k < 4; ++k) {
    if (!absl::SimpleAtod(numbers[k], &n[k])) return bad("not a number");
  }
  v1::ImageRegion* const region = request->mutable_images(image - 1)->add_regions();
  region->set_x_px(n[0]);
  region->set_y_px(n[1]);
  region->set_width_px(n[2]);
  region->set_height_px(n[3]);
  return absl::OkStatus();
}

}  // namespace

absl::Status AddRegions(const RegionArguments& arguments, v1::RecognizeSceneRequest* request) {
  for (const std::string& word : arguments.boxes) {
    const absl::Status added = AddImageRegion(word, request);
    if (!added.ok()) return added;
  }
  const std::vector<double>& all = arguments.space_boxes;
  if (all.size() % kSpaceNumbers != 0) {
    return absl::InvalidArgumentError(
        "--region-box takes the pose of a box's middle in the base and its size: "
        "x y z qw qx qy qz sx sy sz");
  }
  for (size_t first = 0; first < all.size(); first += kSpaceNumbers) {
    const double* n = &all[first];
    const Eigen::Quaterniond q(n[3], n[4], n[5], n[6]);
    if (!(std::abs(q.norm() - 1.0) < 0.01))
      return absl::InvalidArgumentError("--region-box: the quaternion's norm is not 1");
    Rigid3 base_from_region;
    base_from_region.R = q.normalized().toRotationMatrix();
    base_from_region.t = {n[0], n[1], n[2]};
    v1::SpaceRegion* const region = request->add_regions();
    *region->mutable_base_from_region() = ToProto(base_from_region);
    region->mutable_size_m()->set_x(n[7]);
    region->mutable_size_m()->set_y(n[8]);
    region->mutable_size_m()->set_z(n[9]);
  }
  return absl::OkStatus();
}

void AddTrueRegions(TrueRegions regions,
                    double margin,
                    const BopImage& image,
                    v1::SceneImage* out) {
  Eigen::AlignedBox2d all;
  const auto add = [&](const Eigen::AlignedBox2d& box) {
    const double grown = margin * box.sizes().maxCoeff();
    v1::ImageRegion* const region = out->add_regions();
    region->set_x_px(box.min().x() - grown);
    region->set_y_px(box.min().y() - grown);
    region->set_width_px(box.sizes().x() + 2.0 * grown);
    region->set_height_px(box.sizes().y() + 2.0 * grown);
  };
  for (const BopInstance& instance : image.instances) {
    if (instance.visible_box.isEmpty()) continue;
    if (regions == TrueRegions::kParts) add(instance.visible_box);
    all.extend(instance.visible_box);
  }
  if (regions == TrueRegions::kAll && !all.isEmpty()) add(all);
}

}  // namespace horopter
