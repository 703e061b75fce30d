// What rankers are asked, on the wire.
#pragma once

#include <span>
#include <vector>

#include "absl/status/statusor.h"
#include "horopter/v1/ranking.pb.h"
#include "server/pipeline/ranking.h"

namespace horopter {

v1::RankPartsRequest RankingQuestionToProto(std::span<const RankingImage> images);

// Errors: INVALID_ARGUMENT, names the field.
absl::StatusOr<std::vector<RankingImage>> RankingQuestionFromProto(
    const v1::RankPartsRequest& request);

void RankedPartsToProto(std::span<const RankedPart> parts, v1::RankPartsResponse* response);

// Errors: INVALID_ARGUMENT (a name that is none, another number of values).
absl::StatusOr<std::vector<RankedPart>> RankedPartsFromProto(const v1::RankPartsResponse& response,
                                                             int images);

}  // namespace horopter
