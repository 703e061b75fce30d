// Which parts of a catalog too large for one server images may show: what is asked of the rankers,
// and what each answers (ADR 98).
#pragma once

#include <opencv2/core/mat.hpp>
#include <optional>
#include <span>
#include <string>
#include <vector>

#include "server/vision/recognition/object/ranking_keys.h"
#include "server/vision/recognition/recognition.h"

namespace horopter {

// A part that a shard may show, with the value of its best vote in each image.
struct RankedPart {
  std::string id;
  std::vector<float> values;
};

// What rankers are asked: of the images that are looked at (ObjectRankingOptions::images), CV_8UC1
// or CV_8UC3. searched: where in them parts are looked for, one per image; empty: everywhere.
std::vector<RankingImage> RankingQuestion(
    std::span<const cv::Mat> images,
    int threads,
    std::span<const std::optional<SearchedPart>> searched = {});

// Ids of the parts to be searched for, best first, of what all shards answered: what one index of
// all of them would list.
std::vector<std::string> BestParts(std::vector<RankedPart> parts, int images);

// Of a shard of so many: those of its parts that can be in such a list. ids: of the indices' parts
// one after the other; the rest as for PackedValues.
std::vector<RankedPart> RankShard(std::span<const RankingImage> images,
                                  std::span<const PackedIndex* const> indices,
                                  std::span<const std::string> ids,
                                  std::span<const std::uint8_t> wanted,
                                  int shards,
                                  int threads,
                                  const StopRequested& stop);

}  // namespace horopter
