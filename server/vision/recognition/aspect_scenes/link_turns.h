// The turns of a part by which hypotheses of it may link two views.
#pragma once

#include <functional>
#include <span>
#include <vector>

#include "server/vision/geometry/rigid3.h"
#include "server/vision/recognition/aspects/fragment_index.h"

namespace horopter {

inline constexpr std::size_t kMaxSymmetries = 24;  // of a part that are tried; chosen

class LinkTurns {
 public:
  // The parts outlive the object.
  explicit LinkTurns(std::span<const AspectModel> models);

  // The identity, the symmetries of a part and what is nearly one, at most kMaxSymmetries of each.
  std::vector<Rigid3> Of(int object) const;
  // The same of a list, spread over all of it: symmetries of a surface of revolution are listed
  // turn by turn.
  void AppendSpread(std::span<const Rigid3> all, std::vector<Rigid3>* turns) const;
  // Of a round part those that the edges of other parts bear out, `support` says how well; Of()
  // where they do not tell, and of every other part.
  std::vector<Rigid3> Supported(int object,
                                const std::function<double(const Rigid3&)>& support) const;

 private:
  std::span<const AspectModel> models_;
  // Of each part, in steps of three degrees, both ways up when that looks the same; empty: it is
  // not round.
  std::vector<std::vector<Rigid3>> fine_;
};

}  // namespace horopter
