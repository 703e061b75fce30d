// The aspects of a catalog as requests search them: indexed once for each state of the catalog.
#pragma once

#include <memory>
#include <mutex>
#include <span>
#include <vector>

#include "server/vision/recognition/aspects/fragment_index.h"
#include "server/vision/recognition/object/prepared_object.h"

namespace horopter {

using PreparedObjects = std::span<const std::shared_ptr<const PreparedObject>>;

// Index of all aspects of the chosen objects, which must outlive it: part i is object chosen[i].
// 0.5 MB an object.
FragmentIndex MakeSearchIndex(PreparedObjects objects, std::span<const int> chosen, int threads);

// The indices of a list of objects, all with aspects, each made when it is asked for the first
// time. Thread-safe; who asks while one is made waits for it.
class CatalogAspects {
 public:
  explicit CatalogAspects(PreparedObjects objects) : objects_(objects.begin(), objects.end()) {}

  PreparedObjects objects() const { return objects_; }

  // All aspects of all objects.
  std::shared_ptr<const FragmentIndex> Search(int threads) const;

  // A few fragments of each object (object_ranking.h): 0.15 MB an object.
  std::shared_ptr<const FragmentIndex> Ranking(int threads) const;

 private:
  const std::vector<std::shared_ptr<const PreparedObject>> objects_;
  mutable std::mutex mutex_;
  mutable std::shared_ptr<const FragmentIndex> search_;   // guarded by mutex_
  mutable std::shared_ptr<const FragmentIndex> ranking_;  // guarded by mutex_
};

// The catalog of exactly these objects, by identity: requests over one state of a catalog share it.
// The last kRememberedCatalogs lists asked for are kept with their objects. Thread-safe.
inline constexpr int kRememberedCatalogs = 2;
std::shared_ptr<const CatalogAspects> SharedCatalogAspects(PreparedObjects objects);

}  // namespace horopter
