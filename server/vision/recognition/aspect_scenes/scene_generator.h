// What proposes scenes: where the cameras are, and one part or more. Nothing else is a generator's:
// its proposals are adjusted, completed, verified and compared by the search (scene_search.h) as
// those of any other are.
#pragma once

#include <functional>
#include <optional>
#include <vector>

#include "server/vision/recognition/aspect_scenes/aspect_linking.h"
#include "server/vision/recognition/aspect_scenes/view_links.h"

namespace horopter {

struct Proposal {
  AspectScene scene;  // objects by the numbers of AspectLinkInput::models
  // Its cameras may be better than an adjustment finds that knows nothing of where they come from:
  // the images judge it as it is as well.
  bool as_it_is = false;
};

class SceneGenerator {
 public:
  // cost: what asking takes, in searches of one image for all parts; those that take less are asked
  // first. most: of its proposals that are adjusted.
  SceneGenerator(double cost, std::size_t most) : cost_(cost), most_(most) {}
  virtual ~SceneGenerator() = default;

  double cost() const { return cost_; }
  std::size_t most() const { return most_; }

  // Whether it may propose what the best scene so far, without objects at first, does not show.
  virtual bool Applies(const LinkedScene& best) const = 0;
  // Likeliest first, one a call; nothing when there is no other until more is known of the images.
  virtual std::optional<Proposal> Propose() = 0;

 private:
  double cost_;
  std::size_t most_;
};

// What a function lists, which is called once and not before it is asked for.
class ListedScenes final : public SceneGenerator {
 public:
  using List = std::function<std::vector<AspectScene>()>;
  ListedScenes(double cost, List list);
  bool Applies(const LinkedScene& best) const override;
  std::optional<Proposal> Propose() override;

 private:
  List list_;
  std::vector<AspectScene> scenes_;  // that are left, the next one last
};

// Links of pairs of views, through a part that single images show in both.
class LinkedPairs final : public SceneGenerator {
 public:
  // links outlives the object.
  explicit LinkedPairs(const ViewLinks& links);
  bool Applies(const LinkedScene& best) const override;
  std::optional<Proposal> Propose() override;

 private:
  const ViewLinks& links_;
  int known_ = -1;                  // ViewLinks::added when it was asked
  std::vector<GrownScene> starts_;  // that are left, the next one last
};

// Views linked by what is on a part's surface: of one that is printed all over edges explain too
// little in any two views.
class LinkedSurfaces final : public SceneGenerator {
 public:
  // What is pointed to outlives the object.
  LinkedSurfaces(const AspectLinkInput& input,
                 const AspectLinkOptions& options,
                 const ViewLinks& links,
                 const StopRequested& stop);
  bool Applies(const LinkedScene& best) const override;
  std::optional<Proposal> Propose() override;

 private:
  const AspectLinkInput& in_;
  const AspectLinkOptions& options_;
  const ViewLinks& links_;
  const StopRequested& stop_;
  int known_ = -1;
  std::vector<AspectScene> scenes_;
};

}  // namespace horopter
