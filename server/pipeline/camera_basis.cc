#include "server/pipeline/camera_basis.h"

#include <algorithm>
#include <string>

#include "absl/strings/str_cat.h"
#include "server/pipeline/scene.h"

namespace horopter {
namespace {

// Images that share as many matches with others show one scene, and there is one to belong to.
constexpr int kLinkedImages = 2, kEnoughMatches = 30;

std::vector<CameraBasis> BasesOf(const SceneRequest& request,
                                 const SceneTrace& trace,
                                 bool with_station,
                                 std::size_t image) {
  std::vector<CameraBasis> out;
  const auto& matched = trace.reconstruction.view_matches;
  if (image < matched.size() && matched[image].matches > 0) {
    out.push_back({matched[image].source == MatchSource::kTexture ? BasisSource::kTexture
                                                                  : BasisSource::kFeatures,
                   matched[image].matches,
                   matched[image].rms_px});
  }
  if (trace.metric && image < trace.metric->view_fits.size() &&
      trace.metric->view_fits[image].edge_points > 0) {
    const ViewFit& fit = trace.metric->view_fits[image];
    out.push_back({BasisSource::kParts, fit.edge_points, fit.rms_px});
  }
  if (with_station) out.push_back({BasisSource::kStation, 0, 0.0});
  const bool lens = image < request.hints.size() && request.hints[image].focal_px &&
                    !request.hints[image].presumed;
  const bool pose = image < request.camera_poses.size() && request.camera_poses[image];
  if (lens || pose) out.push_back({BasisSource::kGiven, 0, 0.0});
  return out;
}

}  // namespace

void TellCameraBases(const SceneRequest& request,
                     const SceneTrace& trace,
                     bool with_station,
                     SceneAnswer* answer) {
  const auto& matched = trace.reconstruction.view_matches;
  const auto linked = std::count_if(matched.begin(), matched.end(), [](const ViewMatches& m) {
    return m.matches >= kEnoughMatches;
  });
  std::string unrelated;
  answer->camera_bases.assign(answer->cameras.size(), {});
  answer->unrelated_images.assign(answer->cameras.size(), false);
  for (std::size_t i = 0; i < answer->cameras.size(); ++i) {
    if (answer->cameras[i]) {
      answer->camera_bases[i] = BasesOf(request, trace, with_station, i);
      continue;
    }
    if (linked < kLinkedImages || i >= matched.size() || matched[i].matches > 0) continue;
    answer->unrelated_images[i] = true;
    absl::StrAppend(&unrelated, unrelated.empty() ? "" : ", ", i + 1);
  }
  if (unrelated.empty()) return;
  AddReason(ReasonKind::kUnrelatedImages,
            absl::StrCat("images that show nothing of what the others show: ", unrelated),
            answer);
}

}  // namespace horopter
