#include "server/pipeline/placed_boxes.h"

#include <opencv2/core.hpp>
#include <optional>
#include <vector>

#include "server/pipeline/station.h"
#include "server/vision/geometry/camera_prior.h"

namespace horopter {
namespace {

struct PlacedCamera {
  CalibratedCamera view;
  CameraDeviation deviation;
};

// The cameras in the robot's base, as far as focal length and place are known.
std::vector<std::optional<PlacedCamera>> CamerasInBase(const SceneRequest& request) {
  std::vector<CameraHint> hints = request.hints;
  std::vector<std::optional<CameraPoseHint>> poses = request.camera_poses;
  if (request.station) {
    hints = WithStationHints(request).hints;
    poses = WithStationBase(request, {}).camera_poses;
  }
  std::vector<std::optional<PlacedCamera>> out(request.images.size());
  if (hints.size() != out.size() || poses.size() != out.size()) return out;
  for (std::size_t v = 0; v < out.size(); ++v) {
    if (!hints[v].focal_px || !poses[v]) continue;
    const cv::Mat& image = request.images[v];
    const PinholeCamera camera =
        WithHint(CenteredCamera(image.cols, image.rows, *hints[v].focal_px), hints[v]);
    out[v] = PlacedCamera{
        {camera, poses[v]->camera_from_base},
        {FocalLogSigma(hints[v]), poses[v]->rotation_sigma_rad, poses[v]->position_sigma_m}};
  }
  return out;
}

}  // namespace

absl::Status PlaceBoxes(SceneRequest* request) {
  if (request->space_boxes.empty()) return absl::OkStatus();
  request->searched.resize(request->images.size());
  bool any_known = false, any_seen = false;
  const auto cameras = CamerasInBase(*request);
  for (std::size_t v = 0; v < cameras.size(); ++v) {
    if (!cameras[v]) continue;
    any_known = true;
    std::optional<SearchedPart>& part = request->searched[v];
    if (!part) part.emplace();
    for (const SpaceBox& box : request->space_boxes) {
      const auto seen = BoxInImage(box, cameras[v]->view, cameras[v]->deviation);
      if (!seen) continue;
      part->boxes.push_back(*seen);
      any_seen = true;
    }
  }
  if (!any_known) {
    return absl::FailedPreconditionError(
        "boxes in the base need a camera whose focal length and place in the base are known");
  }
  return any_seen ? absl::OkStatus()
                  : absl::InvalidArgumentError("no image whose camera is known shows any of them");
}

}  // namespace horopter
