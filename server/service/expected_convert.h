// Expected parts, from the wire and to it.
#pragma once

#include <string>
#include <vector>

#include "absl/status/statusor.h"
#include "server/pipeline/scene.h"

namespace horopter::v1 {
class ExpectedReport;
class RecognizeSceneRequest;
}  // namespace horopter::v1

namespace horopter {

// Errors: INVALID_ARGUMENT naming the field.
absl::StatusOr<std::vector<ExpectedPart>> ExpectedPartsFromProto(
    const v1::RecognizeSceneRequest& proto);

// answer.expected is set.
void ExpectedToProto(const SceneAnswer& answer,
                     const std::vector<ExpectedPart>& expected,
                     v1::ExpectedReport* proto);

}  // namespace horopter
