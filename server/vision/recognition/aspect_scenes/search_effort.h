// What a search of scenes has done, whatever time that took.
#pragma once

#include <limits>

namespace horopter {

// In searches of one image for all parts; the others are rough shares of it. Counted on the thread
// that searches, between steps: an answer of limited effort is the same on every machine and with
// any number of threads.
class SearchEffort {
 public:
  explicit SearchEffort(double most = std::numeric_limits<double>::infinity()) : most_(most) {}

  void Limit(double most) { most_ = most; }
  void Spend(double effort) { spent_ += effort; }
  double spent() const { return spent_; }
  bool IsSpent() const { return spent_ >= most_; }

 private:
  double most_;
  double spent_ = 0.0;
};

inline constexpr double kImageEffort = 1.0;       // an image searched for all parts
inline constexpr double kFoundPartsEffort = 0.1;  // ... for those found
inline constexpr double kCompletionEffort = 0.3;  // a scene completed and verified
inline constexpr double kStandingEffort = 1.5;    // parts looked for on planes

}  // namespace horopter
