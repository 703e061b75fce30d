#include "server/vision/recognition/object/look_alikes.h"

#include <algorithm>
#include <map>
#include <mutex>
#include <utility>

namespace horopter {
namespace {

constexpr int kAlignments = 4;         // of a shape that are tried
constexpr double kLookAlike = 0.03;    // diameters: mean distance of parts that look alike
constexpr double kSameExtents = 1.15;  // ratio

// How parts lie over each other, of pairs asked for lately: requests over one catalog ask for the
// same ones. Weak pointers: no part's place is reused.
class KnownAlignments {
 public:
  std::vector<ShapeAlignment> Of(const std::shared_ptr<const PreparedObject>& a,
                                 const std::shared_ptr<const PreparedObject>& b) {
    const Pair pair{a, b};
    {
      const std::lock_guard lock(mutex_);
      const auto known = known_.find(pair);
      if (known != known_.end()) return known->second;
    }
    std::vector<ShapeAlignment> found =
        AlignShapes(a->aspects->object.mesh, b->aspects->object.mesh, kAlignments, kSameExtents);
    std::erase_if(found, [](const auto& x) { return x.distance > kLookAlike; });
    const std::lock_guard lock(mutex_);
    if (known_.size() >= kMostKnown) known_.clear();
    return known_[pair] = std::move(found);
  }

 private:
  static constexpr std::size_t kMostKnown = 20000;
  using Part = std::weak_ptr<const PreparedObject>;
  using Pair = std::pair<Part, Part>;
  struct Before {
    bool operator()(const Pair& x, const Pair& y) const {
      if (x.first.owner_before(y.first)) return true;
      return !y.first.owner_before(x.first) && x.second.owner_before(y.second);
    }
  };
  std::mutex mutex_;
  std::map<Pair, std::vector<ShapeAlignment>, Before> known_;
};

}  // namespace

std::vector<ShapeAlignment> LookAlikeAlignments(const std::shared_ptr<const PreparedObject>& a,
                                                const std::shared_ptr<const PreparedObject>& b) {
  static KnownAlignments& known = *new KnownAlignments;
  if (a->aspects == nullptr || b->aspects == nullptr) return {};
  const double ratio = a->aspects->object.mesh.diameter_m / b->aspects->object.mesh.diameter_m;
  if (std::max(ratio, 1.0 / ratio) > kSameExtents) return {};
  return known.Of(a, b);
}

}  // namespace horopter
