// The invariant keys of a catalog that is too large for memory, in segments of some thousand shapes
// (key_segment.h) that never change: look-alikes are sought in them.
#pragma once

#include <functional>
#include <mutex>
#include <span>
#include <string>
#include <string_view>
#include <unordered_map>
#include <unordered_set>
#include <utility>
#include <vector>

#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "server/base/stop_token.h"
#include "server/vision/invariants/key_segment.h"

namespace horopter {

// Shapes of a segment; of fewer than kLeastMembers none is made, their keys stay in memory.
inline constexpr int kSegmentMembers = 4096;
inline constexpr int kLeastMembers = 256;

// Named by addresses (db/object_digest.h), segments hold for every catalog and every server that
// has these shapes, and for one version of the program; a folder of them may be shared. A damaged
// one is put into quarantine and made anew; one that cannot be written stays in memory, and the log
// says so. A segment is read when it is searched and let go: nothing of it stays in memory but
// where its shapes are, 0.2 kB each. Thread-safe: who asks while segments are made waits.
class KeySegments {
 public:
  // folder: made when it is first written to; empty: segments stay in memory.
  explicit KeySegments(std::string folder);

  // Gives the keys of the shapes with these numbers, ascending, to `take`, each once at most:
  // shapes that are left out stay uncovered.
  using TakeKeys = std::function<void(int number, const ObjectKeys& keys)>;
  using ReadKeys = std::function<absl::Status(std::span<const int> numbers, const TakeKeys& take)>;

  // Makes what is missing for these shapes to be found. Errors: those of `read`, CANCELLED.
  absl::Status Cover(std::span<const std::string> addresses,
                     const ReadKeys& read,
                     const StopRequested& stop);

  // For each shape how many keys it shares with these, as SharedKeys (key_index.h) counts; 0 for
  // those that are not covered.
  std::vector<int> SharedKeys(std::span<const std::string> addresses, const ObjectKeys& keys);

  // Calls compare(number, tally) for each of the shapes that is covered and returns how many are.
  int ForEachTally(std::span<const std::string> addresses,
                   const std::function<void(int number, const KeySegmentView::Tally&)>& compare);

  struct Figures {
    int segments = 0;
    int files = 0;        // of them
    int64_t bytes = 0;    // of all
    int64_t members = 0;  // of all
    int loose = 0;        // shapes whose keys are in memory
  };
  Figures figures();

 private:
  struct Segment {
    std::string path;   // of its file; empty: it is in memory
    std::string block;  // then
    int members = 0;
    int64_t bytes = 0;
  };
  struct Place {
    int segment = 0;
    int member = 0;
  };

  // All need mutex_.
  void OpenFolder(std::span<const std::string> addresses);
  // Takes a segment if it is sound and of use. Whether it has any of the wanted shapes.
  bool OpenFile(const std::string& path, const std::unordered_set<std::string_view>& wanted);
  void Adopt(Segment segment, const KeySegmentView& view);
  void Make(KeySegmentWriter writer);
  // Calls look(view) for a segment; one that cannot be read any more is given up: its shapes are
  // not covered from now on.
  void Look(int segment, const std::function<void(const KeySegmentView&)>& look);
  // The loose ones as one segment in memory.
  KeySegmentWriter LooseKeys() const;
  const std::string& LooseBlock();

  const std::string folder_;
  std::mutex mutex_;
  bool opened_ = false;
  std::vector<Segment> segments_;
  std::unordered_map<std::string, Place> places_;
  std::vector<std::pair<std::string, ObjectKeys>> loose_;
  std::unordered_map<std::string, int> loose_at_;
  std::string loose_block_;  // of loose_; empty: to be made
};

}  // namespace horopter
