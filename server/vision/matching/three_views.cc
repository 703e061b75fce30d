#include "server/vision/matching/three_views.h"

#include <Eigen/Dense>
#include <algorithm>
#include <array>
#include <cmath>
#include <cstdio>
#include <map>

namespace horopter {
namespace {

double EpipolarDistance(const Eigen::Vector3d& line, const Eigen::Vector2d& x) {
  return std::abs(line.dot(x.homogeneous())) / std::max(1e-12, line.head<2>().norm());
}

class Triples {
 public:
  Triples(std::span<const ImageFeatures* const> features,
          const ThreeViewOptions& options,
          const std::vector<PairGeometry>& pairs)
      : features_(features), options_(options), pairs_(pairs) {
    for (size_t k = 0; k < pairs.size(); ++k) {
      at_[{pairs[k].view_a, pairs[k].view_b}] = k;
      for (const JunctionMatch& m : pairs[k].matches) {
        forward_[{pairs[k].view_a, pairs[k].view_b}][m.junction_a] = m.junction_b;
        forward_[{pairs[k].view_b, pairs[k].view_a}][m.junction_b] = m.junction_a;
      }
    }
  }

  // The pairs ab, bc, ac of every triple of views with three F that does not close.
  std::vector<std::array<size_t, 3>> Open() const {
    std::vector<std::array<size_t, 3>> open;
    const int views = static_cast<int>(features_.size());
    for (int a = 0; a < views; ++a) {
      for (int b = a + 1; b < views; ++b) {
        for (int c = b + 1; c < views; ++c) {
          const auto ab = at_.find({a, b}), bc = at_.find({b, c}), ac = at_.find({a, c});
          if (ab == at_.end() || bc == at_.end() || ac == at_.end()) continue;
          if (!pairs_[ab->second].F || !pairs_[bc->second].F || !pairs_[ac->second].F) continue;
          if (!Closes(a, b, c, *pairs_[ac->second].F) || !Closes(a, c, b, *pairs_[ab->second].F) ||
              !Closes(b, a, c, *pairs_[bc->second].F))
            open.push_back({ab->second, bc->second, ac->second});
        }
      }
    }
    return open;
  }

 private:
  // Points handed on from view `from` through `over` to `to`, against F between the two ends.
  bool Closes(int from, int over, int to, const Eigen::Matrix3d& F) const {
    const auto first = forward_.find({from, over}), second = forward_.find({over, to});
    if (first == forward_.end() || second == forward_.end()) return true;
    int handed_on = 0, agree = 0;
    for (const auto& [start, middle] : first->second) {
      const auto end = second->second.find(middle);
      if (end == second->second.end()) continue;
      const Eigen::Vector2d& x = features_[from]->junctions[start].point;
      const Eigen::Vector2d& y = features_[to]->junctions[end->second].point;
      ++handed_on;
      agree +=
          std::max(EpipolarDistance(F * x.homogeneous(), y),
                   EpipolarDistance(F.transpose() * y.homogeneous(), x)) < options_.transfer_px;
    }
    return handed_on < options_.min_handed_on || agree >= options_.min_share * handed_on;
  }

  std::span<const ImageFeatures* const> features_;
  const ThreeViewOptions& options_;
  const std::vector<PairGeometry>& pairs_;
  std::map<std::pair<int, int>, size_t> at_;
  std::map<std::pair<int, int>, std::map<int, int>> forward_;  // junctions
};

}  // namespace

int RefuseInconsistentPairs(std::span<const ImageFeatures* const> features,
                            std::span<const char> suspect,
                            const ThreeViewOptions& options,
                            std::vector<PairGeometry>* pairs) {
  const Triples triples(features, options, *pairs);
  for (int refused = 0;; ++refused) {
    std::vector<int> blamed(pairs->size(), 0);
    for (const auto& triple : triples.Open()) {
      for (const size_t k : triple) blamed[k] += suspect[k] != 0;
    }
    size_t worst = pairs->size();
    for (size_t k = 0; k < pairs->size(); ++k) {
      if (blamed[k] == 0) continue;
      if (worst == pairs->size() || blamed[k] > blamed[worst] ||
          (blamed[k] == blamed[worst] &&
           (*pairs)[k].matches.size() < (*pairs)[worst].matches.size()))
        worst = k;
    }
    if (worst == pairs->size()) return refused;
    char text[128];
    std::snprintf(text,
                  sizeof(text),
                  "matches handed on through a third view contradict it (%d triples of views)",
                  blamed[worst]);
    (*pairs)[worst].F.reset();
    (*pairs)[worst].refusal = text;
  }
}

}  // namespace horopter
