// Which views of a scene are searched for what: for all parts where that is needed, else for those
// that other views show.
#pragma once

#include <vector>

#include "server/vision/recognition/aspect_scenes/view_links.h"

namespace horopter {

// Poses of a part refined in views that were not searched for all
inline constexpr int kQuickPerObject = 16;

class ViewSearch {
 public:
  // What is pointed to outlives the object; what is found is added to the links.
  ViewSearch(const AspectLinkInput& input,
             const AspectLinkOptions& options,
             const StopRequested& stop,
             ViewLinks* links);

  // Whether every view has been searched for all parts.
  bool AllSearched() const;
  // For all parts: two views far from each other, which show what most views show; the view
  // farthest in number from those that were searched; all that are left.
  void SearchFirst();
  void SearchNext();
  void SearchRest();

  // For the scene's parts and only for them, in the wanted views or in those not searched for all:
  // so many poses of a part are refined, more than a search of the catalog does. Views looked at as
  // deeply before are left out.
  void SearchFor(const LinkedScene& found, const std::vector<bool>& wanted, int per_object);
  void SearchUnsearchedFor(const LinkedScene& found, int per_object);
  // What was looked at may be looked at again.
  void Forget() { depth_.assign(depth_.size(), 0); }

 private:
  void Search(int v);
  // Of the scene's parts in view v, working pixels, from their sizes in the other views.
  struct SizeRange {
    double least_px = 1e9, most_px = 0.0;
  };
  SizeRange SizesBeside(const LinkedScene& found, int v) const;
  // A first look trusts the size that other views show.
  FindAspectOptions Options(int per_object, const LinkedScene& found, int v) const;

  const AspectLinkInput& in_;
  const AspectLinkOptions& options_;
  const StopRequested& stop_;
  ViewLinks& links_;
  std::vector<bool> searched_;  // for all parts
  std::vector<int> depth_;      // of each view: poses of a part that were refined
};

}  // namespace horopter
