#include "server/pipeline/presumed_focal.h"

#include <algorithm>
#include <cmath>

#include "absl/strings/str_format.h"

namespace horopter {
namespace {

// Focal lengths adjusted to parts that are not quite their models are off by more than their
// covariance says: SharedCameraOptions::widening.
constexpr double kWidening = 2.0;
constexpr double kContradictionSigmas = 3.5;  // of both together; chance: 1 in 2,000 images

}  // namespace

bool HasPresumed(std::span<const CameraHint> hints) {
  return std::any_of(hints.begin(), hints.end(), [](const CameraHint& h) {
    return h.presumed && h.focal_px.has_value();
  });
}

SceneRequest WithoutPresumed(SceneRequest request) {
  for (CameraHint& hint : request.hints) {
    if (!hint.presumed) continue;
    hint.focal_px.reset();
    hint.focal_log_sigma.reset();
    hint.presumed = false;
  }
  return request;
}

std::vector<int> ContradictedFocals(std::span<const CameraHint> hints,
                                    std::span<const std::optional<PosedCamera>> cameras) {
  std::vector<int> out;
  for (std::size_t v = 0; v < hints.size() && v < cameras.size(); ++v) {
    if (!hints[v].presumed || !hints[v].focal_px || !cameras[v]) continue;
    const double off = std::log(cameras[v]->camera.focal_px / *hints[v].focal_px);
    const double sigma =
        std::hypot(FocalLogSigma(hints[v]), kWidening * cameras[v]->focal_log_sigma);
    if (std::abs(off) > kContradictionSigmas * sigma) out.push_back(static_cast<int>(v));
  }
  return out;
}

void TellPresumed(std::span<const CameraHint> hints,
                  std::span<const std::optional<PosedCamera>> cameras,
                  SceneAnswer* answer) {
  answer->presumed_focal.assign(hints.size(), false);
  for (std::size_t v = 0; v < hints.size(); ++v) {
    answer->presumed_focal[v] =
        hints[v].presumed && hints[v].focal_px && v < cameras.size() && cameras[v];
  }
}

AnswerFinding ContradictedFocal(int view, double focal_px) {
  AnswerFinding f;
  f.kind = FindingKind::kExifContradicted;
  f.image = view;
  f.value = focal_px;
  f.detail = absl::StrFormat(
      "the file of image %d gives a focal length of %.0f pixels, which does not fit the image; was "
      "it cut out or edited?",
      view,
      focal_px);
  return f;
}

void TellContradicted(std::span<const CameraHint> hints,
                      const std::vector<int>& images,
                      SceneAnswer* answer) {
  for (const int v : images) answer->findings.push_back(ContradictedFocal(v, *hints[v].focal_px));
}

}  // namespace horopter
