#include <cassert>
#include <cmath>

#include "server/index/box_kernels.h"
#include "server/index/walk.h"

namespace horopter {

using index_internal::BoxExcess;
using index_internal::Node;
using index_internal::SquaredDistances;
using index_internal::Walk;

std::vector<int64_t> XTreeSnapshot::Box(std::span<const double> low,
                                        std::span<const double> high,
                                        QueryStats* stats) const {
  assert(low.size() == static_cast<size_t>(dimensions()) && high.size() == low.size());
  std::vector<int64_t> ids;
  if (root_ == nullptr) return ids;
  QueryStats unused;
  const auto excess = [&](const Node& node, double* values) {
    BoxExcess(node, low.data(), high.data(), values);
  };
  Walk(*root_,
       options_.scan_share,
       stats != nullptr ? *stats : unused,
       excess,
       [&](const Node& node, double* values) {
         excess(node, values);
         for (int i = 0; i < node.count; ++i) {
           if (values[i] <= 0.0) ids.push_back(node.ids[i]);
         }
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
      [&](const Node& node, double* values) {
        SquaredDistances(node, center.data(), bound, values);
        for (int i = 0; i < node.count; ++i) values[i] -= bound;
      },
      [&](const Node& node, double* values) {
        if (!SquaredDistances(node, center.data(), bound, values)) return;
        for (int i = 0; i < node.count; ++i) {
          if (values[i] <= bound) found.push_back({node.ids[i], std::sqrt(values[i])});
        }
      });
  return found;
}

}  // namespace horopter
