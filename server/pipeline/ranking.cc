#include "server/pipeline/ranking.h"

#include <algorithm>

#include "server/base/parallel_for.h"
#include "server/vision/recognition/object/aspect_options.h"

namespace horopter {
namespace {

constexpr int kMostRankedSide = 4096;  // working pixels, as ranking.proto says

}  // namespace

std::vector<RankingImage> RankingQuestion(std::span<const cv::Mat> images,
                                          int threads,
                                          std::span<const std::optional<SearchedPart>> searched) {
  const AspectRecognitionOptions options;
  const std::size_t looked_at =
      std::min(static_cast<std::size_t>(options.ranking.images), images.size());
  std::vector<cv::Mat> chosen;
  std::vector<std::optional<SearchedPart>> parts;
  for (std::size_t i = 0; i < looked_at; ++i) {
    const std::size_t k = i * images.size() / looked_at;
    chosen.push_back(images[k]);
    if (!searched.empty()) parts.push_back(searched[k]);
  }
  std::vector<AspectImage> seen =
      MakeAspectImagesOnGround(chosen, {}, options.images, threads, parts);
  // Long strips of small things: rankers take no such images.
  for (std::size_t i = 0; i < parts.size(); ++i) {
    if (std::max(seen[i].width, seen[i].height) > kMostRankedSide)
      seen[i] = MakeAspectImage(chosen[i], options.images);
  }
  return RankingImages(seen, options.ranking);
}

std::vector<std::string> BestParts(std::vector<RankedPart> parts, int images) {
  // In one order, whoever answered first: it decides between equals.
  std::sort(parts.begin(), parts.end(), [](const RankedPart& a, const RankedPart& b) {
    return a.id < b.id;
  });
  std::vector<std::vector<float>> values(static_cast<std::size_t>(images));
  for (std::size_t i = 0; i < values.size(); ++i) {
    for (const RankedPart& part : parts) values[i].push_back(part.values[i]);
  }
  std::vector<std::string> out;
  for (const int k : BestObjects(values)) out.push_back(parts[k].id);
  return out;
}

std::vector<RankedPart> RankShard(std::span<const RankingImage> images,
                                  std::span<const PackedIndex* const> indices,
                                  std::span<const std::string> ids,
                                  std::span<const std::uint8_t> wanted,
                                  int shards,
                                  int threads,
                                  const StopRequested& stop) {
  ObjectRankingOptions options;
  options.votes.threads = threads;
  options.votes.max_matches = MatchesOfShard(options.votes.max_matches, shards);
  const PartValues best =
      LeaveBest(PackedValues(images, indices, options.votes, wanted, stop), options.objects);
  std::vector<RankedPart> out;
  for (std::size_t k = 0; k < best.parts.size(); ++k) {
    RankedPart& part = out.emplace_back();
    part.id = ids[best.parts[k]];
    for (const std::vector<float>& values : best.values) part.values.push_back(values[k]);
  }
  return out;
}

}  // namespace horopter
