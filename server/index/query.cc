#include <cassert>
#include <cmath>

#include "server/index/box_kernels.h"
#include "server/index/walk.h"

namespace horopter {

using index_internal::ForEachMeeting;
using index_internal::Node;
using index_internal::Scratch;
using index_internal::SquaredDistances;
using index_internal::Walk;

std::vector<int64_t> XTreeSnapshot::Box(std::span<const double> low,
                                        std::span<const double> high,
                                        QueryStats* stats) const {
  assert(low.size() == static_cast<size_t>(dimensions()) && high.size() == low.size());
  std::vector<int64_t> ids;
  if (root_ == nullptr) return ids;
  QueryStats unused;
  Walk(
      *root_,
      options_.scan_share,
      stats != nullptr ? *stats : unused,
      [&](const Node& node, Scratch&, auto visit) {
        ForEachMeeting(node, low.data(), high.data(), visit);
      },
      [&](const Node& node, Scratch&) {
        ForEachMeeting(node, low.data(), high.data(), [&](int i) { ids.push_back(node.ids[i]); });
      });
  return ids;
}

std::vector<Neighbor> XTreeSnapshot::Radius(std::span<const double> center,
                                            double radius,
                                            QueryStats* stats) const {
  assert(center.size() == static_cast<size_t>(dimensions()));
  std::vector<Neighbor> found;
  if (root_ == nullptr || !(radius >= 0.0)) return found;
  QueryStats unused;
  const double bound = radius * radius;
  Walk(
      *root_,
      options_.scan_share,
      stats != nullptr ? *stats : unused,
      [&](const Node& node, Scratch& scratch, auto visit) {
        double* values = scratch.For(node);
        SquaredDistances(node, center.data(), bound, values);
        for (int i = 0; i < node.count; ++i) {
          if (values[i] <= bound) visit(i);
        }
      },
      [&](const Node& node, Scratch& scratch) {
        double* values = scratch.For(node);
        if (!SquaredDistances(node, center.data(), bound, values)) return;
        for (int i = 0; i < node.count; ++i) {
          if (values[i] <= bound) found.push_back({node.ids[i], std::sqrt(values[i])});
        }
      });
  return found;
}

}  // namespace horopter
