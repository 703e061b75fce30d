// Focal lengths that the images' files give (CameraHint::presumed): used until the images say
// otherwise.
#pragma once

#include <optional>
#include <span>
#include <vector>

#include "server/pipeline/scene.h"

namespace horopter {

bool HasPresumed(std::span<const CameraHint> hints);

// The request without them; what else its hints say stays.
SceneRequest WithoutPresumed(SceneRequest request);

// Images whose focal length, adjusted without the presumed one, is too far from it for the
// deviations of both. cameras: one per image.
std::vector<int> ContradictedFocals(std::span<const CameraHint> hints,
                                    std::span<const std::optional<PosedCamera>> cameras);

// The file of image `view` gives a focal length that the image contradicts.
AnswerFinding ContradictedFocal(int view, double focal_px);

// Say in the answer where presumed focal lengths were used, and where they were contradicted.
void TellPresumed(std::span<const CameraHint> hints,
                  std::span<const std::optional<PosedCamera>> cameras,
                  SceneAnswer* answer);
void TellContradicted(std::span<const CameraHint> hints,
                      const std::vector<int>& images,
                      SceneAnswer* answer);

}  // namespace horopter
