#include "server/vision/recognition/aspect_scenes/link_turns.h"

#include <algorithm>
#include <cmath>
#include <numbers>
#include <numeric>

namespace horopter {
namespace {

constexpr int kFineTurns = 120;         // of a round part
constexpr int kPeaks = 3;               // of these, that are looked at closer
constexpr int kPeakWidth = 4;           // of kFineTurns: turns nearer are one peak; chosen
constexpr double kNearPeak = 0.7;       // of the best support
constexpr double kLeastCarried = 0.02;  // that tells turns apart
constexpr double kSameAxis = 0.01;      // between unit vectors

std::vector<Rigid3> FineTurns(const AspectModel& model) {
  std::vector<Rigid3> out;
  for (const SymmetryAxis& axis : model.round) {
    std::vector<Rigid3> sides = {Rigid3{}};
    for (const Rigid3& s : model.symmetries) {
      if ((s.R * axis.axis + axis.axis).norm() > kSameAxis) continue;
      sides.push_back(s);
      break;
    }
    for (const Rigid3& side : sides) {
      for (int k = 0; k < kFineTurns; ++k)
        out.push_back(TurnAbout(axis, 2 * std::numbers::pi * k / kFineTurns) * side);
    }
  }
  return out;
}

}  // namespace

LinkTurns::LinkTurns(std::span<const AspectModel> models) : models_(models) {
  for (const AspectModel& model : models) fine_.push_back(FineTurns(model));
}

std::vector<Rigid3> LinkTurns::Of(int object) const {
  std::vector<Rigid3> turns = {Rigid3{}};
  AppendSpread(models_[object].symmetries, &turns);
  AppendSpread(models_[object].near_turns, &turns);
  return turns;
}

void LinkTurns::AppendSpread(std::span<const Rigid3> all, std::vector<Rigid3>* turns) const {
  const std::size_t count = std::min(all.size(), kMaxSymmetries);
  for (std::size_t i = 0; i < count; ++i) turns->push_back(all[i * all.size() / count]);
}

std::vector<Rigid3> LinkTurns::Supported(
    int object, const std::function<double(const Rigid3&)>& support) const {
  const std::vector<Rigid3>& fine = fine_[object];
  if (fine.empty()) return Of(object);
  // Every other turn, then those beside the good ones.
  std::vector<double> supports(fine.size(), -1.0);
  double best = 0.0;
  for (std::size_t t = 0; t < fine.size(); t += 2) {
    supports[t] = support(fine[t]);
    best = std::max(best, supports[t]);
  }
  for (std::size_t t = 1; t < fine.size(); t += 2) {
    const std::size_t next = (t + 1) % kFineTurns == 0 ? t + 1 - kFineTurns : t + 1;
    if (std::max(supports[t - 1], supports[next]) > kNearPeak * best)
      supports[t] = support(fine[t]);
  }
  std::vector<int> order(fine.size());
  std::iota(order.begin(), order.end(), 0);
  std::stable_sort(
      order.begin(), order.end(), [&](int a, int b) { return supports[a] > supports[b]; });
  if (supports[order.front()] < kLeastCarried) return Of(object);
  std::vector<int> kept;
  for (const int t : order) {
    if (static_cast<int>(kept.size()) >= kPeaks) break;
    const bool beside = std::any_of(kept.begin(), kept.end(), [&](int k) {
      const int apart = std::abs(t - k) % kFineTurns;
      return t / kFineTurns == k / kFineTurns && std::min(apart, kFineTurns - apart) < kPeakWidth;
    });
    if (!beside) kept.push_back(t);
  }
  std::vector<Rigid3> out;
  for (const int t : kept) out.push_back(fine[t]);
  return out;
}

}  // namespace horopter
