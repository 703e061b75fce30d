#include "server/vision/recognition/aspect_scenes/scene_generator.h"

#include <algorithm>
#include <utility>

#include "server/vision/recognition/aspect_scenes/settled_scenes.h"
#include "server/vision/recognition/aspect_scenes/surface_links.h"

namespace horopter {
namespace {

constexpr std::size_t kMostListed = 24, kMostLinks = 10;
constexpr double kLinksCost = 0.3, kSurfacesCost = 2.0;  // rough; their order is what counts

// The last of a list, which loses it.
template <typename T>
std::optional<T> TakeLast(std::vector<T>* list) {
  if (list->empty()) return std::nullopt;
  T last = std::move(list->back());
  list->pop_back();
  return last;
}

}  // namespace

ListedScenes::ListedScenes(double cost, List list)
    : SceneGenerator(cost, kMostListed), list_(std::move(list)) {}

bool ListedScenes::Applies(const LinkedScene&) const {
  return list_ || !scenes_.empty();
}

std::optional<Proposal> ListedScenes::Propose() {
  if (list_) {
    scenes_ = std::exchange(list_, nullptr)();
    std::reverse(scenes_.begin(), scenes_.end());
  }
  std::optional<AspectScene> next = TakeLast(&scenes_);
  if (!next) return std::nullopt;
  return Proposal{*std::move(next), true};
}

LinkedPairs::LinkedPairs(const ViewLinks& links)
    : SceneGenerator(kLinksCost, kMostLinks), links_(links) {}

bool LinkedPairs::Applies(const LinkedScene&) const {
  return links_.added() != known_;
}

std::optional<Proposal> LinkedPairs::Propose() {
  if (links_.added() != known_) {
    known_ = links_.added();
    starts_ = links_.InitialScenes();
    std::reverse(starts_.begin(), starts_.end());
  }
  const std::optional<GrownScene> start = TakeLast(&starts_);
  if (!start) return std::nullopt;
  Proposal out;
  out.scene.views = start->views;
  for (const GrownObject& o : start->objects) out.scene.objects.push_back(o.placed);
  links_.AdjustToHypotheses(*start, &out.scene);
  return out;
}

LinkedSurfaces::LinkedSurfaces(const AspectLinkInput& input,
                               const AspectLinkOptions& options,
                               const ViewLinks& links,
                               const StopRequested& stop)
    : SceneGenerator(kSurfacesCost, kMostLinks),
      in_(input),
      options_(options),
      links_(links),
      stop_(stop) {}

bool LinkedSurfaces::Applies(const LinkedScene& best) const {
  return options_.printed_surfaces && !IsCredible(best) && links_.added() != known_;
}

std::optional<Proposal> LinkedSurfaces::Propose() {
  if (links_.added() != known_) {
    known_ = links_.added();
    scenes_.clear();
    for (const AspectScene& scene : ScenesBySurface(in_, options_, links_, stop_)) {
      scenes_.push_back(scene);
      scenes_.push_back(FromOneFocal(in_, options_, scene));
    }
    std::reverse(scenes_.begin(), scenes_.end());
  }
  std::optional<AspectScene> next = TakeLast(&scenes_);
  if (!next) return std::nullopt;
  return Proposal{*std::move(next)};
}

}  // namespace horopter
