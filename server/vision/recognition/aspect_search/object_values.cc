#include "server/vision/recognition/aspect_search/object_values.h"

#include <algorithm>
#include <cmath>

namespace horopter {
namespace {

// Objects with any value, best first.
std::vector<int> Order(const std::vector<float>& value) {
  std::vector<int> order;
  for (int i = 0; i < static_cast<int>(value.size()); ++i) {
    if (value[i] > 0) order.push_back(i);
  }
  std::stable_sort(order.begin(), order.end(), [&](int a, int b) { return value[a] > value[b]; });
  return order;
}

// Best votes of all parts in one image: the gain of their edges by the root of their length, as
// chance gives a long outline more than a short one.
std::vector<float> BestRanks(const AspectVotes& votes, const FragmentIndex& index) {
  std::vector<float> best;
  for (const auto& list : votes.of_model) {
    best.push_back(0.0f);
    for (const AspectVote& vote : list) {
      const float length = index.aspects[vote.aspect].edge_length * vote.size_px;
      best.back() = std::max(best.back(), vote.rank / std::sqrt(std::max(1.0f, length)));
    }
  }
  return best;
}

}  // namespace

std::vector<std::vector<float>> ObjectValues(std::span<const AspectImage> images,
                                             const FragmentIndex& index,
                                             const ObjectRankingOptions& options,
                                             const StopRequested& stop,
                                             std::span<const std::uint8_t> wanted) {
  const int views = static_cast<int>(images.size());
  const int looked_at = std::min(options.images, views);
  std::vector<std::vector<float>> values;
  for (int i = 0; i < looked_at; ++i) {
    const AspectImage& image = images[static_cast<std::size_t>(i) * views / looked_at];
    values.push_back(BestRanks(VoteForAspects(image, index, options.votes, stop, wanted), index));
  }
  return values;
}

std::vector<int> BestObjects(std::span<const std::vector<float>> values,
                             const ObjectRankingOptions& options) {
  const std::size_t parts = values.empty() ? 0 : values.front().size();
  std::vector<float> sum(parts, 0.0f);
  std::vector<std::vector<int>> orders;
  for (const std::vector<float>& best : values) {
    for (std::size_t k = 0; k < parts; ++k) sum[k] += best[k];
    orders.push_back(Order(best));
  }
  const std::vector<int> together = Order(sum);
  std::vector<int> listed;
  std::vector<bool> taken(parts, false);
  std::vector<std::size_t> next(orders.size() + 1, 0);
  const auto take = [&](const std::vector<int>& order, std::size_t* at) {
    while (*at < order.size() && taken[order[*at]]) ++*at;
    if (*at == order.size()) return false;
    taken[order[*at]] = true;
    listed.push_back(order[*at]);
    return true;
  };
  double single = 0.0;  // owed to the single images
  std::size_t turn = 0;
  bool more = true;
  while (more && static_cast<int>(listed.size()) < options.objects) {
    more = take(together, &next.back());
    for (single += options.of_single_images / (1.0 - options.of_single_images);
         single >= 1.0 && !orders.empty() && static_cast<int>(listed.size()) < options.objects;
         single -= 1.0, ++turn) {
      const std::size_t image = turn % orders.size();
      take(orders[image], &next[image]);
    }
  }
  return listed;
}

}  // namespace horopter
