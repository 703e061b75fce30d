#include "server/vision/recognition/aspect_search/object_ranking.h"

#include "server/vision/recognition/aspect_search/object_values.h"

namespace horopter {
ObjectRankingOptions::ObjectRankingOptions() {
  votes.pool = 8;
  votes.max_per_object = 1;
}

std::vector<int> RankObjects(std::span<const AspectImage> images,
                             const FragmentIndex& index,
                             const ObjectRankingOptions& options,
                             const StopRequested& stop,
                             std::span<const std::uint8_t> wanted) {
  std::vector<int> listed;
  const auto count = [&](int i) { return wanted.empty() || wanted[i] != 0; };
  for (int i = 0; i < index.model_count; ++i) {
    if (count(i)) listed.push_back(i);
  }
  if (static_cast<int>(listed.size()) <= options.objects) return listed;
  return BestObjects(ObjectValues(images, index, options, stop, wanted), options);
}

}  // namespace horopter
