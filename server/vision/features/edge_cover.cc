#include "server/vision/features/edge_cover.h"

#include <algorithm>
#include <cmath>

#include "server/base/stop_scope.h"
#include "server/vision/features/stop_paces.h"

namespace horopter {
namespace {

constexpr int kHalfTurn = 180;  // steps of the coarse angle, about a degree each

}  // namespace

EdgeCover::EdgeCover(int width, int height)
    : width_(width), height_(height), direction_(static_cast<size_t>(width) * height, kFree) {}

uint8_t EdgeCover::EdgeDirection(const Eigen::Vector2f& gradient) {
  const float gx = gradient.y() < 0.0f ? -gradient.x() : gradient.x();
  const float gy = std::abs(gradient.y());
  const float sum = std::abs(gx) + gy;
  // 0 at +x, 90 at +y, 180 at -x.
  const float angle = sum > 0.0f ? 90.0f * (1.0f - gx / sum) : 0.0f;
  return static_cast<uint8_t>(std::min(static_cast<int>(angle), kHalfTurn - 1));
}

void EdgeCover::Mark(const Eigen::Vector2f& point, uint8_t direction) {
  const int x = std::clamp(static_cast<int>(point.x() + 0.5f), 0, width_ - 1);
  const int y = std::clamp(static_cast<int>(point.y() + 0.5f), 0, height_ - 1);
  direction_[static_cast<size_t>(y) * width_ + x] = direction;
}

bool EdgeCover::Covers(const Eigen::Vector2f& point, uint8_t direction) const {
  const int cx = static_cast<int>(point.x() + 0.5f), cy = static_cast<int>(point.y() + 0.5f);
  for (int y = std::max(cy - 1, 0); y <= std::min(cy + 1, height_ - 1); ++y) {
    for (int x = std::max(cx - 1, 0); x <= std::min(cx + 1, width_ - 1); ++x) {
      const uint8_t there = direction_[static_cast<size_t>(y) * width_ + x];
      if (there == kFree) {
        continue;
      }
      const int difference = std::abs(there - direction);
      if (std::min(difference, kHalfTurn - difference) <= kSameDirection) {
        return true;
      }
    }
  }
  return false;
}

void SortLongestFirst(std::vector<EdgeChain>* chains) {
  StopPacer comparisons(kComparisonsPerLook);
  std::stable_sort(chains->begin(), chains->end(), [&](const EdgeChain& a, const EdgeChain& b) {
    comparisons.Step();
    return a.points.size() > b.points.size();
  });
}

std::vector<EdgeChain> JoinLinkedChains(std::vector<EdgeChain> chains, int width, int height) {
  const bool one_channel = std::all_of(chains.begin(), chains.end(), [&](const EdgeChain& chain) {
    return chain.channel == chains.front().channel;
  });
  if (one_channel) {
    return chains;
  }
  SortLongestFirst(&chains);
  EdgeCover cover(width, height);
  std::vector<EdgeChain> joined;
  std::vector<uint8_t> direction;
  StopPacer pacer(kChainsPerLook);
  for (EdgeChain& chain : chains) {
    pacer.Step();
    const int n = static_cast<int>(chain.points.size());
    direction.resize(n);
    std::vector<std::pair<int, int>> runs;
    int begin = 0;
    for (int i = 0; i <= n; ++i) {
      if (i < n) {
        direction[i] = EdgeCover::EdgeDirection(chain.gradients[i]);
        if (!cover.Covers(chain.points[i], direction[i])) {
          continue;
        }
      }
      if (i - begin >= kMinRun) {
        runs.emplace_back(begin, i);
      }
      begin = i + 1;
    }
    for (int i = 0; i < n; ++i) {
      cover.Mark(chain.points[i], direction[i]);
    }
    if (runs.size() == 1 && runs[0] == std::make_pair(0, n)) {
      joined.push_back(std::move(chain));
      continue;
    }
    for (const auto& [from, to] : runs) {
      EdgeChain run;
      run.channel = chain.channel;
      run.points.assign(chain.points.begin() + from, chain.points.begin() + to);
      run.gradients.assign(chain.gradients.begin() + from, chain.gradients.begin() + to);
      run.channels.assign(chain.channels.begin() + from, chain.channels.begin() + to);
      joined.push_back(std::move(run));
    }
  }
  return joined;
}

}  // namespace horopter
