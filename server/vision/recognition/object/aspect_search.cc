#include "server/vision/recognition/object/aspect_search.h"

#include <algorithm>
#include <deque>
#include <numeric>
#include <utility>

#include "server/base/parallel_for.h"
#include "server/vision/recognition/aspect_search/object_ranking.h"
#include "server/vision/recognition/object/aspect_model.h"

namespace horopter {

FragmentIndex MakeSearchIndex(PreparedObjects objects, std::span<const int> chosen, int threads) {
  std::vector<AspectModel> models;
  for (const int i : chosen) models.push_back(AspectModelOf(*objects[i]));
  return BuildFragmentIndex(models, threads);
}

std::shared_ptr<const FragmentIndex> CatalogAspects::Search(int threads) const {
  const std::lock_guard lock(mutex_);
  if (search_ != nullptr) return search_;
  std::vector<int> all(objects_.size());
  std::iota(all.begin(), all.end(), 0);
  search_ = std::make_shared<const FragmentIndex>(MakeSearchIndex(objects_, all, threads));
  return search_;
}

std::shared_ptr<const FragmentIndex> CatalogAspects::Ranking(int threads) const {
  const std::lock_guard lock(mutex_);
  if (ranking_ != nullptr) return ranking_;
  std::vector<FragmentPiece> pieces(objects_.size());
  ParallelFor(static_cast<int>(objects_.size()), threads, [&](int i) {
    const ModelAspects& aspects = *objects_[i]->aspects;
    pieces[i] = MakeFragmentPiece(aspects.object, aspects.fragments, kRankingChoice);
  });
  std::vector<const FragmentPiece*> pointers;
  for (const FragmentPiece& piece : pieces) pointers.push_back(&piece);
  ranking_ = std::make_shared<const FragmentIndex>(BuildFragmentIndex(pointers));
  return ranking_;
}

std::shared_ptr<const CatalogAspects> SharedCatalogAspects(PreparedObjects objects) {
  static std::mutex mutex;
  static auto* remembered = new std::deque<std::shared_ptr<const CatalogAspects>>;  // newest first
  const std::lock_guard lock(mutex);
  const auto known = std::find_if(remembered->begin(), remembered->end(), [&](const auto& catalog) {
    const PreparedObjects its = catalog->objects();
    return std::equal(its.begin(), its.end(), objects.begin(), objects.end());
  });
  std::shared_ptr<const CatalogAspects> found;
  if (known != remembered->end()) {
    found = *known;
    remembered->erase(known);
  } else {
    found = std::make_shared<const CatalogAspects>(objects);
  }
  remembered->push_front(found);
  if (remembered->size() > kRememberedCatalogs) remembered->pop_back();
  return found;
}

}  // namespace horopter
