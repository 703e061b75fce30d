// Target files of BOP: which images of which scenes a method is asked for.
#pragma once

#include <string>
#include <vector>

#include "absl/status/statusor.h"

namespace horopter {

// Images of one scene that are taken together. Empty im_ids: all of them.
struct BopImageSet {
  int scene_id = 0;
  std::vector<int> im_ids;           // ascending
  std::vector<std::string> sensors;  // empty: all
};

// Reads a list of {"scene_id", "im_ids" (test_targets_multiview_bop25.json: views of one static
// scene), or "im_id"} in the file's order; what else an entry says (obj_id, inst_count) is what a
// detector has to find out. Entries of the same images are one set; entries of single images are a
// set a scene, because Horopter takes all views of a scene together.
// Errors: NOT_FOUND, INVALID_ARGUMENT (another form; the file and the entry are named).
absl::StatusOr<std::vector<BopImageSet>> ReadBopTargets(const std::string& path);

// DATASET/SPLIT_targets_multiview_bop25.json where it is there, else empty. Of "test_primesense"
// and the like the file of "test".
std::string MultiviewTargetsOf(const std::string& dataset, const std::string& split);

}  // namespace horopter
