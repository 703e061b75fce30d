// Three views at a time: matches handed on from view to view must keep to the epipolar geometry
// that leads back (thesis 2.7; the transfer that a trifocal tensor makes, for pairs whose F came
// alone).
#pragma once

#include <span>
#include <vector>

#include "server/vision/matching/matching.h"
#include "server/vision/matching/matching_options.h"

namespace horopter {

// Takes F from pairs until all triples of views with three of them close; returns how many. In a
// triple that does not close one of the three is wrong: it is the suspect in most such triples,
// then the one of fewest matches. suspect: per pair; others (of a plane that all views share, which
// were solved together) are never refused. Refused pairs say why and keep their matches.
int RefuseInconsistentPairs(std::span<const ImageFeatures* const> features,
                            std::span<const char> suspect,
                            const ThreeViewOptions& options,
                            std::vector<PairGeometry>* pairs);

}  // namespace horopter
