// What the caller says of lenses (CameraHint), tested against the images before an answer rests on
// it (ADR 71).
#pragma once

#include <optional>
#include <span>
#include <vector>

#include "server/pipeline/scene.h"
#include "server/vision/euclidean/camera_group.h"

namespace horopter {

// Whether the caller says anything of a lens: what an image's file gives is no claim.
bool HasClaim(const CameraHint& hint);
bool HasClaims(std::span<const CameraHint> hints);

// The request without them; what its images' files say, and poses, stay.
SceneRequest WithoutClaims(SceneRequest request);

// The hints with claims so loose that they hide no error, for the adjustment that the images speak
// by: focal lengths remain where the images are silent.
std::vector<CameraHint> LoosenedClaims(std::span<const CameraHint> hints,
                                       std::span<const cv::Mat> images);

struct HintTest {
  bool agrees = true;
  double squared = 0.0, limit = 0.0;  // Mahalanobis distance, and what it must not exceed
  std::vector<int> images;            // that contradict what is said of them
};

// What the images say of one factor common to all focal lengths that are claimed: the log of theirs
// over those of the claims, with its deviation by the images alone. Empty: fewer than one claim.
struct CommonFactor {
  double log = 0.0, sigma = 0.0;
};
std::optional<CommonFactor> CommonFocalFactor(std::span<const CameraHint> hints,
                                              const CameraEvidence& evidence);

// Compares the claims with what the images say (MetricScene::evidence of a scene adjusted with
// LoosenedClaims). Agrees where the images say nothing.
HintTest TestHints(std::span<const CameraHint> hints, const CameraEvidence& evidence);

// Says in the answer which claims are contradicted, and takes the certainty from its scores:
// whether the images or what is said of their cameras is wrong nobody knows.
// cameras: of the scene that the images alone gave.
void TellContradictedHints(std::span<const CameraHint> hints,
                           const HintTest& test,
                           std::span<const std::optional<PosedCamera>> cameras,
                           SceneAnswer* answer);

}  // namespace horopter
